"""Which share of a number's variance is whose: Sobol's indices, from a design of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.sweeping.axes import range_of
from xdynamics.sweeping.designs import Draws
from xdynamics.sweeping.members import OUTCOME
from xdynamics.sweeping.surveying import ROLE
from xdynamics.sweeping.sweep import sweep as swept

if TYPE_CHECKING:
    import xarray as xr

SHARES = {
    "first_order": "share of the variance that the parameter has alone",
    "total_order": "share that it has with all that it acts together with",
}


def sobol_indices(
    model: Model,
    ranges: Mapping[str, Sequence[Any]],
    quantity: str,
    *,
    draws: int = 1024,
    seed: int = 0,
    resamples: int = 200,
    **settings: Any,
) -> xr.Dataset:
    """Say which share of a number's variance each parameter has, alone and with all that it acts together with.

    Parameters
    ----------
    model : Model
    ranges : mapping of str to (lowest, highest)
        Parameters or initial values, spread evenly between.
    quantity : str
        A word of `keep` that stands for one number: ``"end_y"``, ``"event_time_ground"``, ``"maximum_y"``.
    draws : int
        A power of two; draws*(2 + parameters) members are marched.
    seed : int
    resamples : int
        Of the bootstrap that the intervals are from.
    **settings
        Of `simulate`, for all members.

    Returns
    -------
    xarray.Dataset
        Along `parameter`: ``parameter_name``, ``first_order``, ``total_order`` and their 95 % intervals along `bound`.

    Raises
    ------
    InputError
        If a range or the quantity cannot be used, or a member does not come to a number.

    Notes
    -----
    Saltelli et al. 2010 (doi:10.1016/j.cpc.2009.09.018), by `scipy.stats.sobol_indices`. The intervals are percentiles
    of the indices of draws that are drawn again (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section
    13.3), by `seed`: its own bootstrap takes none, and would give others in each call.
    """
    names = list(ranges)
    # two designs at once: columns of independent points, and each of the first with one column of the second
    points = Draws(draws, {f"{name}{k}": (0, 1) for k in "ab" for name in names}, seed=seed).points()
    a, b = points[:, : len(names)], points[:, len(names) :]
    mixed = [np.where(np.arange(len(names)) == i, b, a) for i in range(len(names))]
    spread = np.concatenate([a, b, *mixed])
    values = {name: _spread(model, name, ranges[name], spread[:, i]) for i, name in enumerate(names)}
    found = swept(model, {"draw": values}, keep=[quantity], **settings)
    if quantity not in found or found[quantity].dims != ("draw",):
        raise InputError(f"quantity is {quantity!r}, needs a word that stands for one number, like 'end_{next(iter(model.units))}'")  # fmt: skip
    f = found[quantity].values.astype(float)
    if not np.isfinite(f).all():
        i = int(np.flatnonzero(~np.isfinite(f))[0])
        raise InputError(f"member {i} has no {quantity}: it ended as '{found[OUTCOME].values[i]}'; narrow the ranges")
    told = _shares(f.reshape(2 + len(names), draws))
    again = np.random.default_rng(seed).integers(draws, size=(resamples, draws))
    low, high = np.quantile([_shares(f.reshape(2 + len(names), draws)[:, one]) for one in again], [0.025, 0.975], axis=0)  # fmt: skip
    variables: dict[str, Any] = {
        "parameter_name": (("parameter",), np.array(names), about("1", "what was varied", "name"))
    }
    for i, (name, words) in enumerate(SHARES.items()):
        variables[name] = (("parameter",), told[i], about("1", words, ROLE))
        variables[f"{name}_interval"] = (
            ("parameter", "bound"),
            np.stack([low[i], high[i]], axis=-1),
            about("1", f"95 % interval of {name}, percentiles of {resamples} resamples of the draws", ROLE),
        )
    more = {"quantity": quantity, "draws": draws, "seed": seed, "model_digest": model.digest}
    return exhibit("sobol indices", f"{model.name}: shares of the variance of {quantity}", [], variables, more)


def _shares(f: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return first and total orders of each parameter from what came at both designs and at each mixed one."""
    from scipy.stats import sobol_indices as indices

    told = indices(func={"f_A": f[:1], "f_B": f[1:2], "f_AB": f[2:, None]}, n=f.shape[-1])
    return np.stack([np.ravel(told.first_order), np.ravel(told.total_order)])


def _spread(model: Model, name: str, ends: Sequence[Any], points: NDArray[np.float64]) -> xr.DataArray:
    """Put points from 0 to 1 between the ends of a range, in its unit."""
    import xarray as xr

    known = [*model.parameters, *model.initial]
    if name not in known:
        raise InputError(f"'{name}' is no parameter or initial value; there are {', '.join(known)}")
    column = range_of(model, name, ends)
    low, high = column.values.tolist()
    return xr.DataArray(low + (high - low) * points, attrs={"units": column.unit.text})
