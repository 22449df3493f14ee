"""Ordinary steps in all lanes: aim, propose, judge, accept or reject, as `march.loop` does, without a branch.

The step to the end is reported too. A step that is not ordinary (an event, a step that cannot be shortened, a number
that is not finite) changes nothing in its lane and is reported; the single march then makes it. So each line here
performs the operations of a line in `march.loop` or `march.control`, in the same order, and a lane has the bits of a
single run.

The names in lines of text are numbers of a lane, whose places and count are stated here, or values of earlier lines.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

from xdynamics.kernels import collocation, formulas, interval_program, line_writing, model_programs
from xdynamics.kernels.collocation import FACTORISE, CollocationStep, RadauMemory, memory_width
from xdynamics.kernels.formulas import Formulas, split_assignments
from xdynamics.kernels.layout import POLYNOMIAL, Layout, curve_size
from xdynamics.kernels.line_writing import Steps
from xdynamics.kernels.program import (
    AT,
    UNSOUND,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    loop_element,
    shift_array,
    soundness,
)
from xdynamics.kernels.term_sizes import TERM_SIZES
from xdynamics.methods.steppers import SERIES, SIMPLIFIED
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL

# Numbers of a lane besides its state, in the working memory `w`, which explicit steps leave alone: `lives` is 1 where a
# run goes on; `done` counts accepted and rejected trials, `most` is their limit; h and norm are those of the last
# accepted step, tried is the norm of the last trial; `inner` is 1 where the next node is not the end, `landed` where
# the last step ended at such a node; `doubtful` is 1 where a trial is weighed again by the sizes of terms, `weighed`
# its norm then. After them: absolute tolerances, largest values, the error of that step; for each event
# function the side of zero on which it has to stay (2: either, 0: unknown), and for a gap how large it was; what
# `collocation` keeps; for each switch declared smooth its side, how often it was passed, and when first.
Lane = namedtuple(
    "Lane",
    "t h norm tried step step_log rejected grid on_grid done accepted most lives node snap inner landed start step_size"
    " rtol floor rest rounding weighs doubtful weighed k safety least greatest min_step max_step end first_step ordinary",
)
LANE, PLACES = Lane._fields, Lane(*range(len(Lane._fields)))


def lane_width(layout: Layout, memory: int) -> int:
    """Return how many numbers a lane has in `w`, for steps that work on so many of them."""
    return of_smooth(layout, memory) + 3 * len(layout.smooth)


def noted_width(layout: Layout) -> int:
    """Return how many numbers a step in lanes records besides the state: energies, observables, smooth switches."""
    return max(1, len(layout.derived) + 2 * len(layout.smooth))


def of_collocation(layout: Layout) -> int:
    """Return where in a lane's memory the numbers that a step of Radau IIA keeps begin, or those of Taylor series."""
    return len(LANE) + 3 * layout.used.size + 2 * len(layout.watched)


def of_smooth(layout: Layout, memory: int) -> int:
    """Return where in a lane's memory the numbers of switches declared smooth begin."""
    memory_length = memory_width(layout) if is_solved(layout) else memory if has_series(layout) else 0
    return of_collocation(layout) + memory_length


def is_solved(layout: Layout) -> bool:
    """Whether a step solves equations in lanes, by iterations with a memory for the next step."""
    return layout.scheme is not None and layout.scheme.method.solver == SIMPLIFIED


def has_series(layout: Layout) -> bool:
    """Whether a step sums Taylor series, which choose its size."""
    return layout.scheme is not None and layout.scheme.method.solver == SERIES


class LaneWriter:
    """Writes lines of text, whose names are those of a lane or of earlier lines."""

    def __init__(self, layout: Layout, adaptive_atol: tuple[bool, ...], memory: int) -> None:
        self.body: list[Instruction] = []
        self.known: dict[str, Operand] = {
            "fits": 1.0,
            **formulas.CONSTANTS,
            **collocation.CONSTANTS,
        }
        self.layout = layout
        self.adaptive_atol = adaptive_atol
        self._memory = memory
        self._curve = 0  # where in `w` the step's polynomial begins, if it leaves one
        self.places = {name: Location("w", i) for i, name in enumerate(LANE)}
        self._parts = 0

    def lines(self, text: str, **operands: Operand) -> None:
        """Write lines, some of whose names are given."""
        write = self.begin_formulas()
        write.write(text, **operands)
        self.body += write.lines

    def keep(self, text: str) -> None:
        """Write lines whose values go to the lane; each line reads the lane's former values."""
        write = self.begin_formulas()
        stores = [
            StoreTo(self.places[target], write.formula(expression)) for target, expression in split_assignments(text)
        ]
        self.body += [*write.lines, *stores]

    def component(self, text: str, places: dict[str, Location], **operands: Operand) -> Formulas:
        """Write lines for one component of vectors, named by where they begin."""
        component_operands = {name: value for name, value in self.known.items() if name not in places}
        write = Formulas(self.places | places, "_", component_operands | operands)
        write.write(text)
        return write

    def write_components(
        self, count: int, text: str, places: dict[str, Location], name: str, **operands: Operand
    ) -> None:
        """Write lines for every component of vectors; store the values of one of them."""
        write = self.component(text, places, **operands)
        write.store(places[name], write.known[name])
        self.body.append(Loop("i", count, tuple(write.lines)))

    def greatest_values(
        self,
        starts: Sequence[Operand],
        count: int,
        text: str,
        places: dict[str, Location],
        names: Sequence[str],
        **operands: Operand,
    ) -> Sequence[str]:
        """Write lines for every component of vectors; return the greatest values of names in them, or earlier ones."""
        write = self.component(text, places, **operands)
        self._parts += 1
        totals = tuple(f"greatest{self._parts}_{k}" for k in range(len(names)))
        terms = tuple(write.known[name] for name in names)
        self.body.append(Reduction("i", count, tuple(write.lines), terms, totals, "greatest", tuple(starts)))
        return totals

    def begin_formulas(self) -> Formulas:
        """Begin the next lines, with names of their own."""
        self._parts += 1
        return Formulas(self.places, f"_{self._parts}_", self.known)

    def compute(self, name: str, operation: str, argument: str) -> None:
        """Name the result of an operation that has no word in texts."""
        write = self.begin_formulas()
        self.known[name] = write.compute(operation, self.known[argument])
        self.body += write.lines

    def power(self, name: str, base: str, exponent: int) -> None:
        """Give an integer power of a known value a name."""
        write = self.begin_formulas()
        self.known[name] = write.power(self.known[base], Fraction(exponent))
        self.body += write.lines

    def load(self, name: str, location: Location) -> None:
        """Read a number that was written since it was last read."""
        # no underscore: printed Python writes names with one where they are used, after other lines
        self.known[name] = name
        self.body.append(Load(name, location))

    def store(self, array: str, values: dict[str, str]) -> None:
        """Write numbers to an array laid out as `at`."""
        write = self.begin_formulas()
        stores = [StoreTo(Location(array, AT.index(name)), write.operand_of(value)) for name, value in values.items()]
        self.body += [*write.lines, *stores]

    def slope_index(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is."""
        n, used = self.layout.coordinates.size, self.layout.used.size
        return n + i if i < n else used + i - n

    def pieces(self) -> list[tuple[int, int, int, bool]]:
        """Return neighbours of one kind: begin, end, kind, whether their tolerances follow; all as one if none do."""
        used = self.layout.used.size
        if not any(self.adaptive_atol):
            return [(0, used, 0, False)]
        traits = list(zip(self.layout.kinds.tolist(), self.adaptive_atol, strict=True))
        cuts = [i for i in range(used) if i == 0 or traits[i] != traits[i - 1]]
        return [(begin, end, *traits[begin]) for begin, end in pairwise([*cuts, used])]

    def tops(self, vector: Location) -> dict[int, Operand]:
        """Find the largest absolute value of each kind: `march.tolerance_sizes.tops_of`."""
        tops: dict[int, Operand] = {}
        for begin, end, kind, _ in self.pieces():
            places = {"value": loop_element(vector.array, vector.offset + begin)}
            (tops[kind],) = self.greatest_values(
                [tops.get(kind, 0.0)], end - begin, "size = abs(value)", places, ["size"]
            )
        return tops

    def norms(self, orders: Mapping[str, int]) -> None:
        """Compute the largest ratios of a state, its slopes and coefficients of some orders to allowed errors."""
        tops = self.tops(Location("y")) if any(self.adaptive_atol) else {}
        first, used, n = of_collocation(self.layout), self.layout.used.size, self.layout.coordinates.size
        names = ("size", "slope", *orders)
        totals: Sequence[Operand] = [0.0] * len(names)
        for start, stop, kind, follows in self.pieces():
            for begin, end in pairwise(sorted({start, min(max(n, start), stop), stop})):  # slopes stand in two parts
                places = {f"term_{name}": loop_element("w", first + k * used + begin) for name, k in orders.items()}
                places |= {"value": loop_element("y", begin), "slope": loop_element("y", self.slope_index(begin))}
                places |= {"term_size": places["value"], "term_slope": places["slope"]}
                places["atol" if follows else "allowed"] = loop_element("w", len(LANE) + begin)
                text = "\n".join([*([formulas.ALLOWED] if follows else []), formulas.WEIGHT])
                text += "".join(f"\n{formulas.TERM.format(name)}" for name in names)
                norm_names = [f"norm_{name}" for name in names]
                totals = self.greatest_values(totals, end - begin, text, places, norm_names, top=tops.get(kind, 0.0))
        self.known |= {f"norm_{name}": total for name, total in zip(names, totals, strict=True)}


STRIDE, DERIVED, WEIGH = "stride", "derived", "weigh"

_SIDE = (
    "silent{0} = silent*where(side > 1.5, 1, where(side > 0.5, where(under > 0, 1, 0), where(side < -0.5, where(over <"
    " 0, 1, 0), 0)))"
)
_ASLEEP = "silent{0} = silent*where(side > 1.5, 1, 0)"
# a step below half a spacing of t would not advance: such a step is left to the single march
_READY = """
advances = where(t + width > t, where(reach > t, 1, 0), 0)
ready = lives*advances*fits*where(done <= most, 1, 0)
"""
# a norm that is nan or infinite lets a lane neither move nor repeat: the single march judges that trial
_JUDGE = """
shorter = width*shrink
bound = max(min_step, max(1e-14*abs(t), 1e-300))
repeats = where(judged > 1, where(judged < 1e300, where(least*width > bound, where(least*step > bound, 1, 0), 0), 0), 0)
moves = ready*sound*silent*where(judged <= 1, 1, 0)
turns_back = ready*sound*repeats
"""
_JUDGE_AT_GRID = """
moves = ready*sound*silent
turns_back = 0*ready
"""
# a step that series foresaw is seldom rejected: the single march does it, and all that follow until one is accepted
_JUDGE_FORESEEN = f"{_JUDGE_AT_GRID}moves = moves*where(judged <= 1, 1, 0)"
_FORESEE = """
foreseen = where(rejected > 0, step, min(min(factor*doubling, max_step), remaining))
fits = where(rejected > 0, 0, where(foreseen > max(min_step, max(1e-14*abs(t), 1e-300)), 1, 0))
"""
# a step that the rounding of terms may have shortened is lengthened by the single march
_FORESEE_WEIGHED = """
usual = where(h > 0, where(foreseen < least*h, 0, 1), where(foreseen < tiny*rest, 0, 1))
fits = fits*usual*where(weighs > 1, 0, 1)
"""
_CONTROL = f"logarithm = log(norm)\n{formulas.EXPONENT}\npower = exp(exponent)\n{formulas.PROPORTIONAL}"
_PREDICT = formulas.PREDICTIVE + formulas.PREDICTED
_WEIGHED = """
norm_weighed = where(doubtful_now > 0, weighed_now, unweighed)
lowered = doubtful_now*where(norm_weighed < unweighed, 2, 0)
"""
_DOUBTED = f"""
weighs = where(moves + turns_back > 0, where(lowered > 0, 2, where(judged > {formulas.SMALL}, 0, where(width >= max_step, 0, weighs))), weighs)
"""
_MOVE = """
t = where(moves > 0, reach, t)
h = where(moves > 0, width, h)
grid = where(moves > 0, grid + counts, grid)
on_grid = where(moves > 0, counts, on_grid)
landed = where(moves > 0, lands*inner, landed)
done = done + moves + turns_back
accepted = accepted + moves
ordinary = where(moves + turns_back > 0, 1 - moves*where(lands > inner, 1, 0), 1 - lives)
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
_PACE_FORESEEN = """
step = foreseen
first_step = where(first_step > 0, first_step, foreseen*moves)
"""


# in the first step, and after a rejection, an estimate above 1 is made again at the state that it leads to (Hairer and
# Wanner, Solving ODEs II, section IV.8)
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


def stride_programs(
    layout: Layout, steps: Steps, *, adaptive: bool, adaptive_atol: tuple[bool, ...] = (), sizes: Program | None = None
) -> tuple[Program, ...]:
    """Write the step, after the programs that it calls, those of the method among them; one gives the finite numbers of a row besides the state.

    `adaptive_atol` says of each variable whether its absolute tolerance follows it; none does if it is empty. `sizes` is the
    program of the sizes of terms, if these tolerances have a floor from them.
    """
    write, solves, foresees = _StepWriter(layout, adaptive_atol, steps.memory), is_solved(layout), has_series(layout)
    write.weighs = sizes is not None and layout.estimates
    weighing = () if sizes is None else (sizes, _StepWriter(layout, adaptive_atol, steps.memory).weighed())
    if foresees:
        write.expand(adaptive=adaptive)
    write.lines(formulas.AIM_FREELY if adaptive else formulas.GRID_TIME + formulas.AIM_AT_GRID)
    write.lines(_READY)
    write.store("at", {"t": "t", "t1": "reach", "h": "width"})
    inner = write.solve() if solves else write.propose(steps.programs)
    if layout.derived or layout.smooth:
        write.store("at", {"t": "reach"})
        write.body.append(
            ProgramCall(DERIVED, "at", "z", "samples")
        )  # steps in lanes keep no samples, so there is room
    write.load("finite_row", Location("at", UNSOUND))
    write.lines("sound = where(finite_step == 0, where(finite_row == 0, 1, 0), 0)")
    if layout.estimates:
        write.known["judged"] = write.error_norm()
    write.watch()
    if adaptive and not foresees:
        control = _PREDICT if solves else _CONTROL
        write.lines(control + formulas.NEXT, norm=write.known["judged"], cut=write.known["lands"])
    write.lines(_JUDGE_FORESEEN if adaptive and foresees else _JUDGE if adaptive else _JUDGE_AT_GRID)
    write.smooth()
    write.move(adaptive=adaptive)
    pace = (_PACE_FORESEEN if foresees else _PACE) if adaptive else ""
    judgement_text = (_JUDGED if layout.estimates else "") + (_DOUBTED if write.weighs else "")
    write.keep(_MOVE + judgement_text + pace + (_SOLVED if solves else ""))
    stride_program = Program(STRIDE, "One step in every lane.", tuple(write.body))
    return (
        *weighing,
        *inner,
        *((model_programs.derived(layout),) if layout.derived or layout.smooth else ()),
        stride_program,
    )


class _StepWriter(LaneWriter):
    """Writes the parts of a step."""

    weighs = False  # whether a trial that fails is weighed again

    def expand(self, *, adaptive: bool) -> None:
        """Write the Taylor coefficients at the state; if steps are chosen, choose this one: `march.series.choose_series_step`."""
        self.store("at", {"t": "t"})
        self.body.append(ProgramCall("expand", "at", "y", "z"))
        assert self.layout.scheme is not None  # noqa: S101 - a layout of steps has one
        order = self.layout.scheme.method.order
        if not adaptive:
            return
        self.norms({"before": order - 1, "last": order})
        self.lines(f"remaining = end - t\n{formulas.TIME_OF}")
        self.power("rest_before", "time", (order - 1) // 2)
        self.lines("rest_last = rest_before*time")
        self.known["half"] = self.known["rest_before" if order % 2 == 1 else "rest_last"]
        self.lines(formulas.WITHOUT_UNIT)
        for name in ("top", "before", "last"):
            self.compute("part", "significand", name)
            self.compute("whole", "exponent", name)
            self.lines(formulas.LOG2)
            self.known[f"log2_{name}"] = self.known["log2"]
        self.lines(formulas.FORESEEN, per_before=1.0 / (order - 1), per_last=1.0 / order)
        self.compute("doubling", "binary_power", "whole")
        self.lines(_FORESEE + (_FORESEE_WEIGHED if self.weighs else ""), tiny=formulas.TINY)
        self.known["step"] = self.known["foreseen"]

    def propose(self, programs: tuple[Program, ...]) -> tuple[Program, ...]:
        """Make the step by the lines of the method, whose working memory lies behind a lane's other numbers."""
        layout, first, curve = self.layout, of_collocation(self.layout), curve_size(self.layout)
        self.body.append(ProgramCall("propose", "at", "y", "z"))
        self.load("finite_step", Location("at", UNSOUND))
        if not has_series(layout):
            return programs
        if curve:
            self._curve = first + self._memory - curve
            self.body.append(ProgramCall(POLYNOMIAL, "at", "y", "z"))
            programs = (*programs, line_writing.polynomial_program(layout, self._memory - curve))
        return tuple(shift_array(program, "w", first) for program in programs)

    def solve(self) -> tuple[Program, ...]:
        """Make the step by iterations in all lanes until each has ended; return the programs called for it."""
        layout, follows = self.layout, any(self.adaptive_atol)
        memory = RadauMemory(layout, self.places, of_collocation(layout))
        inner = CollocationStep(memory, len(LANE), follows=follows)
        self.places = places = memory.places
        self.body += inner.begin(self.known)
        self.body.append(When(places["missing"], ProgramCall(collocation.LINEARISE, "at", "y", "z")))
        self.body.append(When(places["unfactored"], ProgramCall(FACTORISE, "at", "y", "z")))
        self.body.append(While(places["open"], ProgramCall(collocation.CORRECT, "at", "y", "z")))
        self.body += inner.end_state_lines()
        self.store("at", {"t": "reach"})
        self.body += [ProgramCall("forces", "at", "z", "z"), *inner.error_lines()]
        self.known["judged_first"] = self.error_norm()
        self.lines("solved = ready*(1 - vain)")
        self.known["ready"] = self.known["solved"]
        self.keep(_AGAIN)
        self.body.append(When(places["again"], ProgramCall(collocation.ESTIMATE, "at", "y", "z")))
        self.body.append(soundness("z", 0, layout.state.size, "finite_step"))
        self.known["finite_step"] = "finite_step"
        self.body += inner.curve()
        self._curve = memory.vector_location("curve", 0).offset
        return (model_programs.linearised(layout), *inner.programs)

    def error_norm(self) -> Operand:
        """Find the largest ratio of an error to its scale: `march.control.trial_error_norm`."""
        norm = self._largest_ratio(floored=False)
        if not self.weighs:
            return norm
        self.known["unweighed"] = norm
        self.keep("doubtful = ready*where(unweighed > 1, 1, where(weighs > 0, 1, 0))")
        self.store("at", {"t": "reach"})
        self.body.append(When(self.places["doubtful"], ProgramCall(WEIGH, "at", "y", "z")))
        for name in ("doubtful", "weighed"):
            self._parts += 1
            self.load(f"{name}{self._parts}", self.places[name])
            self.known[f"{name}_now"] = f"{name}{self._parts}"
        self.lines(_WEIGHED)
        return self.known["norm_weighed"]

    def weighed(self) -> Program:
        """Write the program that weighs a trial by the sizes of terms, too."""
        self.body.append(ProgramCall(TERM_SIZES, "at", "z", "terms"))
        self.load("width", Location("at", AT.index("h")))
        self.body.append(StoreTo(self.places["weighed"], self._largest_ratio(floored=True)))
        about = "The norm of the error, where rounding of the terms of forces is allowed."
        return Program(WEIGH, about, tuple(self.body), local={"terms": self.layout.record.size})

    def _largest_ratio(self, *, floored: bool) -> Operand:
        """Find the largest ratio of an error to its scale: `march.control.largest_ratio`."""
        norm: Operand = 0.0
        tops = self.tops(Location("z")) if any(self.adaptive_atol) else {}
        n = self.layout.coordinates.size
        for begin, end, kind, follows in self.pieces():
            places = {
                name: loop_element(array, begin) for name, array in (("error", "e"), ("before", "y"), ("after", "z"))
            }
            places["atol" if follows else "allowed"] = loop_element("w", len(LANE) + begin)
            places["slope"] = loop_element("z", self.slope_index(begin))
            text = [formulas.ALLOWED] * follows
            if follows and floored:
                text.append(formulas.LEAST_OF_COORDINATE if begin < n else formulas.LEAST_OF_RATE)
                places["terms"] = loop_element("terms", self.slope_index(begin + n if begin < n else begin))
            text.append(formulas.FLOORED_RATIO if follows and floored else formulas.RATIO)
            top = tops.get(kind, 0.0)
            norm = self.greatest_values([norm], end - begin, "\n".join(text), places, ["ratio"], top=top)[0]
        return norm

    def _settle_tolerances(self, first: int) -> None:
        """Update following tolerances as `march.tolerance_sizes.settle_tolerances`; not in lanes that did not move."""
        used = self.layout.used.size
        tops = self.tops(Location("w", first + used))
        for begin, end, kind, follows in self.pieces():
            if follows:
                places = {"size": loop_element("w", first + used + begin), "atol": loop_element("w", first + begin)}
                self.write_components(end - begin, formulas.TOLERANCE, places, "atol", top=tops[kind])

    def watch(self) -> None:
        """Find out whether every event function certainly keeps its side: `march.events.isolation.is_event_free`."""
        self.known["silent"] = 1.0
        if not self.layout.watched:
            return
        self.load("begin", Location("w", LANE.index("t")))
        times = ("begin", self.known["reach"])
        lines, enclosures = interval_program.write_bounds(self.layout, self.known["width"], *times, self._curve)
        self.body += lines
        first = len(LANE) + 3 * self.layout.used.size
        for i, (detector, (lower, upper)) in enumerate(zip(self.layout.watched, enclosures, strict=True)):
            self.load(f"side{i}", Location("w", first + i))
            self.known |= {"under": lower, "over": upper, "side": f"side{i}"}
            # those that act only while a reaction holds are asleep: lanes make no step with a reaction that holds
            self.lines((_ASLEEP if detector.role in (PULL, LIMIT, GRIP) else _SIDE).format(i))
            self.known["silent"] = self.known[f"silent{i}"]
            if detector.role == GAP:
                self.load(f"gap{i}", Location("w", first + len(enclosures) + i))
                self.lines(f"gap{i}_now = max(gap{i}, under)")

    def smooth(self) -> None:
        """Count passages of switches declared smooth, as a row of the log does: `kernels.model_programs.row`."""
        derived_count, first = len(self.layout.derived), of_smooth(self.layout, self._memory)
        for i in range(len(self.layout.smooth)):
            for k, name in enumerate(("value", "decides")):
                self.load(f"{name}{i}", Location("samples", derived_count + 2 * i + k))
                self.known[name] = f"{name}{i}"
            places = {name: Location("w", first + 3 * i + k) for k, name in enumerate(("side", "count", "time"))}
            for name, location in places.items():
                self.load(f"{name}_smooth{i}", location)
                self.known[name] = f"{name}_smooth{i}"
            self.lines(_PASSED)
            self.body += [StoreTo(location, self.known[f"new_{name}"]) for name, location in places.items()]

    def move(self, *, adaptive: bool) -> None:
        """Replace the old state by the new one in lanes that move."""
        first, used = len(LANE) + self.layout.used.size, self.layout.used.size
        if adaptive:
            self._replace_where_moved(used, "max(old, abs(new))", loop_element("z"), loop_element("w", first))
        if any(self.adaptive_atol):
            self._settle_tolerances(len(LANE))
        if self.layout.estimates:
            self._replace_where_moved(used, "new", loop_element("e"), loop_element("w", first + used))
        first += 2 * used + len(self.layout.watched)
        for i, detector in enumerate(self.layout.watched):
            if detector.role == GAP:
                write = self.begin_formulas()
                value = write.formula(f"where(moves > 0, gap{i}_now, gap{i})")
                self.body += [*write.lines, StoreTo(Location("w", first + i), value)]
        self._replace_where_moved(self.layout.record.size, "new", loop_element("z"), loop_element("y"))

    def _replace_where_moved(self, count: int, value: str, new: Location, old: Location) -> None:
        """Replace old numbers by a value of both in lanes that move."""
        self.write_components(
            count, f"kept = where(moves > 0, {value}, old)", {"new": new, "old": old, "kept": old}, "kept"
        )
