"""A method's vector lines as programs: the step, the iterations of its equations, the state inside the step."""

from __future__ import annotations

from dataclasses import dataclass, replace

from xdynamics.kernels.jacobian_pattern import is_compressed, pattern_of
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.line_writing import LineWriter
from xdynamics.kernels.model_programs import changes, expanded, linearised
from xdynamics.kernels.program import Program
from xdynamics.kernels.step_parts import Steps
from xdynamics.kernels.step_polynomial import POLYNOMIAL, curve_size
from xdynamics.methods.scheme import Scheme
from xdynamics.methods.steppers import EXACT


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
