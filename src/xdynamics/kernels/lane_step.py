"""One ordinary step in every lane: aim, propose, judge and accept or reject, as `march.loop` does, without a branch.

A step that is not ordinary (the end, an event, a step that cannot be shortened, a number that is not finite) changes
nothing in its lane and is reported; the single march then makes it. So each line here performs the operations of one in
`march.loop`, `march.acceptance` or `march.control`, in the same order, and a lane has the bits of a single run.
"""

from __future__ import annotations

from itertools import pairwise

from xdynamics.expressions import parse
from xdynamics.kernels import collocation, interval_lanes, model_programs
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.collocation import Collocation
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import (
    AT,
    UNSOUND,
    Call,
    Compute,
    Each,
    Instruction,
    Load,
    Operand,
    Place,
    Program,
    Store,
    When,
    While,
)

# Numbers of a lane besides its state, in the working memory `w`, which explicit steps leave alone: `lives` is 1 where a
# run goes on; `done` counts accepted and rejected trials, `most` is their limit; h and norm are those of the last
# accepted step, tried is the norm of the last trial; `inner` is 1 where the next node is not the end, `landed` where
# the last step ended at a node. After them: absolute tolerances, largest values, the error of that step; for each event
# function the side of zero on which it has to stay (2: either, 0: unknown), and for a gap how large it was; what
# `collocation` keeps; for each switch declared smooth its side, how often it was passed, and when first.
LANE = (
    "t",
    "h",
    "norm",
    "tried",
    "step",
    "step_log",
    "rejected",
    "grid",
    "on_grid",
    "done",
    "accepted",
    "most",
    "lives",
    "node",
    "snap",
    "inner",
    "landed",
    "start",
    "step_size",
    "rtol",
    "floor",
    "rest",
    "k",
    "safety",
    "least",
    "greatest",
    "min_step",
    "max_step",
    "ordinary",
)
STRIDE, DERIVED = "stride", "derived"
STRETCH = 1.01  # of a step that would end just before a node
LEAST_LOGARITHM = -9.210340371976182  # of 1e-4, the smallest norm that the next step remembers

_AIM_FREELY = """
rest_of = node - t
proposed = t + step
lands = where(proposed >= node - snap, 1, where(rest_of <= stretch*step, where(rest_of <= max_step, 1, 0), 0))
reach = where(lands > 0, node, proposed)
width = where(lands > 0, rest_of, proposed - t)
counts = 1 - lands
"""
_AIM_AT_GRID = """
proposed = start + (grid + 1)*step_size
lands = where(node > proposed + snap, 0, 1)
counts = where(lands > 0, where(node >= proposed - snap, 1, 0), 1)
reach = where(lands > 0, node, proposed)
width = where(on_grid > 0, where(counts > 0, step_size, reach - t), reach - t)
"""
_SIDE = (
    "silent{0} = silent*where(side > 1.5, 1, where(side > 0.5, where(under > 0, 1, 0), where(side < -0.5, where(over <"
    " 0, 1, 0), 0)))"
)
_ASLEEP = "silent{0} = silent*where(side > 1.5, 1, 0)"
_READY = """
advances = where(t + width > t, where(reach > t, 1, 0), 0)
ready = lives*where(lands > inner, 0, 1)*advances*where(done <= most, 1, 0)
"""
_JUDGE = """
grown = width*where(rejected > 0, min(factor, 1), factor)
kept_up = where(lands > 0, where(rejected > 0, grown, max(grown, step)), grown)
next_step = min(max_step, max(min_step, kept_up))
bound = max(min_step, max(1e-14*abs(t), 1e-300))
repeats = where(judged > 1, where(judged < 1e300, where(least*width > bound, where(least*step > bound, 1, 0), 0), 0), 0)
moves = ready*sound*silent*where(judged <= 1, 1, 0)
turns_back = ready*sound*repeats
"""
_PREDICT = """
bounded = max(judged, smallest)
own = safety*min(1, least_work/(turn + work))/sqrt(sqrt(bounded))
seen = safety*(width/before)*sqrt(sqrt(norm_before/(bounded*bounded)))
predicted = where(judged <= 1, where(before > 0, min(own, seen), own), own)
limited = min(greatest, max(least, predicted))
stays = where(turns <= few_turns, 1, where(theta <= slow, 1, 0))*where(limited >= 1, where(limited <= held, 1, 0), 0)
growth = where(stays > 0, 1, limited)
factor = min(greatest, max(least, growth))
next_log = least_logarithm
shorter = width*min(0.9, growth)
"""
_CONTROL = """
logarithm = log(judged)
beta = 0.2/k
allowed = safety*exp(where(judged > 1, -logarithm/k, (0.75*beta - 1/k)*logarithm + beta*step_log))
factor = where(judged > 0, min(greatest, max(least, allowed)), greatest)
next_log = max(where(judged > 0, logarithm, least_logarithm), least_logarithm)
shorter = width*max(least, min(0.9, allowed))
"""
_MOVE = """
t = where(moves > 0, reach, t)
h = where(moves > 0, width, h)
grid = where(moves > 0, grid + counts, grid)
on_grid = where(moves > 0, counts, on_grid)
landed = where(moves > 0, lands, landed)
done = done + moves + turns_back
accepted = accepted + moves
ordinary = where(moves + turns_back > 0, 1, 1 - lives)
"""
_JUDGED = """
norm = where(moves > 0, judged, norm)
tried = where(moves + turns_back > 0, judged, tried)
"""
_PACE = """
step = where(moves > 0, next_step, where(turns_back > 0, shorter, step))
step_log = where(moves > 0, next_log, step_log)
rejected = where(moves > 0, 0, where(turns_back > 0, 1, rejected))
"""


_AGAIN = "again = solved*where(rejected > 0, 1, where(before > 0, 0, 1))*where(judged_first <= 1, 0, 1)"
_SOLVED = """
eta = where(moves + turns_back > 0, eta_tried, eta)
since = where(moves > 0, 2, since)
iterations = where(moves > 0, turn, iterations)
evaluations = where(moves + turns_back > 0, evaluations + 3*turn + 1 + again, evaluations)
"""


_PASSED = """
passed = moves*where(decides > 0, where(side*value < 0, 1, 0), 0)
new_side = where(decides > 0, where(value > 0, 1, where(value < 0, -1, side)), 0)
new_time = where(passed > 0, where(count > 0, time, reach), time)
new_count = count + passed
new_side = where(moves > 0, new_side, side)
"""


def lane_width(layout: Layout) -> int:
    """Return how many numbers a lane has in `w`."""
    return _of_smooth(layout) + 3 * len(layout.smooth)


def noted_width(layout: Layout) -> int:
    """Return how many numbers a step in lanes records besides the state: energies, observables, smooth switches."""
    return max(1, len(layout.derived) + 2 * len(layout.smooth))


def of_collocation(layout: Layout) -> int:
    """Return where in a lane's memory the numbers that a step of Radau IIA keeps begin."""
    return len(LANE) + 3 * len(layout.used) + 2 * len(layout.watched)


def _of_smooth(layout: Layout) -> int:
    """Return where in a lane's memory the numbers of switches declared smooth begin."""
    return of_collocation(layout) + (collocation.width(layout) if layout.implicit else 0)


def stride(layout: Layout, *, adaptive: bool, followers: tuple[bool, ...] = ()) -> tuple[Program, ...]:
    """Write the step, after the programs that it calls; one gives the finite numbers of a row besides the state.

    `followers` says of each variable whether its absolute tolerance follows it; none does if it is empty.
    """
    write = _Writing(layout, followers)
    write.lines(_AIM_FREELY if adaptive else _AIM_AT_GRID)
    write.lines(_READY)
    write.store("at", {"t": "t", "t1": "reach", "h": "width"})
    inner = write.solve() if layout.implicit else write.propose()
    if layout.derived or layout.smooth:
        write.store("at", {"t": "reach"})
        write.body.append(Call(DERIVED, "at", "z", "samples"))  # steps in lanes keep no samples, so there is room
    write.load("finite_row", Place("at", UNSOUND))
    write.lines("sound = where(finite_step == 0, where(finite_row == 0, 1, 0), 0)")
    if layout.estimates:
        write.error_norm()
        write.load("judged", Place("norm", same=True))
    write.watch()
    control = _PREDICT if layout.implicit else _CONTROL
    write.lines(control + _JUDGE if adaptive else "moves = ready*sound*silent\nturns_back = 0*ready")
    write.smooth()
    write.move(adaptive=adaptive)
    updates = (_JUDGED if layout.estimates else "") + (_PACE if adaptive else "") + (_SOLVED if layout.implicit else "")
    write.lines(_MOVE + updates, kept=True)
    local = {"norm": 1}
    if any(followers):
        local["tops"] = 1 + max(layout.kinds)
    own = Program(STRIDE, "One step in every lane.", tuple(write.body), {}, local)
    return (*inner, *((model_programs.derived(layout),) if layout.derived or layout.smooth else ()), own)


class _Writing:
    """Writes lines of text, whose names are those of a lane or of earlier lines."""

    def __init__(self, layout: Layout, followers: tuple[bool, ...]) -> None:
        self.body: list[Instruction] = []
        self._layout = layout
        self._followers = followers
        constants: dict[str, Operand] = {"stretch": STRETCH, "least_logarithm": LEAST_LOGARITHM}
        self._known = constants | collocation.CONSTANTS
        self._places = {name: Place("w", i) for i, name in enumerate(LANE)}
        self._parts = 0

    def lines(self, text: str, *, kept: bool = False) -> None:
        """Write lines; with `kept` their values go to the lane, and each line sees what the lane had before."""
        write = self._next()
        stores = []
        for line in filter(None, text.split("\n")):
            target, expression = line.split(" = ")
            value = write.value(parse(expression))
            if kept:
                stores.append(Store(self._places[target], value))
            else:
                self._known[target] = write.name(target, value)
        self.body += [*write.lines, *stores]

    def _next(self) -> Assignments:
        """Begin the next lines, with names of their own."""
        self._parts += 1
        return Assignments(self._found, f"_{self._parts}_")

    def _found(self, lines: Assignments, name: str) -> Operand:
        if name in self._known:
            return self._known[name]
        return lines.load(self._places[name], f"_{self._parts}_{name}")

    def load(self, name: str, place: Place) -> None:
        """Read a number that was written since it was last read."""
        # no underscore: printed Python writes names with one where they are used, after other lines
        self._known[name] = name
        self.body.append(Load(name, place))

    def store(self, array: str, values: dict[str, str]) -> None:
        """Write numbers to an array laid out as `at`."""
        write = self._next()
        stores = [Store(Place(array, AT.index(name)), write.named(value)) for name, value in values.items()]
        self.body += [*write.lines, *stores]

    def propose(self) -> tuple[Program, ...]:
        """Make the step by the lines of the method."""
        self.body.append(Call("propose", "at", "y", "z"))
        self.load("finite_step", Place("at", UNSOUND))
        return ()

    def solve(self) -> tuple[Program, ...]:
        """Make the step by iterations in all lanes until each has ended; return the programs called for it."""
        layout, follows = self._layout, any(self._followers)
        inner = Collocation(layout, self._places, len(LANE), of_collocation(layout), follows=follows)
        self._places = inner.places
        self.body += inner.begin(self._known)
        self.body.append(When(inner.places["missing"], Call(collocation.LINEARISE, "at", "y", "z")))
        self.body.append(When(inner.places["unfactored"], Call(collocation.FACTORISE, "at", "y", "z")))
        self.body.append(While(inner.places["open"], Call(collocation.CORRECT, "at", "y", "z")))
        self.body += inner.ended()
        self.store("at", {"t": "reach"})
        self.body += [Call("forces", "at", "z", "z"), *inner.estimated()]
        self.error_norm()
        self.load("judged_first", Place("norm", same=True))
        self.lines("solved = ready*(1 - vain)")
        self._known["ready"] = self._known["solved"]
        self.lines(_AGAIN, kept=True)
        self.body.append(When(inner.places["again"], Call(collocation.ESTIMATE, "at", "y", "z")))
        write = self._next()
        numbers = [write.load(Place("z", i)) for i in range(len(layout.state))]
        unsound: Operand = 0.0
        for number in numbers:  # a number minus itself is 0 if it is finite, else nan
            unsound = write.compute("add", unsound, write.compute("subtract", number, number))
        self.body += write.lines
        self._known["finite_step"] = unsound
        return (model_programs.linearised(layout), *inner.programs)

    def error_norm(self) -> None:
        """Find the largest ratio of an error to its scale: `march.control.error_norm`."""
        first = len(LANE)
        write = self._next()
        rtol, floor, rest = write.named("rtol"), write.named("floor"), write.named("rest")
        self.body += [*write.lines, Store(Place("norm", same=True), 0.0)]
        if any(self._followers):
            self._tops(Place("z"))
        for begin, end, kind, follows in self._pieces():
            least: tuple[Compute | Load | Store, ...] = (
                (
                    Load("_top", Place("tops", kind, same=True)),
                    Compute("_least", "multiply", (floor, "_top")),
                    Load("_slope", Place("z", self._slope(begin))),
                    Compute("_steep", "abs", ("_slope",)),
                    Compute("_moved", "unequal", ("_atol", 0.0)),
                    Compute("_time", "multiply", (rtol, rest)),
                    Compute("_reach", "multiply", ("_time", "_steep")),
                    Compute("_beginning", "choose", ("_moved", 0.0, "_reach")),
                    Compute("_more", "greatest", ("_atol", "_least")),
                    Compute("_allowed", "greatest", ("_more", "_beginning")),
                )
                if follows
                else ()
            )
            body: tuple[Compute | Load | Store, ...] = (
                Load("_e", Place("e", begin)),
                Load("_y", Place("y", begin)),
                Load("_z", Place("z", begin)),
                Load("_atol", Place("w", first + begin)),
                Load("_norm", Place("norm", same=True)),
                *least,
                Compute("_before", "abs", ("_y",)),
                Compute("_behind", "abs", ("_z",)),
                Compute("_size", "greatest", ("_before", "_behind")),
                Compute("_relative", "multiply", (rtol, "_size")),
                Compute("_scale", "add", ("_allowed" if follows else "_atol", "_relative")),
                Compute("_error", "abs", ("_e",)),
                Compute("_ratio", "divide", ("_error", "_scale")),
                Compute("_there", "unequal", ("_e", 0.0)),
                Compute("_mine", "choose", ("_there", "_ratio", 0.0)),
                Compute("_largest", "greatest", ("_norm", "_mine")),
                Store(Place("norm", same=True), "_largest"),
            )
            self.body.append(Each(end - begin, body))

    def _slope(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is."""
        n, used = len(self._layout.coordinates), len(self._layout.used)
        return n + i if i < n else used + i - n

    def _pieces(self) -> list[tuple[int, int, int, bool]]:
        """Return neighbours of one kind: begin, end, kind, whether their tolerances follow; all as one if none do."""
        used = len(self._layout.used)
        if not any(self._followers):
            return [(0, used, 0, False)]
        traits = list(zip(self._layout.kinds, self._followers, strict=True))
        cuts = [i for i in range(used) if i == 0 or traits[i] != traits[i - 1]]
        return [(begin, end, *traits[begin]) for begin, end in pairwise([*cuts, used])]

    def _tops(self, of: Place) -> None:
        """Find the largest absolute value of each kind: `march.tolerance_sizes.tops_of`."""
        self.body += [Store(Place("tops", kind), 0.0) for kind in range(1 + max(self._layout.kinds))]
        for begin, end, kind, _ in self._pieces():
            top = Place("tops", kind, same=True)
            body = (
                Load("_value", Place(of.array, of.index + begin)),
                Load("_top", top),
                Compute("_amount", "abs", ("_value",)),
                Compute("_greater", "greatest", ("_top", "_amount")),
                Store(top, "_greater"),
            )
            self.body.append(Each(end - begin, body))

    def _settle(self, first: int) -> None:
        """Let tolerances follow: `march.tolerance_sizes.settle_tolerances`; those of a lane that did not move stay."""
        write = self._next()
        rtol, floor, used = write.named("rtol"), write.named("floor"), len(self._layout.used)
        self.body += write.lines
        self._tops(Place("w", first + used))
        for begin, end, kind, follows in self._pieces():
            if follows:
                body = (
                    Load("_largest", Place("w", first + used + begin)),
                    Load("_top", Place("tops", kind, same=True)),
                    Compute("_own", "multiply", (rtol, "_largest")),
                    Compute("_least", "multiply", (floor, "_top")),
                    Compute("_allowed", "greatest", ("_own", "_least")),
                    Store(Place("w", first + begin), "_allowed"),
                )
                self.body.append(Each(end - begin, body))

    def watch(self) -> None:
        """Find out whether every event function certainly keeps its side: `march.events.isolation.quiet`."""
        self._known["silent"] = 1.0
        if not self._layout.watched:
            return
        lines, enclosures = interval_lanes.bounds(self._layout, self._known["width"], self._known["reach"])
        self.body += lines
        first, bounded = len(LANE) + 3 * len(self._layout.used), interval_lanes.is_bounded(self._layout)
        for i, (under, over, _) in enumerate(enclosures):
            self.load(f"side{i}", Place("w", first + i))
            self._known |= {"under": under, "over": over, "side": f"side{i}"}
            self.lines((_SIDE if bounded[i] else _ASLEEP).format(i))
            self._known["silent"] = self._known[f"silent{i}"]
            if interval_lanes.is_gap(self._layout)[i]:
                self.load(f"gap{i}", Place("w", first + len(enclosures) + i))
                self.lines(f"gap{i}_now = max(gap{i}, under)")

    def smooth(self) -> None:
        """Count passages of switches declared smooth, as a row of the log does: `kernels.model_programs.row`."""
        noted, first = len(self._layout.derived), _of_smooth(self._layout)
        for i in range(len(self._layout.smooth)):
            for k, name in enumerate(("value", "decides")):
                self.load(f"{name}{i}", Place("samples", noted + 2 * i + k))
                self._known[name] = f"{name}{i}"
            places = {name: Place("w", first + 3 * i + k) for k, name in enumerate(("side", "count", "time"))}
            for name, place in places.items():
                self.load(f"{name}_smooth{i}", place)
                self._known[name] = f"{name}_smooth{i}"
            self.lines(_PASSED)
            self.body += [Store(place, self._known[f"new_{name}"]) for name, place in places.items()]

    def move(self, *, adaptive: bool) -> None:
        """Replace the old state by the new one in lanes that move."""
        self.body.append(Compute("_moving", "more", (self._known["moves"], 0.0)))
        first, used = len(LANE) + len(self._layout.used), len(self._layout.used)

        def chosen(new: str, to: Place, old: str) -> tuple[Compute | Load | Store, ...]:
            return Compute(f"{old}_now", "choose", ("_moving", new, old)), Store(to, f"{old}_now")

        if adaptive:
            larger = (
                Load("_largest", Place("w", first)),
                Load("_z", Place("z")),
                Compute("_size", "abs", ("_z",)),
                Compute("_most", "greatest", ("_largest", "_size")),
                *chosen("_most", Place("w", first), "_largest"),
            )
            self.body.append(Each(used, larger))
        if any(self._followers):
            self._settle(len(LANE))
        if self._layout.estimates:
            error = (
                Load("_e", Place("e")),
                Load("_kept", Place("w", first + used)),
                *chosen("_e", Place("w", first + used), "_kept"),
            )
            self.body.append(Each(used, error))
        first += 2 * used + len(self._layout.watched)
        for i, gap in enumerate(interval_lanes.is_gap(self._layout)):
            if gap:
                write = self._next()
                value = write.value(parse(f"where(moves > 0, gap{i}_now, gap{i})"))
                self.body += [*write.lines, Store(Place("w", first + i), value)]
        state = (Load("_new", Place("z")), Load("_old", Place("y")), *chosen("_new", Place("y"), "_old"))
        self.body.append(Each(len(self._layout.record), state))
