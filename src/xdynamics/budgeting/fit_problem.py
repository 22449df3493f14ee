"""The problem of a fit: measured records, fitted numbers, the runs of both, and tests of the residuals.

Two tests ask whether the residuals are noise: their size against the uncertainties, and their order in time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.multistart import Loss, Search
from xdynamics.evidence.comparing.measured import Measured
from xdynamics.faults import InputError
from xdynamics.march.configuration import settings_for
from xdynamics.model import Model
from xdynamics.record.unfolding import get_column
from xdynamics.sweeping.axes import INITIAL_PREFIX
from xdynamics.sweeping.sweep import sweep
from xdynamics.units import Quantity, Unit, unit_suffix

Floats = NDArray[np.float64]

UNLIKELY = 1e-3  # probability below which residuals are not noise
FEWEST = 8  # residuals of each sign needed to count runs
SLIGHT = 1e-3  # of the data's standard deviation, below which residuals do not matter
FAR_BELOW = 0.1  # likewise, of the uncertainties if there are any


@dataclass(frozen=True)
class ResidualTests:
    """Results of the tests of residuals.

    Attributes
    ----------
    chi_square_probability : float
        Probability of a larger sum of squares if model and uncertainties are right; nan without uncertainties.
    runs_probability : float
        Probability of fewer runs of one sign if the residuals are independent; nan where there are too few.
    adequate : bool
    text : str
        The reason, in words.
    """

    chi_square_probability: float
    runs_probability: float
    adequate: bool
    text: str


def judge_residuals(
    square: float, freedom: int, rows: Sequence[Floats], measured: Sequence[Floats], *, has_uncertainties: bool
) -> ResidualTests:
    """Test the residuals of a fit.

    Parameters
    ----------
    square : float
        Weighted sum of their squares.
    freedom : int
    rows, measured : sequence of ndarray
        Residuals and measured values of each quantity, in the order of time.
    has_uncertainties : bool
        Whether the data have uncertainties.

    Notes
    -----
    Chi-square: Bevington, Robinson, Data Reduction and Error Analysis, 2003, section 11.1. Runs of one sign: Wald and
    Wolfowitz 1940, doi:10.1214/aoms/1177731909, over all quantities by Bonferroni's inequality. Where residuals are
    small compared with the data, or far below their uncertainties, their order does not matter.
    """
    from scipy.stats import chi2

    chi_square = float(chi2.sf(square, freedom)) if has_uncertainties else nan
    probabilities = [probability for probability in map(runs_probability, rows) if probability == probability]
    runs = min(1.0, len(probabilities) * min(probabilities)) if probabilities else nan
    is_slight = (
        square / freedom <= FAR_BELOW**2
        if has_uncertainties
        else all(_is_slight(*pair) for pair in zip(rows, measured, strict=True))
    )
    if chi_square < UNLIKELY:
        text = (
            f"residuals are {sqrt(square / freedom):.3g} times as large as the uncertainties: the model, the"
            " uncertainties or the minimum that the search came to is wrong"
        )
    elif runs < UNLIKELY and not is_slight:
        text = (
            f"residuals are not in a random order (fewer changes of sign have the probability {runs:.1g}): the model or"
            " the minimum that the search came to is wrong"
        )
    else:
        judgement = "no matter beside the data" if is_slight else "no more than noise"
        return ResidualTests(chi_square, runs, adequate=True, text=f"residuals are {judgement}")
    return ResidualTests(chi_square, runs, adequate=False, text=text)


def runs_probability(row: Floats) -> float:
    """Return the probability of at most so many runs of one sign in independent numbers.

    Examples
    --------
    >>> round(runs_probability(np.tile([1.0, -1.0], 10)), 3), runs_probability(np.repeat([1.0, -1.0], 20)) < 1e-8
    (1.0, True)
    """
    from scipy.special import ndtr

    signs = np.sign(row)[np.sign(row) != 0.0]
    positive_count, negative_count = int(np.count_nonzero(signs > 0)), int(np.count_nonzero(signs < 0))
    if positive_count + negative_count < 2 * FEWEST:
        return nan
    if not min(positive_count, negative_count):
        return 0.5 ** (positive_count + negative_count - 1)
    runs, n = 1 + int(np.count_nonzero(signs[1:] != signs[:-1])), positive_count + negative_count
    mean = 1.0 + 2.0 * positive_count * negative_count / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1)
    # a half corrects for continuity: runs are counted, and the normal distribution is not
    return float(ndtr((runs + 0.5 - mean) / sqrt(variance))) if variance > 0.0 else nan


def _is_slight(row: Floats, measured: Floats) -> bool:
    """Whether residuals are small compared with the variation of the data."""
    return float(np.sqrt(np.mean(row**2))) <= SLIGHT * float(np.std(measured))


SHIFT = 1e-3  # relative to a parameter's scale, for slopes
SIDES = np.array([-2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0  # of the fourth-order slope from these sides
OFFSET = "offset"  # of a clock: what a record's times read where the model's time is 0
MAX_OFFSETS = 8  # unlike ones that are marched together, whose times all members then have
SPACINGS = 10.0  # of a record's times, to which its offset is scaled
MAX_TRIED_OFFSETS = 2000  # offsets, among which the start is chosen
SHARED = -1  # in the place of a record's number


@dataclass(frozen=True)
class FitRecord:
    """One measured record: which numbers of a model are fitted to it.

    Attributes
    ----------
    model : Model
    names : tuple of str
        Parameters and initial values.
    data : Measured
    quantities : dict of str to Unit
        Measured quantities, in the model's own units; of a record of event times, ``event_time_floor``.
    settings : dict
        Settings of `simulate`.
    label : str
        Name of the record, where there are several.
    """

    model: Model
    names: tuple[str, ...]
    data: Measured
    quantities: dict[str, Unit]
    settings: dict[str, Any]
    label: str = ""

    def declared(self, name: str) -> Quantity:
        """Return the declared value of a parameter or initial value; a clock's offset begins at 0."""
        elements = self.model.elements
        if self.is_offset(name):
            return Quantity(0.0, self.model.time_unit)
        return (
            elements.statement.parameters[name].quantity
            if name in elements.statement.parameters
            else elements.statement.initial[name]
        )

    def is_offset(self, name: str) -> bool:
        """Whether a name is the offset of the record's clock, and nothing that the model has."""
        return (
            name == OFFSET
            and name not in self.model.elements.statement.parameters
            and name not in self.model.elements.statement.initial
        )

    @property
    def offsets(self) -> tuple[float, float]:
        """The least and the greatest offset that leave all of a record of values inside the run; any for event times."""
        if self.data.occurrences.size:
            return -np.inf, np.inf
        begin, end = self._span
        return float(self.data.times.max()) - end, float(self.data.times.min()) - begin

    @property
    def offset_scale(self) -> float:
        """A time in which measured values change a little, s: some spacings of the record's times."""
        spacings = np.diff(np.unique(self.data.times))
        return SPACINGS * float(np.median(spacings)) if spacings.size else 1.0

    @property
    def _span(self) -> tuple[float, float]:
        return self.model.statement.initial["t"].si, float(settings_for(self.model, **self.settings).until)

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

    def in_first_share(self, share: float) -> NDArray[np.bool_]:
        """Return which measured values lie in the first share of the time, quantities concatenated."""
        first, last = float(self.data.times.min()), float(self.data.times.max())
        selected = self.data.times <= first + share * (last - first)
        if share == 1.0:
            selected[:] = True  # regardless of rounding at the last
        return np.tile(selected, len(self.quantities))

    def computed(self, values: Floats, *, require_all: bool = True) -> Floats:
        """Return the model's values for rows of parameters in their own units, shape (n, measured values).

        Raises
        ------
        InputError
            If a run ends before all times, or has too few events, and `require_all` is set; otherwise those values are nan.
        """
        import xarray as xr

        columns = {
            f"{INITIAL_PREFIX}{name}" if name in self.model.elements.statement.initial else name: xr.DataArray(
                values[:, i], attrs={"units": self.declared(name).unit.text}
            )
            for i, name in enumerate(self.names)
            if not self.is_offset(name)
        } or self._unchanged(len(values))
        numbers, offsets = self.data.occurrences, self._offsets(values)
        shifts, shift_indices = np.unique(np.zeros(len(values)) if numbers.size else offsets, return_inverse=True)
        if len(shifts) > MAX_OFFSETS:
            order = np.argsort(shift_indices, kind="stable")
            row_groups = np.split(
                order, np.searchsorted(shift_indices[order], np.arange(MAX_OFFSETS, len(shifts), MAX_OFFSETS))
            )
            return np.concatenate([self.computed(values[part], require_all=require_all) for part in row_groups])[
                np.argsort(order)
            ]
        times, places = (np.zeros(0), (numbers - 1)[None, :]) if numbers.size else self._times(shifts)
        members = sweep(
            self.model,
            {"fitted": columns},
            keep=list(self.quantities),
            members_per_task=len(values),
            **({"occurrences": int(numbers.max())} if numbers.size else {"times": times}),
            **self.settings,
        )
        marched = members.compute()
        clock_offsets = offsets[:, None] if numbers.size else 0.0
        rows = np.concatenate(
            [
                np.take_along_axis(
                    get_column(marched, name).values.reshape(len(values), -1), places[shift_indices], axis=1
                )
                + clock_offsets
                for name in self.quantities
            ],
            axis=1,
        )
        if require_all and not np.isfinite(rows).all():
            k = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
            raise InputError(self._missing(values[k], rows[k], marched.isel(fitted=k)))
        return rows

    def _offsets(self, values: Floats) -> Floats:
        """Return the offset of the record's clock in each row of numbers; 0 where it is not fitted."""
        columns = [values[:, i] for i, name in enumerate(self.names) if self.is_offset(name)]
        return columns[0] if columns else np.zeros(len(values))

    def _times(self, shifts: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Return the distinct times of the run for all offsets, and the index of each reading among them."""
        times = self.data.times[None, :] - shifts[:, None]
        if OFFSET in self.names and self.is_offset(OFFSET):
            times = np.clip(times, *self._span)  # slopes at an end are looked for a little outside of it
        run_times, places = np.unique(times, return_inverse=True)
        return run_times, places.reshape(times.shape)

    def likely_offset(self, values: Floats, low: float, high: float) -> float:
        """Return the offset between bounds at which a run with given numbers differs least from the measured values."""
        spacing = self.offset_scale / SPACINGS / 2.0
        begin, end = self._span
        count = int(np.clip((end - begin) / spacing, 2, 10 * MAX_TRIED_OFFSETS))
        dense = replace(
            self,
            data=replace(
                self.data,
                times=np.linspace(begin, end, count),
                values={name: (np.zeros(count), unit) for name, unit in self.quantities.items()},
                uncertainties={},
            ),
        )
        numbers_without_offset = np.where([*map(self.is_offset, self.names)], 0.0, values)
        lines = np.split(dense.computed(numbers_without_offset[None, :], require_all=False)[0], len(self.quantities))
        tried_offsets = np.linspace(low, high, int(np.clip((high - low) / spacing, 2, MAX_TRIED_OFFSETS)))
        squares = []
        for offset in tried_offsets:
            rows = np.concatenate([np.interp(self.data.times - offset, dense.data.times, line) for line in lines])
            squares.append(float(np.sum(((rows - self.measured) * self.weights) ** 2)))
        return float(tried_offsets[int(np.argmin(np.nan_to_num(squares, nan=np.inf)))])

    def _unchanged(self, members: int) -> dict[str, Any]:
        """Return the axis of runs where the offset alone is fitted: a parameter at its constant value."""
        import xarray as xr

        name, part = next(iter(self.model.elements.statement.parameters.items()))
        return {name: xr.DataArray(np.full(members, part.quantity.value), attrs={"units": part.quantity.unit.text})}

    def _missing(self, values: Floats, row: Floats, member: Any) -> str:
        """Return the message for a run in which something measured does not happen."""
        numbers = ", ".join(f"{name} = {float(value)!r}" for name, value in zip(self.names, values, strict=True))
        end = f"'{member.run_outcome.values}' at t = {float(member.end_time)!r}{unit_suffix(self.model.time_unit)}"
        if not self.data.occurrences.size:
            return f"with {numbers} the run ends as {end}, before all that was measured"
        value_index = int(np.flatnonzero(~np.isfinite(row))[0])
        name = [*self.quantities][value_index // self.data.occurrences.size]
        return (
            f"with {numbers} the run, which ends as {end}, has no occurrence"
            f" {int(self.data.occurrences[value_index % self.data.occurrences.size])} of '{name.removeprefix('event_time_')}',"
            " which was measured: begin nearer, or end the run later by until"
        )


@dataclass(frozen=True)
class FittedNumber:
    """A fitted number: a parameter or initial value of all records, or a record's own."""

    name: str
    record: int = SHARED


@dataclass(frozen=True)
class Fitting:
    """The problem as searches see it: scaled numbers, and residuals over their uncertainties.

    Attributes
    ----------
    records : tuple of Asked
        Each of them has the names of its numbers, in their order here.
    numbers : tuple of FittedNumber
    scales : ndarray, shape (n,)
    loss : Loss
    """

    records: tuple[FitRecord, ...]
    numbers: tuple[FittedNumber, ...]
    scales: Floats
    loss: Loss = field(default_factory=Loss)

    @classmethod
    def of_record(cls, record: FitRecord, scales: Floats) -> Fitting:
        """Return the problem of one record."""
        return cls((record,), tuple(map(FittedNumber, record.names)), scales)

    def number_indices(self, record: int) -> list[int]:
        """Return the places of a record's numbers among all."""
        return [i for i, number in enumerate(self.numbers) if number.record in (SHARED, record)]

    @property
    def has_uncertainties(self) -> bool:
        """Whether the data have uncertainties."""
        return bool(self.records[0].data.uncertainties)

    @property
    def weights(self) -> Floats:
        """One over the uncertainty of each measured value, records concatenated."""
        return np.concatenate([record.weights for record in self.records])

    @property
    def measured(self) -> Floats:
        """All measured values, records concatenated."""
        return np.concatenate([record.measured for record in self.records])

    def weighted_residuals(self, scaled: Floats, share: float = 1.0) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes, for the data up to a share of their time.

        Raises
        ------
        InputError
            If a run ends before all times, or there are not more values than fitted numbers.
        """
        used = [record.in_first_share(share) for record in self.records]
        count = sum(map(np.count_nonzero, used))
        if count <= scaled.size:
            raise InputError(f"{count} numbers are too few")
        residuals, slopes = [], []
        for k, (record, selected) in enumerate(zip(self.records, used, strict=True)):
            places, weights = self.number_indices(k), record.weights[selected]
            values, number_slopes = with_slopes(record, (scaled * self.scales)[places], self.scales[places])
            rows = np.zeros((weights.size, scaled.size))
            rows[:, places] = number_slopes[selected] * weights[:, None] * self.scales[places]
            residuals.append((values[selected] - record.measured[selected]) * weights)
            slopes.append(rows)
        return np.concatenate(residuals), np.concatenate(slopes)

    def squares(self, scaled: Floats, share: float) -> Floats:
        """Return the sum of losses at many starts, over a share of the time; infinite if a run ends before."""
        sums = np.zeros(len(scaled))
        for k, record in enumerate(self.records):
            places = self.number_indices(k)
            rows = record.computed(scaled[:, places] * self.scales[places], require_all=False)
            residuals = ((rows - record.measured) * record.weights)[:, record.in_first_share(share)]
            sums += np.sum(self.loss.sizes(residuals), axis=1)
        return np.where(np.isfinite(sums), sums, np.inf)

    def residual_tests(self, search: Search) -> ResidualTests:
        """Test the residuals at the end of a search; of a robust loss, those that are no outliers."""
        rows, measured = list[Floats](), list[Floats]()
        residual = search.residual
        for record, ends in zip(
            self.records, np.cumsum([record.measured.size for record in self.records]), strict=True
        ):
            size = record.measured.size
            part, order = residual[ends - size : ends], np.argsort(record.data.times, kind="stable")
            for row, values in zip(
                np.split(part / record.weights, len(record.quantities)),
                np.split(record.measured, len(record.quantities)),
                strict=True,
            ):
                rows.append(row[order])
                measured.append(values)
        good_residuals = residual[~self.outlying(residual)]
        return judge_residuals(
            float(good_residuals @ good_residuals),
            good_residuals.size - search.end.size,
            rows,
            measured,
            has_uncertainties=self.has_uncertainties,
        )

    def outlying(self, residual: Floats) -> NDArray[np.bool_]:
        """Return which weighted residuals are outliers: of a robust loss, over three standard deviations."""
        outlying: NDArray[np.bool_] = np.abs(residual) > 3.0 * self.loss.spread
        return outlying & (self.loss.name != "linear")


def with_slopes(record: FitRecord, values: Floats, scales: Floats) -> tuple[Floats, Floats]:
    """Return the model's values, shape (measured values,), and slopes by parameters, (measured values, n)."""
    n = len(values)
    rows = np.tile(values, (1 + n * len(SIDES), 1))
    for i in range(n):
        rows[1 + i * len(SIDES) : 1 + (i + 1) * len(SIDES), i] += SHIFT * scales[i] * SIDES
    computed = record.computed(rows)
    shifted = computed[1:].reshape(n, len(SIDES), -1)
    return computed[0], np.stack([WEIGHTS @ shifted[i] / (SHIFT * scales[i]) for i in range(n)], axis=1)
