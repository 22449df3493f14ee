"""How fast two runs part that begin next to each other: the largest Lyapunov exponent, where motion has one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.inside import model_of, sampled
from xdynamics.elementary.arrays import dot, least_squares, log
from xdynamics.evidence.marching import march
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record.provenance import asked_of

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

BESIDE = 1e-8  # of the range of each quantity, by which the other run begins beside
LOOKED_AT = 400  # times
NEAR = 0.03  # of the ranges, up to which runs part as linear equations have them
GROWN = 100.0  # times, from which on a growth is one


class Parting(NamedTuple):
    """How two runs part.

    Attributes
    ----------
    exponent : float, s-1
        Slope of the logarithm of their distance, by least squares; 0 where they stay together or part by a power of time.
    run : xarray.Dataset
        The one that begins beside.
    """

    exponent: float
    run: xr.Dataset


def parting(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None) -> Parting:
    """March the model of a run once more from a start beside its own, and see how the distance grows.

    It is the growth along this run, from its start on: a global exponent, of a strange attractor for instance, is its mean
    over a time that is much longer than it takes to part.

    The distance is the root of the sum of squares of all differences of coordinates, velocities and states over their
    ranges in the run. It has an exponent if it grows a hundredfold before it is 3 % of the ranges, and if its logarithm
    lies closer to a line in time than to one in the logarithm of time.
    """
    model = model_of(run, functions)
    names = [name for name in model.units if float(np.ptp(np.asarray(run[name]))) > 0.0]
    if not names:
        raise InputError("nothing moves in the run: there is no range that a start beside its own could be measured by")
    ranges = {name: float(np.ptp(np.asarray(run[name]))) for name in names}
    other = _beside(run, model, ranges)
    begin, end = float(run["time"][0]), min(float(one["time"][-1]) for one in (run, other))
    times = np.linspace(begin, end, LOOKED_AT)
    each = [sampled(one, times, after=True, rule=REINTEGRATE, functions=functions) for one in (run, other)]
    apart = np.sqrt(
        sum(((np.asarray(each[1][name]) - np.asarray(each[0][name])) / ranges[name]) ** 2 for name in names)
    )
    return Parting(_exponent(times - begin, np.asarray(apart)), other)


def _beside(run: xr.Dataset, model: Model, ranges: Mapping[str, float]) -> xr.Dataset:
    """March from a start beside the run's own, above it or, where contacts do not let it, below."""
    asked, why = asked_of(run) | {"force_samples": "none"}, ""
    for sign in (1.0, -1.0):
        started = {name: float(run[name][0]) + sign * BESIDE * span for name, span in ranges.items()}
        values = {name: f"{value!r} {run[name].attrs['units']}" for name, value in started.items()}
        try:
            return march(model.replace(initial=values), **asked)
        except InputError as error:
            why = str(error)
    raise InputError(f"there is no start beside the run's own: {why}")


def _exponent(times: Floats, apart: Floats) -> float:
    """Fit the growth of a distance while it is small."""
    far = np.flatnonzero(apart > NEAR)
    last = int(far[0]) if far.size else len(apart)
    t, size = times[1:last], apart[1:last]
    known = size > 0.0
    t, size = t[known], log(size[known])
    if t.size < 8 or size.max() - size[0] < log(GROWN):
        return 0.0
    lines = [np.stack([np.ones(t.size), x], axis=1) for x in (t, log(t))]
    fits = [least_squares(one, size) for one in lines]
    straight, power = (float(np.sum((size - dot(one, fit)) ** 2)) for one, fit in zip(lines, fits, strict=True))
    return float(fits[0][1]) if straight < power else 0.0
