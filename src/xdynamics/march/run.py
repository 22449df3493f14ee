"""The state of a march in flat arrays, which phases of the loop change in place.

Named numbers are fields of arrays of one record, because compiled code cannot pass records around; fields are
read and set as ``run.now[0].t``. The bytes of everything except the log and addresses are a march's whole memory.

The run's annotations state how long each array lives, and what its elements are.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.interval_program import RULES
from xdynamics.kernels.machine import address_of
from xdynamics.kernels.program import TABLE, WORDS


class ArrayKind(NamedTuple):
    """The type of an array's elements and its number of dimensions; compiled code tells kinds apart by name.

    With `either_order` the elements along the last dimension may be as far apart as the first one is long.
    """

    name: str
    elements: Any
    dimensions: int = 1
    either_order: bool = False


class Lifetime(Enum):
    """How long an array lives, and whose it is."""

    LASTING = "it is part of the memory to continue from, even after the end"
    PASSING = "it belongs to a step: part of the memory within a march, but after a node nothing needs it"
    GIVEN = "by the model and the settings: runs side by side share it"
    OWN = "given to a run by itself"
    SCRATCH = "computed where it is needed"
    ADDRESS = "it belongs to a process: runs side by side share it"
    LOG = "lent to the run until it is full"


class Within(NamedTuple):
    """The array that another one is a part of."""

    owner: str


class Array(NamedTuple):
    """The annotation of an array of a run."""

    kind: ArrayKind
    lifetime: Lifetime
    owner: str  # the array that it is a part of, if any

    @classmethod
    def read(cls, annotation: Any) -> Array:
        """Read the marks of an annotation; without a lifetime it is `LASTING`."""
        kind, *marks = annotation.__metadata__
        lifetimes = [mark for mark in marks if isinstance(mark, Lifetime)]
        owners = [mark.owner for mark in marks if isinstance(mark, Within)]
        return cls(kind, lifetimes[0] if lifetimes else Lifetime.LASTING, owners[0] if owners else "")


T = TypeVar("T")
Passing = Annotated[T, Lifetime.PASSING]
Given = Annotated[T, Lifetime.GIVEN]
Own = Annotated[T, Lifetime.OWN]
Scratch = Annotated[T, Lifetime.SCRATCH]
Address = Annotated[T, Lifetime.ADDRESS]
Log = Annotated[T, Lifetime.LOG]


def record_type(floats: str, integers: str) -> np.dtype[Any]:
    """Return the type of a row of named numbers, floats before integers."""
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in integers.split()]
    return np.dtype((np.record, fields))


# A delay, and the place in `p` of the number that tells its time from what was before the start.
DELAY = record_type("time", "flag")
# The past of a march with delays: how many pieces are kept, of `width` numbers each, from where on in `tables`, and at most
# which derivative a breaking point may jump in that is landed on; `slot` is the place of the first delay after the drives,
# `stretch` the number of that which the march is in, `crossing` 1 right after a breaking point, `aimed` where the trial
# ends at one; `evaluations` are those that a polynomial takes.
BOOK = record_type("", "pieces breaks stretch crossing aimed first width slot most evaluations")


# What a march does not change. `step_size` is 0 where the grid is given or steps are chosen; a grid time that differs
# from a node by at most `snap` of its size is that node; `floor` is the least absolute tolerance that follows, over the
# largest of its kind, and `rest` a time over which the slope of a variable at rest counts; `rounding` is the share of
# terms that cancel which is allowed to errors at least, 0 for none; `apart` is 1 where events
# are located one by one, as in version 0.2; `assemblies` counts contacts of many links, of which at most `together` are
# struck at one time; `steps` are those of a trial, three with step doubling; `steps_over` is 1 where impacts are not located;
# `margin` is added to the rounding by which an interval is widened; `order` is k of an error that falls as h**k;
# `divisor` is 2**order - 1 of the method; `degree` is that of the polynomial in s that a step leaves, 0 if it leaves
# none, `curve` where in `w` its coefficients begin, `polynomial` the law's number of their program; `series` is the degree
# of the Taylor series that steps are chosen by, 0 where they are not; `doubled` is 1 where numbers are sums of two floats,
# and `start_rest` and `step_rest` are then what is left of the start and of the step beside the nearest float; `held` is
# the law's number of the program that puts a state where constraints hold, 0 without any, `moved` the place in a state of
# how far it did, and `consistent` is 1 where the start may be moved, too; `passing` is 1 where kinks at points of tables
# are landed on without a row of events each; `slides` is 1 where the motion may slide along switches, `along` the number of
# those that it does; `resumes` is 1 where it goes on from an event at which that changed, 2 where it begins, 3 where no motion goes on;
# `indeterminate` is 1 where more reactions may hold than the motion needs.
PLAN = record_type(
    "start end snap step_size rtol floor rest order safety least greatest min_step max_step first_step most_steps"
    " divisor margin start_rest step_rest rounding",
    "adaptive differences estimates steps extrapolated limited stages samples"
    " coordinates kinetic used follows state regime evaluated reactions pressed switches apart assemblies steps_over together"
    " degree curve polynomial series doubled held moved consistent passing slides along resumes indeterminate",
)
# Where it stands: `step` is to be tried next, `step_log` the logarithm of the error norm of the last accepted step, `h`
# the step last tried, `rest` what is left of the time beside `t`; `node` counts the nodes landed on, `crossed` those after which forces were evaluated.
NOW = record_type(
    "t h norm step step_log first_step rest",
    "status regime rows trials events samples grid node crossed on_grid rejected evaluations jacobians factorisations",
)
# A step that has yet to be judged; `iterations` is -1 where Newton's method did not converge; `unsound` is 0
# where its state is finite, and `unsound_events` where its event functions are, else nan; `deviation` is how far from 1
# the length of a quaternion was, see `attitudes`; `weighed` is 1 where some of its errors were the rounding of terms.
TRIAL = record_type("t h unsound unsound_events rest deviation", "landing iterations weighed")
# How to look for each event: `tolerance` of its time, and `position`, how far from zero its function may be then;
# `role` is one of `model.detectors`, `reaction` the number of its reaction. A switch at the next points of a table has
# the number of its drive, else -1, and the places of the argument, its rate and acceleration in a state; for a velocity
# `turn` equals `rate`. `slides` is 1 for an event between regimes that the motion may slide between.
DETECTOR = record_type(
    "tolerance position",
    "direction action to count value slope bend of_time role reaction at_zero interpolant sampled drive argument rate"
    " turn slides",
)
# The state of an event function. `armed` is its side since it left zero, 0 until it does, `began` the value before the
# trial; `ever` is whether it left zero, `seen` how often the event was met; the rest is of the current trial: whether
# it may have a zero there (`alive`), its bounds and those of its slope on the current piece, from where it cannot be
# distinguished from zero (`zone`), and what was found between which steps. One that is `asleep` is not looked for;
# `guard` is the side that it, for instance a gap, may not leave by more than `floor`.
WATCH = record_type(
    "low high down up least_bend most_bend floor zone clear left right before greatest drift",
    "armed began ever alive state flaw broken forced hit seen asleep guard",
)
# Where the motion takes an event function from an instant at which it is zero, in runs whose events are judged there:
# `rate` is that before the event, `side` the one that it goes to, 0 where it stays zero; `leaves` is one of
# `events.departures.STANDING` and so on; `at_start` whether it was zero there; `from_rest` whether its rate is zero, too,
# `goes_on` how it ever failed to turn a motion back, in bits of `events.departures`; `met` whether it has happened, and has
# yet to act.
# `last` is when it acted last, `pause` and `earlier` the last two times between, `longest` the longest of `short` pauses
# in a row that are near the time tolerance. Of actions that crowd together, `limit` is when they would end, uncertain by
# `doubt`.
DEPARTURE = record_type(
    "rate last pause earlier longest limit doubt", "side leaves met short at_start from_rest goes_on"
)
# The instant at which the march stands: whether events have yet to act there, how many states were met, whether any was
# reset, and whether the last events changed the state or forces.
AT_INSTANT = record_type("", "meets states resets changed")
# A piece of a trial: its ends in time, its width as a step; `wide` is 1 where errors of the step count too. `full` is
# the width of the trial. `rough` asks for less care where it is 1, and where it is 2 for the enclosures of given bounds
# of positions and so on; `part` is 1 where it is not the whole trial, `cut` where substeps were made in a trial that is
# accepted nonetheless; `substeps` counts those made since its search began; `first` and `last` are its ends as shares of
# the trial.
PIECE = record_type("start end width wide full first last", "cut rough part substeps")
# What Newton's method solves: unknowns and entries of the matrix are in separate lists, given by first and number; the
# rest as in `newton_matrix.NewtonSystem`.
EQUATIONS = record_type(
    "", "evaluations residuals first_unknown unknowns first_entry entries state weights derivatives"
)
# What is kept from step to step, and forgotten at a node. `weighs` is above 0 where errors may be the rounding of terms, 2
# where they were so in the last trial; the rest is of `march.implicit.radau`. The factors belong to the step size `factored`, 0 if there are
# none; `change` and `ratio` are of Newton's last correction, `theta` and `eta` its convergence; `step` and `norm`, 0
# after a start, those of the previous accepted step; `growth` is the factor for the next step, 0 where step control
# chooses it. `linearised` is whether the derivatives may be used, `fresh` whether they are those at the state itself,
# `since` what the march did since the last trial.
KEPT = record_type("factored change ratio theta eta step norm growth", "linearised fresh since turns weighs")
BEGUN, STAYED, MOVED = range(3)
# The constants of each reaction: `role`, its sort, and `normal` as in `model.reactions`, the law of impacts, and how
# low bounces are that may be skipped; relative to the largest gap so far where `rest_height` is negative.
REACTION = record_type("tolerance rest_height", "role normal law")
# A reaction at a state: the gap of a contact, the rate of the gap or of the slip, the acceleration without reactions;
# `coefficient` is that of restitution, or of friction in slip, and `most` that in stick; of a friction element, forces.
# (Not `size`: a row of NumPy's has an attribute of that name.)
LINK = record_type("gap rate free coefficient most", "")
# What a reaction does. `largest` is the largest gap so far, `fastest` the largest rate, `steepest` the largest effect
# of a unit of it on its own rate, `limit` the time at which its bounces would end, uncertain by `doubt`, `speed` how
# fast it opened last, and `since` when, `lost` the energy that an impact takes, or bounces that are skipped, `bounce`
# its coefficient of restitution in the last impact. The rest is of the current problem: its part there
# (`contacts.delassus.ABSENT`, …), the rate or acceleration it starts from, its known part, coefficient and bound of
# friction, scale, place among the unknowns, its force or impulse and the resulting rate or acceleration, all impulses
# of an impact and the rate after them; `near` is 1 where a contact touches, `hit` is the detector that met it, `held`
# what it did before the event, `slack` the uncertainty of a rate; `way` is the direction of slip, and of a contact
# whether its bounces have been examined.
TOUCH = record_type(
    "largest fastest steepest limit doubt speed since lost bounce origin known coefficient bound scale found after"
    " slack rate total",
    "state part place way hit near held",
)
# A contact of many links: how many there are, or elements where they are all pairs of these; the leaves of its pattern, of
# which `coordinates` move, and of the first of them with an interval its number and row; its detector and law of impacts;
# whether its gap changes with time alone; where its links (among all), its leaves, its order of elements, its hulls begin, how many groups.
ASSEMBLY = record_type(
    "tolerance rest_height",
    "links first_link elements paired rubs leaves coordinates row_leaf row detector law timed first_leaf first_order first_hull groups",
)
ENCLOSE = 2 * len(RULES)  # the entry of the engine after the operations on intervals in `functions`
AFTER_EVENT, BEGINS, ENDS_THERE = 1, 2, 3  # of `plan.resumes`
ALL, ALIVE = -1, -2  # event functions to be enclosed; otherwise the number of one
# numbers of `Run.balance`: which guard failed, for which contact or coordinate, a figure and its bound; kinetic
# energy before contacts act and after; what impulses took by the rates of their contacts, with the size of the terms;
# what skipped bounces take
GUARD, OWNER, FIGURE, BOUND, BEFORE, BEHIND, TAKEN, TERMS, SKIPPED = range(9)
BALANCE = 9
KEPT_ALL, APART, SHIFTED, SLOWED, WORK, LOSSES = range(6)  # which guard failed, if any
# Rows of the log.
TRIAL_ROW = record_type("time step_size error_norm", "step reason")
EVENT_ROW = record_type(
    "time left residual slope uncertainty murk interpolation rest",
    "row_before row_after detector kind direction substeps link",
)
NO_LINK = -1  # of an event that is of no contact of many links
# The counts of `NOW` at the log's first row, and how many samples the log has room for.
BASE = record_type("", "rows trials events samples room")

Floats = Annotated[NDArray[np.float64], ArrayKind("Floats", "f8")]
Columns = Annotated[NDArray[np.float64], ArrayKind("Columns", "f8", 2)]
LogRows = Annotated[NDArray[np.float64], ArrayKind("LogRows", "f8", 2, either_order=True)]
IntArray = Annotated[NDArray[np.int64], ArrayKind("Whole", "i8")]
Short = Annotated[NDArray[np.int16], ArrayKind("Short", "i2")]
Places = Annotated[NDArray[np.int32], ArrayKind("Places", "i4")]
Pairs = Annotated[NDArray[np.int32], ArrayKind("Pairs", "i4", 2)]
Lists = Annotated[NDArray[np.int64], ArrayKind("Lists", "i8", 2)]
Flags = Annotated[NDArray[np.int8], ArrayKind("Flags", "i1", 2)]
Plans = Annotated[NDArray[Any], ArrayKind("Plans", PLAN)]
Nows = Annotated[NDArray[Any], ArrayKind("Nows", NOW)]
Trials = Annotated[NDArray[Any], ArrayKind("Trials", TRIAL)]
Detectors = Annotated[NDArray[Any], ArrayKind("Detectors", DETECTOR)]
Solves = Annotated[NDArray[Any], ArrayKind("Solves", EQUATIONS)]
Kepts = Annotated[NDArray[Any], ArrayKind("Kepts", KEPT)]
Watches = Annotated[NDArray[Any], ArrayKind("Watches", WATCH)]
Departures = Annotated[NDArray[Any], ArrayKind("Departures", DEPARTURE)]
Instants = Annotated[NDArray[Any], ArrayKind("Instants", AT_INSTANT)]
Pieces = Annotated[NDArray[Any], ArrayKind("Pieces", PIECE)]
Bases = Annotated[NDArray[Any], ArrayKind("Bases", BASE)]
Delays = Annotated[NDArray[Any], ArrayKind("Delays", DELAY)]
Books = Annotated[NDArray[Any], ArrayKind("Books", BOOK)]
Reactions = Annotated[NDArray[Any], ArrayKind("Reactions", REACTION)]
Links = Annotated[NDArray[Any], ArrayKind("Links", LINK)]
Touches = Annotated[NDArray[Any], ArrayKind("Touches", TOUCH)]
Assemblies = Annotated[NDArray[Any], ArrayKind("Assemblies", ASSEMBLY)]
TrialRows = Annotated[NDArray[Any], ArrayKind("TrialRows", TRIAL_ROW)]
EventRows = Annotated[NDArray[Any], ArrayKind("EventRows", EVENT_ROW)]


class Twins(NamedTuple):
    """Runs that only compiled code sees: the addresses of their tables, and the memory of both."""

    addresses: NDArray[np.int64]
    memory: NDArray[np.uint8]
    tables: NDArray[np.int64]


class Run:
    """The march of one model by one method. States are in the order of `Layout.record`.

    Parameters
    ----------
    like : Run, optional
        The run that has what is not given here.
    **arrays : ndarray
        All of the attributes below, contiguous; rows of the log in C order or, where they are wide, in Fortran's.
    """

    # given to laws, in the order of `program.TABLE`
    at: Passing[Floats]  # `program.AT`: what a law reads of a step
    y: Floats  # the state at now.t
    p: Own[Floats]  # parameters, unit constants, pi
    tables: Given[Floats]
    places: Passing[IntArray]  # of the tables, and the current piece of a drive of time
    z: Passing[Floats]  # the state that the trial led to
    e: Passing[Floats]  # its error
    samples: Passing[Floats]  # force evaluations of the trial, one after the other
    # vectors of an implicit method; of `march.implicit.radau` its stages' states and the derivatives; a step's polynomial
    w: Passing[Floats]
    log_rows: Log[LogRows]  # `Layout.row`: time, step_size, the state, energies, observables, errors, iterations
    # used by the march alone
    plan: Own[Plans]
    now: Nows
    trial: Passing[Trials]
    located: Passing[Trials]  # the trial that ends at an event
    g: Floats  # event functions at y
    g1: Passing[Floats]  # at z
    region: Passing[Floats]  # see `events.enclosures.set_region`
    box_variables: Given[Lists]  # of its box the sort, the coordinate or row, the place of its bounds
    half: Passing[Floats]  # the state after half a step
    whole: Passing[Floats]  # the state after a whole one, to judge two halves
    located_z: Passing[Floats]
    located_e: Passing[Floats]
    located_g: Passing[Floats]
    located_samples: Passing[Floats]
    watches: Watches
    departures: Departures  # of each detector; none where no event acts, or in archives from before they were judged
    instant: Passing[Instants]
    met_states: Passing[Columns]  # regime and state, of each state that was met at the instant
    arguments: Passing[Floats]  # rates of events, then what tables are looked up at; see `Layout.tracked`
    resets: Passing[Floats]  # values to which events and controllers set the state
    targets: Given[Lists]  # event, or -1 - action of a controller, and place in the state of each
    ticks: Given[IntArray]  # actions of controllers at the start, at each node and the end, as bits; none without any
    alarms: Given[IntArray]  # the periodic events there, in the same way
    piece: Passing[Pieces]
    near: Passing[Floats]  # states and event functions at the ends of a piece
    full: Passing[Floats]  # the state at the end of the trial in which events are looked for, `piece.full` long
    full_e: Passing[Floats]  # its error
    near_g: Passing[Floats]
    far: Passing[Floats]
    far_g: Passing[Floats]
    entered: Passing[Floats]  # the side of every event function where the piece begins
    pending: Passing[Floats]  # how long before the step its zero may be, where the march landed on another near it
    branches: Passing[Columns]  # right ends of pieces still to be searched: step, state, event functions
    rows: Given[Lists]  # by `kernels.interval_program`: the event functions, to be computed with intervals
    numbers: Given[Floats]
    parts: Given[IntArray]
    under: Passing[Floats]  # the intervals
    over: Passing[Floats]
    flaws: Passing[IntArray]
    needed_intervals: Scratch[IntArray]  # 1 where an interval is needed
    slopes: Passing[Floats]  # time derivatives of the event functions
    reactions: Given[Reactions]
    touches: Touches
    swiftest: Floats  # the largest sum of the terms of each reaction's rate so far, at events
    entry: Passing[Floats]  # positions and velocities before contacts act at an event
    approach: Passing[Floats]  # rate of each reaction there
    slowed: Passing[Floats]  # rate that holding removed from each
    pulled: Passing[Floats]  # the impulse that did so
    balance: Passing[Floats]  # their effect as the guards see it; see `march.contacts.balance`
    lingering: Floats  # gap up to which an open contact counts as closed
    spare: Passing[IntArray]  # 1 of a reaction whose row follows from those of others that hold
    # the end of `p`: two numbers of each reaction and shares of forces, see `model.reactions`, then the side of each switch
    modes: Annotated[Floats, Within("p")]
    contact_tables: Passing[
        Floats
    ]  # contacts and friction at a state, as `model.reactions.reaction_table` lists it; its parts:
    links: Annotated[Links, Within("contact_tables")]
    delassus: Annotated[Columns, Within("contact_tables")]  # (k, j): effect of a unit of j on the rate of k
    directions: Annotated[Columns, Within("contact_tables")]  # derivative of a reaction's rate by each velocity
    responses: Annotated[Columns, Within("contact_tables")]  # effect of a unit of a reaction on each acceleration
    problem: Passing[Columns]  # a complementarity problem; see `march.contacts.delassus`
    basis: Passing[IntArray]  # of the problem, and where each unknown is
    solution: Passing[Floats]
    effects: Passing[Columns]  # contribution of each unknown to each reaction
    square: Passing[Floats]  # a linear system, and which reactions are in it
    column: Passing[Floats]
    chosen: Passing[IntArray]
    assemblies: Given[Assemblies]
    pattern_inputs: Given[Lists]  # of patterns; see `march.assembly.broad_phase`
    members: Given[IntArray]  # the place of each leaf for every link, or element, among coordinates or parameters
    slots: Given[IntArray]  # of the impulse along each coordinate
    handed: Given[Lists]  # pattern, place of a parameter there, place here
    patterns: Address[IntArray]  # two runs of one link for each assembly
    counters: Scratch[
        IntArray
    ]  # see `march.assembly.broad_phase`, where all is made anew when a march begins or goes on
    spans: Scratch[Floats]
    boxes: Scratch[Columns]  # bounds of every coordinate, and those of few steps
    renewed: Scratch[IntArray]  # which of them are new
    hulls: Scratch[Columns]  # of groups
    grouped: Scratch[IntArray]  # elements, group by group
    candidates: Scratch[Lists]  # links that boxes do not prove apart
    close: Scratch[IntArray]  # those that may meet in the trial
    meets: Scratch[IntArray]  # 1 where one does on the piece
    touching: Scratch[Columns]  # links that are struck together, numbers of each; see `march.assembly.impact`
    normals: Scratch[Columns]  # the derivative of each one's rate by velocities; those of closed links come last
    unit_responses: Scratch[Columns]  # effect of a unit of its impulse on them
    coordinate_indices: Scratch[Lists]  # which these are
    closed: IntArray  # how many links are closed, then the number of each among all links, ascending
    greatest: Floats  # the largest velocity so far, then for every assembly the largest speed of an impact
    closed_link_ends: Scratch[Lists]  # assembly, link and elements of each closed link
    loads: Scratch[Floats]  # the force of each at the last evaluation
    pulls: Scratch[Floats]  # its friction
    remains: Scratch[Floats]  # the acceleration that its gap is left with
    lifted: Scratch[IntArray]  # what passes zero in the trial: 1 the force of one, 2 its grip, 3 its slip
    release_functions: Scratch[Columns]  # what may fall to zero of each in a step; see `march.assembly.narrow_phase`
    grips: IntArray  # what each does along its slip; see `march.assembly.closed_links`
    vectors: Scratch[Columns]  # of a system of all links that touch, or are closed; see `march.assembly.closed_links`
    paths: Scratch[Columns]  # directions and their images; see `march.assembly.friction`
    shares: Passing[Floats]  # forces of closed links, along each row, as they were shared last
    swing: Scratch[Floats]  # what forces of links do to all coordinates
    chains: Scratch[IntArray]  # rows of equations that read the same coordinate; see `march.assembly.normal_forces`
    stiffened: Scratch[Columns]  # masses with what links add to them, factored; see `march.assembly.banded_factors`
    changes: Scratch[Columns]  # of these since they were factored
    ordering: Scratch[Lists]  # of coordinates in these
    of_time: Given[IntArray]  # drives of time
    delays: Given[Delays]
    book: Books  # of the past, where there are delays
    past_steps: Annotated[Floats, Within("tables")]  # their end: polynomials of accepted steps, see `march.past`
    breaks: Columns  # breaking points to come, ascending: the time, and the derivative that jumps there
    first_breaks: Given[Floats]  # those that follow from tables before the start
    jumps: Given[IntArray]  # which derivative of the motion jumps at each node: at ticks the motion itself; -1 for none
    attitudes: Given[Lists]  # places in the state of the four parts of every unit quaternion
    atol: Own[Floats]
    adaptive_atol: Given[Short]  # 1 where the tolerance follows the size of its variable
    kinds: Given[Short]  # kind of each variable; coordinates, velocities, states of one dimension share one
    tops: Scratch[Floats]  # the largest of each kind, then of their slopes, then a time scale
    largest: Floats  # absolute values so far, where steps are chosen; at least a floor where tolerances follow them
    probe: Scratch[Floats]  # a state at which forces are evaluated only for scales, or the sizes of their terms
    turning: Scratch[Floats]  # slopes and directions for that; see `tolerance_sizes`
    nodes: Given[Floats]  # times to land on between start and end
    node_rests: Given[Floats]  # what is left of each, and of the end, beside the float, where numbers are sums of two
    snaps: Given[Floats]  # how far a grid time may differ from each, and from the end, by rounding alone
    grid: Given[Floats]  # times of a given grid
    steps: Given[Floats]  # the step to each of them
    detectors: Given[Detectors]
    matrix: Passing[Floats]
    right: Passing[Floats]
    equations: Given[Solves]
    unknowns: Given[Lists]
    entries: Given[Pairs]  # of 32 bits, as the order: a large model has millions
    groups: Given[IntArray]  # where entries of columns begin whose derivatives are found at once; none: each by itself
    order: Given[Places]  # the place of each unknown of the matrix, which is a band in that order
    band: Given[IntArray]  # entries below and above its diagonal; none: the matrix is kept whole
    kept: Passing[Kepts]
    stage: Passing[Floats]  # a state at which forces are evaluated
    shifted: Passing[Floats]  # a state next to it, for differences
    stages: Passing[Floats]  # Z: increments of the stages; slopes, residuals and corrections while these are found
    turned: Passing[Floats]  # W: the same in transformed variables
    past: Passing[Floats]  # differences of the previous step's collocation polynomial
    pivots: Passing[Places]  # of the real system, then the complex one: rows exchanged, first and last rows of columns
    # addresses; the last are that of the sizes of terms, 0 where nothing weighs them, and that of what solves the equations
    law: Address[IntArray]  # of a step, 0 where nothing is solved
    functions: Address[
        IntArray
    ]  # of operations on intervals, see `events.enclosures.operation_addresses`, and of what encloses event functions
    phases: Address[IntArray]  # of phases, see `march.phases`; 0 where a model needs none of their part
    base: Log[Bases]  # the counts of `now` at the log's first row
    log_flags: Log[Flags]  # kind, regime
    log_samples: Log[LogRows]  # `Layout.sample`: time, step, stage, state, results
    log_trials: Log[TrialRows]
    log_events: Log[EventRows]
    log_rates: Log[Columns]  # of observables at the events
    log_closed: Log[Columns]  # row, number, gap, force, residual, friction, grip of links that are closed in it
    log_links: Log[IntArray]  # how many of these there are
    log_impulses: Log[Columns]  # of contacts at events, by coordinate; energy that impacts took, offsets of positions

    def __init__(self, like: Run | None = None, /, **arrays: NDArray[Any]) -> None:
        self.keepalive: tuple[Any, ...] = ()  # what has to live as long as the run
        self._table = np.zeros((len(ARRAYS), WORDS), np.int64)  # addresses for compiled code; see `handle`
        vars(self).update(vars(like) if like else {})
        # until here it may be that of `like`, which must not be written to
        self._table = self._table.copy()
        self.address = address_of(self._table)
        self.put(**arrays)

    def twins(self, count: int) -> Twins:
        """Return runs like this one, to be marched side by side: changing arrays are copied, others shared."""
        shared = (Lifetime.GIVEN, Lifetime.ADDRESS)
        names = [name for name, array in ARRAYS.items() if array.lifetime not in shared and not array.owner]
        arrays = [getattr(self, name) for name in names]
        offsets = np.cumsum([0, *(-(-part.nbytes // _ALIGNED) * _ALIGNED for part in arrays)])
        memory, tables = np.zeros((count, int(offsets[-1])), np.uint8), np.tile(self._table, (count, 1, 1))
        for part, begin in zip(arrays, offsets.tolist(), strict=False):
            memory[:, begin : begin + part.nbytes] = np.frombuffer(part.tobytes(), np.uint8)
        begins = memory.ctypes.data + memory.shape[1] * np.arange(count)[:, None] + offsets[:-1]
        tables[:, [_PLACES[name] for name in names], 0] = begins
        for name, array in ARRAYS.items():
            # a part lies as far behind where its owner begins as in the original
            if array.owner:
                array_index, owner = _PLACES[name], _PLACES[array.owner]
                tables[:, array_index, 0] += tables[:, owner, 0] - self._table[owner, 0]
        return Twins(tables.ctypes.data + tables[0].nbytes * np.arange(count), memory, tables)

    def put(self, **arrays: NDArray[Any]) -> None:
        """Set arrays, for compiled code too; for instance new blocks of a log."""
        for name, array in arrays.items():
            setattr(self, name, array)
        places = [_PLACES[name] for name in arrays]
        self._table[places] = [(address_of(block), block.shape[0], block.shape[-1]) for block in arrays.values()]
        for name in ("log_rows", "log_samples"):
            if name in arrays and not arrays[name].flags.c_contiguous:
                self._table[_PLACES[name], 2] = 1  # the distance of elements along the first dimension


ARRAYS = {name: Array.read(annotation) for name, annotation in get_type_hints(Run, include_extras=True).items()}
KINDS = {array.kind.name: array.kind for array in ARRAYS.values()}
_PLACES = {name: i for i, name in enumerate(ARRAYS)}
_OF_LAWS = [{"places": "pieces", "log_rows": "rows"}.get(name, name) for name in ARRAYS][: len(TABLE)]
if tuple(_OF_LAWS) != TABLE:
    raise AssertionError("laws would find other arrays than they look for")
_ALIGNED = 64  # bytes
_REMEMBERED = (Lifetime.LASTING, Lifetime.PASSING)
CHANGING = tuple(  # what a march changes: the memory to continue it; parts of an array are remembered with it
    name
    for name, array in ARRAYS.items()
    if array.lifetime in _REMEMBERED and not (array.owner and ARRAYS[array.owner].lifetime in _REMEMBERED)
)
