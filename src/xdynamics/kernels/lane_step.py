"""One ordinary step in every lane: aim, propose, judge and accept or reject, as `march.loop` does, without a branch.

A step that is not ordinary (the end, an event, a step that cannot be shortened, a number that is not finite) changes
nothing in its lane and is reported; the single march then makes it. So each line here performs the operations of one in
`march.loop`, `march.acceptance` or `march.control`, in the same order, and a lane has the bits of a single run.
"""

from __future__ import annotations

from collections import namedtuple
from itertools import pairwise

from xdynamics.kernels import collocation, interval_program, model_programs, radau_lines, step_control
from xdynamics.kernels.collocation import CollocationStep
from xdynamics.kernels.formulas import Formulas, parted
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import (
    AT,
    UNSOUND,
    Instruction,
    Load,
    Loop,
    Operand,
    Place,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    element,
    soundness,
)
from xdynamics.kernels.radau_memory import RadauMemory, width
from xdynamics.kernels.radau_systems import FACTORISE
from xdynamics.methods.steppers import SIMPLIFIED
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL

# Numbers of a lane besides its state, in the working memory `w`, which explicit steps leave alone: `lives` is 1 where a
# run goes on; `done` counts accepted and rejected trials, `most` is their limit; h and norm are those of the last
# accepted step, tried is the norm of the last trial; `inner` is 1 where the next node is not the end, `landed` where
# the last step ended at a node. After them: absolute tolerances, largest values, the error of that step; for each event
# function the side of zero on which it has to stay (2: either, 0: unknown), and for a gap how large it was; what
# `collocation` keeps; for each switch declared smooth its side, how often it was passed, and when first.
Lane = namedtuple(
    "Lane",
    "t h norm tried step step_log rejected grid on_grid done accepted most lives node snap inner landed start step_size"
    " rtol floor rest k safety least greatest min_step max_step ordinary",
)
LANE, PLACES = Lane._fields, Lane(*range(len(Lane._fields)))
STRIDE, DERIVED = "stride", "derived"
SCALED_RATIO = f"{step_control.ALLOWED}\n{step_control.RATIO}"  # where tolerances follow their variables
STRETCH = 1.01  # of a step that would end just before a node

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
shorter = width*shrink
bound = max(min_step, max(1e-14*abs(t), 1e-300))
repeats = where(judged > 1, where(judged < 1e300, where(least*width > bound, where(least*step > bound, 1, 0), 0), 0), 0)
moves = ready*sound*silent*where(judged <= 1, 1, 0)
turns_back = ready*sound*repeats
"""
_CONTROL = f"logarithm = log(norm)\n{step_control.EXPONENT}\npower = exp(exponent)\n{step_control.PROPORTIONAL}"
_PREDICT = step_control.PREDICTIVE + step_control.PREDICTED
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
    return len(LANE) + 3 * layout.used.size + 2 * len(layout.watched)


def _of_smooth(layout: Layout) -> int:
    """Return where in a lane's memory the numbers of switches declared smooth begin."""
    return of_collocation(layout) + (width(layout) if is_solved(layout) else 0)


def is_solved(layout: Layout) -> bool:
    """Whether a step solves equations in lanes, by iterations that keep what they know for the next one."""
    return layout.scheme is not None and layout.scheme.method.solver == SIMPLIFIED


def stride(
    layout: Layout, programs: tuple[Program, ...], *, adaptive: bool, followers: tuple[bool, ...] = ()
) -> tuple[Program, ...]:
    """Write the step, after the programs that it calls, `programs` of the method's lines among them; one gives the finite numbers of a row besides the state.

    `followers` says of each variable whether its absolute tolerance follows it; none does if it is empty.
    """
    write, solves = _LaneWriting(layout, followers), is_solved(layout)
    write.lines(_AIM_FREELY if adaptive else _AIM_AT_GRID)
    write.lines(_READY)
    write.store("at", {"t": "t", "t1": "reach", "h": "width"})
    inner = write.solve() if solves else write.propose(programs)
    if layout.derived or layout.smooth:
        write.store("at", {"t": "reach"})
        write.body.append(
            ProgramCall(DERIVED, "at", "z", "samples")
        )  # steps in lanes keep no samples, so there is room
    write.load("finite_row", Place("at", UNSOUND))
    write.lines("sound = where(finite_step == 0, where(finite_row == 0, 1, 0), 0)")
    if layout.estimates:
        write.known["judged"] = write.error_norm()
    write.watch()
    if adaptive:
        control = _PREDICT if solves else _CONTROL
        write.lines(control + step_control.NEXT, norm=write.known["judged"], cut=write.known["lands"])
    write.lines(_JUDGE if adaptive else "moves = ready*sound*silent\nturns_back = 0*ready")
    write.smooth()
    write.move(adaptive=adaptive)
    updates = (_JUDGED if layout.estimates else "") + (_PACE if adaptive else "") + (_SOLVED if solves else "")
    write.keep(_MOVE + updates)
    own = Program(STRIDE, "One step in every lane.", tuple(write.body))
    return (*inner, *((model_programs.derived(layout),) if layout.derived or layout.smooth else ()), own)


class _LaneWriting:
    """Writes lines of text, whose names are those of a lane or of earlier lines."""

    def __init__(self, layout: Layout, followers: tuple[bool, ...]) -> None:
        self.body: list[Instruction] = []
        self.known: dict[str, Operand] = {"stretch": STRETCH, **step_control.CONSTANTS, **radau_lines.CONSTANTS}
        self._layout = layout
        self._followers = followers
        self._curve = 0  # where in `w` the step's polynomial begins, if it leaves one
        self._places = {name: Place("w", i) for i, name in enumerate(LANE)}
        self._parts = 0

    def lines(self, text: str, **given: Operand) -> None:
        """Write lines, some of whose names are given."""
        write = self._next()
        write.write(text, **given)
        self.body += write.lines

    def keep(self, text: str) -> None:
        """Write lines whose values go to the lane; each line sees what the lane had before."""
        write = self._next()
        stores = [StoreTo(self._places[target], write.of(expression)) for target, expression in parted(text)]
        self.body += [*write.lines, *stores]

    def _component(self, text: str, places: dict[str, Place], **given: Operand) -> Formulas:
        """Write lines for one component of vectors, named by where they begin."""
        known = {name: value for name, value in self.known.items() if name not in places}
        write = Formulas(self._places | places, "_", known | given)
        write.write(text)
        return write

    def _each(self, count: int, text: str, places: dict[str, Place], name: str, **given: Operand) -> None:
        """Write lines for every component of vectors; store what they compute for one of them."""
        write = self._component(text, places, **given)
        write.store(places[name], write.known[name])
        self.body.append(Loop("i", count, tuple(write.lines)))

    def _greatest(
        self, start: Operand, count: int, text: str, places: dict[str, Place], name: str, **given: Operand
    ) -> str:
        """Write lines for every component of vectors; return the greatest value of a name in them, or an earlier one."""
        write = self._component(text, places, **given)
        self._parts += 1
        total, term = f"greatest{self._parts}", write.known[name]
        assert isinstance(term, str)  # noqa: S101 - components differ
        self.body.append(Reduction("i", count, tuple(write.lines), (term,), (total,), "greatest", start))
        return total

    def _next(self) -> Formulas:
        """Begin the next lines, with names of their own."""
        self._parts += 1
        return Formulas(self._places, f"_{self._parts}_", self.known)

    def load(self, name: str, place: Place) -> None:
        """Read a number that was written since it was last read."""
        # no underscore: printed Python writes names with one where they are used, after other lines
        self.known[name] = name
        self.body.append(Load(name, place))

    def store(self, array: str, values: dict[str, str]) -> None:
        """Write numbers to an array laid out as `at`."""
        write = self._next()
        stores = [StoreTo(Place(array, AT.index(name)), write.named(value)) for name, value in values.items()]
        self.body += [*write.lines, *stores]

    def propose(self, programs: tuple[Program, ...]) -> tuple[Program, ...]:
        """Make the step by the lines of the method."""
        self.body.append(ProgramCall("propose", "at", "y", "z"))
        self.load("finite_step", Place("at", UNSOUND))
        return programs

    def solve(self) -> tuple[Program, ...]:
        """Make the step by iterations in all lanes until each has ended; return the programs called for it."""
        layout, follows = self._layout, any(self._followers)
        memory = RadauMemory(layout, self._places, of_collocation(layout))
        inner = CollocationStep(memory, len(LANE), follows=follows)
        self._places = places = memory.places
        self.body += inner.begin(self.known)
        self.body.append(When(places["missing"], ProgramCall(collocation.LINEARISE, "at", "y", "z")))
        self.body.append(When(places["unfactored"], ProgramCall(FACTORISE, "at", "y", "z")))
        self.body.append(While(places["open"], ProgramCall(collocation.CORRECT, "at", "y", "z")))
        self.body += inner.ended()
        self.store("at", {"t": "reach"})
        self.body += [ProgramCall("forces", "at", "z", "z"), *inner.estimated()]
        self.known["judged_first"] = self.error_norm()
        self.lines("solved = ready*(1 - vain)")
        self.known["ready"] = self.known["solved"]
        self.keep(_AGAIN)
        self.body.append(When(places["again"], ProgramCall(collocation.ESTIMATE, "at", "y", "z")))
        self.body.append(soundness("z", 0, layout.state.size, "finite_step"))
        self.known["finite_step"] = "finite_step"
        self.body += inner.curve()
        self._curve = memory.place("curve", 0).offset
        return (model_programs.linearised(layout), *inner.programs)

    def error_norm(self) -> Operand:
        """Find the largest ratio of an error to its scale: `march.control.error_norm`."""
        norm: Operand = 0.0
        tops = self._tops(Place("z")) if any(self._followers) else {}
        for begin, end, kind, follows in self._pieces():
            places = {name: element(array, begin) for name, array in (("error", "e"), ("before", "y"), ("after", "z"))}
            places["atol" if follows else "allowed"] = element("w", len(LANE) + begin)
            places["slope"] = element("z", self._slope(begin))
            text = SCALED_RATIO if follows else step_control.RATIO
            norm = self._greatest(norm, end - begin, text, places, "ratio", top=tops.get(kind, 0.0))
        return norm

    def _slope(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is."""
        n, used = self._layout.coordinates.size, self._layout.used.size
        return n + i if i < n else used + i - n

    def _pieces(self) -> list[tuple[int, int, int, bool]]:
        """Return neighbours of one kind: begin, end, kind, whether their tolerances follow; all as one if none do."""
        used = self._layout.used.size
        if not any(self._followers):
            return [(0, used, 0, False)]
        traits = list(zip(self._layout.kinds.tolist(), self._followers, strict=True))
        cuts = [i for i in range(used) if i == 0 or traits[i] != traits[i - 1]]
        return [(begin, end, *traits[begin]) for begin, end in pairwise([*cuts, used])]

    def _tops(self, of: Place) -> dict[int, Operand]:
        """Find the largest absolute value of each kind: `march.tolerance_sizes.tops_of`."""
        tops: dict[int, Operand] = {}
        for begin, end, kind, _ in self._pieces():
            places = {"value": element(of.array, of.offset + begin)}
            tops[kind] = self._greatest(tops.get(kind, 0.0), end - begin, "size = abs(value)", places, "size")
        return tops

    def _settle(self, first: int) -> None:
        """Let tolerances follow: `march.tolerance_sizes.settle_tolerances`; those of a lane that did not move stay."""
        used = self._layout.used.size
        tops = self._tops(Place("w", first + used))
        for begin, end, kind, follows in self._pieces():
            if follows:
                places = {"size": element("w", first + used + begin), "atol": element("w", first + begin)}
                self._each(end - begin, step_control.TOLERANCE, places, "atol", top=tops[kind])

    def watch(self) -> None:
        """Find out whether every event function certainly keeps its side: `march.events.isolation.quiet`."""
        self.known["silent"] = 1.0
        if not self._layout.watched:
            return
        self.load("begin", Place("w", LANE.index("t")))
        times = ("begin", self.known["reach"])
        lines, enclosures = interval_program.bounds(self._layout, self.known["width"], *times, self._curve)
        self.body += lines
        first = len(LANE) + 3 * self._layout.used.size
        for i, (detector, (under, over)) in enumerate(zip(self._layout.watched, enclosures, strict=True)):
            self.load(f"side{i}", Place("w", first + i))
            self.known |= {"under": under, "over": over, "side": f"side{i}"}
            # those that act only while a reaction holds are asleep: lanes make no step with a reaction that holds
            self.lines((_ASLEEP if detector.role in (PULL, LIMIT, GRIP) else _SIDE).format(i))
            self.known["silent"] = self.known[f"silent{i}"]
            if detector.role == GAP:
                self.load(f"gap{i}", Place("w", first + len(enclosures) + i))
                self.lines(f"gap{i}_now = max(gap{i}, under)")

    def smooth(self) -> None:
        """Count passages of switches declared smooth, as a row of the log does: `kernels.model_programs.row`."""
        noted, first = len(self._layout.derived), _of_smooth(self._layout)
        for i in range(len(self._layout.smooth)):
            for k, name in enumerate(("value", "decides")):
                self.load(f"{name}{i}", Place("samples", noted + 2 * i + k))
                self.known[name] = f"{name}{i}"
            places = {name: Place("w", first + 3 * i + k) for k, name in enumerate(("side", "count", "time"))}
            for name, place in places.items():
                self.load(f"{name}_smooth{i}", place)
                self.known[name] = f"{name}_smooth{i}"
            self.lines(_PASSED)
            self.body += [StoreTo(place, self.known[f"new_{name}"]) for name, place in places.items()]

    def move(self, *, adaptive: bool) -> None:
        """Replace the old state by the new one in lanes that move."""
        first, used = len(LANE) + self._layout.used.size, self._layout.used.size
        if adaptive:
            self._moved(used, "max(old, abs(new))", element("z"), element("w", first))
        if any(self._followers):
            self._settle(len(LANE))
        if self._layout.estimates:
            self._moved(used, "new", element("e"), element("w", first + used))
        first += 2 * used + len(self._layout.watched)
        for i, detector in enumerate(self._layout.watched):
            if detector.role == GAP:
                write = self._next()
                value = write.of(f"where(moves > 0, gap{i}_now, gap{i})")
                self.body += [*write.lines, StoreTo(Place("w", first + i), value)]
        self._moved(self._layout.record.size, "new", element("z"), element("y"))

    def _moved(self, count: int, value: str, new: Place, old: Place) -> None:
        """Replace old numbers by a value of both in lanes that move."""
        self._each(count, f"kept = where(moves > 0, {value}, old)", {"new": new, "old": old, "kept": old}, "kept")
