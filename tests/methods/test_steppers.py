"""What steppers answer: their equations as written, what solves them, what is counted, what is refused."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd
from xdynamics.methods.lines import read_lines, spread_over_vectors
from xdynamics.methods.steppers import (
    DIFFERENCES,
    EXACT,
    LINES,
    NEWTON,
    NOTHING,
    SIMPLIFIED,
    Collocation,
    Stepper,
    TimeStepping,
)

GAUSS = Collocation(
    a=(("5/36", "a", "b"), ("c", "2/9", "d"), ("e", "f", "5/36")), b=("5/18", "4/9", "5/18"), c=("l", "1/2", "r")
)
RADAU = Collocation(a=(("5/12", "-1/12"), ("3/4", "1/4")), b=("3/4", "1/4"), c=("1/3", "1"))
LOBATTO = Collocation(a=(("0", "0", "0"), ("a", "b", "c"), ("d", "e", "f")), b=("d", "e", "f"), c=("0", "1/2", "1"))


class Asked:
    """Writes down what a stepper asks of the writer of programs."""

    def by_lines(self) -> str:
        """Return that it was asked for lines."""
        return "lines"

    def by_stages(self, stages: int) -> str:
        """Return how many stages it was asked for."""
        return f"{stages} stages"


def ball(**contact: Any) -> xd.Model:
    """A mass over a floor; without a contact where none is described."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "10 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"y": "-m*g"}},
        contacts={"floor": {"gap": "y"} | contact} if contact else {},
        initial={"y": "1 m", "v_y": "0 m s-1"},
    )


def test_equations_of_collocation() -> None:
    """Assert the lines of a formula whose last stage is the end of the step, and of one where it is not."""
    assert RADAU.template.splitlines() == [
        "y2 = y + 1/3*h*k",
        "y3 = y + h*k",
        "solve y2, y3:",
        "    k2 = f(t + 1/3*h, y2)",
        "    k3 = f(t1, y3)",
        "    y2 = y + h*(5/12*k2 + -1/12*k3)",
        "    y3 = y + h*(3/4*k2 + 1/4*k3)",
        "y1 = y3",
        "k1 = f(t1, y1)",
    ]
    assert GAUSS.template.splitlines()[-2:] == ["y1 = y + h*(5/18*k2 + 4/9*k3 + 5/18*k4)", "k1 = f(t1, y1)"]
    assert LOBATTO.template.splitlines()[-2] == "y1 = y4"


@pytest.mark.parametrize(
    ("stepper", "asked", "inner", "jacobians", "memory"),
    [
        (LINES, "lines", None, (EXACT,), False),
        (TimeStepping(), "lines", None, (EXACT,), False),
        (RADAU, "2 stages", 0.1, (EXACT, DIFFERENCES), True),
        (GAUSS, "3 stages", 0.1, (EXACT, DIFFERENCES), True),
    ],
)
def test_what_a_march_asks(stepper: Stepper, asked: str, inner: Any, jacobians: Any, memory: bool) -> None:
    """Assert the programs that are written, and what a step keeps for the next one."""
    assert stepper.programs(Asked()) == asked
    assert (stepper.rtol_scaling and stepper.rtol_scaling[0], stepper.jacobians, stepper.has_memory) == (
        inner,
        jacobians,
        memory,
    )
    assert stepper.locates is (asked != "lines" or stepper is LINES)


def test_what_solves_the_equations() -> None:
    """Assert that equations among other lines are solved by Newton's method, and what is counted of them."""
    plain = read_lines(spread_over_vectors("k2 = f(t + 1/2*h, y2)\ny1 = y + h*k2\nk1 = f(t1, y1)"))
    implicit = read_lines(spread_over_vectors(RADAU.template))
    assert (LINES.solver(plain), LINES.solver(implicit), RADAU.solver(implicit)) == (NOTHING, NEWTON, SIMPLIFIED)
    assert (LINES.evaluations(plain, ()), LINES.evaluations(plain, plain[:1])) == (2, 3)
    assert (LINES.evaluations(implicit, plain), RADAU.evaluations(implicit, plain)) == (5, 3)


def test_models_that_have_no_such_steps() -> None:
    """Assert that steps over contacts refuse a law of located impacts, and an estimate that knows of none."""
    newton, energetic, free = ball(restitution=0.5), ball(restitution=0.5, law="energetic"), ball()
    steps, law, error = TimeStepping(), "Newton's law of restitution over whole steps", "knows of impacts"
    assert [[*steps.refusals(model), *LINES.refusals(model)] for model in (newton, free)] == [[], []]
    assert [steps.faults_of_estimates(free, "m"), LINES.faults_of_estimates(newton, "m")] == [[], []]
    (first,), (second,) = steps.refusals(energetic), steps.faults_of_estimates(newton, "m")
    assert law in first
    assert error in second
    assert LINES.refusals(energetic) == []
