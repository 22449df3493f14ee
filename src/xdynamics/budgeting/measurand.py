"""The measurand of a budget: a quantity at a time, at an occurrence of an event, or its extreme in a run.

The budget also states which run the number was taken from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.audit import contradiction
from xdynamics.evidence.diagnosing.extremes import Extreme, find_extreme, values_between_rows
from xdynamics.evidence.diagnosing.summits import LOCATED, RULES
from xdynamics.evidence.kept_results import Keep, ResultForm
from xdynamics.evidence.observables import comparable, observables_of, observe
from xdynamics.evidence.runs import march_model
from xdynamics.evidence.stage_tasks import Task, setting_words
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.march.configuration import settings_for
from xdynamics.march.outcomes import GOOD
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model
from xdynamics.record import unfold
from xdynamics.record.folding import elements_of, quantity_names
from xdynamics.record.provenance import xdynamics_version
from xdynamics.record.unfolding import element_array, event_words, get_column
from xdynamics.schema import EVENT_AFTER, OCCURRENCE, STEPS
from xdynamics.sweeping.sweep import sweep
from xdynamics.units import SECONDS, Unit, parse_unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

LARGEST, LEAST = "maximum", "minimum"  # over a whole run
TIME = "t"  # the quantity that is the time of the event itself
SIDES = ("before", "after")
ROUNDED = 8.0 * EPS  # relative rounding of a time
SHARPER = 1e-3  # factor on the time tolerance of events in runs for slopes
MEMBERS = 512  # copies or draws of a task
NEAR = 1e-3  # fraction of a step over which a quantity's rate at an event is taken


@dataclass(frozen=True)
class Target:
    """A quantity at a time or event, or its extreme over a run.

    Attributes
    ----------
    quantity : str
        A coordinate, velocity, state, energy or observable, or at an event ``t``, its time; over a whole run the
        largest or the least value of one of these or of a force: ``maximum_force_drag_y``,
        ``minimum_contact_force_floor``.
    at : float, s, optional
    event : str, optional
    occurrence : int
        Which occurrence of the event, from 1.
    side : {"before", "after"}
        Side of the event.
    second : str
        Unit of the model's time; ``1`` if it is a pure number.
    is_parted : bool
        Whether the states before and after the event may differ, as at an impact or a reset.
    """

    quantity: str
    at: float | None = None
    event: str = ""
    occurrence: int = 1
    side: str = "before"
    second: str = SECONDS.text
    is_parted: bool = True

    @classmethod
    def from_arguments(cls, model: Model, quantity: Any, at: Any, event: Any, occurrence: Any, side: Any) -> Target:
        """Read and check the arguments of a budget.

        Raises
        ------
        InputError
            If the model has no such quantity or event, or not exactly one time or event is given.
        """
        elements = model.elements
        quantity, event = (
            model.shapes.internal_name(name) if isinstance(name, str) else name for name in (quantity, event)
        )
        quantities, extremes = comparable(model), _extreme_names(model)
        if at is None and event is None and quantity in extremes:
            return cls(quantity, second=model.time_unit.text)
        if quantity in extremes:
            raise InputError(_extreme_message(quantity, at, event))
        if (at is None) == (event is None):
            raise InputError(
                "a budget is of one number: give at='1 s' or event='ground', one of them, or neither of an extreme"
                f" like '{extremes[0]}'"
            )
        if event is not None and event not in (
            *elements.events,
            *elements.contacts,
            *elements.frictions,
        ):
            names = ", ".join((*elements.events, *elements.contacts, *elements.frictions)) or "none"
            if event in model.assemblies:
                raise InputError(
                    f"event is {event!r}, a contact of many links, whose impacts differ in number from run to run; give"
                    " at='1 s', or an extreme of the whole run"
                )
            raise InputError(f"event is {event!r}; there are {names}")
        if quantity not in (quantities if event is None else (*quantities, TIME)):
            raise InputError(
                f"quantity is {quantity!r}; there are {', '.join(quantity_names(quantities))}, at an event {TIME}, and without a"
                f" time or event {LARGEST}_… and {LEAST}_… of these and of forces, like '{extremes[0]}'"
                f"{elements_of(quantity, quantities) if isinstance(quantity, str) else ''}"
            )
        if isinstance(occurrence, bool) or not isinstance(occurrence, int) or occurrence < 1:
            raise InputError(f"occurrence is {occurrence!r}, needs a whole number from 1 on")
        if side not in SIDES:
            raise InputError(f"side is {side!r}; there are {', '.join(SIDES)}")
        unit = model.time_unit
        time = None if at is None else time_in(unit, at, "at")
        parts = event is None or event not in elements.events or bool(elements.events[event].reset)
        return cls(quantity, time, event or "", occurrence, side, unit.text, parts)

    @property
    def extreme(self) -> tuple[str, float] | None:
        """Quantity and sign of an extreme, 1 for the largest, -1 for the least; None for other numbers."""
        if self.at is not None or self.event:
            return None
        word, _, name = self.quantity.partition("_")
        return name, 1.0 if word == LARGEST else -1.0

    @property
    def description(self) -> str:
        """A description in words."""
        if self.extreme is not None:
            name, sign = self.extreme
            return f"{LARGEST if sign > 0 else LEAST} of {name}"
        if self.at is not None:
            return f"{self.quantity} at t = {self.at:.9g}{'' if self.second == '1' else f' {self.second}'}"
        occurrence_text, side_text = (
            "" if self.occurrence == 1 else f" number {self.occurrence}",
            self.side if self.is_parted else "at",
        )
        return (
            f"time of {self.event}{occurrence_text}"
            if self.quantity == TIME
            else f"{self.quantity} {side_text} {self.event}{occurrence_text}"
        )

    def units(self, run: xr.Dataset) -> Unit:
        """Return the unit of the number."""
        if self.quantity == TIME:
            return parse_unit(self.second)
        return parse_unit(str(get_column(run, self.extreme[0] if self.extreme else self.quantity).attrs["units"]))

    def extreme_in(self, run: xr.Dataset, model: Model) -> Extreme | None:
        """Find an extreme in a run, with its time and rule; None if the number is not an extreme."""
        return None if self.extreme is None else find_extreme(unfold(run), *self.extreme, model.functions)

    def in_run(self, run: xr.Dataset, model: Model) -> tuple[float, float, float]:
        """Return the number in a run, and its errors from interpolation and from the location of the event.

        Raises
        ------
        InputError
            If the run ends before.
        """
        if self.at is not None:
            time = np.array([_clip_to_run(self.at, run["time"].values)])
            value, errors = observe(run, model, [self.quantity], time)[self.quantity]
            return float(value[0]), float(errors[0]), 0.0
        if (extreme_found := self.extreme_in(run, model)) is not None:
            return extreme_found.value, extreme_found.uncertainty, self._location_error(run, model, extreme_found)
        event_index = self._event_index(run)
        located = float(run["event_time_uncertainty"].values[event_index])
        if self.quantity == TIME:
            return float(run["event_time"].values[event_index]), 0.0, located
        row = int(run[f"event_row_{self.side}"].values[event_index])
        return (
            float(get_column(run, self.quantity)[row]),
            0.0,
            abs(self._rate_at_event(run, model, event_index)) * located,
        )

    def time_in(self, run: xr.Dataset) -> float:
        """Return the time of the event in a run.

        Raises
        ------
        InputError
            If the run ends before.
        """
        return float(run["event_time"].values[self._event_index(run)])

    def moment_in(self, run: xr.Dataset, model: Model) -> float:
        """Return the time of the number in a run that has it."""
        if self.at is not None:
            return self.at
        extreme_found = self.extreme_in(run, model)
        return self.time_in(run) if extreme_found is None else extreme_found.time

    @property
    def sweep_word(self) -> str:
        """The word that keeps it of a sweep's members, and the variable that holds it."""
        if not self.event:
            return self.quantity
        return f"event_time_{self.event}" if self.quantity == TIME else f"{self.side}_{self.event}_{self.quantity}"

    def _location_error(self, run: xr.Dataset, model: Model, top: Extreme) -> float:
        """Return the error of an extreme at an event from the location of the event; 0 where the quantity is level."""
        if top.rule != LOCATED or self.extreme is None:
            return 0.0
        if (model.python_functions or model.delays) and self.extreme[0] not in model.elements.units:
            return 0.0
        name, time = self.extreme[0], run["time"].values
        row = int(np.flatnonzero((time == top.time) & (get_column(run, name).values == top.value))[0])
        doubts = run["event_time_uncertainty"].values[run["event_time"].values == top.time]
        neighbour = row + 1 if int(run["row_kind"][row]) == EVENT_AFTER else row - 1
        if not doubts.size or not 0 <= neighbour < len(time) or time[neighbour] == time[row]:
            return 0.0
        nearby_time = time[row] + NEAR * (time[neighbour] - time[row])
        nearby_value = float(
            values_between_rows(unfold(run), model, name, np.array([nearby_time]), model.functions)[0][0]
        )
        return abs(nearby_value - top.value) / abs(float(nearby_time - time[row])) * float(doubts.max())

    def _event_index(self, run: xr.Dataset) -> int:
        """Return the index of the event in a run."""
        names = np.array(event_words(run)) if run.sizes.get("event", 0) else np.zeros(0, str)
        places = np.flatnonzero(names == self.event)
        if len(places) < self.occurrence:
            ended = "" if run.attrs["run_outcome"] in GOOD else f", which ended badly: {run.attrs['run_outcome_text']}"
            raise InputError(
                f"'{self.event}' is met {len(places)} times in the run, and number {self.occurrence} is asked for, by"
                f" {run.attrs['solver_method']}{ended}"
            )
        return int(places[self.occurrence - 1])

    def _rate_at_event(self, run: xr.Dataset, model: Model, event_index: int) -> float:
        """Return the rate of the quantity on that side of the event, by a difference over a small part of a step."""
        time = run["time"].values
        row = int(run[f"event_row_{self.side}"].values[event_index])
        neighbour = max(row - 1, 0) if self.side == "before" else min(row + 1, len(time) - 1)
        nearby_time = float(time[row] + NEAR * (time[neighbour] - time[row]))
        if nearby_time == time[row]:
            return 0.0
        nearby_value = float(observe(run, model, [self.quantity], np.array([nearby_time]))[self.quantity][0][0])
        return (nearby_value - float(get_column(run, self.quantity)[row])) / (nearby_time - float(time[row]))


@dataclass(frozen=True)
class Measurand:
    """A number of a run: the model, the target in its run, and the settings of the march.

    Attributes
    ----------
    model : Model
    target : Target
    settings : dict
        Of `simulate`.
    seed : int
        Of everything that is drawn.
    keep : Keep, optional
        Where results of tasks are kept.
    """

    model: Model
    target: Target
    settings: dict[str, Any]
    seed: int = 0
    keep: Keep | None = None

    @property
    def inputs(self) -> tuple[Any, ...]:
        """Everything that the number depends on, for the names of tasks."""
        return self.model.digest, self.target, setting_words(self.settings), xdynamics_version()

    @property
    def unkept(self) -> Measurand:
        """The measurand without the folder of its results, for tasks whose results do not depend on it."""
        return replace(self, keep=None)

    @property
    def sharp(self) -> float:
        """The time tolerance of events in runs for slopes."""
        return SHARPER * settings_for(self.model, **self.settings).time_tolerance

    def check_time(self) -> None:
        """Check that a time of the number is one that the run is to reach.

        Raises
        ------
        InputError
            If it is not.
        """
        if self.target.at is None:
            return
        span = np.array([self.model.statement.initial["t"].si, settings_for(self.model, **self.settings).until])
        if not span[0] <= _clip_to_run(self.target.at, span) <= span[1]:
            unit = unit_suffix(self.model.time_unit)
            start, until = span.tolist()
            raise InputError(
                f"at is {self.target.at!r}{unit}, outside the run, from {start!r}{unit} to until = {until!r}{unit}"
            )

    def number(self, model: Model, **settings: Any) -> float:
        """March a model, with other settings where they are given, and return its number.

        Raises
        ------
        InputError
            If the run does not have the number.
        """
        run = march_model(model, **{"force_samples": "none"} | self.settings | settings)
        return self.target.in_run(run, model)[0]

    def numbers(self, axes: dict[str, Any], **settings: Any) -> xr.DataArray:
        """Return the number of every member of a sweep, lazy; nan for those that end before."""
        target, places = self.target, dict[str, Any]()
        if target.at is not None:
            places = {"times": [target.at]}
        elif target.event:
            places = {"occurrences": (target.occurrence - 1, target.occurrence)}
        # members of a sweep are of single floats
        shared_settings = self.settings | settings | {"members_per_task": MEMBERS, "precision": FLOAT64}
        member_values = sweep(self.model, axes, keep=[target.sweep_word], **places, **shared_settings)
        numbers = element_array(member_values, target.sweep_word)
        numbers = numbers.isel({OCCURRENCE: 0}) if OCCURRENCE in numbers.dims else numbers
        numbers = numbers[..., 0] if target.at is not None else numbers
        return numbers if self.keep is None else self.keep.blocks(numbers)


def _extreme_message(quantity: str, moment: Any, event: Any) -> str:
    """Return the message that an extreme has no time or event of its own."""
    stated_arguments = [f"at is {moment!r}"] * (moment is not None) + [f"event is '{event}'"] * (event is not None)
    ending_text = f"until = {moment!r}" if moment is not None else f"action = 'stop' of the event '{event}'"
    return (
        f"quantity is '{quantity}', over the whole run, and {' and '.join(stated_arguments)}: leave that out; where the extreme up to"
        f" there is wanted, end the run there, by {ending_text}"
    )


def _extreme_names(model: Model) -> tuple[str, ...]:
    """Return the names of all extremes of a run, as in `diagnose`."""
    layout = layout_of(model)
    names = (*observables_of(model), *layout.applied_forces)
    return tuple(f"{word}_{name}" for name in names for word in (LARGEST, LEAST))


def _clip_to_run(moment: float, time: Floats) -> float:
    """Clip a time to the run if it is outside by rounding alone, as in runs marched in other units."""
    rounding_tolerance = ROUNDED * max(abs(float(time[0])), abs(float(time[-1])))
    clipped = min(max(moment, float(time[0])), float(time[-1]))
    return clipped if abs(clipped - moment) <= rounding_tolerance else moment


class OwnRun(NamedTuple):
    """The run of a budget, as far as its Dataset names it: a few words, so that the run stays where it was marched.

    Attributes
    ----------
    method, outcome : str
    units : str
        Of the number.
    step_units : str
        Of its steps, which are pure numbers where its time is.
    extreme_rule : str, optional
        How an extreme was found; None for other numbers.
    extreme_time : float
        When it was, in the model's unit of time.
    contradiction : str
        What contradicts itself in its record, in words; nothing if nothing does. See `evidence.audit`.
    """

    method: str
    outcome: str
    units: str
    step_units: str
    extreme_rule: str | None
    extreme_time: float
    contradiction: str = ""

    @classmethod
    def from_run(cls, measurand: Measurand, run: xr.Dataset) -> OwnRun:
        """Describe a run; one without rows is still to be marched.

        Raises
        ------
        InputError
            If it does not have the number.
        """
        target = measurand.target
        rule, time = (None if target.extreme is None else ""), float("nan")
        if run.sizes[STEPS] and (extreme := target.extreme_in(run, measurand.model)) is not None:
            rule, time = RULES[extreme.rule], extreme.time
        units, step_units = target.units(run).text, str(run["step_size"].attrs["units"])
        method, outcome = str(run.attrs["solver_method"]), str(run.attrs["run_outcome"])
        contradiction_text = contradiction(run, measurand.model.functions) if run.sizes[STEPS] else ""
        return cls(method, outcome, units, step_units, rule, time, contradiction_text)


OWN_RUNS = ResultForm(list, lambda entries: OwnRun(*entries))


def own_run_task(measurand: Measurand, run: Task) -> Task:
    """Return the task that describes a run."""
    task = Task.of("own_run", partial(OwnRun.from_run, measurand.unkept), (run,), *measurand.inputs)
    return task if measurand.keep is None else measurand.keep.task(task, OWN_RUNS)
