"""What a model's inputs may have a number off: parameters, values at the start, measured tables, declared discrepancies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.target import Target
from xdynamics.budgeting.term import COVERED, PHYSICAL, Term
from xdynamics.evidence.marching import march
from xdynamics.faults import InputError
from xdynamics.march.asking import settings_for
from xdynamics.model import Model
from xdynamics.model.drives import Table
from xdynamics.model.parts import Drive, Parameter
from xdynamics.model.spread import NORMAL, normal_quantile
from xdynamics.sweeping.axes import FOR_INITIAL
from xdynamics.units import Unit, spell

Floats = NDArray[np.float64]

DISCREPANCY = "discrepancy"
SHIFTS = (1e-2, 2.5e-3, 6.25e-4, 1.5625e-4)  # of an input, or of its uncertainty where that is larger, for a slope
SIDES = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0  # of a slope of sixth order from these sides
SHARPER = 1e-3  # of its own, the time tolerance of events in what slopes are taken from
LINES = 64  # resampled tables
LEAST = 2.0**-54
BY_DIFFERENCES = "slope by central differences of sixth order over {0:.3g} of it; next to {1:.1g} of itself"


def inputs(model: Model, target: Target, asked: dict[str, Any]) -> list[Term]:
    """Return a term for everything that has an uncertainty in the model.

    Raises
    ------
    InputError
        If the number is not there any more where an input is changed a little.
    """
    known = model.uncertain
    if not known:
        return []
    slopes = _slopes(model, target, asked)
    found = []
    for name, one in known.items():
        factor, (slope, off, shift) = float(one.quantity.unit.factor), slopes[name]
        assert one.spread is not None  # noqa: S101
        size = one.spread.size.si / factor if one.spread.bounded else COVERED * one.uncertainty
        rule = BY_DIFFERENCES.format(shift, off / abs(slope) if slope else 0.0)
        found.append(Term(
            name, PHYSICAL, abs(slope) * one.uncertainty, abs(slope) * size, rule, slope / factor,
            one.uncertainty * factor, spell(one.quantity.unit.dimension),
        ))  # fmt: skip
    return found


def _slopes(model: Model, target: Target, asked: dict[str, Any]) -> dict[str, tuple[float, float, float]]:
    """Return the slope of the number by every input, per its own unit, how sure it is, and over what: copies side by side.

    Of several spacings that one is taken from which the next differs least: wider ones are bent, narrower ones rounded.
    """
    known = model.uncertain
    sizes = {name: max(abs(one.quantity.value), one.uncertainty) for name, one in known.items()}
    moves = np.multiply.outer(np.array(SHIFTS), SIDES)
    values = {name: np.full((len(known), *moves.shape), one.quantity.value) for name, one in known.items()}
    for i, name in enumerate(known):
        values[name][i] += sizes[name] * moves
    axes = {"input": {named(model, name): _with_units(one.ravel(), known[name]) for name, one in values.items()}}
    sharp = asked | {"time_tolerance": SHARPER * settings_for(model, **asked).time_tolerance}
    found = target.values(target.in_many(model, axes, sharp)).reshape(len(known), *moves.shape)
    told = {}
    for i, name in enumerate(known):
        slopes = found[i] @ WEIGHTS / (sizes[name] * np.array(SHIFTS))
        off = np.abs(np.diff(slopes))
        if not np.isfinite(off).any():
            raise InputError(f"{target.said} is not there any more where '{name}' is changed by a ten-thousandth: a budget of small changes says nothing of it; draw, by a sweep")  # fmt: skip
        k = int(np.nanargmin(off))
        told[name] = float(slopes[k]), float(off[k]), SHIFTS[k]
    return told


def named(model: Model, name: str) -> str:
    """Return what an axis over an input is called: of a start not like the variable itself."""
    return f"{FOR_INITIAL}{name}" if name in model.starts else name


def _with_units(values: Floats, one: Parameter) -> Any:
    import xarray as xr

    return xr.DataArray(values, attrs={"units": one.quantity.unit.text})


def tables(model: Model, target: Target, asked: dict[str, Any], value: float, seed: int) -> list[Term]:
    """Return a term for every measured table that tells its uncertainties: drawn anew, line by line."""
    return [
        _resampled(model, target, asked, value, name, drive, seed)
        for name, drive in model.drives.items()
        if drive.table.uncertainty is not None and drive.table.uncertainty.any()
    ]


def _resampled(model: Model, target: Target, asked: dict[str, Any], value: float, name: str, drive: Drive, seed: int) -> Term:  # fmt: skip
    table, rng = drive.table, np.random.default_rng(seed)
    assert table.uncertainty is not None  # noqa: S101
    points = np.maximum(rng.random((LINES // 2, len(table.value))), LEAST)
    found = []
    for deviates in normal_quantile(points):
        for sign in (1.0, -1.0):  # pairs, of which what is linear has the mean that it has
            text = _written(table, table.value + sign * deviates * table.uncertainty)
            changed = model.replace(drives={name: {**_said(model, name), "csv": text}})
            found.append(target.in_run(march(changed, **asked), changed)[0])
    standard = float(np.sqrt(np.mean((np.array(found) - value) ** 2)))
    rule = f"{LINES} tables with every line drawn anew from its uncertainty; known to {100 / np.sqrt(LINES):.0f} %"
    return Term(name, PHYSICAL, standard, COVERED * standard, rule)


def _said(model: Model, name: str) -> dict[str, Any]:
    import tomllib

    found: dict[str, Any] = tomllib.loads(model.to_toml())["drives"][name]
    return found


def _written(table: Table, values: Floats) -> str:
    """Write a table with other values, in the units that it has."""
    factors = [float(one.factor) for one in (table.argument_unit, table.value_unit)]
    head = f"argument [{table.argument_unit.text}],value [{table.value_unit.text}]"
    rows = (f"{x!r},{y!r}" for x, y in zip((table.argument / factors[0]).tolist(), (values / factors[1]).tolist(), strict=True))  # fmt: skip
    return "\n".join([head, *rows, ""])


def discrepancy(model: Model, target: Target, unit: Unit) -> list[Term]:
    """Return what the model declares of its own approximations, of the quantity that is asked for."""
    one = model.discrepancy.get(target.quantity)
    if one is None:
        return []
    standard = one.standard.si / float(unit.factor)
    return [Term(DISCREPANCY, PHYSICAL, standard, COVERED * standard, one.description or "declared in the model")]


def covariance(model: Model, terms: list[Term]) -> Floats:
    """Return the covariances of what terms contribute: those of inputs that the model correlates, and variances."""
    found = np.diag([one.standard**2 for one in terms])
    names = [one.name for one in terms]
    for (first, second), correlation in model.correlations.items():
        if first in names and second in names and model.uncertain[first].spread.distribution == NORMAL:  # type: ignore[union-attr]
            i, j = names.index(first), names.index(second)
            one, other = terms[i], terms[j]
            shared = correlation * one.sensitivity * one.input_uncertainty * other.sensitivity * other.input_uncertainty
            found[i, j] = found[j, i] = shared
    return found
