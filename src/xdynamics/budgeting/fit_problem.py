"""The problem of a fit: measured data, what is to be found, and the runs that both are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.multistart import Search
from xdynamics.budgeting.residuals import Tested, tested
from xdynamics.evidence.comparing.measured import Measured
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.record import unfold
from xdynamics.sweeping.axes import FOR_INITIAL
from xdynamics.sweeping.sweep import sweep
from xdynamics.units import Quantity, Unit, unit_suffix

if TYPE_CHECKING:
    pass

Floats = NDArray[np.float64]

SHIFT = 1e-3  # relative to a parameter's scale, for slopes
SIDES = np.array([-2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0  # of the fourth-order slope from these sides


@dataclass(frozen=True)
class Asked:
    """Which numbers of a model are fitted to which data.

    Attributes
    ----------
    model : Model
    names : tuple of str
        Parameters and initial values.
    data : Measured
    quantities : dict of str to Unit
        Measured quantities, in the model's own units.
    settings : dict
        Settings of `simulate`.
    """

    model: Model
    names: tuple[str, ...]
    data: Measured
    quantities: dict[str, Unit]
    settings: dict[str, Any]

    def declared(self, name: str) -> Quantity:
        """Return the declared value of a parameter or initial value."""
        return self.model.parameters[name].quantity if name in self.model.parameters else self.model.initial[name]

    @property
    def measured(self) -> Floats:
        """All measured values, quantities concatenated, in the model's units."""
        return self._all(self.data.values)

    @property
    def weights(self) -> Floats:
        """One over each standard uncertainty; 1 in the model's unit if there are none."""
        return 1.0 / self._all(self.data.uncertainties) if self.data.uncertainties else np.ones(self.measured.size)

    def _all(self, columns: Mapping[str, tuple[Floats, Unit]]) -> Floats:
        converted = [
            columns[name][0] * float(columns[name][1].factor / unit.factor) for name, unit in self.quantities.items()
        ]
        return np.concatenate(converted)

    def within(self, share: float) -> NDArray[np.bool_]:
        """Return which measured values lie in the first share of the time, quantities concatenated."""
        first, last = float(self.data.times.min()), float(self.data.times.max())
        selected = (self.data.times <= first + share * (last - first)) | (
            share == 1.0
        )  # regardless of rounding at the last
        return np.tile(selected, len(self.quantities))

    def computed(self, values: Floats, *, whole: bool = True) -> Floats:
        """Return what the model computes for rows of parameters in their own units, shape (n, measured values).

        Raises
        ------
        InputError
            If a run ends before all times and `whole` is set; otherwise those values are nan.
        """
        import xarray as xr

        columns = {
            f"{FOR_INITIAL}{name}" if name in self.model.initial else name: xr.DataArray(
                values[:, i], attrs={"units": self.declared(name).unit.text}
            )
            for i, name in enumerate(self.names)
        }
        times, inverse = np.unique(self.data.times, return_inverse=True)
        members = sweep(
            self.model,
            {"fitted": columns},
            keep=list(self.quantities),
            times=times,
            members_per_task=len(values),
            **self.settings,
        )
        marched = unfold(members.compute())
        rows = np.concatenate([marched[name].values[:, inverse] for name in self.quantities], axis=1)
        if whole and not np.isfinite(rows).all():
            k = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
            parameter_values = ", ".join(
                f"{name} = {float(value)!r}" for name, value in zip(self.names, values[k], strict=True)
            )
            raise InputError(
                f"with {parameter_values} the run ends as '{marched.run_outcome.values[k]}' at t ="
                f" {float(marched.end_time[k])!r}{unit_suffix(self.model.time_unit)}, before all that was measured"
            )
        return rows


@dataclass(frozen=True)
class Fitting:
    """The problem as searches see it: scaled numbers, and residuals over their uncertainties.

    Attributes
    ----------
    asked : Asked
    scales : ndarray, shape (n,)
    """

    asked: Asked
    scales: Floats

    def looked(self, scaled: Floats, share: float = 1.0) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes, for the data up to a share of their time.

        Raises
        ------
        InputError
            If a run ends before all times, or there are not more values than fitted numbers.
        """
        asked, used = self.asked, self.asked.within(share)
        if np.count_nonzero(used) <= scaled.size:
            raise InputError(f"{np.count_nonzero(used)} numbers are too few")
        values, slopes = with_slopes(asked, scaled * self.scales, self.scales)
        weights = asked.weights[used]
        return (values[used] - asked.measured[used]) * weights, slopes[used] * weights[:, None] * self.scales

    def squares(self, scaled: Floats, share: float) -> Floats:
        """Return the sums of squares of many starts over a share of the time; infinite if a run ends before."""
        selected, rows = self.asked.within(share), self.asked.computed(scaled * self.scales, whole=False)
        sums = np.sum((((rows - self.asked.measured) * self.asked.weights) ** 2)[:, selected], axis=1)
        return np.where(np.isfinite(sums), sums, np.inf)

    def tested(self, search: Search) -> Tested:
        """Test the residuals at the end of a search."""
        asked, residual = self.asked, search.residual
        order = np.argsort(asked.data.times, kind="stable")
        rows, measured = (
            list(np.split(array, len(asked.quantities))) for array in (residual / asked.weights, asked.measured)
        )
        has_uncertainties = bool(asked.data.uncertainties)
        freedom = residual.size - search.end.size
        return tested(
            float(residual @ residual), freedom, [array[order] for array in rows], measured, known=has_uncertainties
        )


def with_slopes(asked: Asked, values: Floats, scales: Floats) -> tuple[Floats, Floats]:
    """Return what the model computes, and its slopes by every parameter, shape (measured values, n)."""
    n = len(values)
    rows = np.tile(values, (1 + n * len(SIDES), 1))
    for i in range(n):
        rows[1 + i * len(SIDES) : 1 + (i + 1) * len(SIDES), i] += SHIFT * scales[i] * SIDES
    computed = asked.computed(rows)
    shifted = computed[1:].reshape(n, len(SIDES), -1)
    return computed[0], np.stack([WEIGHTS @ shifted[i] / (SHIFT * scales[i]) for i in range(n)], axis=1)
