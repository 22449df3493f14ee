"""Event functions of models with dimensions, and their time derivatives, are written in loops."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.array_programs import compiled
from xdynamics.kernels import Layout, layout_of, model_programs
from xdynamics.kernels.program import AT, Loop, Program, Reduction
from xdynamics.model.motion import constants

PROGRAMS = ("events", "event_rates")


def membrane(n: int, **more: object) -> xd.Model:
    """A square membrane of n times n masses, released at rest in its lowest mode."""
    sides = "+ ".join(f"shift(w, {dim}, {k}, 0*metre)" for dim in ("row", "column") for k in (1, -1))
    mode = "*".join(f"sin(pi*(index({dim}) + 1)/(size({dim}) + 1))" for dim in ("row", "column"))
    half = {"function": "max(abs(w), row, column) - 0.5*A", "direction": "falling", "action": "stop"}
    return xd.Model(
        name="membrane",
        dimensions={"row": n, "column": n},
        coordinates={"w": {"unit": "m", "dims": ["row", "column"]}},
        parameters={"k": "1 N/m", "A": "0.1 m"},
        mass={"w": "1*kilogram"},
        forces={"tension": {"w": f"k*({sides} - 4*w)"}},
        initial={"w": f"A*{mode}"},
        **({"events": {"half": half}} | more),
    )


def lines_of(program: Program) -> int:
    """How many instructions a program has, those in loops once."""
    pending, count = [*program.body], 0
    while pending:
        line = pending.pop()
        count += 1
        pending += getattr(line, "body", ())
    return count


@pytest.mark.parametrize("which", PROGRAMS)
def test_a_largest_of_many_elements_takes_few_lines(which: str) -> None:
    """Assert that a program with the largest of 1,600 elements is as long as that of 100."""
    write = getattr(model_programs, which)
    small, large = (lines_of(write(layout_of(membrane(n)))) for n in (10, 40))
    assert small == large < 40


def test_time_of_a_largest_amplitude() -> None:
    """Assert that the largest of 81 elements, of which the largest come in fours, is at half where a cosine is.

    The mode moves as cos(w t) with the discrete frequency w^2 = 8 (k/m) sin(pi/(2 (n + 1)))^2.
    """
    n = 9
    omega = np.sqrt(8.0) * np.sin(np.pi / (2 * (n + 1)))
    run = xd.simulate(membrane(n), method="dormand_prince", rtol=1e-11, atol=1e-13, until=3.0 / omega)
    assert run.sizes["event"] == 1
    np.testing.assert_allclose(run.event_time[0], np.arccos(0.5) / omega, rtol=1e-11)


FUNCTIONS = {
    "reduced": "max(abs(w), row, column) + sum(v_w**2, row, column)*second**2/metre - norm(w, row, column)",
    "of rows": "min(w, column) - dot(w, v_w, column)*second/metre + index(row)*A",
    "moved": "roll(w, row, 1)*shift(v_w, column, -2, 0*metre/second) + w[2, 3]*v_w",
    "of ends": "norm(second(w, pair) - first(w, pair), column) - speed*second*first(w[0, 1]*index(row), pair)/metre",
}


def written(functions: dict[str, str], which: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Layout, Program, Program]:
    """Return a program of events in loops, and with its elements written out."""
    events = {f"e{i}": {"function": function} for i, function in enumerate(functions.values())}
    model = membrane(
        6,
        events=events,
        relations={"pair": {"of": "row"}},
        definitions={"speed": "sum(v_w, row, column)"},
        observables={"largest": "max(w, row)", "unknown": "sum(a_w, row)"},
    )
    layout, write = layout_of(model), getattr(model_programs, which)
    loops = write(layout)
    monkeypatch.setattr(model_programs, "_quantity_program", lambda *_: None)
    return layout, loops, write(layout)


@pytest.mark.parametrize("which", PROGRAMS)
def test_loops_give_the_numbers_of_elements(which: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that functions have the bits of their elements written out, and rates the same to rounding."""
    layout, loops, elements = written(FUNCTIONS, which, monkeypatch)
    assert any(isinstance(line, Loop | Reduction) for line in loops.body)
    assert not any(isinstance(line, Loop | Reduction) for line in elements.body)
    assert loops.sound == elements.sound == (0, len(layout.watched) + (which == "event_rates") * 6)
    y = np.random.default_rng(5).uniform(-1.0, 1.0, layout.record.size)
    found, expected = np.full((2, loops.sound[1]), np.nan)
    p = np.array([*constants(layout.model).values()])
    for program, z in ((loops, found), (elements, expected)):
        compiled(program)(y=y, p=p, at=np.zeros(len(AT)), z=z)
    assert np.isfinite(expected).all()
    if which == "events":
        np.testing.assert_array_equal(found.view(np.int64), expected.view(np.int64))
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_functions_that_read_a_table_are_in_loops() -> None:
    """Assert that each element meets a table that rises from 0 to 1 at its own height, by a program in loops."""
    n = 60
    model = xd.Model(
        name="tide",
        dimensions={"post": n},
        states={"x": {"unit": "m", "dims": ["post"], "rate": "0*metre/second"}},
        drives={"tide": {"table": "tide.csv", "csv": "t [s],tide [m]\n0,0\n0.25,0.25\n1,1\n", "argument": "t"}},
        initial={"x": "metre*(index(post) + 0.5)/size(post)"},
        events={"wet": {"function": "tide - x", "direction": "rising"}},
        observables={"depth": "tide - x"},
    )
    for which in PROGRAMS:
        assert lines_of(getattr(model_programs, which)(layout_of(model))) < n
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    np.testing.assert_allclose(run.event_time, (np.arange(n) + 0.5) / n, rtol=1e-13)
    np.testing.assert_array_equal(run.event_post, np.arange(n))
