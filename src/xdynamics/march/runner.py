"""A march driven from Python: settings, blocks, interruption, outcome. Python sees blocks, never steps.

Ctrl-C while a run is marched: the first ends it with what is recorded, the second raises.

Marches that begin alike, as in a loop over one model, share one template of their first arrays, copied for each.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from math import inf, isfinite
from operator import itemgetter
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.kernels.engine_part import is_being_made
from xdynamics.kernels.law import FORCE_SAMPLES, ROW_ENERGIES
from xdynamics.kernels.machine import aligned_zeros
from xdynamics.march.energy_gains import Gains, add_gains, impacts_of, place_of_loss
from xdynamics.march.engine import NoMemoryError, engine
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import LOG_COUNTS, Log, LogBlock, log_of, misplaced_events, most_recycled
from xdynamics.march.memory import (
    LARGE,
    changing_arrays,
    final_numbers,
    give_back_memory,
    march_apart,
    put_back,
    rest_on,
)
from xdynamics.march.outcomes import (
    AT_SWITCH,
    INTERRUPTED,
    NONFINITE_OBSERVABLE,
    OUTCOMES,
    RUNNING,
    STEP_LIMIT,
    STOPPED,
    Outcome,
)
from xdynamics.march.past import make_room
from xdynamics.march.run import ARRAYS, NOW, Run
from xdynamics.march.settings import Settings
from xdynamics.march.sliding import Sliding
from xdynamics.march.thinning import RowsAroundTimes, Thinning, Witnesses
from xdynamics.march.unlocated_switches import NOWHERE, Passages, chattering
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model
from xdynamics.model.switches import Switch
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import ERRORS, EVENT_AFTER, EVENT_BEFORE, WITNESSES
from xdynamics.units import TIME, unit_suffix


@contextmanager
def ending_at_interrupt(end: Callable[[], None]) -> Iterator[None]:
    """Let the first Ctrl-C end the run as an outcome; a second one raises, and one while the engine is being made."""
    # Python sets signal handlers in the main thread alone
    if not _is_main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, previous)
        if is_being_made():  # by numba for a minute or longer, of which nothing is lost
            raise KeyboardInterrupt
        end()

    previous = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:  # of blocks that nobody closed, any thread that collects garbage comes here
        if _is_main_thread() and signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, previous)


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


FEW = 64  # numbers of a state, and parameters, of which what a march begins with is kept


def recurs(model: Model, settings: Settings, layout: Layout) -> bool:
    """Whether the first arrays of a march are small, and determined by settings that equal marches share.

    Equal floats may stand for unequal numbers, as they were written, and 0.0 for -0.0; times of controllers, of tables and
    nodes follow from these.
    """
    return (
        max(layout.used.size, len(model.elements.statement.parameters)) <= FEW
        and not (layout.reactions or layout.watched or model.events)
        and not (model.python_functions or model.assemblies or model.delays or model.drives or model.controllers)
        and not (settings.nodes or isinstance(settings.step, tuple) or settings.until == 0.0)
        and settings.precision == FLOAT64
    )


def copy_template_run(model: Model, settings: Settings, law: Law) -> Run:
    """Return a run that has not begun, as `pose_run` makes it, with arrays of its own."""
    first, filled = _template_run(model, settings, law)
    # "K" keeps Fortran's order, which rows of wide logs have
    arrays = {name: getattr(first, name).copy("K") for name in filled}
    return Run(first, **arrays | {"w": aligned_zeros(first.w.size)})


@lru_cache(maxsize=32)
def _template_run(model: Model, settings: Settings, law: Law) -> tuple[Run, tuple[str, ...]]:
    """Return a run that does not begin, and the names of its arrays that have elements."""
    run = pose_run(model, settings, law, log_of(law.layout, settings, 0), addresses_of(law))
    return run, tuple(name for name in ARRAYS if getattr(run, name).size)


PAUSE_ROWS = 250_000  # between two checks of the clock and the keyboard
LOOK = 0.5  # s between two checks where steps are slow
LARGEST_BLOCK = 1 << 24
SHORTEST_PART = 1 << 12
FIRST_PART = 1 << 6  # rows, where the clock matters and the time of one is unknown
FIRST_BLOCK = 1 << 10  # rows, where their number is unknown
THINNED_BLOCK = 1 << 14  # rows, of which some are kept: as many as a processor's cache holds
RECYCLED_NUMBERS = 1 << 19  # of a block that is filled again and again, where rows are wide: they stay in a cache
COPIED_BLOCK = 1 << 17  # rows of which some columns are kept, each in memory that goes back to the system

Progress = Callable[[float, float, int], None]  # fraction done, time in s, rows


class March:
    """One march of a model by a method.

    Parameters
    ----------
    model : Model
    settings : Settings
    progress : callable, optional
        Called between parts of a block with the fraction done, the time in s and the rows so far.
    times : ndarray, s, optional
        If given, rows are kept only around these times.

    Raises
    ------
    InputError
        If the settings are invalid, or a Python force is missing or cannot be compiled.
    """

    def __init__(
        self,
        model: Model,
        settings: Settings,
        progress: Progress | None = None,
        times: NDArray[np.float64] | None = None,
    ) -> None:
        settings.check(model)
        model.require_functions()
        self.model = model
        self.settings = settings
        self.progress = progress
        self.layout: Layout = settings.layout(model)
        self.times = times
        self.law: Law = law_of(self.layout, sampled=settings.samples, unread=self._unread)
        self.interrupted = False
        self.stopping_event = ""
        self.chattering = NOWHERE  # the detector of the switch that a march without end passed to and fro
        self.slides: Switch | None = None  # not located, along which it went on in tiny steps of its own choice
        self.bad_values: dict[str, float] = {}  # energies and observables of a row that could not be kept
        self.doubts: list[str] = []  # doubts about its accuracy, once it is over; see `outcome_text.ending`
        self.atol_effect = ""  # effect of errors of given absolute tolerances, in words, once it is over
        self.event_pairs = 0
        self.held_links = False  # by contacts of many
        self.gains = Gains()  # energy that impacts created
        self.misplaced = np.zeros(len(self.layout.watched), bool)  # those with an event beyond its position tolerance
        self.witnesses = Witnesses(self.layout.used.size, self.estimated)

    @cached_property
    def run(self) -> Run:
        """The state of the march; its log is lent to it block by block."""
        if recurs(self.model, self.settings, self.layout):
            return copy_template_run(self.model, self.settings, self.law)
        return pose_run(self.model, self.settings, self.law, self._log(0), self._addresses())

    @cached_property
    def passages(self) -> Passages:
        """The last rows of the march, where switches are too many to be located."""
        return Passages(self.model, self.settings, self.layout)

    @cached_property
    def sliding(self) -> Sliding:
        """What the march slides along."""
        return Sliding(self)

    @cached_property
    def thinning(self) -> Thinning | None:
        """The selection of recorded rows; None where all are recorded."""
        if self.times is not None:
            return RowsAroundTimes(self.times, self.settings.scales.si_factor(TIME))
        nodes = np.array(self.settings.nodes) / self.settings.scales.si_factor(TIME)
        return Thinning(self.settings.keep_every, nodes) if self.settings.keep_every > 1 else None

    @property
    def now(self) -> Any:
        """The current numbers of the march, as named fields."""
        return self.run.now[0]

    @cached_property
    def estimated(self) -> range:
        """Return the columns of a log with estimated errors, by which given absolute tolerances are judged."""
        tolerances, used = self.settings.tolerances, self.layout.used
        if not self.settings.adaptive or tolerances is None or not (tolerances.of_all(used) > 0.0).any():
            return range(0)
        first = self.layout.row.offset_of(self.layout.errors.blocks[1].name)
        return range(first, first + used.size)

    @property
    def expected_rows(self) -> int | None:
        """Rows of a run without events; unknown where steps are chosen."""
        if self.settings.adaptive:
            return None
        plan, inner = self.run.plan[0], len(self.run.nodes)
        steps = (plan.end - plan.start) / plan.step_size if plan.step_size else len(self.run.steps)
        return int(steps) + inner + 4

    def blocks(self, rows: int | None = None, patience: float = inf) -> Generator[LogBlock]:
        """March to the end and yield one block after the other; who stops before closes them, for Ctrl-C is theirs.

        Parameters
        ----------
        rows : int, optional
            Rows of a block. Two logs are filled in turn, so a block may be used until the next but one is requested;
            of one row there is one, to be done with before the next. By default every block is new, and one holds
            the run if possible; where rows or columns are left out, blocks are small and filled in turn.
        patience : float, s
            After about this time a block is yielded as it is.
        """
        thinning = self.thinning
        if rows is None and (thinning or self.settings.partial):
            max_rows = THINNED_BLOCK if thinning else COPIED_BLOCK
            rows = min(max_rows, max(1, RECYCLED_NUMBERS // self.layout.row.size))
        logs = 1 if rows == 1 and not thinning else 2
        size = rows or min(self.expected_rows or FIRST_BLOCK, LARGEST_BLOCK)
        logs_in_turn: list[Log] = []
        with ending_at_interrupt(self._end_here), self._memory():
            while not self.is_over or not self.now.rows:  # even if interrupted at once, yield the initial row
                if rows is None or len(logs_in_turn) < logs:
                    log = self._log(size)
                    logs_in_turn = [*logs_in_turn, log] if rows else []
                else:
                    log = logs_in_turn[0]  # the older one
                    logs_in_turn.reverse()
                block = self._filled(log, patience)
                self.witnesses.take(block, _counts(self.run)[0])
                self._look_at_the_end(block)
                self._judge_events(block)
                self.held_links = self.held_links or bool(log.closed_rows.shape[1])
                self.event_pairs += _rows_without_a_step(log, block.rows)
                yield thinning.thinned(self.run, block, last=not self.unfinished) if thinning else block
                # rows of events come as they come
                max_rows = max(most_recycled(self.layout), (self.expected_rows or 0) - int(self.now.rows))
                size = rows or min(size * (4 if self.settings.adaptive else 1), max_rows)
        if logs_in_turn:
            self._log(0).lend(self.run)  # nothing of the others is touched any more

    @contextmanager
    def _memory(self) -> Iterator[None]:
        """Raise in one sentence that the system gives no memory."""
        try:
            yield
        except MemoryError as fault:
            raise InputError(
                f"the system gave no memory for the log of the model '{self.model.name}', or for what is read from it:"
                " keep less, by log = 'states' or keep_every, or give the process more memory (ulimit -v)"
            ) from fault

    def _log(self, rows: int) -> Log:
        """Return an empty log; see `log_of`."""
        return log_of(self.layout, self.settings, rows, int(self.run.plan[0].samples) if rows else 0)

    def empty_log(self) -> Log:
        """Return a log of no row, for a run that another log is lent to."""
        return self._log(0)

    def waiting_block(self) -> LogBlock | None:
        """Return the last row of an interrupted march, if a march that goes on would leave it out."""
        return self.thinning.waiting_block(self.run) if self.thinning else None

    @property
    def waits(self) -> bool:
        """Whether a row waits to be returned by `waiting_block`."""
        return self.thinning is not None and self.thinning.waiting is not None

    @property
    def accepted(self) -> int:
        """Number of accepted steps; rows that no step led to do not count."""
        return max(0, int(self.now.rows) - 1 - self.event_pairs)

    @property
    def passed(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """How often each switch declared smooth was passed, and the time of the first state after it, else nan."""
        counts = self.run.w[self.run.w.size - 3 * len(self.layout.smooth) :].reshape(-1, 3)
        return counts[:, 1].astype(np.int64), np.where(counts[:, 1] > 0.0, counts[:, 2], np.nan)

    @property
    def outcome(self) -> Outcome:
        """The outcome of the run, as the loop reports it; `outcome_text.ending` explains a failure."""
        return OUTCOMES[INTERRUPTED if self.now.status == RUNNING else int(self.now.status)]

    @property
    def is_over(self) -> bool:
        """Whether it has ended or was interrupted."""
        return _status(self.run) != RUNNING or self.interrupted

    @property
    def unfinished(self) -> bool:
        """Whether there is more to march: it was interrupted, or its blocks have not been requested."""
        return _status(self.run) == RUNNING

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return everything needed to go on from here, by name."""
        own_arrays = {
            "witnesses": np.ascontiguousarray(self.witnesses.rows),
            "errors": np.ascontiguousarray(self.witnesses.errors),
            "event_pairs": np.array([self.event_pairs]),
            "gains": np.array(self.gains),
            "misplaced": self.misplaced,
        }
        return (
            changing_arrays(self.run)
            | own_arrays
            | self.passages.memory()
            | (self.thinning.memory() if self.thinning else {})
        )

    def go_on_from(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Continue from the memory of a march of equal model and settings.

        Raises
        ------
        InputError
            If it belongs to another version.
        """
        if self.run.plan["slides"][0]:
            self.sliding.recall(memory["modes"], int(memory["now"]["regime"][0]))
        put_back(self.run, memory)
        self.passages.go_on_from(memory)
        witnesses, self.event_pairs = memory["witnesses"], int(memory["event_pairs"][0])
        if "gains" in memory:  # version 0.2 kept none, and empty arrays are not kept
            self.gains = Gains(*memory["gains"].tolist())
        self.misplaced = memory.get("misplaced", self.misplaced).copy()
        unknown = np.full((len(self.estimated), witnesses.shape[1]), np.nan)
        self.witnesses.put(witnesses, memory.get("errors", unknown))
        if self.thinning:
            self.thinning.go_on_from(memory)

    def numbers_at_end(self) -> tuple[str, NDArray[np.float64]]:
        """Return the numbers that it needs to go on after its end, and names for them, as a record keeps them.

        After a good end the memory of trials is given back, and these numbers stand in the place of its own.
        """
        ended_well = not self.unfinished and self.outcome.good
        if ended_well:
            give_back_memory(self.run)
        names, numbers = final_numbers(self.run)
        if not self.settings.keeps_states:  # rows by which it is judged, and which its record leaves out
            names, numbers = f"{names} {WITNESSES}", np.append(numbers, self.witnesses.rows)
            if self.witnesses.errors.size:
                names, numbers = f"{names} {ERRORS}", np.append(numbers, self.witnesses.errors)
        if ended_well:
            rest_on(self.run, numbers)
        return names, numbers

    def _filled(self, log: Log, patience: float) -> LogBlock:
        """Fill one log, with checks of clock and keyboard now and then."""
        first, counts_before, march, in_time = _counts(self.run), None, engine().march, True
        sampled, clock = int(self.run.plan[0].samples), time.monotonic
        pause = FIRST_PART if isfinite(patience) else SHORTEST_PART
        started = looked = clock()
        log.follow(*first)
        log.lend(self.run)
        while counts_before != (counts := _counts(self.run)) and in_time and (not counts[0] or not self.is_over):
            counts_before = counts
            pause = self.passages.shortened(pause, counts[0])
            log.make_ready(counts[0] - first[0], pause, sampled)
            make_room(self.run)
            try:
                march_apart(march, self.run, pause)
            except NoMemoryError:
                t = self.now.t * self.settings.scales.si_factor(TIME)
                raise NoMemoryError(
                    f"the model '{self.model.name}'", f", at t = {t:.6g}{unit_suffix(self.model.time_unit)}"
                ) from None
            if _status(self.run) == AT_SWITCH:
                self.sliding.go_on()
            new = slice(counts[0] - first[0], _counts(self.run)[0] - first[0])
            self.slides = self.passages.sliding(self.run, log.rows[:, new], counts[0])
            looked, took = clock(), clock() - looked
            pause = _rows_to_come(pause, counts[0], took)
            if self.progress:
                plan, now = self.run.plan[0], self.now
                done = float((now.t - plan.start) / (plan.end - plan.start))
                self.progress(done, float(now.t * self.settings.scales.si_factor(TIME)), int(now.rows))
            in_time = looked - started < patience
        rows, trials, events, samples = (
            count_after - counts_before for count_after, counts_before in zip(counts, first, strict=True)
        )
        return LogBlock(log, rows, trials, events, samples)

    def _look_at_the_end(self, block: LogBlock) -> None:
        """Determine from the log which event stopped the run, which number was not finite, where the run rested."""
        status = _status(self.run)
        if status == STEP_LIMIT or self.interrupted:
            self.chattering = chattering(self.run.detectors, block.log.events[: block.events])
        if status == STOPPED:
            events = block.log.events[: block.events]
            met = [self.layout.watched[i] for i in events["detector"][events["time"] == self.now.t]]
            self.stopping_event = " and ".join(
                f"'{detector.name}'" for detector in met if detector.event.action == "stop"
            )
        elif status == NONFINITE_OBSERVABLE:
            column = block.log.rows[:, 0 if self.now.h == 0.0 else block.rows]
            self.bad_values = dict(zip(self.layout.row, column.tolist(), strict=True))

    def _judge_events(self, block: LogBlock) -> None:
        """Find events outside their position tolerance, and impacts that create energy."""
        log, count = block.log, block.events
        if not count:
            return
        self.misplaced[log.events["detector"][:count][misplaced_events(self.run.detectors, log, count)]] = True
        # in most runs no event gains energy
        loss_row = place_of_loss(self.layout)
        if loss_row >= 0 and log.impulses[loss_row, :count].min() < 0.0:
            impacts = impacts_of(self.layout, self.settings.scales, log, count)
            self.gains = add_gains(self.gains, self.layout, impacts, int(log.base[0]["events"]))

    @property
    def _unread(self) -> frozenset[str]:
        """The results of the law that nothing reads; small samples cost nothing."""
        settings = self.settings
        are_small = 8 * self.layout.sample_width * settings.scheme.samples < LARGE
        is_read = {ROW_ENERGIES: settings.energies}
        is_read[FORCE_SAMPLES] = settings.keeps_samples or are_small
        return frozenset(part_name for part_name, read in is_read.items() if not read)

    def _addresses(self) -> NDArray[np.int64]:
        """Compile the law, or load it."""
        if not self.model.functions:
            return addresses_of(self.law)
        # late, as numba takes most of a second to import, and most models have no functions in Python
        from numba.core.errors import NumbaError

        try:
            return addresses_of(self.law)
        except NumbaError as error:
            names = ", ".join(self.model.functions)
            raise InputError(
                f"the Python forces {names} cannot be compiled by numba: {str(error).strip().splitlines()[-1]}"
            ) from None

    def _end_here(self) -> None:
        self.interrupted = True


def _rows_without_a_step(log: Log, rows: int) -> int:
    """Count the second rows of events, and the first ones of those that are met where the march stands already."""
    kinds = log.flags[0, :rows]
    time_steps = log.rows[1, :rows]
    met_at_once = (kinds == EVENT_BEFORE) & (time_steps == 0.0)
    return int(np.count_nonzero(kinds == EVENT_AFTER) + np.count_nonzero(met_at_once))


# numpy takes microseconds to read one field of a record by name: all fields as one tuple cost less
_of_counts = itemgetter(*map((NOW.names or ()).index, LOG_COUNTS))
_of_status = itemgetter((NOW.names or ()).index("status"))


def _counts(run: Run) -> tuple[int, int, int, int]:
    """Return the numbers of rows, trials, events and force samples."""
    counts: tuple[int, int, int, int] = _of_counts(run.now.tolist()[0])
    return counts


def _rows_to_come(pause: int, rows: int, took: float) -> int:
    """Choose the rows up to the next check: few enough to be quick and not to prepare much memory in vain."""
    if took > LOOK:
        return max(1, int(pause * LOOK / took))
    return min(PAUSE_ROWS, max(SHORTEST_PART, rows // 4), 4 * pause)


def _status(run: Run) -> int:
    return int(_of_status(run.now.tolist()[0]))
