"""What is kept of every member of a grid: words of `keep`, and the variables they stand for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import DOUBT_SAID, RULE_SAID
from xdynamics.evidence.diagnosing.heights import RULES
from xdynamics.evidence.evidence_dataset import about
from xdynamics.evidence.observables import is_comparable, is_observable, observables_of
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.model.joints import joint_reactions
from xdynamics.model.whole import is_read_whole
from xdynamics.record.element_attributes import attributes_of_whole, of_wholes
from xdynamics.record.element_names import Names, Whole, expanded
from xdynamics.record.run_columns import named_columns
from xdynamics.record.switches import shapes_with_switches
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT, EVENTS, OCCURRENCE, flags
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import DOT, parted
from xdynamics.sweeping.ensemble_records import Harvest
from xdynamics.sweeping.extrema import NO_RULE, extremes
from xdynamics.sweeping.run_quantities import RunQuantity, run_quantities
from xdynamics.units import SECONDS, Unit, time_in

Values = NDArray[Any]
Take = Callable[[Harvest], Values]

END, LOG = "end", "log"
EVENT_TIME, EVENT_COUNT, AFTER, BEFORE = "event_time_", "event_count_", "after_", "before_"
LARGEST, LEAST = "maximum_", "minimum_"
DIAGNOSTIC, EVENT, COUNT = "diagnostic", "event", "effort"
FLAGS = ("flag_values", "flag_meanings")
OUTCOME, DIGEST, UNCONTROLLED, STOPPED_BY = "run_outcome", "run_digest", "run_uncontrolled", "run_stopped_by"
COUNTS: dict[str, Take] = {
    "run_accepted_steps": lambda runs: runs.runs.accepted,
    "run_rejected_trials": lambda runs: runs.runs.trials,
    "run_force_evaluations": lambda runs: runs.runs.evaluations,
}  # as attributes of a record call them
# what every sweep has of its members, whatever is kept
ALWAYS = ("end_time", *COUNTS, OUTCOME, DIGEST, UNCONTROLLED, STOPPED_BY)


@dataclass(frozen=True)
class Kept:
    """A variable of a sweep.

    Attributes
    ----------
    name : str
    dims : tuple of str
        Dimensions after those of the axes.
    sizes : tuple of int
    units, long_name, role : str
    take : callable
        From a `Harvest` to an array, shape (members, *sizes).
    reads, motion : tuple of str
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
    take: Take
    reads: tuple[str, ...] = ()
    motion: tuple[str, ...] = ()
    dtype: str = "f8"
    more: Mapping[str, Any] = field(default_factory=dict)
    of_run: str = ""
    first: int = 0

    @property
    def attributes(self) -> dict[str, Any]:
        """The variable's attributes in a sweep."""
        return about(self.units, self.long_name, self.role) | dict(self.more)


@dataclass(frozen=True)
class Keeping:
    """What is kept of every member.

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
    def whole(self) -> bool:
        """Whether full records are kept."""
        return LOG in self.words

    def variables(self, model: Model, settings: Any) -> tuple[Kept, ...]:
        """Return the variables that the words stand for.

        Raises
        ------
        InputError
            If words stand for nothing in the model; all of them are named.
        """
        reader = _WordReader(self, model, settings)
        variables: dict[str, Kept] = {}
        unknown = []
        for word in (*reader.words, *reader.sampled()):
            kept = reader.read(word) or reader.of_run(word)
            unknown += [] if kept or word in (LOG, *ALWAYS) else [word]
            variables |= {variable.name: variable for variable in kept}
        if unknown:
            known = list(dict.fromkeys([*of_wholes(reader.known()), *reader.of_runs, *ALWAYS]))
            raise InputError(f"keep has {'; '.join(misspelt(word, known) for word in unknown)}")
        stems = {name: parted(name)[0] for name in variables}
        own = {name: variables[name] for name, stem in stems.items() if stem == name or stem not in variables}
        return folded(own, reader.shapes)  # an element whose quantity is kept is in it


def misspelt(word: str, known: Sequence[str]) -> str:
    """Say that a word of `keep` stands for nothing, and which three are nearest."""
    nearest = get_close_matches(word, known, n=3, cutoff=0.0)
    return f"'{word}', which no run, event or diagnosis of the model has; the nearest are {', '.join(nearest)}"


def folded(variables: Mapping[str, Kept], shapes: Shapes) -> tuple[Kept, ...]:
    """Make one variable of the elements of each quantity with dimensions."""
    wholes = Names(shapes).wholes(variables)
    whole_of = {name: whole for whole in wholes.values() for name in whole.members.values()}
    collected: dict[str, Kept] = {}
    for name, variable in variables.items():
        whole = whole_of.get(name)
        if whole is None:
            collected[name] = variable
        elif whole.name not in collected:
            collected[whole.name] = _whole(whole, {i: variables[member] for i, member in whole.members.items()})
    return tuple(collected.values())


def _whole(whole: Whole, elements: Mapping[int, Kept]) -> Kept:
    """Return a quantity with dimensions, which come last."""
    first = next(iter(elements.values()))
    shared = attributes_of_whole({i: (element.name, element.attributes) for i, element in elements.items()}, whole.size)
    return replace(
        first,
        name=whole.name,
        dims=(*first.dims, *whole.dims),
        sizes=(*first.sizes, *whole.shape),
        long_name=shared["long_name"],
        take=lambda runs: whole.stacked({i: element.take(runs) for i, element in elements.items()}),
        reads=tuple(dict.fromkeys(name for element in elements.values() for name in element.reads)),
        more=dict(first.more) | whole.more,
    )


class _WordReader:
    """Resolve the words of `keep` for a model."""

    def __init__(self, keeping: Keeping, model: Model, settings: Any) -> None:
        self.keeping, self.model, self.settings = keeping, model, settings
        self.layout = settings.layout(model)
        self.columns = named_columns(self.layout, settings)
        self.shapes = shapes_with_switches(self.layout.model)
        detectors = str(self.columns["event_detector"].variable.more["flag_meanings"]).split()
        self.detectors = detectors if self.layout.watched else []
        self.motion = (
            "time",
            "step_size",
            *self.layout.used,
            *self.layout.reactions,
        )  # what states inside steps are computed from
        self.loads = {*self.layout.loads, *joint_reactions(model.joints)}  # they have extremes too
        self.words = tuple(
            one for word in keeping.words for one in self._one_by_one(self.shapes.inside(word, "keep has"))
        )

    def _one_by_one(self, word: str) -> tuple[str, ...]:
        """Return a word of a quantity as those of its elements, where it is not read whole."""
        return (word,) if self.reads(word) else expanded((word,), self.known(), self.shapes)

    def known(self) -> list[str]:
        """List the words that can be kept."""
        events = [word + name for name in self.detectors for word in (EVENT_TIME, EVENT_COUNT)]
        quantities = [word + name for word in ("end_", LARGEST, LEAST, "") for name in observables_of(self.model)]
        beside = [f"{word}{name}_…" for name in self.single_detectors for word in (AFTER, BEFORE)]
        loads = [word + name for word in (LARGEST, LEAST) for name in self.loads]
        return [END, LOG, *events, *beside, *quantities, *loads]

    @cached_property
    def of_runs(self) -> Mapping[str, RunQuantity]:
        """What takes the whole run of a member, by name."""
        return run_quantities(self.model, self.settings)

    @property
    def single_detectors(self) -> list[str]:
        """Detectors without dimensions: what stands beside those of elements would be of two elements."""
        return [name for name in self.detectors if DOT not in name]

    def sampled(self) -> list[str]:
        """Return what is kept at times by default: every state, if times are given and no quantity is named."""
        named = any(is_observable(self.model, word) for word in self.words)
        return [] if named or not self.keeping.times.size else self.states

    @property
    def states(self) -> list[str]:
        """Coordinates, velocities and states: quantities where these are read whole, else elements."""
        used = self.layout.used
        return [block.name for block in used.blocks] if is_read_whole(self.model) else [*used]

    def reads(self, word: str) -> bool:
        """Whether a word stands for variables, as it is."""
        try:
            return word in (END, LOG, *ALWAYS) or bool(self.read(word))
        except InputError:  # which says why it cannot be kept
            return True

    def read(self, word: str) -> list[Kept]:
        """Return the variables that a word stands for; none if it is not known."""
        if word == END:
            return [self._end(name) for name in self.states]
        if is_observable(self.model, word):
            return [self._at(word)]
        for head, make in ((EVENT_TIME, self._event_time), (EVENT_COUNT, self._event_count)):
            if word.removeprefix(head) in self.detectors and word.startswith(head):
                return [make(word.removeprefix(head))]
        for head in ("end_", LARGEST, LEAST):
            name = word.removeprefix(head)
            if name in self.loads and word.startswith(head) and head != "end_":
                return self._extreme(word, name)
            if word.startswith(head) and is_observable(self.model, name):
                if head == "end_":
                    return [self._end(name)]
                return [] if self.columns[name].variable.dims[1:] else self._extreme(word, name)
        return self._of_events(word)

    def _of_events(self, word: str) -> list[Kept]:
        for head in (AFTER, BEFORE):
            for detector in self.single_detectors:
                name = word.removeprefix(f"{head}{detector}_")
                if name != word and name in self.columns:
                    return [self._beside(word, head, detector, name)]
        for detector in self.detectors:
            name = word.removesuffix(f"_{detector}")
            if name != word and name in self.columns and self._is_of_events(self.columns[name].variable.dims):
                return [self._of_event(word, name, detector)]
        return []

    def _is_of_events(self, dims: tuple[str, ...]) -> bool:
        return dims[0] == EVENTS and {*dims[1:]} <= {*self.model.shapes.extents}

    def _of_event(self, word: str, name: str, detector: str) -> Kept:
        column = self.columns[name].variable
        further, description = column.dims[1:], f"{column.long_name}, '{detector}'"
        return self._occurrences(
            word, detector, column.units, description, lambda runs, places: runs[name][places].astype(float), further
        )

    def of_run(self, word: str) -> list[Kept]:
        """Return the variable of a word that takes the whole run of a member; none if it is not known."""
        if word in (LOG, *ALWAYS) or word not in self.of_runs:
            return []
        found, (begin, end) = self.of_runs[word], self.keeping.occurrences
        more = {name: found.attributes[name] for name in FLAGS if name in found.attributes}
        is_counted = found.is_listed and (begin, end) != (0, 1)
        dims = (OCCURRENCE, *found.dims) if is_counted else found.dims
        sizes = (*((end - begin,) if is_counted else ()), *self.model.shapes.shape(found.dims))
        description = f"{found.attributes['long_name']}{', first' if found.is_listed and not is_counted else ''}"
        missing: Any = np.nan if found.dtype.startswith("f") else -1
        kept = Kept(
            word,
            dims,
            sizes,
            str(found.attributes["units"]),
            f"{description}; {'nan' if missing != -1 else '-1'} of a run that failed",
            str(found.attributes["role"]),
            lambda runs: np.full((runs.size, *sizes), missing),
            dtype=found.dtype,
            more=more,
            of_run=word,
            first=begin if found.is_listed else 0,
        )
        return [kept]

    def _end(self, name: str) -> Kept:
        column = self.columns[name].variable
        return Kept(
            f"end_{name}",
            column.dims[1:],
            self.model.shapes.shape(column.dims[1:]),
            column.units,
            f"{column.long_name}, where the run ended; nan of one that failed",
            column.role,
            lambda runs: runs.of_good_runs(runs.last(name)),
        )

    def _at(self, name: str) -> Kept:
        times, column = self.keeping.times, self.columns[name].variable
        shape = self.model.shapes.shape(column.dims[1:])
        if not times.size:
            raise InputError(f"keep has '{name}', which needs times=[…]; or keep 'end_{name}'")
        if not is_comparable(self.model, name):
            raise InputError(
                f"keep has '{name}', which reads accelerations, which contacts change; keep what it is made of"
            )

        def take(runs: Harvest) -> Values:
            values = np.full((runs.size, times.size, *shape), np.nan)
            members, indices, states, rows = runs.at_times(times)
            if members.size:
                values[members, indices] = runs.value(name, states, members, rows, times[indices])
            return values

        return Kept(
            name,
            (AT, *column.dims[1:]),
            (times.size, *shape),
            column.units,
            f"{column.long_name}; nan after the end of a run",
            column.role,
            take,
            motion=self.motion,
        )

    def _event_time(self, detector: str) -> Kept:
        return self._occurrences(
            f"{EVENT_TIME}{detector}",
            detector,
            self.model.time_unit.text,
            f"time at which '{detector}' was met",
            lambda runs, places: runs["event_time"][places],
        )

    def _event_count(self, detector: str) -> Kept:
        def take(runs: Harvest) -> Values:
            return np.bincount(runs.met(detector)[1], minlength=runs.size)

        return Kept(f"{EVENT_COUNT}{detector}", (), (), "1", f"how often '{detector}' was met", EVENT, take, dtype="i8")

    def _beside(self, word: str, head: str, detector: str, name: str) -> Kept:
        column, side = self.columns[name].variable, "event_row_after" if head == AFTER else "event_row_before"

        def take(runs: Harvest, places: Values) -> Values:
            first = np.repeat(runs.runs.first_row[:-1], np.diff(runs.runs.first_event))
            values: Values = runs[name][(first + runs[side])[places]]
            return values

        description = f"{column.long_name}, {head.removesuffix('_')} '{detector}' was met"
        kept = self._occurrences(word, detector, column.units, description, take, column.dims[1:])
        return replace(kept, role=column.role, reads=(name,), motion=self.motion)

    def _occurrences(
        self,
        name: str,
        detector: str,
        units: str,
        description: str,
        value: Callable[[Harvest, Values], Values],
        further: tuple[str, ...] = (),
    ) -> Kept:
        """Return a variable over the kept occurrences of an event, if there are to be several, and over its own dimensions."""
        begin, end = self.keeping.occurrences
        count, shape = end - begin, self.model.shapes.shape(further)

        def take(runs: Harvest) -> Values:
            values = np.full((runs.size, count, *shape), np.nan)
            places, members, which = runs.met(detector)
            selected = (which >= begin) & (which < end)
            values[members[selected], which[selected] - begin] = value(runs, places[selected])
            return values[:, 0] if single else values

        single = (begin, end) == (0, 1)
        dims, sizes = ((), ()) if single else ((OCCURRENCE,), (count,))
        return Kept(
            name,
            (*dims, *further),
            (*sizes, *shape),
            units,
            f"{description}{', first' if single else ''}; nan where it was not",
            EVENT,
            take,
        )

    def _extreme(self, word: str, name: str) -> list[Kept]:
        """Return the largest or least value of a quantity, and when it was reached."""
        sign, column = (1.0 if word.startswith(LARGEST) else -1.0), self.columns[name].variable
        description = f"{'largest' if sign > 0 else 'least'} {name} of the run"
        rules = flags({NO_RULE: "none", **dict(enumerate(RULES))})

        def kept(end: str, place: int, units: str, description: str, role: str, **extra: Any) -> Kept:
            return Kept(
                f"{word}{end}",
                (),
                (),
                units,
                description,
                role,
                lambda runs: runs.of_good_runs(extremes(runs, name, sign)[place]),
                reads=(name,),
                motion=self.motion,
                **extra,
            )

        return [
            kept("", 0, column.units, description, DIAGNOSTIC),
            kept(
                "_time", 1, self.model.time_unit.text, f"when {name} was {description.split(maxsplit=1)[0]}", DIAGNOSTIC
            ),
            kept("_rule", 2, "1", RULE_SAID, "flag", dtype="i1", more=rules),
            kept("_uncertainty", 3, column.units, DOUBT_SAID.format(word), "error"),
        ]


def keeping_of(words: Sequence[str] | str, times: Any, occurrences: Any, unit: Unit = SECONDS) -> Keeping:
    """Read the arguments `keep`, `times` and `occurrences` of a sweep.

    Raises
    ------
    InputError
        If words, times or occurrences cannot be used.
    """
    from xdynamics.dynamics.wanted_times import wanted_times

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
