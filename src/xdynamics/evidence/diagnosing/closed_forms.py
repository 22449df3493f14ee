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
from xdynamics.model.motion import constants, evaluated_many, tables_of
from xdynamics.schema import STEPS

Floats = NDArray[np.float64]


def residuals(rows: Chunks, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the residuals of a run against closed forms at its accepted states."""
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    run, model = rows.run, rows.model
    for name, text in exact.items():
        if name not in model.units or name not in run.variables:
            raise InputError(f"exact names '{name}'; there are {', '.join(model.units)}")
        computed, expected = _beside_closed_form(rows, name, text)
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


def _beside_closed_form(rows: Chunks, name: str, text: str) -> tuple[Floats, Floats]:
    """Return a variable, and an expression of time and parameters in its unit, at the accepted times.

    Raises
    ------
    InputError
        If the expression cannot be read, reads anything else, or has another dimension.
    """
    ledger, model = Ledger(f"exact '{name}'"), rows.model
    with ledger.entry(repr(text)[:60]):
        tree = model.expanded(parse(text))
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
