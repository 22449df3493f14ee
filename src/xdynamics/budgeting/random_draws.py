"""Runs with inputs drawn from the declared distributions, of a given number or until they suffice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.montecarlo import DrawStatistics, draw_statistics
from xdynamics.budgeting.physical import input_axis_name
from xdynamics.faults import InputError
from xdynamics.model.uncertainty import normal_quantile
from xdynamics.sweeping.designs import DECLARED, MIN_PROBABILITY, Draws
from xdynamics.units import Unit, parse_quantity

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MAX_DRAWS = 1 << 22
STREAM = 1  # of random numbers, besides that of the inputs


@dataclass(frozen=True)
class Propagation:
    """The distributions that are propagated to a number.

    Attributes
    ----------
    measurand : Measurand
    names : sequence of str
        The uncertain inputs of the model that are drawn.
    value : float
        The number in the run itself, used if no input is drawn.
    added : sequence of float
        Standard uncertainties of terms that are not inputs of the model, added to each draw as normal.
    """

    measurand: Measurand
    names: Sequence[str]
    value: float
    added: Sequence[float]

    def values(self, draws: int) -> Floats:
        """March runs with drawn inputs, and return the number in each.

        Raises
        ------
        InputError
            If nothing is uncertain, or a run does not have the number.
        """
        numbers = self.numbers(draws)
        return self.added_to(None if numbers is None else numbers.values, draws)

    def numbers(self, draws: int, **settings: Any) -> xr.DataArray | None:
        """Return the number in runs with drawn inputs, lazy; None if no input is drawn.

        Raises
        ------
        InputError
            If nothing is uncertain.
        """
        names = [input_axis_name(self.measurand.model, name) for name in self.names]
        if not names and not self.added:
            raise InputError(
                "nothing in the model has an uncertainty to draw from; give parameters or initial values one"
            )
        if not names:
            return None
        axes = {"draw": Draws(draws, names, design=DECLARED, seed=self.measurand.seed)}
        return self.measurand.numbers(axes, **settings)

    def added_to(self, input_numbers: Floats | None, draws: int) -> Floats:
        """Add what is not an input of the model to the number in each of these runs.

        Raises
        ------
        InputError
            If a run does not have the number.
        """
        values = np.full(draws, self.value) if input_numbers is None else input_numbers
        if missing := int(np.count_nonzero(~np.isfinite(values))):
            raise InputError(
                f"{self.measurand.target.description} does not exist in {missing} of {draws} draws: the inputs are too uncertain for it to"
                " be one number"
            )
        points = np.random.default_rng([self.measurand.seed, STREAM]).random((draws, len(self.added)))
        for k, standard in enumerate(self.added):
            values = values + standard * normal_quantile(np.maximum(points[:, k], MIN_PROBABILITY))
        return values


def draw_until_known(
    propagation: Propagation, draws: int, coverage: float, end_tolerance: float
) -> tuple[DrawStatistics, int]:
    """Draw until the intervals' ends are known as well as wanted; return the result and the number of draws.

    Raises
    ------
    InputError
        If the largest number of draws does not suffice.
    """
    while True:
        statistics = draw_statistics(propagation.values(draws), coverage)
        if statistics.ends_doubt <= end_tolerance:
            return statistics, draws
        if draws >= MAX_DRAWS:
            raise InputError(
                f"{draws} draws leave the ends of the interval uncertain by {statistics.ends_doubt:.3g}, and {end_tolerance:.3g}"
                " is wanted; ask for less"
            )
        draws *= 2


def end_tolerance_of(size_text: str | None, unit: Unit, target: Target, default_level: float) -> float:
    """Return the standard uncertainty wanted of the intervals' ends; infinite by default.

    Raises
    ------
    InputError
        If it is not a positive size in a unit of the number, optionally with a percentage.
    """
    if size_text is None:
        return inf
    size, separator, level_text = str(size_text).partition(" at ")
    quantity = parse_quantity(size)
    try:
        level = float(level_text.strip().removesuffix("%")) / 100.0 if separator else default_level
    except ValueError:
        level = nan
    if quantity.unit.dimension != unit.dimension or not quantity.value > 0 or not 0.0 < level < 1.0:
        raise InputError(
            f"until_uncertainty is {size_text!r}, needs a positive size of {target.description}, like '1 {unit.text} at 95 %'"
        )
    return quantity.si / float(unit.factor) / float(normal_quantile(np.array([(1.0 + level) / 2.0]))[0])
