"""The state of a march in flat arrays, which phases of the loop change in place.

Named numbers are fields of arrays of one record, because compiled code cannot pass records around; fields are
read and set as ``run.now[0].t``. The bytes of everything except the log and addresses are a march's whole memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.interval_program import RULES
from xdynamics.kernels.program import TABLE, WORDS


def _record(floats: str, integers: str) -> np.dtype[Any]:
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in integers.split()]
    return np.dtype((np.record, fields))


# What a march does not change. `step_size` is 0 where the grid is given or steps are chosen; a grid time that differs
# from a node by at most `snap` of its size is that node; `floor` is the least absolute tolerance that follows, over the
# largest of its kind, and `rest` a time over which the slope of a variable at rest counts; `apart` is 1 where events
# are located one by one, as in version 0.2; `steps` are those of a trial, three with step doubling; `contacts` is what
# they do after one; `margin` is added to the rounding by which an interval is widened; `order`
# is k of an error that falls as h**k; `divisor` is 2**order - 1 of the method.
PLAN = _record(
    "start end snap step_size rtol floor rest order safety least greatest min_step max_step first_step most_steps"
    " divisor margin",
    "adaptive differences estimates steps extrapolated limited stages samples"
    " coordinates kinetic used follows state regime evaluated reactions pressed switches contacts apart",
)
# Where it stands: `step` is to be tried next, `step_log` the logarithm of the error norm of the last accepted step, `h`
# the step last tried; `node` counts the nodes landed on, `crossed` those after which forces were evaluated.
NOW = _record(
    "t h norm step step_log first_step",
    "status regime rows trials events samples grid node crossed on_grid rejected evaluations jacobians factorisations",
)
# A step that has yet to be judged; `iterations` is -1 where Newton's method did not converge; `unsound` is 0
# where its state is finite, and `unsound_events` where its event functions are, else nan.
TRIAL = _record("t h unsound unsound_events", "landing iterations")
# How to look for each event: `tolerance` of its time, and `position`, how far from zero its function may be then;
# `role` is one of `model.detectors`, `reaction` the number of its reaction. A switch at the next points of a table has
# the number of its drive, else -1, and the places of the argument, its rate and acceleration in a state; for a velocity
# `turn` equals `rate`.
DETECTOR = _record(
    "tolerance position",
    "direction action to count value slope bend of_time role reaction at_zero interpolant sampled drive argument rate"
    " turn",
)
# The state of an event function. `armed` is its side since it left zero, 0 until it does, `began` the value before the
# trial; `ever` is whether it left zero, `seen` how often the event was met; the rest is of the current trial: whether
# it may have a zero there (`alive`), its bounds and those of its slope on the current piece, from where it cannot be
# distinguished from zero (`zone`), and what was found between which steps. One that is `asleep` is not looked for;
# `guard` is the side that it, for instance a gap, may not leave by more than `floor`.
WATCH = _record(
    "low high down up least_bend most_bend floor zone clear left right before greatest drift",
    "armed began ever alive state flaw broken forced hit seen asleep guard",
)
# A piece of a trial: its ends in time, its width as a step; `wide` is 1 where errors of the step count too. `full` is
# the width of the trial. `rough` asks for less care where it is 1, and where it is 2 for the enclosures of given bounds
# of positions and so on; `part` is 1 where it is not the whole trial, `cut` where substeps were made in a trial that is
# accepted nonetheless; `substeps` counts those made since its search began.
PIECE = _record("start end width wide full", "cut rough part verdict substeps")
# What Newton's method solves: unknowns and entries of the matrix are in separate lists, given by first and number.
EQUATIONS = _record("", "evaluations residuals first_unknown unknowns first_entry entries")
# What `march.implicit.radau` keeps from step to step. The factors belong to the step size `factored`, 0 if there are
# none; `change` and `ratio` are of Newton's last correction, `theta` and `eta` its convergence; `step` and `norm`, 0
# after a start, those of the previous accepted step; `growth` is the factor for the next step, 0 where step control
# chooses it. `linearised` is whether the derivatives may be used, `fresh` whether they are those at the state itself,
# `since` what the march did since the last trial.
KEPT = _record("factored change ratio theta eta step norm growth", "linearised fresh since turns")
BEGUN, STAYED, MOVED = range(3)
# The constants of each reaction: `role`, its sort, and `normal` as in `model.reactions`, the law of impacts, and how
# low bounces are that may be skipped; relative to the largest gap so far where `rest_height` is negative.
REACTION = _record("tolerance rest_height", "role normal law")
# What a reaction does. `largest` is the largest gap so far, `fastest` the largest rate, `steepest` the largest effect
# of a unit of it on its own rate, `limit` the time at which its bounces would end, uncertain by `doubt`, `speed` how
# fast it opened last, and `since` when, `lost` the energy that an impact takes, or bounces that are skipped, `bounce`
# its coefficient of restitution in the last impact. The rest is of the current problem: its part there
# (`contacts.delassus.ABSENT`, …), the rate or acceleration it starts from, its known part, coefficient and bound of
# friction, scale, place among the unknowns, its force or impulse and the resulting rate or acceleration, all impulses
# of an impact and the rate after them; `near` is 1 where a contact touches, `hit` is the detector that met it, `held`
# what it did before the event, `slack` the uncertainty of a rate.
TOUCH = _record(
    "largest fastest steepest limit doubt speed since lost bounce origin known coefficient bound scale found after"
    " slack rate total",
    "state part place way hit near held",
)
# Entries of the engine, after the operations on intervals in `functions`.
ENCLOSE, SUBSTEP, HAPPEN, TOUCHED = (2 * len(RULES) + i for i in range(4))
ALL, ALIVE = -1, -2  # event functions to be enclosed; otherwise the number of one
BEGIN, HOLD, SETTLE, RESOLVE, INFORM, STEP_IN_TIME, WEIGH = range(7)  # what `contacts.dispatch` is to do
SIDES = -3  # in place of a reason: find the side of each switch on which the march is
# numbers of `Run.balance`: which guard failed, for which contact or coordinate, a figure and its bound; kinetic
# energy before contacts act and after; what impulses took by the rates of their contacts, with the size of the terms;
# what skipped bounces take
GUARD, OWNER, FIGURE, BOUND, BEFORE, BEHIND, TAKEN, TERMS, SKIPPED = range(9)
BALANCE = 9
KEPT_ALL, APART, SHIFTED, SLOWED, WORK, LOSSES = range(6)  # which guard failed, if any
# Rows of the log.
TRIAL_ROW = _record("time step_size error_norm", "step reason")
EVENT_ROW = _record(
    "time left residual slope uncertainty murk interpolation", "row_before row_after detector kind direction substeps"
)
# The counts of `NOW` at the log's first row.
BASE = _record("", "rows trials events samples")


Floats = NDArray[np.float64]
Columns = NDArray[np.float64]
Whole = NDArray[np.int64]
Lists = NDArray[np.int64]
Flags = NDArray[np.int8]
Plans = NDArray[Any]
Nows = NDArray[Any]
Trials = NDArray[Any]
Detectors = NDArray[Any]
Solves = NDArray[Any]
Kepts = NDArray[Any]
Watches = NDArray[Any]
Pieces = NDArray[Any]
Bases = NDArray[Any]
Reactions = NDArray[Any]
Touches = NDArray[Any]
TrialRows = NDArray[Any]
EventRows = NDArray[Any]
KINDS: dict[str, tuple[Any, int]] = {  # of the arrays of a run: elements, dimensions
    "Floats": ("f8", 1),
    "Columns": ("f8", 2),
    "Whole": ("i8", 1),
    "Lists": ("i8", 2),
    "Flags": ("i1", 2),
    "Plans": (PLAN, 1),
    "Nows": (NOW, 1),
    "Trials": (TRIAL, 1),
    "Detectors": (DETECTOR, 1),
    "Solves": (EQUATIONS, 1),
    "Reactions": (REACTION, 1),
    "Touches": (TOUCH, 1),
    "Watches": (WATCH, 1),
    "Pieces": (PIECE, 1),
    "Kepts": (KEPT, 1),
    "Bases": (BASE, 1),
    "TrialRows": (TRIAL_ROW, 1),
    "EventRows": (EVENT_ROW, 1),
}
FLEETING = (
    "law",
    "functions",
    "base",
)  # not part of the memory, like everything that begins with log_: addresses belong to a process
# given by the model and the settings, or computed from the rest when needed
FIXED = (
    "plan",
    "p",
    "tables",
    "of_time",
    "leaves",
    "reactions",
    "wanted",
    "atol",
    "followers",
    "kinds",
    "tops",
    "probe",
    "turning",
    "nodes",
    "snaps",
    "grid",
    "steps",
    "detectors",
    "targets",
    "rows",
    "numbers",
    "parts",
    "equations",
    "unknowns",
    "entries",
)


class Twins(NamedTuple):
    """Runs that only compiled code sees: the addresses of their tables, and the memory of both."""

    addresses: NDArray[np.int64]
    memory: NDArray[np.uint8]
    tables: NDArray[np.int64]


class Run:
    """The march of one model by one method. States are in the order of `Layout.record`.

    Parameters
    ----------
    **arrays : ndarray
        All of the attributes below, contiguous.
    """

    # given to laws, in the order of `program.TABLE`
    at: Floats  # `program.AT`: what a law reads of a step
    y: Floats  # the state at now.t
    p: Floats  # parameters, unit constants, pi
    tables: Floats
    places: Whole  # of the tables, and the current piece of a drive of time
    z: Floats  # the state that the trial led to
    e: Floats  # its error
    samples: Floats  # force evaluations of the trial, one after the other
    w: Floats  # vectors of an implicit method; of `march.implicit.radau` the states of its stages and the derivatives
    log_rows: Columns  # `Layout.row`: time, step_size, the state, energies, observables, errors, iterations
    # used by the march alone
    plan: Plans
    now: Nows
    trial: Trials
    located: Trials  # the trial that ends at an event
    g: Floats  # event functions at y
    g1: Floats  # at z
    region: Floats  # `events.event_free_region`; of its box the sort, the coordinate or row, the place of its bounds
    leaves: Lists
    half: Floats  # the state after half a step
    whole: Floats  # the state after a whole one, to judge two halves
    located_z: Floats
    located_e: Floats
    located_g: Floats
    located_samples: Floats
    watches: Watches
    resets: Floats  # values to which events set the state
    targets: Lists  # event and place in the state of each
    piece: Pieces
    near: Floats  # states and event functions at the ends of a piece
    full: Floats  # the state at the end of the trial in which events are looked for, `piece.full` long
    full_e: Floats  # its error
    near_g: Floats
    far: Floats
    far_g: Floats
    entered: Floats  # the side of every event function where the piece begins
    pending: Floats  # how long before the step its zero may be, where the march landed on another event near it
    branches: Columns  # right ends of pieces still to be searched: step, state, event functions
    rows: Lists  # by `kernels.interval_program`: the event functions, to be computed with intervals
    numbers: Floats
    parts: Whole
    under: Floats  # the intervals
    over: Floats
    flaws: Whole
    wanted: Whole  # 1 where an interval is needed
    slopes: Floats  # time derivatives of the event functions
    reactions: Reactions
    touches: Touches
    swiftest: Floats  # the largest sum of the terms of each reaction's rate so far, at events
    entry: Floats  # positions and velocities before contacts act at an event
    approach: Floats  # rate of each reaction there
    slowed: Floats  # rate that holding removed from each
    pulled: Floats  # the impulse that did so
    balance: Floats  # their effect as the guards see it; see `march.contacts.balance`
    lingering: Floats  # gap up to which an open contact counts as closed
    modes: Floats  # the end of `p`: two numbers of each reaction, see `model.reactions`, then the side of each switch
    links: Floats  # contact tables at a state, one after the other; see `march.contacts.delassus`
    problem: Columns  # a complementarity problem; see `march.contacts.complementarity`
    basis: Whole  # of the problem
    solution: Floats
    effects: Columns  # contribution of each unknown to each reaction
    square: Floats  # a linear system, and which reactions are in it
    column: Floats
    chosen: Whole
    of_time: Whole  # drives of time
    atol: Floats
    followers: Whole  # 1 where the tolerance follows the size of its variable
    kinds: Whole  # kind of each variable; coordinates, velocities, states of one dimension share one
    tops: Floats  # the largest of each kind, then of their slopes
    largest: Floats  # absolute values so far, where steps are chosen; at least a floor where tolerances follow them
    probe: Floats  # a state at which forces are evaluated only for scales
    turning: Floats  # sizes, slopes and directions for that; see `tolerance_sizes`
    nodes: Floats  # times to land on between start and end
    snaps: Floats  # how far a grid time may differ from each, and from the end, by rounding alone
    grid: Floats  # times of a given grid
    steps: Floats  # the step to each of them
    detectors: Detectors
    matrix: Floats
    right: Floats
    equations: Solves
    unknowns: Lists
    entries: Lists
    kept: Kepts
    stage: Floats  # a state at which forces are evaluated
    shifted: Floats  # a state next to it, for differences
    stages: Floats  # Z: increments of the stages, one after the other
    turned: Floats  # W: the same in transformed variables
    defects: Floats  # residuals of the transformed equations, and the resulting corrections
    past: Floats  # differences of the previous step's collocation polynomial
    pivots: Whole  # of the real system, then of the complex one: rows exchanged, first and last rows of columns
    law: Whole  # addresses; the last is that of what solves the equations of a step, 0 where nothing is solved
    functions: Whole  # of operations on intervals, see `events.intervals.rules`, and entries of the engine
    base: Bases  # the counts of `now` at the log's first row
    log_flags: Flags  # kind, regime
    log_samples: Columns  # `Layout.sample`: time, step, stage, state, results
    log_trials: TrialRows
    log_events: EventRows
    log_rates: Columns  # of observables at the events
    log_impulses: Columns  # of contacts at the events, by coordinate; energy that an impact took, offsets of positions

    def __init__(self, **arrays: NDArray[Any]) -> None:
        self._table = np.zeros((len(ARRAYS), WORDS), np.int64)  # addresses for compiled code; see `handle`
        self.address = int(self._table.ctypes.data)
        self.put(**arrays)

    def twins(self, count: int) -> Twins:
        """Return runs like this one, to be marched side by side: what changes is copied, the rest is shared."""
        names = [name for name in ARRAYS if name not in SHARED]
        arrays = [getattr(self, name) for name in names]
        sizes = np.array([-(-part.nbytes // _ALIGNED) * _ALIGNED for part in arrays])
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        memory, tables = np.zeros((count, int(offsets[-1])), np.uint8), np.tile(self._table, (count, 1, 1))
        for part, begin in zip(arrays, offsets.tolist(), strict=False):
            memory[:, begin : begin + part.nbytes] = np.frombuffer(part.tobytes(), np.uint8)
        begins = memory.ctypes.data + memory.shape[1] * np.arange(count)[:, None] + offsets[:-1]
        tables[:, [_PLACES[name] for name in names], 0] = begins
        # modes are the end of the parameters, not a separate array
        end = self.p.nbytes - self.modes.nbytes
        tables[:, _PLACES["modes"], 0] = tables[:, _PLACES["p"], 0] + end
        return Twins(tables.ctypes.data + tables[0].nbytes * np.arange(count), memory, tables)

    def put(self, **arrays: NDArray[Any]) -> None:
        """Set arrays, for compiled code too; for instance new blocks of a log."""
        for name, array in arrays.items():
            setattr(self, name, array)
        places = [_PLACES[name] for name in arrays]
        self._table[places] = [(block.ctypes.data, block.shape[0], block.shape[-1]) for block in arrays.values()]


ARRAYS: dict[str, str] = dict(Run.__annotations__)  # name and kind
_PLACES = {name: i for i, name in enumerate(ARRAYS)}
_OF_LAWS = [{"places": "pieces", "log_rows": "rows"}.get(name, name) for name in ARRAYS][: len(TABLE)]
if tuple(_OF_LAWS) != TABLE:
    raise AssertionError("laws would find other arrays than they look for")
# of runs side by side; modes are in p
SHARED = (
    "tables",
    "leaves",
    "of_time",
    "nodes",
    "snaps",
    "grid",
    "steps",
    "detectors",
    "targets",
    "rows",
    "numbers",
    "parts",
    "reactions",
    "equations",
    "unknowns",
    "entries",
    "law",
    "functions",
    "modes",
    "followers",
    "kinds",
)
_ALIGNED = 64  # bytes
CHANGING = tuple(name for name in ARRAYS if name not in {*FLEETING, *FIXED} and not name.startswith("log_"))
