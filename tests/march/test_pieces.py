"""Which piece of a table holds, where its ends are, and what lies behind one that was passed: against the table's rows."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.plain import plain
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.events import switch_sides
from xdynamics.march.run import Run

X, V, A = range(3)  # of a state: a position, its velocity, its acceleration


def tabulated(folder: Path, random: np.random.Generator, interpolation: str, outside: str) -> tuple[Run, list[float]]:
    """A run whose force goes by a table of three to six random rows, and the positions of these."""
    points = np.cumsum(random.uniform(0.1, 2.0, random.integers(3, 7))) - random.uniform(0, 5)
    rows = zip(points.tolist(), random.uniform(-2, 2, points.size).tolist(), strict=True)
    (folder / "force.csv").write_text("x [m],force [N]\n" + "".join(f"{x!r},{force!r}\n" for x, force in rows))
    (folder / "model.toml").write_text(f'''name = "tabulated"
coordinates.x = "m"
parameters.m = "1 kg"
mass.x = "m"
forces.spring = {{ x = "force" }}
initial = {{ x = "{float(points[:2].mean())!r} m", v_x = "0 m s-1" }}
drives.force = {{ table = "force.csv", argument = "x", interpolation = "{interpolation}", outside = "{outside}" }}
''')
    model = xd.Model.from_toml(folder / "model.toml")
    return March(model, settings_for(model, method="rk4", step=0.1, until=1.0)).run, points.tolist()


def factors(run: Run, x: float) -> list[float]:
    """What is positive inside the piece that was entered: how far it is to its lower end, and to its upper one."""
    at = run.detectors[0].to
    return [run.modes[at] * x + run.modes[at + 1], run.modes[at + 3] - run.modes[at + 2] * x]


def moving(x: float, v: float, a: float = 0.0) -> Any:
    """A state."""
    return np.array([x, v, a])


@pytest.mark.cases(60)
@pytest.mark.parametrize("outside", ["hold", "error"])
@pytest.mark.parametrize("interpolation", ["linear", "previous"])
def test_the_function_of_a_piece_is_zero_at_its_ends(
    interpolation: str, outside: str, case: int, tmp_path: Path
) -> None:
    """Assert shares of the piece's width inside it, of the table's outside, and no end where the model ends instead."""
    run, points = tabulated(tmp_path, np.random.default_rng([26, 5, case]), interpolation, outside)
    ends, last, whole = outside == "error", len(points) - 1, points[-1] - points[0]
    for k, (low, high) in enumerate(pairwise(points), start=1):
        plain(switch_sides.enter_piece)(run, 0, k)
        assert (run.places[2], run.watches[0].guard) == (k, 1)
        for x in (low, 0.75 * low + 0.25 * high, high):
            left, right = (x - low) / (high - low), (high - x) / (high - low)
            wanted = [1.0 if ends and k == 1 else left, 1.0 if ends and k == last else right]
            assert factors(run, x) == pytest.approx(wanted, abs=1e-13)
    if not ends:
        plain(switch_sides.enter_piece)(run, 0, 0)
        assert factors(run, points[0] - 0.3) == pytest.approx([1.0, 0.3 / whole], abs=1e-13)
        plain(switch_sides.enter_piece)(run, 0, run.places[1] - 1)
        assert factors(run, points[-1] + 0.3) == pytest.approx([0.3 / whole, 1.0], abs=1e-13)


@pytest.mark.cases(60)
@pytest.mark.parametrize("outside", ["hold", "zero", "error"])
def test_a_point_belongs_to_the_piece_that_is_moved_into(outside: str, case: int, tmp_path: Path) -> None:
    """Assert the piece inside, at points by the way of motion, and at the table's own ends by a velocity alone."""
    run, points = tabulated(tmp_path, np.random.default_rng([26, 6, case]), "linear", outside)
    find, last = plain(switch_sides.find_table_piece), len(points) - 1
    for k, (low, high) in enumerate(pairwise(points), start=1):
        for rate in (-1.0, 0.0, 1.0):
            assert find(run, 0, moving(0.3 * low + 0.7 * high, rate), rate) == k
        for rate in (-1.0, 0.0, 1.0) if k < last else ():
            assert find(run, 0, moving(high, 0.0, rate), rate) == k + (rate >= 0)
    for x, v, wanted in (
        (points[0], -1.0, 0),
        (points[0], 0.0, 1),
        (points[-1], 1.0, last + 1),
        (points[-1], 0.0, last),
    ):
        assert find(run, 0, moving(x, v), v or 2 * wanted - last - 1) == wanted
        assert find(run, 0, moving(x, -v), -v) == (1 if x == points[0] else last)
    assert find(run, 0, moving(points[0] - 0.1, 0.0), 0.0) == 0
    assert find(run, 0, moving(points[-1] + 0.1, 0.0), 0.0) == last + 1
    assert [plain(switch_sides.argument_motion)(run, 0, moving(0.0, *va)) for va in ((2.0, -1.0), (0.0, -1.0))] == [
        2.0,
        -1.0,
    ]


@pytest.mark.cases(60)
def test_behind_a_point_is_the_next_piece_or_a_later_one(case: int, tmp_path: Path) -> None:
    """Assert it where the point is passed, where rounding has it just not be passed, and where others are passed too."""
    run, points = tabulated(tmp_path, np.random.default_rng([26, 7, case]), "linear", "hold")
    for k, (low, high) in enumerate(pairwise(points), start=1):
        for x, v, wanted in (
            (high, 1.0, k + 1),
            (low, -1.0, k - 1),
            (points[-1] + 1.0, 1.0, len(points)),
            (points[0] - 1.0, -1.0, 0),
        ):
            for side in (-np.inf, x, np.inf):
                plain(switch_sides.enter_piece)(run, 0, k)
                run.z[:3] = moving(float(np.nextafter(x, side)), v)
                assert plain(switch_sides.passed_into)(run, 0) == wanted


@pytest.mark.parametrize("outside", ["hold", "zero", "error"])
def test_a_last_value_at_a_point_alone_has_no_width(outside: str, tmp_path: Path) -> None:
    """Assert that a table of steps ends with a value at one point, which is left for what lies beyond, if anything does."""
    run, points = tabulated(tmp_path, np.random.default_rng(26), "previous", outside)
    count, find = int(run.places[1]), plain(switch_sides.find_table_piece)
    assert plain(switch_sides.last_piece_is_point)(run, 0)
    at_end = [find(run, 0, moving(points[-1], v), v) for v in (-1.0, 0.0, 1.0)]
    assert at_end == [count - 3, count - 2, count - 2 if outside == "error" else count - 1]
    linear, _ = tabulated(tmp_path, np.random.default_rng(26), "linear", outside)
    assert not plain(switch_sides.last_piece_is_point)(linear, 0)
