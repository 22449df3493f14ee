"""Residuals of a run against closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.evidence_dataset import about
from xdynamics.evidence.scaling import scale_of, scaled
from xdynamics.expressions import dimension_of, free_names, parse
from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model
from xdynamics.model.motion import constants, evaluated_many, tables_of
from xdynamics.record.element_attributes import of_wholes
from xdynamics.schema import STEPS
from xdynamics.shapes.naming import written
from xdynamics.shapes.trees import at, dims_of, prepared

Floats = NDArray[np.float64]


def residuals(rows: Chunks, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the residuals of a run against closed forms at its accepted states."""
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    run, model = rows.run, rows.model
    for name, text, place in _of_elements(model, exact):
        if name not in model.units or name not in run.variables:
            raise InputError(f"exact names '{name}'; there are {', '.join(of_wholes(model.units))}")
        computed, expected = _beside_closed_form(rows, name, text, place)
        residual = computed - expected
        units = str(run[name].attrs["units"])
        yield f"residual_{name}", ((STEPS,), residual, about(units, f"{name} less {text}", "residual"))
        yield (
            f"largest_residual_{name}",
            ((), float(np.max(np.abs(residual))), about(units, f"largest size of residual_{name}", "residual")),
        )
        yield (
            f"rms_residual_{name}",
            (
                (),
                float(np.sqrt(np.mean(residual**2))),
                about(units, f"root of the mean square of residual_{name}", "residual"),
            ),
        )
        scale_text = f"largest size of {text} at the accepted times; where that is 0, of {name} as computed"
        scale = scale_of(expected, computed)
        yield from scaled("residual", name, residual, scale, (STEPS,), units, scale_text, ("largest", "rms")).items()


def _of_elements(model: Model, exact: Mapping[str, str]) -> Iterator[tuple[str, str, Mapping[str, int]]]:
    """Yield each closed form with the name and the place of each element that it is of."""
    for name, text in exact.items():
        whole = written(name)
        for place in model.shapes.places(model.shapes.dims.get(whole, ())):
            yield model.shapes.element(whole, place), text, place


def _beside_closed_form(rows: Chunks, name: str, text: str, place: Mapping[str, int]) -> tuple[Floats, Floats]:
    """Return a variable, and an expression of time and parameters in its unit, at the accepted times.

    Raises
    ------
    InputError
        If the expression cannot be read, reads anything else, or has another dimension.
    """
    ledger, model = Ledger(f"exact '{name}'"), rows.model
    with ledger.entry(repr(text)[:60]):
        whole = prepared(parse(text), model.shapes)
        if further := [dim for dim in dims_of(whole, model.shapes) if dim not in place]:
            raise InputError(
                f"has the dimension '{further[0]}', which {name} does not have; reduce it, like sum(…, {further[0]})"
            )
        tree = model.expanded(at(whole, place, model.shapes))
        dimension = dimension_of(tree, model.dimensions)
        if read := sorted(free_names(tree) & {*model.units, *model.drives}):
            raise InputError(f"reads '{read[0]}', which is what is computed; a closed form is of t and parameters")
        if dimension != model.units[name].dimension:
            raise InputError(f"has units '{dimension}', needs '{model.units[name].text}'")
    ledger.raise_faults()
    computed, expected = np.zeros((2, rows.size))
    for part in rows.parts("time", *model.units):
        times, here = part.own("time"), slice(part.first, part.first + part.count)
        state = {variable: part.own(variable) * float(unit.factor) for variable, unit in model.units.items()}
        values = evaluated_many(model, [tree], state | {"t": times}, constants(model), tables_of(model))[0]
        computed[here], expected[here] = (
            part.own(name),
            np.broadcast_to(values, times.shape) / float(model.units[name].factor),
        )
    return computed, expected
