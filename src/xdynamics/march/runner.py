"""Driving a compiled march from Python: settings, blocks, interruption, outcome. Python sees blocks, never steps."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from types import FrameType

import numpy as np

from xdynamics.faults import InputError
from xdynamics.kernels import Problem, compile_march, pose, source_digest, write_source
from xdynamics.kernels.cache import missing_functions
from xdynamics.kernels.layout import EXTRAPOLATED, STEP_DOUBLING
from xdynamics.march.diagnosis import Failure, advice_on_stiffness, diagnose
from xdynamics.march.log import Control, Floats, Log, Memory, Pace, Plan, Tally, allocate
from xdynamics.march.outcomes import COMPLETED, INTERRUPTED, OUTCOMES, RUNNING, STEP_LIMIT, STOPPED, Outcome
from xdynamics.march.settings import Settings, given_times
from xdynamics.model import Model
from xdynamics.schema import EVENT_AFTER
from xdynamics.units import TIME

PAUSE_ROWS = 250_000  # between two looks at the clock and the keyboard
LARGEST_BLOCK = 1 << 24
MOST_WITNESSES = 50
FIRST_BLOCK = 1 << 12  # rows, where nobody knows how many there will be
_DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}

Progress = Callable[[float, float, int], None]  # fraction done, time in s, rows


@dataclass(frozen=True)
class Block:
    """A filled part of the log; `rows`, `trials`, `events`, `samples` are how much of it."""

    log: Log
    rows: int
    trials: int
    events: int
    samples: int


class March:
    """One march of a model by a method.

    Parameters
    ----------
    model : Model
    settings : Settings
    progress : callable, optional
        Called between parts of a block with the fraction done, the time in s and the rows so far.

    Raises
    ------
    InputError
        If the settings cannot be used or a Python force is not at hand or cannot be compiled.
    """

    def __init__(self, model: Model, settings: Settings, progress: Progress | None = None) -> None:
        settings.check(model)
        missing_functions([one.name for one in model.python_forces], model.functions)
        self.model = model
        self.settings = settings
        self.progress = progress
        self.layout = settings.layout(model)
        self.problem: Problem = pose(model, settings.scales)
        self.memory = self._before()
        self.interrupted = False
        self.stopping_event = ""
        self.event_pairs = 0
        self._failure: Failure | None = None
        self._witnesses: Floats = np.empty((3 + len(self.layout.used), 0))  # row number, time, step, state

    @cached_property
    def source(self) -> str:
        """Source text of the compiled march."""
        return write_source(self.layout, self.settings.method, samples=self.settings.samples)

    @property
    def force_digest(self) -> str:
        """sha256 of the source and of every Python force."""
        functions = "".join(one.digest for one in self.model.python_forces)
        return source_digest(self.source + functions)

    @cached_property
    def plan(self) -> Plan:
        """What the march does not change, in internal units."""
        scale = self.settings.scales.of(TIME)
        start, end = self.problem.start, self.settings.until / scale
        inner = self.problem.nodes[(self.problem.nodes > start) & (self.problem.nodes < end)]
        nodes, step = np.append(inner, end), self.settings.step
        snap = 4.0 * float(np.finfo(float).eps) * max(abs(start), abs(end))
        given = tuple(one / scale for one in step) if isinstance(step, tuple) else ()
        grid, steps = _given(start, given, nodes, snap)
        events = self.model.events.values()
        uniform = step / scale if isinstance(step, float | int) and not self.settings.adaptive else 0.0
        return Plan(
            start,
            uniform,
            grid,
            steps,
            self._control(start, end),
            nodes,
            snap,
            tuple(_DIRECTIONS[one.direction] for one in events) or (0,),
            tuple(one.time_tolerance.si / scale for one in events) or (1.0,),
            tuple(one.action == "stop" for one in events) or (False,),
            self.problem.parameters,
            self.problem.tables,
            self._sampled,
        )

    @property
    def _sampled(self) -> int:
        """Force samples that one step logs at most."""
        if not self.settings.samples:
            return 0
        marched = 3 if self.settings.estimator in (STEP_DOUBLING, EXTRAPOLATED) else 1
        return marched * self.settings.method.evaluations + (self.settings.estimator == EXTRAPOLATED)

    def _control(self, start: float, end: float) -> Control:
        settings, pacing = self.settings, self.settings.pacing
        scale = settings.scales.of(TIME)
        sizes = {name: settings.scales.of(self.model.dimensions[name]) for name in self.layout.used}
        asked = settings.tolerances
        # without tolerances nothing is asked of an error
        atol = tuple(asked.of(name) / sizes[name] if asked else float("inf") for name in self.layout.used)
        return Control(
            settings.adaptive,
            asked.rtol if asked else 0.0,
            atol,
            float(settings.error_order),
            pacing.safety,
            float(pacing.growth_limits[0]),
            float(pacing.growth_limits[1]),
            pacing.min_step / scale,
            min(pacing.max_step / scale, end - start),
            settings.step / scale if settings.adaptive and isinstance(settings.step, float | int) else 0.0,
            float(pacing.max_steps) if settings.adaptive else float("inf"),
        )

    @property
    def expected_rows(self) -> int | None:
        """Rows of a run without events; unknown where steps are chosen."""
        if self.settings.adaptive:
            return None
        plan = self.plan
        steps = (plan.nodes[-1] - plan.start) / plan.step_size if plan.step_size else len(plan.steps)
        return int(steps) + len(plan.nodes) + 3

    def blocks(self, rows: int | None = None) -> Iterator[Block]:
        """March to the end, handing over one block after the other.

        Parameters
        ----------
        rows : int, optional
            Rows a block holds. Two logs are filled in turn, so a block may be used until the next but one is asked
            for. Without it every block is new, and one holds the run if it can.
        """
        size = rows or min(self.expected_rows or FIRST_BLOCK, LARGEST_BLOCK)
        kept: list[Log] = []
        with self._watching_keyboard():
            run = self._compiled()
            while not self._is_over():
                if rows is None or len(kept) < 2:
                    log = allocate(self.layout, size, sampled=self.plan.sampled)
                    kept = [*kept, log] if rows else []
                else:
                    log = kept[0]  # the one filled longer ago
                    kept.reverse()
                base = self.memory.tally
                self._fill(run, log, base)
                self._remember(log, base)
                self._look_at_the_end(log, base)
                now = self.memory.tally
                self.event_pairs += int(np.count_nonzero(log.row_flags[0, : now.rows - base.rows] == EVENT_AFTER))
                yield Block(log, *(int(a) - int(b) for a, b in zip(now, base, strict=True)))
                size = rows or min(4 * size if self.settings.adaptive else size, 1 << 20)

    @property
    def accepted(self) -> int:
        """How many steps were accepted; an event's second row is none."""
        return max(0, self.memory.tally.rows - 1 - self.event_pairs)

    @property
    def outcome(self) -> Outcome:
        """How the run ended."""
        if self._failure:
            return self._failure.outcome
        return OUTCOMES[INTERRUPTED if self.memory.status == RUNNING else self.memory.status]

    @property
    def outcome_text(self) -> str:
        """The outcome as a sentence, with t, h and the cause."""
        scale = self.settings.scales.of(TIME)
        cause = self._failure.cause if self._failure else self.stopping_event
        t, h = self.memory.t * scale, self.memory.h * scale
        return self.outcome.sentence.format(t=f"{t:.15g}", h=f"{h:.6g}", cause=cause) + self._advice

    @cached_property
    def _advice(self) -> str:
        """What a run that got on, or ran out of steps, has to say about its steps."""
        if self.memory.status not in (COMPLETED, STOPPED, STEP_LIMIT):
            return ""
        return advice_on_stiffness(self, self._witnesses[1:])

    def _fill(self, run: Callable[..., Memory], log: Log, base: Tally) -> None:
        """Fill one log, looking up now and then."""
        before = None
        while before != self.memory.tally and not self._is_over():
            before = self.memory.tally
            self.memory = run(self.plan, self.memory, log, base, PAUSE_ROWS)
            if self.progress:
                done = (self.memory.t - self.plan.start) / (self.plan.nodes[-1] - self.plan.start)
                self.progress(done, self.memory.t * self.settings.scales.of(TIME), self.memory.tally.rows)

    def _remember(self, log: Log, base: Tally) -> None:
        """Keep some rows of the whole run, the same whatever its blocks: those whose number a power of two divides."""
        if not self.settings.adaptive:
            return
        rows, n = self.memory.tally.rows, len(self.layout.used)
        stride = 1 << max(0, (rows // MOST_WITNESSES).bit_length())
        new = np.arange(-(-base.rows // stride) * stride, rows, stride)
        kept = self._witnesses[:, self._witnesses[0] % stride == 0]
        self._witnesses = np.hstack([kept, np.vstack([new, log.rows[: 2 + n, new - base.rows]])])

    def _look_at_the_end(self, log: Log, base: Tally) -> None:
        """Find out, while its log is at hand, which event stopped the run or what failed."""
        if self.memory.status == STOPPED:
            names = list(self.model.events)
            events = log.events[:, : self.memory.tally.events - base.events]
            detectors = events[7, events[0] == self.memory.t].astype(int)
            self.stopping_event = " and ".join(f"'{names[i]}'" for i in detectors if self.plan.stops[i])
        elif self.memory.status != RUNNING and not OUTCOMES[self.memory.status].good:
            self._failure = diagnose(self, log, base)

    def _is_over(self) -> bool:
        return self.memory.status != RUNNING or self.interrupted

    def _before(self) -> Memory:
        """Return the memory of a march that has not begun."""
        n = len(self.layout.state)
        state = self.problem.initial + (0.0,) * (n - len(self.problem.initial))
        values = (0.0,) * max(1, len(self.model.events))
        pieces = (0,) * len(self.layout.time_drives)
        pace, tally = Pace(0.0, 1.0, False, 0.0), Tally(0, 0, 0, 0)
        return Memory(RUNNING, self.problem.start, 0.0, 0, 0, True, state, state, values, pieces, 0.0, pace, 0, tally)

    def _compiled(self) -> Callable[..., Memory]:
        from numba.core.errors import NumbaError

        run = compile_march(self.source, self.model.functions)
        if not self.model.functions:
            return run

        def guarded(*arguments: object) -> Memory:
            try:
                return run(*arguments)
            except NumbaError as error:
                names = ", ".join(self.model.functions)
                raise InputError(
                    f"the Python forces {names} cannot be compiled by numba: {str(error).strip().splitlines()[-1]}"
                ) from None

        return guarded

    @contextmanager
    def _watching_keyboard(self) -> Iterator[None]:
        """Let the first Ctrl-C end the run as an outcome; a second one raises as always."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(_signal: int, _frame: FrameType | None) -> None:
            self.interrupted = True
            signal.signal(signal.SIGINT, previous)

        previous = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, previous)


def _given(start: float, steps: tuple[float, ...], nodes: Floats, snap: float) -> tuple[Floats, Floats]:
    """Return the times that given steps lead to, those close to a node being that node, and the steps."""
    times, t, end = [], start, float(nodes[-1])
    for aim, step in zip(given_times(start, steps, end), steps, strict=True):
        t = end if aim == end else t + step
        near = nodes[np.abs(nodes - t) <= snap]
        t = float(near[0]) if near.size else t
        times.append(t)
    return np.array(times), np.array(steps)
