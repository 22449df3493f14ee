"""The words of `keep`: the variables that a sweep records of every member.

Largest and least values are searched for all members at once, as `diagnose` searches those of one run.

Other numbers need the complete run of a member: its diagnosis, and the attributes of the march in its record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.evidence.diagnosing.conservation import ROLE
from xdynamics.evidence.diagnosing.diagnosis import diagnose, foreseen_diagnosis
from xdynamics.evidence.diagnosing.extremes import DOUBT_SAID, RULE_SAID
from xdynamics.evidence.diagnosing.phases import TURNS
from xdynamics.evidence.diagnosing.summits import (
    INTERPOLATED,
    LOCATED,
    RULES,
    SAMPLED,
    Summits,
    crests,
    humps,
    parabola_excess,
    summits,
)
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.observables import is_comparable, is_observable, observables_of, rate_tree
from xdynamics.faults import InputError
from xdynamics.march import March, Settings
from xdynamics.march.outcomes import GOOD
from xdynamics.model import Model
from xdynamics.model.detectors import labels
from xdynamics.model.joints import joint_reactions
from xdynamics.record.column import shapes_with_switches
from xdynamics.record.folding import Names, QuantityElements, attributes_of_quantity, expand_quantities, quantity_names
from xdynamics.record.run_columns import named_columns
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import DOT, split_element_name
from xdynamics.sweeping.ensemble_records import MemberRuns
from xdynamics.units import NUMBERS, SECONDS, Unit, time_in

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

NO_RULE = -1  # of a member without a finite value


class Extremes(NamedTuple):
    """The extremes of one quantity, shape (members,).

    Attributes
    ----------
    value : ndarray
        In the unit of a record; nan for a member without a finite value.
    time : ndarray, s
    rule : ndarray of int8
        Index into `RULES` (an accepted state, a state between, one at an event), or `NO_RULE`.
    uncertainty : ndarray
        Of the value, by interpolation alone, as for a single run.
    """

    value: Floats
    time: Floats
    rule: NDArray[np.int8]
    uncertainty: Floats


def extremes_of_members(runs: MemberRuns, name: str, sign: float) -> Extremes:
    """Find the largest value of a quantity in every member (with a sign of -1 the least), its time and uncertainty.

    Parameters
    ----------
    runs : Harvest
        With complete logs.
    name : str
    sign : float
    """
    if (name, sign) not in runs.extremes_cache:
        runs.extremes_cache[name, sign] = _search_extremes(runs, name, sign)
    return Extremes(*runs.extremes_cache[name, sign])


def _search_extremes(runs: MemberRuns, name: str, sign: float) -> Extremes:
    values, time, first = runs[name], runs["time"], runs.runs.first_row
    rows, members = crests(sign * values, first)
    tops = _highest_rows(sign * values, rows, members, runs.size)
    extremes = _extremes_of_rows(runs, values, tops)
    unrated = runs.columns[name].variable.role not in schema.INTEGRATED and bool(runs.model.python_functions)
    solves_anew = (
        bool(runs.model.assemblies) and not runs.settings.method.stepper.locates
    )  # impulses at each time inside
    if unrated or solves_anew:
        for i in np.flatnonzero(extremes.rule == SAMPLED).tolist():
            run_rows = slice(first[i], first[i + 1])
            extremes.uncertainty[i] = parabola_excess(values[run_rows], time[run_rows], int(tops[i] - first[i]))
    if unrated:
        return extremes
    search = _begin_search(runs, name, sign, extremes, humps(sign * values, time, first, rows, members))
    if solves_anew:
        # fmax, not maximum: a nan on one side gives way to the number on the other
        return extremes._replace(uncertainty=np.fmax(extremes.uncertainty, search.open_heights))
    while (places := search.places()).size:
        times = search.place_members
        states, from_rows = runs.states_at(times, places, after_event=False, known_rows=search.rows)
        search.narrow(*runs.evaluate_with_rates(name, states, times, from_rows, places))
    between = np.flatnonzero(sign * search.best > sign * extremes.value)
    for array, improved in ((extremes.value, search.best), (extremes.time, search.when)):
        array[between] = improved[between]
    if between.size:
        extremes.rule[between] = INTERPOLATED
        extremes.uncertainty[between] = runs.interpolation_errors(name, between, extremes.time[between])
    return extremes


def _extremes_of_rows(runs: MemberRuns, values: Floats, tops: Rows) -> Extremes:
    """Return the extremes over accepted states alone."""
    has_number = tops >= 0
    at_event = np.isin(runs["row_kind"][tops], (schema.EVENT_BEFORE, schema.EVENT_AFTER))
    rule = np.where(has_number, np.where(at_event, LOCATED, SAMPLED), NO_RULE).astype(np.int8)
    best, best_times = np.where(has_number, values[tops], np.nan), np.where(has_number, runs["time"][tops], np.nan)
    return Extremes(best, best_times, rule, np.where(has_number, 0.0, np.nan))


def _begin_search(
    runs: MemberRuns, name: str, sign: float, accepted: Extremes, humps_found: tuple[Rows, Rows]
) -> Summits:
    """Begin the search for extremes between accepted states, around the humps of a quantity."""
    (rows, members), first, time = humps_found, runs.runs.first_row, runs["time"]
    rates = None
    if rate_tree(runs.model, name) is not None:
        low, high = np.maximum(rows - 1, first[members]), np.minimum(rows + 1, first[members + 1] - 1)
        rates_at_rows = runs.rate_at_rows(name, members, rows)
        rising = sign * rates_at_rows > 0.0
        rates_opposite = runs.rate_at_rows(
            name, members, np.where(rising, high, low)
        )  # at the other end of the bracket
        rates = np.stack(
            [np.where(rising, np.nan, rates_opposite), rates_at_rows, np.where(rising, rates_opposite, np.nan)]
        )
    return summits(sign, accepted.value.copy(), accepted.time.copy(), runs[name], time, first, rates, rows, members)


def _highest_rows(values: Floats, rows: Rows, members: Rows, size: int) -> Rows:
    """Return the first row of each member that holds its largest value, a crest; -1 where there is no finite value."""
    largest = np.full(size, -np.inf)
    # `at` takes every row of a member; indexed assignment would keep one of them
    np.maximum.at(largest, members, values[rows])
    # backwards, so that of equal rows the first is assigned last, and stays
    highest = np.flatnonzero(values[rows] == largest[members])[::-1]
    tops = np.full(size, -1)
    tops[members[highest]] = rows[highest]
    return tops


LISTED = (schema.CYCLE, TURNS)  # of which a run has as many as it happens to have
BY_COMPANION = ("believed_until", "phase_offset")  # for which a diagnosis marches once more


@dataclass(frozen=True)
class RunQuantity:
    """A number, or a list of numbers, that follows from a complete run.

    Attributes
    ----------
    dims : tuple of str
        Without those of `LISTED`.
    dtype : str
    attributes : mapping
    is_listed : bool
        Whether a run has any number of them: of its cycles or turns.
    """

    dims: tuple[str, ...]
    dtype: str
    attributes: Mapping[str, Any]
    is_listed: bool = False


def run_quantities(model: Model, settings: Settings) -> dict[str, RunQuantity]:
    """Return by name the numbers that the record and the diagnosis of a model's run have; nothing is marched for it."""
    rate, time = NUMBERS.per(model.time_unit).text, model.time_unit.text
    units = dict.fromkeys(schema.COUNTS, "1") | {"run_fastest_rate": rate, "run_slowest_period": time}
    units |= dict.fromkeys(("run_h_omega_start", "run_h_omega_largest"), "1")
    quantities = {
        name: RunQuantity((), "f8", attrs_of(unit, name.removeprefix("run_").replace("_", " "), ROLE))
        for name, unit in units.items()
    }
    diagnosis = foreseen_diagnosis(March(model, settings), 1)
    for name, variable in diagnosis.variables.items():
        dims = tuple(str(dim) for dim in variable.dims)
        is_known = {*dims} <= {*LISTED, *model.shapes.extents}  # gates are of the model, and no numbers
        if variable.dtype.kind in "fi" and variable.attrs.get("role") != "rule" and is_known:
            element_dims = tuple(dim for dim in dims if dim not in LISTED)
            quantities[str(name)] = RunQuantity(
                element_dims, variable.dtype.str[1:], dict(variable.attrs), is_listed=element_dims != dims
            )
    return quantities


def run_values(run: xr.Dataset, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named numbers of a run; a run that failed has attributes alone."""
    of_diagnosis = [name for name in names if name not in run.attrs and run.attrs["run_outcome"] in GOOD]
    diagnosis = diagnose(run, companion=bool({*of_diagnosis} & {*BY_COMPANION})) if of_diagnosis else run
    values = {name: diagnosis.variables[name].values for name in of_diagnosis if name in diagnosis.variables}
    return values | {name: np.asarray(run.attrs[name]) for name in names if name in run.attrs}


Values = NDArray[Any]
ValueFunction = Callable[[MemberRuns], Values]

END, LOG = "end", "log"
EVENT_TIME, EVENT_COUNT, AFTER, BEFORE = "event_time_", "event_count_", "after_", "before_"
LARGEST, LEAST = "maximum_", "minimum_"
DIAGNOSTIC, EVENT, COUNT = "diagnostic", "event", "effort"
FLAGS = ("flag_values", "flag_meanings")
OUTCOME, DIGEST, UNCONTROLLED, STOPPED_BY = "run_outcome", "run_digest", "run_uncontrolled", "run_stopped_by"
STRAYED = "run_events_strayed"
COUNT_FUNCTIONS: dict[str, ValueFunction] = {
    "run_accepted_steps": lambda runs: runs.runs.accepted,
    "run_rejected_trials": lambda runs: runs.runs.trials,
    "run_force_evaluations": lambda runs: runs.runs.evaluations,
}  # as attributes of a record call them
# what every sweep has of its members, whatever is kept
ALWAYS = ("end_time", *COUNT_FUNCTIONS, OUTCOME, DIGEST, UNCONTROLLED, STRAYED, STOPPED_BY)


@dataclass(frozen=True)
class KeptVariable:
    """A variable of a sweep.

    Attributes
    ----------
    name : str
    dims : tuple of str
        Dimensions after those of the axes.
    sizes : tuple of int
    units, long_name, role : str
    take : callable
        From `MemberRuns` to an array, shape (members, *sizes).
    log_columns, motion : tuple of str
        Variables along `step` that it takes from complete logs: by itself, and for states inside steps, as all that need these.
    dtype : str
    more : mapping
        Further attributes, such as the meanings of flags.
    of_run : str
        What it is called in the diagnosis or the attributes of a member's own run, if it is taken from there; then `take`
        gives nan.
    first : int
        Of something that a run has any number of: the first one that is kept, from 0.
    """

    name: str
    dims: tuple[str, ...]
    sizes: tuple[int, ...]
    units: str
    long_name: str
    role: str
    take: ValueFunction
    log_columns: tuple[str, ...] = ()
    motion: tuple[str, ...] = ()
    dtype: str = "f8"
    more: Mapping[str, Any] = field(default_factory=dict)
    of_run: str = ""
    first: int = 0

    @property
    def attributes(self) -> dict[str, Any]:
        """The variable's attributes in a sweep."""
        return attrs_of(self.units, self.long_name, self.role) | dict(self.more)


@dataclass(frozen=True)
class Keeping:
    """The variables that a sweep records of every member.

    Attributes
    ----------
    words : tuple of str
        As given.
    times : ndarray, shape (n,), s
    occurrences : (int, int)
        Range of occurrences of each event, counted from 0; the end is excluded.
    """

    words: tuple[str, ...]
    times: NDArray[np.float64]
    occurrences: tuple[int, int]

    @property
    def keeps_whole_runs(self) -> bool:
        """Whether complete runs are recorded."""
        return LOG in self.words

    def variables(self, model: Model, settings: Any) -> tuple[KeptVariable, ...]:
        """Return the variables that the words stand for.

        Raises
        ------
        InputError
            If words stand for nothing in the model; all of them are named.
        """
        reader = _WordReader(self, model, settings)
        variables: dict[str, KeptVariable] = {}
        unknown = []
        for word in (*reader.words, *reader.default_words()):
            word_variables = reader.variables_of(word) or reader.of_run(word)
            unknown += [] if word_variables or word in (LOG, *ALWAYS) else [word]
            variables |= {variable.name: variable for variable in word_variables}
        if unknown:
            available_words = list(dict.fromkeys([*quantity_names(reader.keepable_words()), *reader.of_runs, *ALWAYS]))
            raise InputError(f"keep has {'; '.join(misspelling_text(word, available_words) for word in unknown)}")
        stems = {name: split_element_name(name)[0] for name in variables}
        distinct_variables = {
            name: variables[name] for name, stem in stems.items() if stem == name or stem not in variables
        }
        return fold_elements(distinct_variables, reader.shapes)  # an element whose quantity is kept is in it


def misspelling_text(word: str, available_words: Sequence[str]) -> str:
    """Describe an unknown word of `keep` with the three most similar words."""
    nearest = get_close_matches(word, available_words, n=3, cutoff=0.0)
    return f"'{word}', which no run, event or diagnosis of the model has; the nearest are {', '.join(nearest)}"


def fold_elements(variables: Mapping[str, KeptVariable], shapes: Shapes) -> tuple[KeptVariable, ...]:
    """Fold the elements of each quantity with dimensions into one variable."""
    quantities = Names(shapes).by_quantity(variables)
    quantity_of_element = {name: quantity for quantity in quantities.values() for name in quantity.members.values()}
    collected: dict[str, KeptVariable] = {}
    for name, variable in variables.items():
        quantity = quantity_of_element.get(name)
        if quantity is None:
            collected[name] = variable
        elif quantity.name not in collected:
            collected[quantity.name] = _stack_elements(
                quantity, {i: variables[member] for i, member in quantity.members.items()}
            )
    return tuple(collected.values())


def _stack_elements(quantity: QuantityElements, elements: Mapping[int, KeptVariable]) -> KeptVariable:
    """Return a quantity with dimensions, which come last."""
    first = next(iter(elements.values()))
    shared_attributes = attributes_of_quantity(
        {i: (element.name, element.attributes) for i, element in elements.items()}, quantity.size
    )
    return replace(
        first,
        name=quantity.name,
        dims=(*first.dims, *quantity.dims),
        sizes=(*first.sizes, *quantity.shape),
        long_name=shared_attributes["long_name"],
        take=lambda runs: quantity.stacked({i: element.take(runs) for i, element in elements.items()}),
        log_columns=tuple(dict.fromkeys(name for element in elements.values() for name in element.log_columns)),
        more=dict(first.more) | quantity.more,
    )


class _WordReader:
    """Resolve the words of `keep` for a model."""

    def __init__(self, keeping: Keeping, model: Model, settings: Any) -> None:
        self.keeping, self.model, self.settings = keeping, model, settings
        self.layout = settings.layout(model)
        self.columns = named_columns(self.layout, settings)
        self.shapes = shapes_with_switches(self.layout.model)
        self.detectors = labels(self.layout.watched)
        self.motion = (
            "time",
            "step_size",
            *self.layout.used,
            *self.layout.reactions,
        )  # what states inside steps are computed from
        # accelerations, forces and what joints bear have extremes, too
        self.evaluated_names = {
            *self.layout.accelerations,
            *self.layout.applied_forces,
            *joint_reactions(model.joints),
        }
        self.words = tuple(
            element_word
            for word in keeping.words
            for element_word in self._one_by_one(self.shapes.internal_name(word, "keep has"))
        )

    def _one_by_one(self, word: str) -> tuple[str, ...]:
        """Replace the word of a quantity by the words of its elements, unless the quantity is recorded at once."""
        return (
            (word,)
            if self.stands_for_variables(word)
            else expand_quantities((word,), self.keepable_words(), self.shapes)
        )

    def keepable_words(self) -> list[str]:
        """List all valid words of `keep`."""
        events = [word + name for name in self.detectors for word in (EVENT_TIME, EVENT_COUNT)]
        quantities = [word + name for word in ("end_", LARGEST, LEAST, "") for name in observables_of(self.model)]
        event_words = [f"{word}{name}_…" for name in self.single_detectors for word in (AFTER, BEFORE)]
        evaluated = [word + name for word in (LARGEST, LEAST) for name in self.evaluated_names]
        return [END, LOG, *events, *event_words, *quantities, *evaluated]

    @cached_property
    def of_runs(self) -> Mapping[str, RunQuantity]:
        """The numbers that need a member's complete run, by name."""
        return run_quantities(self.model, self.settings)

    @property
    def single_detectors(self) -> list[str]:
        """Detectors without dimensions: states after events of elements would need the dimensions of both."""
        return [name for name in self.detectors if DOT not in name]

    def default_words(self) -> list[str]:
        """Return the words recorded at times by default: every state, if times are given without a quantity."""
        names_quantity = any(is_observable(self.model, word) for word in self.words)
        return [] if names_quantity or not self.keeping.times.size else self.state_words

    @property
    def state_words(self) -> list[str]:
        """Coordinates, velocities and states."""
        return [block.name for block in self.layout.used.blocks]

    def stands_for_variables(self, word: str) -> bool:
        """Whether a word stands for variables, as it is."""
        try:
            return word in (END, LOG, *ALWAYS) or bool(self.variables_of(word))
        except InputError:  # which says why it cannot be kept
            return True

    def variables_of(self, word: str) -> list[KeptVariable]:
        """Return the variables that a word stands for; none if it is not known."""
        if word == END:
            return [self._end_variable(name) for name in self.state_words]
        if is_observable(self.model, word):
            return [self._sampled_variable(word)]
        for head, make in ((EVENT_TIME, self._event_time_variable), (EVENT_COUNT, self._event_count_variable)):
            if word.removeprefix(head) in self.detectors and word.startswith(head):
                return [make(word.removeprefix(head))]
        for head in ("end_", LARGEST, LEAST):
            name = word.removeprefix(head)
            if name in self.evaluated_names and word.startswith(head) and head != "end_":
                return self._extreme_variables(word, name)
            if word.startswith(head) and is_observable(self.model, name):
                if head == "end_":
                    return [self._end_variable(name)]
                return [] if self.columns[name].variable.dims[1:] else self._extreme_variables(word, name)
        return self._of_events(word)

    def _of_events(self, word: str) -> list[KeptVariable]:
        for head in (AFTER, BEFORE):
            for detector in self.single_detectors:
                name = word.removeprefix(f"{head}{detector}_")
                if name != word and name in self.columns:
                    return [self._variable_at_event(word, head, detector, name)]
        for detector in self.detectors:
            name = word.removesuffix(f"_{detector}")
            if name != word and name in self.columns and self._is_of_events(self.columns[name].variable.dims):
                return [self._event_variable(word, name, detector)]
        return []

    def _is_of_events(self, dims: tuple[str, ...]) -> bool:
        return dims[0] == schema.EVENTS and {*dims[1:]} <= {*self.model.shapes.extents}

    def _event_variable(self, word: str, name: str, detector: str) -> KeptVariable:
        column = self.columns[name].variable
        element_dims, description = column.dims[1:], f"{column.long_name}, '{detector}'"
        return self._occurrence_variable(
            word,
            detector,
            column.units,
            description,
            lambda runs, places: runs[name][places].astype(float),
            element_dims,
        )

    def of_run(self, word: str) -> list[KeptVariable]:
        """Return the variable of a word that needs a member's complete run; none for other words."""
        if word in (LOG, *ALWAYS) or word not in self.of_runs:
            return []
        quantity, (begin, end) = self.of_runs[word], self.keeping.occurrences
        more = {name: quantity.attributes[name] for name in FLAGS if name in quantity.attributes}
        is_counted = quantity.is_listed and (begin, end) != (0, 1)
        dims = (schema.OCCURRENCE, *quantity.dims) if is_counted else quantity.dims
        sizes = (*((end - begin,) if is_counted else ()), *self.model.shapes.shape(quantity.dims))
        description = f"{quantity.attributes['long_name']}{', first' if quantity.is_listed and not is_counted else ''}"
        missing: Any = np.nan if quantity.dtype.startswith("f") else -1
        variable = KeptVariable(
            word,
            dims,
            sizes,
            str(quantity.attributes["units"]),
            f"{description}; {'nan' if missing != -1 else '-1'} of a run that failed",
            str(quantity.attributes["role"]),
            lambda runs: np.full((runs.size, *sizes), missing),
            dtype=quantity.dtype,
            more=more,
            of_run=word,
            first=begin if quantity.is_listed else 0,
        )
        return [variable]

    def _end_variable(self, name: str) -> KeptVariable:
        column = self.columns[name].variable
        return KeptVariable(
            f"end_{name}",
            column.dims[1:],
            self.model.shapes.shape(column.dims[1:]),
            column.units,
            f"{column.long_name}, where the run ended; nan of one that failed",
            column.role,
            lambda runs: runs.of_good_runs(runs.last_values(name)),
        )

    def _sampled_variable(self, name: str) -> KeptVariable:
        times, column = self.keeping.times, self.columns[name].variable
        shape = self.model.shapes.shape(column.dims[1:])
        if not times.size:
            raise InputError(f"keep has '{name}', which needs times=[…]; or keep 'end_{name}'")
        if not is_comparable(self.model, name):
            raise InputError(
                f"keep has '{name}', which reads accelerations, which contacts change; keep what it is made of"
            )

        def sampled_values(runs: MemberRuns) -> Values:
            values = np.full((runs.size, times.size, *shape), np.nan)
            members, indices, states, rows = runs.at_times(times)
            if members.size:
                values[members, indices] = runs.evaluate(name, states, members, rows, times[indices])
            return values

        return KeptVariable(
            name,
            (schema.AT, *column.dims[1:]),
            (times.size, *shape),
            column.units,
            f"{column.long_name}; nan after the end of a run",
            column.role,
            sampled_values,
            motion=self.motion,
        )

    def _event_time_variable(self, detector: str) -> KeptVariable:
        return self._occurrence_variable(
            f"{EVENT_TIME}{detector}",
            detector,
            self.model.time_unit.text,
            f"time at which '{detector}' was met",
            lambda runs, places: runs["event_time"][places],
        )

    def _event_count_variable(self, detector: str) -> KeptVariable:
        def event_counts(runs: MemberRuns) -> Values:
            return np.bincount(runs.detector_events(detector)[1], minlength=runs.size)

        return KeptVariable(
            f"{EVENT_COUNT}{detector}", (), (), "1", f"how often '{detector}' was met", EVENT, event_counts, dtype="i8"
        )

    def _variable_at_event(self, word: str, head: str, detector: str, name: str) -> KeptVariable:
        column, side = self.columns[name].variable, "event_row_after" if head == AFTER else "event_row_before"

        def values_at_event(runs: MemberRuns, places: Values) -> Values:
            # events name rows of their own member, and the columns have those of all, one after the other
            first = np.repeat(runs.runs.first_row[:-1], np.diff(runs.runs.first_event))
            values: Values = runs[name][(first + runs[side])[places]]
            return values

        description = f"{column.long_name}, {head.removesuffix('_')} '{detector}' was met"
        variable = self._occurrence_variable(
            word, detector, column.units, description, values_at_event, column.dims[1:]
        )
        return replace(variable, role=column.role, log_columns=(name,), motion=self.motion)

    def _occurrence_variable(
        self,
        name: str,
        detector: str,
        units: str,
        description: str,
        value: Callable[[MemberRuns, Values], Values],
        element_dims: tuple[str, ...] = (),
    ) -> KeptVariable:
        """Return a variable over an event's recorded occurrences, if several, and over its own dimensions."""
        begin, end = self.keeping.occurrences
        count, shape = end - begin, self.model.shapes.shape(element_dims)

        def occurrence_values(runs: MemberRuns) -> Values:
            values = np.full((runs.size, count, *shape), np.nan)
            places, members, occurrence_numbers = runs.detector_events(detector)
            selected = (occurrence_numbers >= begin) & (occurrence_numbers < end)
            values[members[selected], occurrence_numbers[selected] - begin] = value(runs, places[selected])
            return values[:, 0] if is_single else values

        is_single = (begin, end) == (0, 1)
        dims, sizes = ((), ()) if is_single else ((schema.OCCURRENCE,), (count,))
        return KeptVariable(
            name,
            (*dims, *element_dims),
            (*sizes, *shape),
            units,
            f"{description}{', first' if is_single else ''}; nan where it was not",
            EVENT,
            occurrence_values,
        )

    def _extreme_variables(self, word: str, name: str) -> list[KeptVariable]:
        """Return the largest or least value of a quantity, and when it was reached."""
        sign, column = (1.0 if word.startswith(LARGEST) else -1.0), self.columns[name].variable
        description = f"{'largest' if sign > 0 else 'least'} {name} of the run"
        rules = schema.flag_attributes({NO_RULE: "none", **dict(enumerate(RULES))})

        def extreme_variable(
            end: str, field_index: int, units: str, description: str, role: str, **extra: Any
        ) -> KeptVariable:
            return KeptVariable(
                f"{word}{end}",
                (),
                (),
                units,
                description,
                role,
                lambda runs: runs.of_good_runs(extremes_of_members(runs, name, sign)[field_index]),
                log_columns=(name,),
                motion=self.motion,
                **extra,
            )

        return [
            extreme_variable("", 0, column.units, description, DIAGNOSTIC),
            extreme_variable(
                "_time", 1, self.model.time_unit.text, f"when {name} was {description.split(maxsplit=1)[0]}", DIAGNOSTIC
            ),
            extreme_variable("_rule", 2, "1", RULE_SAID, "flag", dtype="i1", more=rules),
            extreme_variable("_uncertainty", 3, column.units, DOUBT_SAID.format(word), "error"),
        ]


def keeping_of(words: Sequence[str] | str, times: Any, occurrences: Any, unit: Unit = SECONDS) -> Keeping:
    """Read the arguments `keep`, `times` and `occurrences` of a sweep.

    Raises
    ------
    InputError
        If words, times or occurrences cannot be used.
    """
    from xdynamics.dynamics.recorded_steps import wanted_times

    row: list[Any] = [words] if isinstance(words, str) or not hasattr(words, "__iter__") else list(words)
    if not row or not all(isinstance(entry, str) for entry in row):
        raise InputError(f"keep is {str(words)[:60]}, needs words like 'end'")
    bounds = (0, occurrences) if isinstance(occurrences, int) else occurrences
    is_pair = isinstance(bounds, tuple | list) and len(bounds) == 2 and all(type(entry) is int for entry in bounds)
    if isinstance(occurrences, bool) or not is_pair or not 0 <= bounds[0] < bounds[1]:
        raise InputError(f"occurrences is {occurrences!r}, needs a positive whole number, or a pair like (100, 160)")
    if times is None:
        instants = np.zeros(0)
    else:
        if not isinstance(times, str | np.ndarray) and hasattr(times, "__iter__"):
            times = [time_in(unit, entry, "times") for entry in times]
        instants = wanted_times(times, unit)
    return Keeping(tuple(dict.fromkeys(row)), instants, (int(bounds[0]), int(bounds[1])))
