"""Proven bounds as one Dataset, with what was proven in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.schema import AT, AT_TIME, ENCLOSURE, PROVEN, STEPS, bounds_of
from xdynamics.tubes.boxes import Box, enclosed, multiply
from xdynamics.tubes.interval_problem import intervals, unbounded
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

MODEL = "model_toml"
COMPLETED, NOT_PROVEN = "completed", "not_proven"


@dataclass(frozen=True)
class Tube:
    """Bounds at some times.

    Attributes
    ----------
    times : ndarray, shape (k,), s
    bounds : ndarray, shape (2, k, numbers)
        Of coordinates, velocities and states in SI units; nan at a time that no proof reached.
    steps : int
    reached : float
        The time up to which the proof holds, s.
    reason : str
        Why it goes no further; empty if it goes to the end.
    at_times : bool
        Whether these times were asked for; else they are those after each step.
    """

    times: NDArray[np.float64]
    bounds: Box
    steps: int
    reached: float
    reason: str
    at_times: bool = False


def enclosure_dataset(model: Model, tube: Tube, order: int, tolerance: float) -> xr.Dataset:
    """Return the evidence."""
    along, unit = (AT, AT_TIME) if tube.at_times else (STEPS, "time"), model.time_unit.text
    long_name = "time at which bounds were asked for" if tube.at_times else "time after a step"
    variables: dict[str, Any] = {along[1]: ((along[0],), tube.times, about(unit, long_name, "time"))}
    variables |= dict(_bounds(model, tube, along[0]))
    variables[MODEL] = ((), np.array(model.to_toml()), about("1", "the whole model as TOML", "model"))
    outcome = NOT_PROVEN if tube.reason else COMPLETED
    suffix = unit_suffix(model.time_unit)
    attributes = {
        "summary": proposition(model, tube),
        PROVEN: 1,
        "proven_until": tube.reached,
        "outcome": outcome,
        "outcome_text": (
            f"no bounds are proven after t = {tube.reached!r}{suffix}: {tube.reason}"
            if tube.reason
            else f"proven to the end, t = {tube.reached!r}{suffix}, in {tube.steps} steps"
        ),
        "solver_method": "Taylor series in intervals, carried as Lohner's set",
        "solver_order": order,
        "solver_rtol": tolerance,
        "solver_steps": tube.steps,
        "precision": "intervals of float64, rounded outward",
        "math_functions": NAME,
        "model_digest": model.digest,
    }
    return exhibit(ENCLOSURE, f"Proven bounds of {model.name}", [], variables, attributes, shapes=model.shapes)


def proposition(model: Model, tube: Tube) -> str:
    """Say what is proven."""
    suffix, start = unit_suffix(model.time_unit), model.initial["t"].si
    named = intervals(model)
    whose = f"For every {', '.join(named)} within its half_width, and all else as written" if named else "As written"
    text = (
        f"{whose}, the motion exists and is unique from t = {start!r}{suffix} to {tube.reached!r}{suffix}, and at every"
        f" time told here each quantity y lies between {' and '.join(bounds_of('y'))}."
    )
    if ignored := unbounded(model):
        text += f" Standard uncertainties, of {', '.join(ignored)}, are no bounds: the values alone count."
    return text


def _bounds(model: Model, tube: Tube, along: str) -> Iterator[tuple[str, Any]]:
    """Yield lower and upper bounds of every quantity, in its own unit."""
    for i, name in enumerate(layout_of(model).used):
        unit = model.units[name]
        both = zip(bounds_of(name), ("lower", "upper"), _in_units(tube.bounds[:, :, i], unit.factor), strict=True)
        for key, side, values in both:
            yield key, ((along,), values, about(unit.text, f"proven {side} bound of {name}", f"{side}_bound"))


def _in_units(bounds: Box, factor: Fraction) -> Box:
    """Return bounds in SI units in another unit, rounded outward."""
    return bounds if factor == 1 else multiply(bounds, enclosed(1 / factor)[:, None])


def lines_of(enclosure: xr.Dataset) -> list[str]:
    """Say what is proven, and the last bounds."""
    lines = [str(enclosure.attrs["summary"]), str(enclosure.attrs["outcome_text"])]
    along, time = (AT, AT_TIME) if AT_TIME in enclosure.variables else (STEPS, "time")
    prefix, _ = bounds_of("")
    names = [str(name).removeprefix(prefix) for name in enclosure.data_vars if str(name).startswith(prefix)]
    firsts = [enclosure[bounds_of(name)[0]].values.reshape(enclosure.sizes[along], -1)[:, 0] for name in names]
    known = np.flatnonzero(np.isfinite(firsts).all(axis=0))
    if not known.size:
        return lines
    last = enclosure.isel({along: int(known[-1])})
    lines.append(f"at t = {float(last[time])!r}{unit_suffix(str(enclosure[time].attrs['units']))}")
    for name in names:
        low, high = (last[bound] for bound in bounds_of(name))
        lines.append(f"  {name:<8}  {_between(low.values, high.values)}{unit_suffix(str(low.attrs['units']))}")
    return lines


def _between(low: Any, high: Any) -> str:
    """Write two bounds, or of many how far they are apart at most."""
    width = float((high - low).max())
    return f"{float(low)!r} to {float(high)!r}, {width:.2g}" if low.ndim == 0 else f"{low.size} of width {width:.2g}"
