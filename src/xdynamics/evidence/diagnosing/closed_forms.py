"""Residuals of a run against closed forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.scaling import scale_of, scaled_variables
from xdynamics.expressions import Node, dimension_of, free_names, parse
from xdynamics.faults import InputError, Ledger
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states
from xdynamics.record.element_attributes import quantity_names
from xdynamics.schema import STEPS
from xdynamics.shapes.trees import at_element, dims_of, resolve_min_max

Floats = NDArray[np.float64]


def closed_form_residuals(rows: Chunks, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the residuals of a run against closed forms at its accepted states.

    Raises
    ------
    InputError
        If closed forms are not given by name, or one cannot be evaluated.
    """
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    run = rows.run
    forms = [form for name, text in exact.items() for form in _element_closed_forms(rows, name, text)]
    for (name, text, _), computed, expected in zip(forms, *_computed_and_expected(rows, forms), strict=True):
        residual = computed - expected
        units = str(run[name].attrs["units"])
        yield f"residual_{name}", ((STEPS,), residual, attrs_of(units, f"{name} less {text}", "residual"))
        yield (
            f"largest_residual_{name}",
            ((), float(np.max(np.abs(residual))), attrs_of(units, f"largest size of residual_{name}", "residual")),
        )
        yield (
            f"rms_residual_{name}",
            (
                (),
                float(np.sqrt(np.mean(residual**2))),
                attrs_of(units, f"root of the mean square of residual_{name}", "residual"),
            ),
        )
        scale_text = f"largest size of {text} at the accepted times; where that is 0, of {name} as computed"
        scale = scale_of(expected, computed)
        yield from scaled_variables(
            "residual", name, residual, scale, (STEPS,), units, scale_text, ("largest", "rms")
        ).items()


def _element_closed_forms(rows: Chunks, name: str, text: str) -> Iterator[tuple[str, str, Node]]:
    """Yield the closed form of each element of a quantity, which is read and checked once.

    Raises
    ------
    InputError
        If there is no such quantity, or the expression cannot be read, reads anything but time and parameters, or has
        another dimension.
    """
    model, quantity_name = rows.model, rows.model.shapes.internal_name(name)
    shapes = model.shapes
    places = shapes.index_combinations(shapes.dims.get(quantity_name, ()))
    elements = [(shapes.element_at(quantity_name, element_index), element_index) for element_index in places]
    first, element_index = elements[0]
    if first not in model.units or first not in rows.run.variables:
        raise InputError(f"exact names '{first}'; there are {', '.join(quantity_names(model.units))}")
    ledger = Ledger(f"exact '{name}'")
    with ledger.entry(repr(text)[:60]):
        tree = resolve_min_max(parse(text), shapes)
        if further := [dim for dim in dims_of(tree, shapes) if dim not in element_index]:
            raise InputError(
                f"has the dimension '{further[0]}', which {name} does not have; reduce it, like sum(…, {further[0]})"
            )
        dimension = dimension_of(model.expanded(at_element(tree, element_index, shapes)), model.dimensions)
        if dimension != model.units[first].dimension:
            raise InputError(f"has units '{dimension}', needs '{model.units[first].text}'")
        computed = {*model.units, *model.drives}
        for element, element_index in elements:
            element_tree = model.expanded(at_element(tree, element_index, shapes))
            if read := sorted(free_names(element_tree) & computed):
                raise InputError(f"reads '{read[0]}', which is what is computed; a closed form is of t and parameters")
            yield element, text, element_tree
    ledger.raise_faults()


def _computed_and_expected(rows: Chunks, forms: Sequence[tuple[str, str, Node]]) -> tuple[Floats, Floats]:
    """Return variables, and expressions of time and parameters in their units, at the accepted times."""
    model, trees = rows.model, [tree for _, _, tree in forms]
    units = {name: float(model.units[name].factor) for name, _, _ in forms}
    drive_inputs = {name for argument_tree in model.looked_up_at.values() for name in free_names(argument_tree)} & {
        *model.units
    }
    computed, expected = np.zeros((2, len(forms), rows.size))
    for part in rows.parts("time", *dict.fromkeys((*units, *drive_inputs))):
        times, row_slice = part.own_rows("time"), slice(part.first, part.first + part.count)
        state = {name: part.own_rows(name) * float(model.units[name].factor) for name in drive_inputs} | {"t": times}
        values = evaluate_over_states(model, trees, state, constants(model), drive_pieces(model))
        for i, ((name, _, _), value) in enumerate(zip(forms, values, strict=True)):
            computed[i, row_slice], expected[i, row_slice] = (
                part.own_rows(name),
                np.broadcast_to(value, times.shape) / units[name],
            )
    return computed, expected
