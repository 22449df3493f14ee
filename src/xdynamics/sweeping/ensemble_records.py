"""Many runs of one model as concatenated columns of a record: states, events, states in between."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.dynamics.recorded_steps import RowLinks, step_columns
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.evidence.observables import evaluate_inside_steps, rate_tree, reaction_columns, share_columns
from xdynamics.expressions import Name, Node, free_names
from xdynamics.kernels import Layout, law_of
from xdynamics.kernels.layout import layout_of
from xdynamics.march import Pacing, Runs, Settings
from xdynamics.march.dense_output import PartsAbreast, past_of, states_within, step_start_rows
from xdynamics.march.outcomes import OUTCOMES
from xdynamics.march.simd_ensemble import lanes_for
from xdynamics.methods.steppers import SERIES
from xdynamics.model import Model
from xdynamics.model.constraints import Assignment
from xdynamics.model.detectors import labels
from xdynamics.model.motion import assignments_read, constants
from xdynamics.model.parts import Function
from xdynamics.model.reactions import reactions
from xdynamics.record.column import Column
from xdynamics.record.run_columns import named_columns, state_name
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.units import parse_unit, spell

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
LANE_STATES = 1 << 12  # states, enough for lanes
VALUE, RATE = ("value",), ("rate",)  # what is evaluated of a quantity


class _NamedStates(Mapping[str, Floats]):
    """States by their names, one line of an array each, taken where it is read: there may be many."""

    def __init__(self, names: Blocks, lines: Floats) -> None:
        self._names, self._lines = names, lines

    def __getitem__(self, name: str) -> Floats:
        if name not in self._names:
            raise KeyError(name)
        line: Floats = self._lines[self._names.index(name)]
        return line

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass(frozen=True)
class MemberRuns:
    """The runs of members that differ in numbers alone.

    Attributes
    ----------
    model : Model
    settings : Settings
    runs : Runs
    parts : PartsAbreast, optional
        Repeats steps of the runs, side by side.
    """

    model: Model
    settings: Settings
    runs: Runs
    parts: PartsAbreast | None = None

    @property
    def layout(self) -> Layout:
        """The layout of the numbers in the march."""
        return self.runs.layout

    @property
    def size(self) -> int:
        """Number of members."""
        return len(self.runs.ends)

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """Every column of the records, by name, taken from the stored logs."""
        return named_columns(self.layout, self.settings)

    @cached_property
    def _kept_columns(self) -> frozenset[str]:
        return frozenset(self.runs.columns)

    @cached_property
    def _column_cache(self) -> dict[str, NDArray[Any]]:
        return {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a variable of the records, or an element of one, over all rows of all members, in the unit of a record."""
        if name not in self._column_cache:
            row = self.layout.row
            if (
                row.find_offset(name) is not None
                and (name if name in row else row.block(name).first) not in self._kept_columns
            ):
                raise KeyError(f"'{name}' was not kept of the logs")
            self._column_cache[name] = self.columns[name].take(self.runs.log_block)
        return self._column_cache[name]

    def last_values(self, name: str) -> NDArray[Any]:
        """Return a variable in every member's last row."""
        return self[name][self.runs.last_rows]

    @cached_property
    def _failed(self) -> NDArray[np.bool_]:
        is_good = np.array([status in OUTCOMES and OUTCOMES[status].good for status in range(max(OUTCOMES) + 1)])
        failed: NDArray[np.bool_] = ~is_good[self.runs.status]
        return failed

    def of_good_runs(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values of complete runs: nan for members that failed before their end."""
        if values.dtype.kind != "f" or not self._failed.any():
            return values
        # the values may be a cached column, which others still read
        masked_values = values.copy()
        masked_values[self._failed] = np.nan
        return masked_values

    def detector_events(self, detector: str) -> tuple[Rows, Rows, Rows]:
        """Return the events of one detector: index among all events, member, and which occurrence it is, from 0."""
        if detector not in self.detectors:
            empty = np.zeros(0, np.int64)
            return empty, empty, empty
        first = self.runs.first_event
        places = np.flatnonzero(self.event_detectors == self.detectors.index(detector))
        members = np.repeat(np.arange(self.size), np.diff(first))[places]
        # members ascend, so searchsorted gives the place of each one's first event, from which its others are counted
        return places, members, np.arange(len(places)) - np.searchsorted(members, members)

    @cached_property
    def detectors(self) -> tuple[str, ...]:
        """The detectors of events; of detectors with dimensions every element."""
        return tuple(labels(self.layout.watched))

    @cached_property
    def event_detectors(self) -> Rows:
        """The number among `detectors` of what located each event of all members."""
        numbers = np.array([self.detectors.index(detector.name) for detector in self.layout.watched], np.int64)
        block = self.runs.log_block
        detectors: Rows = numbers[block.log.events["detector"][: block.events]]
        return detectors

    @cached_property
    def extremes_cache(self) -> dict[tuple[str, float], tuple[NDArray[Any], ...]]:
        """Extremes computed so far, by name and sign."""
        return {}

    def states_at(
        self, members: Rows, times: Floats, *, after_event: bool, known_rows: Rows | None = None
    ) -> tuple[Mapping[str, Floats], Rows]:
        """Evaluate states of members at times, as `sample` does; return also the row that each step starts from.

        For the first times the rows may be given as `known_rows`.
        """
        first, known_rows = self.runs.first_row, np.zeros(0, np.int64) if known_rows is None else known_rows
        low, high = first[members], first[members + 1] - 1
        remaining = slice(known_rows.size, None)
        rows = np.concatenate(
            [
                known_rows,
                step_start_rows(
                    self["time"], low[remaining], high[remaining], times[remaining], last_at_time=after_event
                ),
            ]
        )
        values = self._states_within_steps(members, times, rows, np.minimum(rows + 1, high))
        return _NamedStates(self.layout.used, values), rows

    def _states_within_steps(self, members: Rows, times: Floats, rows: Rows, following: Rows) -> Floats:
        """Repeat steps, shortened to end at the given times: side by side where possible."""
        slides = any((~np.isnan(self._slid(name, rows))).any() for name in self.layout.shares)
        if self.parts is not None and not slides:
            return self.parts.states(self.runs, np.stack([rows, following, members]), times)
        return self._repeat_steps(members, times, rows, following, with_error=False)[: self.layout.used.size]

    @cached_property
    def _row_links(self) -> RowLinks | None:
        """The closed links of many in each row, as `StepInterpolator` takes them from a record."""
        closed_links = self.runs.log_block.log.closed.astype(np.int64)
        return RowLinks(closed_links[0], closed_links[[1, 6]]) if self.model.assemblies else None

    def _repeat_steps(self, members: Rows, times: Floats, rows: Rows, following: Rows, *, with_error: bool) -> Floats:
        """Repeat steps one by one; if `with_error`, return also the distance of each state from a more accurate one."""
        time, column_rows = self["time"], step_columns(self.model, self.settings, rows, following)
        columns = np.concatenate(
            [
                self._slid(name, row_indices)[None]
                if name in self.layout.shares
                else flattened_rows(self[name][row_indices]).T
                for name, row_indices in column_rows
            ]
        )
        links = None if self._row_links is None else self._row_links.links_at(rows)
        if self.model.delays:
            step_times = np.stack([times, time[rows], time[following]])
            return self._repeat_with_past(members, step_times, columns, with_error=with_error)
        return states_within(
            self.model,
            single_step_settings(self.model, self.settings),
            law_of(self.layout, sampled=False),
            np.stack([times, time[rows], time[following]]),
            columns,
            state_factors(self.model, self.settings)[:, None],
            reintegrated=True,
            with_distances=with_error,
            # the model's own numbers: what may follow them are addresses of the run that was marched
            parameters=self.runs.parameters[:, : (1 + self.layout.is_doubled) * len(constants(self.model))],
            runs=members,
            links=links,
        )

    def _slid(self, share: str, rows: Rows | slice) -> Floats:
        """Return a number where the motion slides along a switch, else nan: its side is known where no share is kept."""
        flag, slides = self.layout.sliding_flags[share]
        return np.where(self.runs.log_block.log.flags[flag, rows] == slides, 0.5, np.nan)

    def _repeat_with_past(self, members: Rows, step_times: Floats, columns: Floats, *, with_error: bool) -> Floats:
        """Repeat steps of one member after the other, each with the past that its own rows leave."""
        settings, factors = (
            single_step_settings(self.model, self.settings),
            state_factors(self.model, self.settings)[:, None],
        )
        law, states = law_of(self.layout, sampled=False), np.empty((2 * self.layout.used.size, members.size))
        names = ("time", "step_size", "regime", "row_kind", *map(state_name, reactions(self.model)), *self.layout.used)
        for member in np.unique(members).tolist():
            selected, rows = members == member, slice(*self.runs.first_row[member : member + 2].tolist())
            model = self._member_model(member, rows.start)
            past = past_of(model, settings, law, np.stack([self[name][rows].astype(float) for name in names]), factors)
            step_inputs = step_times[:, selected], columns[:, selected], factors
            states[:, selected] = states_within(
                model, settings, law, *step_inputs, reintegrated=True, with_distances=with_error, past=past
            )
        return states

    def _member_model(self, member: int, row: int) -> Model:
        """Return a member's own model, that begins with its first row."""
        model, si = (
            self.model,
            {name: spell(dimension).text for name, dimension in self.model.elements.dimensions.items()},
        )
        member_values = self._member_parameters(np.array([member]), frozenset(model.elements.statement.parameters))
        starts = {name: f"{self[name][row].item()!r} {self.columns[name].variable.units}" for name in self.layout.used}
        starts["t"] = f"{self['time'][row].item()!r} {model.time_unit.text}"
        parameters = {name: f"{value[0].item()!r} {si[name]}" for name, value in member_values.items()}
        return model.replace(parameters=parameters, initial=starts) if parameters else model.replace(initial=starts)

    def at_times(self, times: Floats) -> tuple[Rows, Rows, Mapping[str, Floats], Rows]:
        """Evaluate all members at times; return member and time index of each, the states, and the row stepped from."""
        if "at" not in self._sample_cache:
            first, last = self["time"][self.runs.first_row[:-1]], self.last_values("time")
            members, indices = np.nonzero((times >= first[:, None]) & (times <= last[:, None]))
            self._sample_cache["at"] = (members, indices, *self.states_at(members, times[indices], after_event=True))
        sampled: tuple[Rows, Rows, Mapping[str, Floats], Rows] = self._sample_cache["at"]
        return sampled

    @cached_property
    def _sample_cache(self) -> dict[str, Any]:
        return {}

    def evaluate(self, name: str, states: Mapping[str, Floats], members: Rows, rows: Rows, times: Floats) -> Floats:
        """Evaluate a quantity, or an element of one, at states inside steps, in the unit of a record: shape (k, ...)."""
        if name in states:
            return states[name]
        row = self.layout.row
        block = Block(name, "") if row.find_offset(name) is None or name in row else row.block(name)
        if not block.dims:
            return self._evaluate_trees(name, VALUE, states, members, rows, times)[0]
        elements = [self.evaluate(element, states, members, rows, times) for element in block.elements()]
        return np.stack(elements, axis=-1).reshape(-1, *block.shape)

    def evaluate_rate(
        self, name: str, states: Mapping[str, Floats], members: Rows, rows: Rows, times: Floats
    ) -> Floats:
        """Evaluate the rate of a quantity whose rate is known."""
        return self._evaluate_trees(name, RATE, states, members, rows, times)[0]

    def rate_at_rows(self, name: str, members: Rows, rows: Rows) -> Floats:
        """Evaluate the rate of a quantity whose rate is known at accepted states."""
        states = {state: self[state][rows] for state in _evaluation_plan(self.model, name, RATE).states}
        return self.evaluate_rate(name, states, members, rows, self["time"][rows])

    def evaluate_with_rates(
        self, name: str, states: Mapping[str, Floats], members: Rows, rows: Rows, times: Floats
    ) -> tuple[Floats, Floats]:
        """Evaluate a quantity and its rate; if the rate is not known, return the quantity for both."""
        if rate_tree(self.model, name) is None:
            values = self.evaluate(name, states, members, rows, times)
            return values, values
        if name in states:
            return states[name], self.evaluate_rate(name, states, members, rows, times)
        values, rates = self._evaluate_trees(name, (*VALUE, *RATE), states, members, rows, times)
        return values, rates

    def interpolation_errors(self, name: str, members: Rows, times: Floats) -> Floats:
        """Estimate the error of a quantity from interpolation inside steps, as `extremes.values_between_rows` does for one run."""
        first, used = self.runs.first_row, self.layout.used
        last = first[members + 1] - 1
        rows = step_start_rows(self["time"], first[members], last, times, last_at_time=False)
        states_and_errors = self._repeat_steps(members, times, rows, np.minimum(rows + 1, last), with_error=True)
        parts = states_and_errors[: len(used)], states_and_errors[len(used) : 2 * len(used)]
        states, errors = (_NamedStates(used, part) for part in parts)
        if name in states:
            deviation: Floats = np.abs(errors[name])
            return deviation
        value = self.evaluate(name, states, members, rows, times)
        total = np.zeros(value.shape)
        states_read = {
            coordinate: states[coordinate] for coordinate in _evaluation_plan(self.model, name, VALUE).states
        }
        for coordinate, state in states_read.items():
            shifted_states = states_read | {coordinate: state + errors[coordinate]}
            total += np.abs(self.evaluate(name, shifted_states, members, rows, times) - value)
        return total

    def _evaluate_trees(
        self, name: str, kinds: tuple[str, ...], states: Mapping[str, Floats], members: Rows, rows: Rows, times: Floats
    ) -> list[Floats]:
        plan = _evaluation_plan(self.model, name, kinds)
        unit = float(parse_unit(self.columns[name].variable.units).factor)
        # what follows a member's last row is the first one of another member
        following = np.minimum(rows + 1, self.runs.first_row[members + 1] - 1)
        columns = evaluate_inside_steps(
            self.model,
            plan.trees,
            {state: states[state] for state in plan.states},
            times,
            (rows, following),
            {column: self[column] for column in ("regime", *reaction_columns(self.model))}
            | {share: self._slid(share, slice(None)) for share in self.layout.shares},
            self.settings.math_functions,
            self._member_parameters(members, plan.names),
            plan.read,
            trees_of=lambda model: _evaluated_trees(model, name, kinds),
        )
        return [column_values / unit for column_values in columns]

    def _member_parameters(self, members: Rows, names: frozenset[str]) -> dict[str, Floats]:
        """Return the named parameters of each member, SI."""
        model, scales, places = self.model, self.settings.scales, _parameter_indices(self.model)
        return {
            name: self.runs.parameters[members, i] * scales.si_factor(model.elements.dimensions[name])
            for i, name in sorted((places[name], name) for name in names if name in places)
        }


class _EvaluationPlan(NamedTuple):
    """Expressions, the assignments of the motion that they read, every name that these need, and which are states."""

    trees: tuple[Node, ...]
    read: tuple[Assignment, ...]
    names: frozenset[str]
    states: tuple[str, ...]


@lru_cache(maxsize=64)
def _parameter_indices(model: Model) -> dict[str, int]:
    """Return the index of each parameter among the constants of a law."""
    return {name: i for i, name in enumerate(constants(model)) if name in model.elements.statement.parameters}


@lru_cache(maxsize=64)
def _evaluation_plan(model: Model, name: str, kinds: tuple[str, ...]) -> _EvaluationPlan:
    """Collect what evaluating a quantity, its known rate, or both takes."""
    trees = _evaluated_trees(model, name, kinds)
    assignments = tuple(assignments_read(model, trees))
    values = [entry.value for entry in assignments]
    names = [set(entry.arguments) if isinstance(entry, Function) else free_names(entry) for entry in (*trees, *values)]
    needed_names = frozenset().union(
        *names, *map(free_names, model.elements.looked_up_at.values())
    )  # tables are looked up all at once
    used = layout_of(model).used
    if share_columns(model):  # shares read what forces of either side do
        needed_names |= {*used, *model.elements.statement.parameters}
    states = sorted((name for name in needed_names if name in used), key=used.index)
    return _EvaluationPlan(tuple(trees), assignments, needed_names, tuple(states))


def _evaluated_trees(model: Model, name: str, kinds: tuple[str, ...]) -> list[Node]:
    """Return the expressions of a quantity, its known rate, or both."""
    trees = []
    for entry in kinds:
        # as in `observe`: without forces that depend on the side of a switch
        tree = layout_of(model).derived.get(name, Name(name)) if (entry,) == VALUE else rate_tree(model, name)
        assert tree is not None  # noqa: S101 - callers have checked
        trees.append(tree)
    return trees


def parallel_parts(model: Model, settings: Settings) -> PartsAbreast | None:
    """Return what repeats steps of members side by side; None where only the single run can."""
    layout = settings.layout(model)
    law, step_settings = law_of(layout, sampled=False), single_step_settings(model, settings)
    # a step by series repeats its expansion, too, and one with delays reads the past of its own run
    one_by_one = bool(reactions(model)) or law.scheme.method.solver == SERIES or bool(model.delays)
    lanes = 1 if one_by_one else lanes_for(law, step_settings, LANE_STATES, None)
    return PartsAbreast(model, step_settings, law, state_factors(model, settings), lanes) if lanes > 1 else None


def single_step_settings(model: Model, settings: Settings) -> Settings:
    """Return settings for a single step, as in `sample`: equations are solved as well as possible at any tolerance."""
    return replace(settings, until=model.statement.initial["t"].si, step=None, tolerances=None, pacing=Pacing())


def state_factors(model: Model, settings: Settings) -> Floats:
    """Return the factors from internal numbers of coordinates, velocities and states to those of the record."""
    return record.factors(settings.layout(model), settings.scales)
