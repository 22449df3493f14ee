"""The transient of sections: what a motion does before it has settled, which is left out of figures."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.record.flag_words import time_unit_of
from xdynamics.schema import OCCURRENCE
from xdynamics.sweeping.collection import NUMBER
from xdynamics.sweeping.kept_quantities import AFTER, BEFORE, EVENT_TIME
from xdynamics.units import Unit, parse_unit, time_in, unit_suffix

SHARE = 5  # one in so many periods of a section is its transient, where nothing is said
FEWEST_PERIODS = 50  # of a section whose first ones are left out then

_WHOLE = re.compile(r"\s*-?\d+\s*")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Transient:
    """How long a transient lasts.

    Attributes
    ----------
    count : int
        Occurrences of an event, or periods of a section.
    time : str
        Or a time of the run, with its unit; empty where it is counted.
    """

    count: int = 0
    time: str = ""

    @classmethod
    def from_argument(cls, argument: Any) -> Transient:
        """Read a number of occurrences, or a time.

        Raises
        ------
        InputError
            If it is neither.
        """
        if isinstance(argument, str) and not _WHOLE.fullmatch(argument):
            return cls(time=argument)
        if isinstance(argument, bool) or not isinstance(argument, str | int | np.integer) or int(argument) < 0:
            raise InputError(
                f"transient is {argument!r}, needs a whole number of occurrences or periods, like 100, or a time, like"
                " '200 s'"
            )
        return cls(int(argument))

    def end_time(self, unit: Unit) -> float:
        """Return the time at which it ends, in the unit of a run's time."""
        return time_in(unit, self.time, "transient") / float(unit.factor)


def times_after_transient(run: xr.Dataset, times: Floats, transient: Transient | None) -> Floats:
    """Return the times of a run's section that are behind its transient: its first fifth, where nothing is said.

    Raises
    ------
    InputError
        If none is left.
    """
    if transient is None:
        return times[times.size // SHARE :] if times.size >= FEWEST_PERIODS else times
    left = times[times >= transient.end_time(time_unit_of(run))] if transient.time else times[transient.count :]
    if times.size and not left.size:
        suffix = unit_suffix(time_unit_of(run))
        raise InputError(
            f"transient is {transient.time or transient.count}, and the section has {times.size} periods, the last at"
            f" t = {times[-1]:.6g}{suffix}: nothing is left"
        )
    return left


def without_transient(sweep: xr.Dataset, transient: Transient) -> xr.Dataset:
    """Leave occurrences of the transient out of a sweep.

    Raises
    ------
    InputError
        If the sweep keeps no occurrences, or none after the transient, or no times of theirs where a time is given.
    """
    occurrence_names = [
        str(name) for name, variable in sweep.data_vars.items() if OCCURRENCE in variable.dims and name != NUMBER
    ]
    if not occurrence_names:
        raise InputError(
            "transient leaves out occurrences of events, and the sweep keeps none but the first: keep more, like"
            " keep=['after_section_x'], occurrences=160"
        )
    if not transient.time:
        numbers = sweep[NUMBER].values
        if not (numbers > transient.count).any():
            raise InputError(
                f"transient is {transient.count}, and the sweep keeps occurrences {numbers[0]} to {numbers[-1]}: nothing"
                " is left; keep more occurrences"
            )
        return sweep.isel({OCCURRENCE: numbers > transient.count})
    later = {
        name: sweep[name].where(_times_of(sweep, name) >= _transient_end(sweep, name, transient))
        for name in occurrence_names
    }
    if not any(bool(values.notnull().any()) for values in later.values()):
        raise InputError(f"transient is {transient.time}, and the sweep keeps no occurrence after it")
    return sweep.assign({name: values.assign_attrs(sweep[name].attrs) for name, values in later.items()})


def _transient_end(sweep: xr.Dataset, name: str, transient: Transient) -> float:
    return transient.end_time(parse_unit(str(_times_of(sweep, name).attrs["units"])))


def _times_of(sweep: xr.Dataset, name: str) -> xr.DataArray:
    """Return the times of the event that a variable belongs to."""
    for key, times in sweep.data_vars.items():
        event = str(key).removeprefix(EVENT_TIME)
        if event != key and (name == key or name.startswith((f"{AFTER}{event}_", f"{BEFORE}{event}_"))):
            return times
    raise InputError(
        f"transient is a time, and the sweep keeps no times of the event of {name}: give a number of occurrences, or"
        f" keep event_time_… beside it"
    )
