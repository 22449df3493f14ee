"""A method's vector lines as programs: the step, the iterations of its equations, the state inside the step.

A line of vectors becomes a loop over their components. A step consists of its programs, the equations that it solves,
and its working memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from xdynamics.expressions import Node, parse
from xdynamics.kernels.assignments import Assignments, FusedAssignments
from xdynamics.kernels.constraint_programs import CONSTRAIN, KEEP, OPEN, PROGRESS
from xdynamics.kernels.layout import POLYNOMIAL, Layout, curve_size
from xdynamics.kernels.model_programs import changes, expanded, linearised
from xdynamics.kernels.newton_matrix import Coupling, NewtonSystem, is_compressed, pattern_of
from xdynamics.kernels.program import (
    AT,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    ProgramCall,
    StoreTo,
    While,
    loop_element,
    named_arrays,
    nested_lines,
)
from xdynamics.methods.lines import SCALARS, ConstraintImpulse, Evaluation, Solve, TaylorSeries, VectorStatement, Walker
from xdynamics.methods.scheme import Scheme, Update
from xdynamics.methods.steppers import EXACT, SERIES


@dataclass(frozen=True)
class Steps:
    """The programs of one step.

    Attributes
    ----------
    programs : tuple of Program
        One for an explicit method. Where equations are solved: what comes before, one iteration, what comes after, and
        so on; last the derivatives along a direction, where a matrix is found group by group.
    equations : tuple of Equations
    memory : int
        Numbers of the working memory; the last ones are the coefficients of the step's polynomial, where it leaves one.
    """

    programs: tuple[Program, ...]
    equations: tuple[NewtonSystem, ...]
    memory: int


class LineWriter(Walker):
    """Writes lines as they come; vectors are arrays, and a line of vectors becomes a line for each component."""

    def __init__(self, layout: Layout, *, sampled: bool, working: bool) -> None:
        self.layout = layout
        self.sampled = sampled
        self.working = working  # whether vectors live in `w`, so that the next program has them too
        self.stage = 0
        self._memory = 0
        self._views: dict[str, tuple[str, int, int]] = {}
        self._local: dict[str, int] = {}
        self._bodies: list[list[Instruction]] = []
        self._equations: list[NewtonSystem] = []
        self._changes: tuple[Program, ...] = ()
        self._derivatives = 0  # where those of a matrix found group by group are
        self._last, self._time, self.impulse_count = "", "t", 0
        self._begin_program()
        first = 0
        for name, count in zip("qvxar", map(self._component_count, "qvxar"), strict=True):
            self._views[name] = ("y", first, count)
            first += count
        assert layout.scheme is not None  # noqa: S101 - a layout of steps has one
        self._fused = layout.scheme.method.solver == SERIES and not layout.is_doubled
        self._updates = layout.scheme.compensated
        self._carry: dict[str, str] = {}
        first = layout.used.size + layout.evaluation.size
        for name in "qvx" if self._updates else "":
            self._carry[name] = f"{name}_carried"
            self._views[self._carry[name]] = ("y", first, self._component_count(name))
            first += self._component_count(name)

    # ------------------------------------------------------------------------------------------------ kinds of line

    def assign(self, line: VectorStatement) -> None:
        """Write one vector from others."""
        self._vector(line.target)
        if line.target in self._updates:
            self._compensated_update(line.target, self._updates[line.target])
        else:
            self._write_components(line.target, line.expression)

    def evaluate(self, line: Evaluation) -> None:
        """Evaluate the forces at a state that is assembled for it."""
        self._evaluation(line, "forces")

    def expand(self, line: TaylorSeries) -> None:
        """Use the coefficients of the motion that are given in `w`."""
        used = self.layout.used.size
        for i in range(line.degree + 1):
            for name in "qvx":
                _, first, count = self._views[name]
                self._views[f"{name}_{i}"] = ("w", i * used + first, count)

    def solve(self, line: Solve) -> None:
        """Write one iteration of Newton's method as a separate program, and go on after it."""
        self._begin_program()
        self.walk(line.definitions)
        grouped = self._in_groups(line)
        slopes = [self._evaluation(part, "forces" if grouped else "linearised") for part in line.evaluations]
        residuals = self._memory
        for part in line.equations:
            target = f"b_{part.target}"
            self._vector(target, self._component_count(part.target))
            self._write_components(target, part.expression, taken_from=part.target)
        places = tuple(
            (self._views[name][1], *self._start_slots(name, 0), self._component_count(name)) for name in line.unknowns
        )
        system = NewtonSystem(len(line.evaluations), residuals, places)
        coupling = Coupling(self.layout, line, slopes, self.coefficient)
        if grouped:
            system = self._grouped_system(system, line, coupling)
        else:
            system = replace(system, entries=self._matrix_entries(line, coupling))
        self._equations.append(system)
        self._begin_program()
        self.walk(line.definitions)

    def _in_groups(self, line: Solve) -> bool:
        """Whether the matrix is one of accelerations and rates at a single state, so that it has the model's pattern."""
        single = len(line.evaluations) == 1 and [name[0] for name in line.unknowns] == ["v", "x"]
        return single and is_compressed(self.layout)

    def _matrix_entries(self, line: Solve, coupling: Coupling) -> tuple[tuple[int, int, int, int], ...]:
        """Return the terms subtracted from the unit matrix, entry by entry."""
        targets = [(part.target, i) for part in line.equations for i in range(self._component_count(part.target))]
        unknowns = [(name, i) for name in line.unknowns for i in range(self._component_count(name))]
        return tuple(
            entry
            for row, target in enumerate(targets)
            for column, unknown in enumerate(unknowns)
            for entry in coupling.entries(row, column, target, unknown)
        )

    def _grouped_system(self, system: NewtonSystem, line: Solve, coupling: Coupling) -> NewtonSystem:
        """Write the coefficients of all entries, and make room for derivatives, their direction and the time."""
        (evaluation,), (_, state, _) = line.evaluations, self._views[f"f{self.stage}"]
        weights, entries = coupling.weights(), len(pattern_of(self.layout).entries)
        if not self._changes:
            self._derivatives = self._memory
            self._changes = (changes(self.layout, self._derivatives + entries),)
            self._memory += entries + self.layout.used.size + 1
        time = self._derivatives + entries + self.layout.used.size
        self._scalars.store(Location("w", time), self._scalars.value(parse(evaluation.time)))
        return replace(system, state=state, weights=weights, derivatives=self._derivatives)

    # ------------------------------------------------------------------------------------------------------- ends

    def end(self) -> None:
        """Write the new state to `z`: the result of the step, and of its last force evaluation."""
        self.out("z", ["q1", "v1", "x1", "a1", "r1"], self.layout.used + self.layout.accelerations + self.layout.rates)
        first = self.layout.used.size + self.layout.accelerations.size + self.layout.rates.size
        last = self.layout.used.size + self.layout.evaluation.size
        self._copy_elements(Location("z", first), Location(self._last, first), last - first)
        for name in "qvx" if self._updates else "":
            self._copy_elements(Location("z", last), Location(self._carry[name]), self._component_count(name))
            last += self._component_count(name)
        if self.layout.model.constraints:
            self._constrain()

    def _constrain(self) -> None:
        """Project the new state onto constraints; an estimate reads the state before the projection."""
        at_array = self._allocate_array("at_end", len(AT), is_local=True)
        for name, value in (
            ("t", self._scalars.value(parse("t1"))),
            ("h", self._scalars.value(parse("h"))),
            ("regime", self._load_regime()),
        ):
            self._scalars.store(Location(at_array, AT.index(name)), value)
        self._flush()
        self._bodies[-1].append(ProgramCall(CONSTRAIN, at_array, "z", "z"))

    def ends_given(self) -> None:
        """Use the state at the end of the step that is given in `z`."""
        for name in "qvxar":
            self._views[f"{name}1"] = ("z", *self._views[name][1:])

    def stages_given(self, begin: int = 0) -> None:
        """Use the states of two stages that are given in `w`."""
        for k, stage in enumerate("23"):
            for name in "qvx":
                _, first, count = self._views[name]
                self._views[f"{name}{stage}"] = ("w", begin + k * self.layout.used.size + first, count)

    def out(self, array: str, vectors: Iterable[str], names: Sequence[str], begin: int = 0) -> None:
        """Copy vectors, one after another, into a given array."""
        first = begin
        for name in vectors:
            self._copy_elements(Location(array, first), Location(name), self._component_count(name))
            first += self._component_count(name)
        assert first == begin + len(names)  # noqa: S101 - vectors and names are two spellings of one order

    def finished(self, name: str, about: str, answered: tuple[int, int] | None = None) -> Steps:
        """Return the programs written; the last answers for the part `answered` of `z`."""
        self._flush()
        programs = []
        for i, body in enumerate(self._bodies):
            label = name if not i else f"{name}{i // 2}" if i % 2 == 0 else f"iterate{i // 2}"
            description = (
                about if i % 2 == 0 else "One iteration: residuals, coefficients and derivatives of the equations."
            )
            used = {array for line in nested_lines(body) for array in named_arrays(line)}
            views = {key: view for key, view in self._views.items() if key in used}
            used |= {array for array, _, _ in views.values()}
            local = {key: count for key, count in self._local.items() if key in used}
            # the result of a step follows the last equations
            sound = answered if i == len(self._bodies) - 1 else None
            programs.append(Program(label, description, tuple(body), views, local, sound))
        return Steps((*programs, *self._changes), tuple(self._equations), self._memory)

    # ---------------------------------------------------------------------------------------------------- in parts

    def coefficient(self, weight: Node, inner_derivative: Node | None = None) -> int:
        """Compute a number of the matrix that all components share, and return its index in `w`."""
        value = self._scalars.value(weight)
        if inner_derivative is not None:
            value = self._scalars.compute("multiply", value, self._scalars.value(inner_derivative))
        slot = self._memory
        self._memory += 1
        self._scalars.store(Location("w", slot), value)
        return slot

    def _begin_program(self) -> None:
        """Begin a program."""
        if self._bodies:
            self._flush()
        self._bodies.append([])
        self._scalars = Assignments(lambda lines, name: lines.load(Location("at", AT.index(name)), name), "_")

    def _flush(self) -> None:
        self._bodies[-1] += self._scalars.lines
        self._scalars.lines.clear()

    def _compensated_update(self, target: str, update: Update) -> None:
        """Add to every component of a vector, and keep the rounding error of the sum.

        The last update of the step puts it back; until then forces may be evaluated a rounding error beside the sum, so
        that no evaluation waits for it.
        """
        letter, lines = target[0], self._component_lines()
        last = target == f"{letter}1"
        old_value, added = lines.load(loop_element(update.start_vector)), lines.value(update.increment)
        carried = lines.load(loop_element(self._carry[letter]))
        if last:
            added = lines.compute("add", added, carried)
        total = lines.compute("add", old_value, added)
        # Kahan's compensated sum: exactly what the rounded sum lost of `added`, if the old value is the larger of the
        # two
        lost = lines.compute("subtract", added, lines.compute("subtract", total, old_value))
        self._carry[letter] = self._allocate_array(f"{target}_carried", self._component_count(target))
        lines.store(loop_element(target), total)
        lines.store(loop_element(self._carry[letter]), lost if last else lines.compute("add", carried, lost))
        self._flush()
        self._bodies[-1].append(Loop("i", self._component_count(target), tuple(lines.lines)))

    def _component_lines(self) -> Assignments:
        """Begin the lines of one component of vectors."""

        def find(lines: Assignments, name: str) -> Operand:
            return self._scalars.operand_of(name) if name in SCALARS else lines.load(loop_element(name))

        kind = FusedAssignments if self._fused else Assignments
        return kind(find, f"_{len(self._bodies[-1])}_")

    def _write_components(self, target: str, expression: Node, taken_from: str = "") -> None:
        """Compute an expression for every component of a vector, or the difference of `taken_from` from it."""
        lines = self._component_lines()
        value = lines.value(expression)
        if taken_from:
            value = lines.compute("subtract", lines.load(loop_element(taken_from)), value)
        lines.store(loop_element(target), value)
        self._flush()
        self._bodies[-1].append(Loop("i", self._component_count(target), tuple(lines.lines)))

    def _copy_elements(self, target: Location, source: Location, count: int) -> None:
        """Copy elements; both places are those of the first."""
        self._flush()
        name = f"_{len(self._bodies[-1])}_"
        self._bodies[-1].append(
            Loop(
                "i",
                count,
                (
                    Load(name, loop_element(source.array, source.offset)),
                    StoreTo(loop_element(target.array, target.offset), name),
                ),
            )
        )

    def keep(self, line: ConstraintImpulse) -> None:
        """Write impulses of constraints, along the gradients at the last force evaluation."""
        self.impulse_count += 1
        record, at_array = (
            self._allocate_array(f"k{self.impulse_count}", self.layout.record.size),
            self._allocate_array(f"at_k{self.impulse_count}", len(AT), is_local=True),
        )
        progress = self._allocate_array(f"turns_k{self.impulse_count}", len(PROGRESS), is_local=True)
        scalars = {"t": self._scalars.value(parse(self._time)), "t1": self._scalars.value(parse(line.time))}
        for name, value in (scalars | {"regime": self._load_regime()}).items():
            self._scalars.store(Location(at_array, AT.index(name)), value)
        for i, value in enumerate((1.0, 0.0, self._scalars.value(parse(line.distance)))):
            self._scalars.store(Location(progress, i), value)
        coordinates = self.layout.coordinates.size
        vectors = (line.position, 0), (line.velocity, coordinates)
        for name, first in vectors:
            self._copy_elements(Location(record, first), Location(name), coordinates)
        self._flush()
        self._bodies[-1].append(
            While(Location(progress, OPEN), ProgramCall(KEEP, at_array, self._last or "y", record, progress))
        )
        for name, first in vectors:
            self._copy_elements(Location(name), Location(record, first), coordinates)

    def _evaluation(self, line: Evaluation, program: str) -> int:
        """Call the forces at a state; return the index of the derivatives by `linearised`."""
        self.stage += 1
        record, at_array = (
            self._allocate_array(f"f{self.stage}", self.layout.record.size),
            self._allocate_array(f"at{self.stage}", len(AT), is_local=True),
        )
        first = 0
        for name in (line.position, line.velocity, line.state):
            self._copy_elements(Location(record, first), Location(name), self._component_count(name))
            first += self._component_count(name)
        time = self._scalars.value(parse(line.time))
        self._scalars.store(Location(at_array, AT.index("t")), time)
        self._scalars.store(Location(at_array, AT.index("regime")), self._load_regime())
        self._flush()
        slopes = self._memory
        if program == "linearised":
            self._allocate_array(f"j{self.stage}", len(self.layout.jacobian))
        self._bodies[-1].append(
            ProgramCall(program, at_array, record, record, f"j{self.stage}" if program == "linearised" else "e")
        )
        for name, count in zip((line.acceleration, line.rate), map(self._component_count, "ar"), strict=True):
            self._add_view(name, record, first, count)
            first += count
        self._last, self._time = record, line.time
        if self.sampled:
            self._sample(time, record)
        return slopes

    def _load_regime(self) -> Operand:
        """Read the regime in which forces are evaluated."""
        return self._scalars.load(Location("at", AT.index("regime")), "regime")

    def _sample(self, time: Operand, record: str) -> None:
        """ConstraintImpulse time, state, force components and drives of an evaluation."""
        layout = self.layout
        n, sample, width = layout.used.size, f"sample{self.stage}", layout.sample_width
        forces = width - 1 - n
        self._views[sample] = ("samples", (self.stage - 1) * width, width)
        self._bodies[-1].append(StoreTo(Location(sample), time))
        self._copy_elements(Location(sample, 1), Location(record), n)
        self._copy_elements(Location(sample, 1 + n), Location(record, n + layout.evaluation.size - forces), forces)

    def _vector(self, name: str, count: int | None = None) -> None:
        if name not in self._views and name not in self._local:
            self._allocate_array(name, self._component_count(name) if count is None else count)

    def _allocate_array(self, name: str, count: int, *, is_local: bool = False) -> str:
        """Make room for an array, local to the program or in the working memory."""
        if self.working and not is_local:
            self._views[name] = ("w", self._memory, count)
            self._memory += count
        else:
            self._local[name] = count
        return name

    def _add_view(self, name: str, array: str, first: int, count: int) -> None:
        outer, start, _ = self._views.get(array, (array, 0, 0))
        self._views[name] = (outer, start + first, count)

    def _start_slots(self, name: str, i: int) -> tuple[int, int]:
        """Return the places of value and slope of an unknown's component at the start of the step."""
        value, slope = ("x", "r") if name[0] == "x" else ("v", "a")
        return self._views[value][1] + i, self._views[slope][1] + i

    def _component_count(self, name: str) -> int:
        letter = name.removeprefix("b_")[0]
        return self.layout.states.size if letter in "xr" else self.layout.coordinates.size


@dataclass(frozen=True)
class _StepWriting:
    """Writes the steps that steppers ask for."""

    layout: Layout
    scheme: Scheme
    sampled: bool

    def by_lines(self) -> Steps:
        """Write the lines of the method, and those of its estimate."""
        layout, scheme = self.layout, self.scheme
        write = LineWriter(layout, sampled=self.sampled, working=bool(scheme.method.solves))
        write.walk(scheme.method.lines(layout.model))
        write.end()
        write.walk(scheme.error_lines)
        if scheme.error_lines:
            write.out("e", [f"{letter}e" for letter in "qvx"], layout.used)
        return write.finished("propose", f"One step by {scheme.method.name}.", (0, layout.state.size))

    def by_series(self, degree: int) -> Steps:
        """Write the lines of the method, then the program that expands the motion, whose coefficients they read."""
        layout = self.layout
        series = expanded(layout, degree)
        lines = self.by_lines().programs
        return Steps((*lines, series.program), (), series.memory)

    def by_stages(self, stages: int) -> Steps:
        """Write the derivatives at a state: all else is made by `march.implicit.radau`, with the stages in `w`."""
        layout, first, exact = self.layout, stages * self.layout.used.size, self.scheme.jacobian == EXACT
        if is_compressed(layout):
            direction = first + len(pattern_of(layout).entries)
            return Steps((changes(layout, direction),) if exact else (), (), direction + layout.used.size)
        return Steps((linearised(layout, "w", first),) if exact else (), (), first + len(layout.couplings))


def step_program_set(layout: Layout, scheme: Scheme, *, sampled: bool) -> Steps:
    """Write one step of a method, with the estimate of its error where an embedded formula gives it."""
    steps = scheme.method.stepper.programs(_StepWriting(layout, scheme, sampled))
    return replace(steps, memory=steps.memory + curve_size(layout))


def polynomial_program(layout: Layout, curve: int, stages: int = 0) -> Program:
    """Write the coefficients in s of a step's polynomial, power by power, to `w` from `curve` on.

    It takes the states at the step's ends in `y` and `z`, and those of its stages in `w` from `stages` on; where these do
    not suffice the step is made again, and its end is written to `z`.
    """
    write, scheme = LineWriter(layout, sampled=False, working=False), layout.scheme
    assert scheme is not None  # noqa: S101 - a layout of steps has one
    if scheme.interpolant.needs_no_stages:
        write.ends_given()
        write.stages_given(stages)
    else:
        write.walk(scheme.method.lines(layout.model))
        write.end()
    write.walk(scheme.interpolant.polynomials)
    for power in range(scheme.interpolant.degree + 1):
        write.out("w", [f"{letter}s{power}" for letter in "qvx"], layout.used, curve + power * layout.used.size)
    return write.finished(POLYNOMIAL, f"The polynomial of a step by {scheme.method.name}.").programs[0]


def interpolation_program(layout: Layout, scheme: Scheme) -> Program:
    """Write the state at t + s*h, to `e`: from the states at both ends of the step, or with the step's own stages."""
    write = LineWriter(layout, sampled=False, working=False)
    if scheme.interpolant.needs_no_stages:
        write.ends_given()
        write.stages_given()
    else:
        write.walk(scheme.method.lines(layout.model))
        write.end()
    write.walk(scheme.interpolant.lines)
    write.out("e", [f"{letter}s" for letter in "qvx"], layout.used)
    return write.finished("inside", f"The state inside a step by {scheme.method.name}.").programs[0]
