"""Lyapunov exponents against eigenvalues, multipliers in closed form, and published digits; and runs that have none."""

import math
import os
import subprocess
import sys
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.dynamics import growth
from xdynamics.dynamics.path import BLOCKS
from xdynamics.dynamics.path import RunPath as Along
from xdynamics.dynamics.tangents import (
    FEW,
    Exponents,
    LocalGrowth,
    _initial_tangent,
    _row_chunks,
    _scheme,
    exponents_of,
)
from xdynamics.evidence.diagnosing.chaos import exponents_in_words, lyapunov
from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines

MODELS = Path(__file__).parents[2] / "data" / "models"


def exponents(run: xr.Dataset, *, wanted: bool | int = True) -> xr.Dataset:
    """Return what `diagnose` says of growth, and of nothing else."""
    return xr.Dataset(lyapunov(run, None, exponent_count=wanted))


def diagnosis(run: xr.Dataset, **more: Any) -> xr.Dataset:
    """Diagnose a run without a further one."""
    return xd.diagnose(run, companion=False, **({"lyapunov": True} | more))


def marched(model: xd.Model, until: float, **asked: object) -> xr.Dataset:
    """March without samples, by dop853 unless something else is asked for."""
    return xd.simulate(model, until=until, force_samples="none", **({"method": "dop853", "rtol": 1e-9} | asked))


def agree(found: xr.Dataset, expected: np.ndarray | list[float], within: float) -> None:
    """Assert exponents within a bound, and within three of their uncertainties but for rounding."""
    off = np.abs(found.lyapunov_exponents.values - np.sort(expected)[::-1])
    assert (off <= within).all(), (off, within)
    assert (off <= 3.0 * found.lyapunov_uncertainty.values + 1e-7).all()


def flow(name: str, rates: Mapping[str, str], start: Mapping[str, float]) -> xd.Model:
    """Return a model of first-order states without units."""
    states = {one: {"unit": "1", "rate": text} for one, text in rates.items()}
    return xd.Model(name=name, time={"unit": "1"}, states=states, initial={k: repr(v) for k, v in start.items()})


def oscillator(force: str, start: tuple[float, float], **parameters: float) -> xd.Model:
    """Return x'' = force without units."""
    return xd.Model(
        name="oscillator",
        time={"unit": "1"},
        coordinates={"x": "1"},
        mass={"x": "1"},
        parameters={name: repr(value) for name, value in parameters.items()},
        forces={"all": {"x": force}},
        initial={"x": repr(start[0]), "v_x": repr(start[1])},
    )


LORENZ = {"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 8/3*z"}


# ------------------------------------------------------------------------------------------------------- the parts


def plain(function: Any) -> Any:
    """Return a compiled function as Python has it."""
    return getattr(function, "py_func", function)


def weighted(times: np.ndarray, grown: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return the mean of growth per time, weighted by sin(pi s)**2, of blocks with their middles between."""
    middles = (times[1:] + times[:-1]) / 2
    weights = np.where((middles > begin) & (middles < end), np.sin(np.pi * (middles - begin) / (end - begin)) ** 2, 0.0)
    found: np.ndarray = (weights @ grown) / (weights @ np.diff(times))
    return found


def test_exponents_are_means_behind_the_transient() -> None:
    """Assert values, order, each part of the uncertainties, and the growth of the start, of logarithms drawn at random."""
    rng, shift = np.random.default_rng(4), math.log(2.0**332)
    times = 3.0 + np.cumsum(rng.uniform(0.05, 0.15, 401))
    logs = rng.normal(0.0, 1.0, (400, 3)) * 0.01 + np.diff(times)[:, None] * [-0.5, 1.5, 0.25]
    powers, errors = np.zeros((400, 3), np.int64), rng.uniform(0.0, 1e-3, 400)
    powers[7, 1], powers[300, 2] = 2, -1
    whole = np.array([[3.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.1]])
    found = exponents_of(LocalGrowth(times, np.exp(logs), powers, errors, whole, 2, 500, 3))
    begin, end = float(times[0]), float(times[-1])
    first, grown = begin + 0.1 * (end - begin), logs + powers * shift
    values = weighted(times, grown, first, end)
    order = np.argsort(-values)
    assert values[0] < 0.0 < values[1]
    assert found.values == pytest.approx(values[order], rel=1e-10)
    assert (found.begin, found.pieces, found.variables) == (pytest.approx(first), 500, 3)
    edges = first + (end - first) * np.arange(17) / 16
    batches = np.stack([weighted(times, grown, *edges[k : k + 2]) for k in range(16)])
    halves = weighted(times, grown, edges[8], end) - weighted(times, grown, first, edges[8])
    integrated = weighted(times, errors[:, None], first, end)[0]
    doubts = np.sqrt(batches.var(axis=0, ddof=1) / 16 + halves**2 + integrated**2)
    assert found.uncertainties == pytest.approx(doubts[order], rel=1e-9)
    largest = np.linalg.svd(whole, compute_uv=False)[0]
    assert found.finite_time == pytest.approx((math.log(largest) + 2 * shift) / (end - begin), rel=1e-9)


def test_a_direction_that_is_gone_is_certain() -> None:
    """Assert minus infinity without an uncertainty, last, and no growth at all of a start that is forgotten whole."""
    times, factors = np.linspace(0.0, 40.0, 401), np.full((400, 2), math.exp(0.1))
    factors[200, 0] = 0.0
    with np.errstate(divide="ignore"):
        found = exponents_of(
            LocalGrowth(times, factors, np.zeros((400, 2), np.int64), np.zeros(400), np.zeros((2, 2)), 0, 400, 2)
        )
    assert found.values == pytest.approx([1.0, -np.inf])
    assert found.uncertainties == pytest.approx([0.0, 0.0], abs=1e-12)
    assert found.finite_time == -math.inf


@pytest.mark.parametrize(
    ("rate", "span", "noise", "time"),
    [
        (0.5, 20.0, 0.0, 2.0),
        (0.5, 14.0, 0.0, math.inf),
        (0.5, 15.4, 0.0, 2.0),
        (0.5, 20.0, 0.24, 2.0),
        (0.5, 20.0, 0.26, math.inf),
        (-0.5, 200.0, 0.0, math.inf),
    ],
)
def test_a_time_follows_from_growth_that_is_certain(
    rate: float, span: float, noise: float, time: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert exponents, units, and 1 over the largest: above twice its uncertainty, and grown a thousandfold behind the transient."""
    times = np.linspace(3.0, 3.0 + span, 3201)
    grown = np.exp(np.diff(times)[:, None] * [rate - 0.25, rate])
    local = LocalGrowth(
        times,
        grown,
        np.zeros(grown.shape, np.int64),
        np.full(3200, noise * span / 3200),
        np.diag([1.0, math.exp(0.3 * span)]),
        0,
        9,
        2,
    )
    monkeypatch.setattr("xdynamics.evidence.diagnosing.chaos.local_growth", lambda *_: local)
    run = xr.Dataset({"time": ("step", times, {"units": "h"})})
    found = exponents(run)
    assert found.lyapunov_exponents.values == pytest.approx([rate, rate - 0.25])
    assert found.lyapunov_uncertainty.values == pytest.approx([noise, noise], abs=1e-9)
    assert float(found.lyapunov_exponent) == pytest.approx(rate)
    assert float(found.lyapunov_time) == pytest.approx(time)
    assert float(found.finite_time_growth) == pytest.approx(0.3)
    assert {variable.attrs["units"] for name, variable in found.data_vars.items() if name != "lyapunov_time"} == {"h-1"}
    about = found.lyapunov_exponents.attrs
    assert (found.lyapunov_time.attrs["units"], about["transient_end"]) == ("h", pytest.approx(3.0 + span / 10))
    assert (about["pieces"], about["variables"], about["piece_tolerance"]) == (9, 2, 1e-8)
    said = list(exponents_in_words(found))
    assert said[0].startswith("lyapunov_exponents = ")
    assert said[1].startswith(
        f"lyapunov_time = {time:.3g} h" if time < math.inf else "lyapunov_time = inf: the largest"
    )
    assert said[2] == "finite_time_growth = 0.3 h-1, over the run's own time"
    pure = exponents(run.assign(time=("step", times, {"units": "1"})))
    assert {variable.attrs["units"] for variable in pure.data_vars.values()} == {"1"}
    assert [line.rpartition(" ")[2] for line in exponents_in_words(pure)][2] == "time"
    assert list(exponents_in_words(xr.Dataset())) == []


def test_vectors_are_taken_apart_as_q_and_r(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert Q R of rows, and 0 with an orthogonal unit vector in the place of one that depends on those before it."""
    monkeypatch.setattr(
        growth, "replace_vanished", plain(growth.replace_vanished)
    )  # what is compiled has no way in from Python
    rng = np.random.default_rng(1)
    vectors, upper = rng.normal(0.0, 3.0, (4, 5)), np.zeros((3, 3))
    given = vectors.copy()
    plain(growth.orthonormalise)(vectors, upper)
    assert vectors[0].tolist() == given[0].tolist()  # the state
    assert vectors[1:] @ vectors[1:].T == pytest.approx(np.eye(3), abs=1e-14)
    assert upper.T @ vectors[1:] == pytest.approx(given[1:], rel=1e-12)
    assert (np.diag(upper) > 0.0).all()
    for size, gone in ((1e-9, False), (1e-14, True)):
        upper[:], near = 0.0, np.array([[0.0] * 3, [1.0, 2.0, 2.0], [2.0, 4.0, 4.0], [0.0, 0.0, 1.0]])
        near[2, 0] += size * 6.0
        plain(growth.orthonormalise)(near, upper)
        assert bool(upper[1, 1] == 0.0) is gone
        assert near[1:] @ near[1:].T == pytest.approx(np.eye(3), abs=1e-6 if not gone else 1e-13)


def test_growth_is_noted_of_each_block_and_of_all() -> None:
    """Assert factors, powers of 2**332 above and below, and the product of all triangles."""
    tangent = _initial_tangent(np.eye(3), 2, 7.0)
    assert tangent.pace.tolist() == [7.0]
    assert tangent.state[1:] @ tangent.state[1:].T == pytest.approx(np.eye(2), abs=1e-14)
    assert (tangent.state[1:] != 0.0).all()
    grown = growth.Grown(np.ones((2, 2)), np.zeros((2, 2), np.int64), np.zeros(2))
    first, second = np.array([[2.0, 3.0], [0.0, 0.5]]), np.array([[4.0, -1.0], [0.0, 2.0**-200]])
    for block, upper in ((0, first), (1, second), (1, second)):
        tangent.upper[:] = upper
        plain(growth.add_growth)(tangent, grown, block)
    assert grown.factors.tolist() == [[2.0, 0.5], [16.0, 2.0**-68]]
    assert grown.exponents.tolist() == [[0, 0], [0, -1]]
    assert tangent.total == pytest.approx(second @ second @ first)
    tangent.upper[:] = np.array([[2.0**200, 0.0], [0.0, 2.0**-200]])
    for _ in range(2):
        plain(growth.add_growth)(tangent, grown, 0)
    assert grown.factors[0].tolist() == [2.0**69, 0.5 * 2.0**-68]
    assert grown.exponents[0].tolist() == [1, -1]
    assert int(tangent.exponents[0]) == 1
    assert float(tangent.total[0, 0]) == pytest.approx(32.0 * 2.0**68)
    small = _initial_tangent(np.eye(3), 2, 7.0)
    for _ in range(2):
        small.upper[:] = np.diag([2.0**-200, 2.0**-210])
        plain(growth.add_growth)(small, grown, 0)
    assert int(small.exponents[0]) == -1
    assert np.diag(small.total).tolist() == [2.0**-68, 2.0**-88]


def test_stages_and_ends_are_those_of_dop853() -> None:
    """Assert sums of weights, what a stage and an end are put together from, the error's norm, and products with derivatives."""
    scheme, rng = _scheme(10), np.random.default_rng(2)
    assert scheme.b.sum() == pytest.approx(1.0)
    assert scheme.a.sum(axis=1) == pytest.approx(scheme.c, abs=1e-14)
    assert (scheme.fifth.sum(), scheme.third.sum()) == pytest.approx((0.0, 0.0), abs=1e-14)
    tangent = _initial_tangent(np.eye(3), 2, 1.0)
    tangent.state[0] = rng.normal(size=3)
    tangent.slopes[:] = rng.normal(size=tangent.slopes.shape)
    error = plain(growth.finish_piece)(scheme, tangent, -0.5)
    assert tangent.end == pytest.approx(tangent.state - 0.5 * np.tensordot(scheme.b, tangent.slopes, 1))
    low, lower = (
        float(np.sum(np.tensordot(one, tangent.slopes[:, 1:], 1) ** 2)) for one in (scheme.fifth, scheme.third)
    )
    assert error == pytest.approx(0.5 * low / math.sqrt(low + 0.01 * lower))
    tangent.slopes[:] = 0.0
    assert plain(growth.finish_piece)(scheme, tangent, -0.5) == 0.0
    tangent.slopes[:] = rng.normal(size=tangent.slopes.shape)
    plain(growth.combine)(tangent.state, tangent.slopes, scheme.a, 7, 0.25, tangent.stage)
    assert tangent.stage == pytest.approx(tangent.state + 0.25 * np.tensordot(scheme.a[7, :7], tangent.slopes[:7], 1))
    entries, weights, e = np.array([[1, 2, 2], [0, 1, 2]]), np.array([2.0, 3.0, -1.0]), np.array([0.5, 4.0, 7.0, 9.0])
    before = tangent.slopes.copy()
    plain(growth.multiply_derivatives)(e, weights, entries, 1, tangent.stage, tangent.slopes, 4)
    matrix = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 12.0, -7.0]])
    assert tangent.slopes[4, 1:, 1:] == pytest.approx((tangent.stage[1:] @ matrix.T)[:, 1:])
    assert tangent.slopes[4, :, 0].tolist() == before[4, :, 0].tolist()
    assert tangent.slopes[4, 0].tolist() == before[4, 0].tolist()


@pytest.fixture
def in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put Python's own in the place of what is compiled, which has no way in from Python."""
    for name in ("replace_vanished", "orthonormalise", "add_growth"):
        monkeypatch.setattr(growth, name, plain(getattr(growth, name)))


@pytest.mark.usefixtures("in_python")
def test_pieces_are_as_long_as_their_errors_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert pieces that are tried, their halving and doubling, errors of those that are kept, and both ends that are none."""
    asked: list[tuple[float, float]] = []
    most = [0.3]

    def advance(_law: Any, _scheme: Any, tangent: Any, t: float, h: float) -> float:
        asked.append((t, h))
        tangent.end[:] = math.exp(h) * tangent.state
        return 1e-8 * h / most[0]

    monkeypatch.setattr(growth, "advance_piece", advance)
    carry: Any = plain(growth.carry)

    def carried(t: float, t1: float, pieces: int = 99, pace: float = 1.0) -> tuple[int, Any, Any]:
        asked.clear()
        tangent, grown = (
            _initial_tangent(np.eye(3), 2, pace),
            growth.Grown(np.ones((2, 2)), np.zeros((2, 2), np.int64), np.zeros(2)),
        )
        return carry(None, _scheme(pieces), tangent, grown, 1, t, t1), tangent, grown

    came, tangent, grown = carried(0.0, 1.0)
    assert came == growth.DONE
    assert asked == [(0.0, 1.0), (0.0, 0.5), (0.0, 0.25), (0.25, 0.25), (0.5, 0.25), (0.75, 0.25)]
    assert (int(tangent.pieces[0]), float(tangent.pace[0])) == (6, 0.25)
    assert grown.errors == pytest.approx([0.0, 1e-8 / 0.3])
    assert grown.factors == pytest.approx(np.array([[1.0, 1.0], [math.e, math.e]]))
    assert tangent.state[0] == pytest.approx(math.e * _initial_tangent(np.eye(3), 2, 1.0).state[0])
    assert [carried(0.0, 1.0, pieces)[0] for pieces in (5, 6)] == [growth.STIFF, growth.DONE]
    most[0] = 1e6
    assert carried(0.0, 0.7, pace=0.1)[0] == growth.DONE
    assert [h for _, h in asked] == pytest.approx([0.1, 0.2, 0.4])
    most[0] = math.nan
    assert carried(1.0, 1.0 + 1e-9)[0] == growth.LOST
    assert 15 < len(asked) < 30


def test_differences_along_vectors_are_the_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert products of a quadratic force's derivatives with every vector, each in units of its variable's size."""
    y, z, sizes = np.zeros(5), np.zeros(5), np.array([2.0, 0.5, 10.0])
    matrix = np.array([[1.0, -2.0, 0.5], [0.25, 3.0, -1.0]])

    def force(*_: Any) -> None:
        z[3:] = matrix @ y[:3] ** 2

    monkeypatch.setattr(growth, "strode_by", force)
    law = growth.GrowthLaw(0, 0, 0, 0, y, z, *([None] * 6), sizes, None, 1, 1e-4)  # type: ignore[arg-type]
    state = np.array([[1.0, -2.0, 3.0], [0.5, 0.25, -1.0], [1.0, 1.0, 2.0]])
    slopes = np.full((3, 3), 7.0)
    plain(growth.differences_at)(law, state, slopes)
    wanted = (2.0 * matrix * state[0]) @ (state[1:] * sizes).T / sizes[1:, None]
    assert slopes[1:, 1:] == pytest.approx(wanted.T, rel=1e-8)
    assert slopes[:, 0].tolist() == [7.0] * 3
    assert slopes[0].tolist() == [7.0] * 3


@pytest.mark.parametrize(("doubts", "time"), [([0.3, 0.01], math.inf), ([0.01, 0.3], 2.0)])
def test_a_time_is_of_the_largest_exponent(doubts: list[float], time: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that its own uncertainty counts, and how many vectors are carried for all, and for some."""
    asked: list[Any] = []
    monkeypatch.setattr("xdynamics.evidence.diagnosing.chaos.local_growth", lambda *given: asked.append(given[2]))
    found = Exponents(np.array([0.5, 0.1]), np.array(doubts), 0.4, 2.0, 9, 2)
    monkeypatch.setattr("xdynamics.dynamics.tangents.exponents_of", lambda _: found)
    run = xr.Dataset({"time": ("step", [0.0, 30.0], {"units": "s"})})
    assert [float(exponents(run, wanted=wanted).lyapunov_time) for wanted in (True, 1, 2)] == [time] * 3
    assert asked == [None, 1, 2]


def test_events_act_in_units_of_each_variable() -> None:
    """Assert the matrix of an event on vectors whose places are over the variables' sizes; the state stays."""
    tangent, sizes = _initial_tangent(np.eye(3), 2, 1.0), np.array([2.0, 0.5, 10.0])
    matrix, before = np.arange(9.0).reshape(3, 3) - 4.0, tangent.state.copy()
    law = growth.GrowthLaw(*([None] * 12), sizes, None, 1, 0.0)  # type: ignore[arg-type]
    plain(growth.apply_event_matrix)(law, matrix, tangent)
    assert tangent.state[1:] == pytest.approx((before[1:] * sizes) @ matrix.T / sizes)
    assert tangent.state[0].tolist() == before[0].tolist()


def test_rows_are_carried_a_part_at_a_time() -> None:
    """Assert that parts of 1,024 steps share the row between them, and leave none out."""
    count, each = 2500, np.arange(2500)
    rows = growth.Rows(
        np.arange(count + 1.0),
        each[:, None] * 1.0,
        each * 1.0,
        each[:, None] * 1.0,
        each[:, None],
        each,
        np.eye(2)[None],
        each,
        each,
    )
    parts = list(_row_chunks(rows))
    assert [len(part.times) - 1 for part in parts] == [1024, 1024, 452]
    assert [float(part.times[0]) for part in parts] == [0.0, 1024.0, 2048.0]
    assert all(
        part.states[0, 0]
        == part.regimes[0]
        == part.sides[0, 0]
        == part.pieces[0, 0]
        == part.jumps[0]
        == part.parts[0]
        == part.blocks[0]
        == part.times[0]
        for part in parts
    )
    assert all(len(part.states) == len(part.jumps) == len(part.blocks) == len(part.times) - 1 for part in parts)
    assert FEW == 16


def uneven_path(case: int) -> Along:
    """Rows of steps that are far shorter and far longer than a part of 2,048, some of them 0, as an event leaves them."""
    rng = np.random.default_rng(case)
    steps = 10.0 ** rng.uniform(-6.0, 0.0, 400)
    steps[rng.integers(1, 400, 9)] = 0.0
    path = Along(xr.Dataset(), None)
    vars(path)["times"] = 5.0 + np.concatenate([[0.0], np.cumsum(steps)])
    return path


@pytest.mark.parametrize("case", range(3))
def test_blocks_are_parts_of_the_time(case: int) -> None:
    """Assert that blocks follow each other from first to last, each step is in its own, and none is longer than a part."""
    path = uneven_path(case)
    times, (parts, counts, first), ends = path.times, path._time_blocks, path.block_times
    width, sizes = (times[-1] - times[0]) / BLOCKS, np.diff(path.times)
    assert (ends[0], ends[-1], len(ends) - 1) == (times[0], times[-1], int(counts.sum()))
    assert (np.diff(ends) > 0.0).mean() > 0.95
    assert parts.tolist() == [max(1, math.ceil(size / width)) for size in sizes]
    assert (ends[first] <= times[:-1] + 1e-12).all()
    assert (times[1:] <= ends[first + parts] + 1e-12).all()
    assert np.diff(ends).max() <= 2.0 * width
    long = sizes > width
    assert np.diff(ends)[first[long]] == pytest.approx((sizes / parts)[long], rel=1e-6)
    alone = [set(range(int(a), int(a + n))) for a, n in zip(first[long], parts[long], strict=True)]
    assert sum(map(len, alone)) == len(set().union(*alone)) == int(parts[long].sum())
    assert not set(first[~long].tolist()) & set().union(*alone)
    short = np.flatnonzero(~long)
    middles = times[:-1] + sizes / 2
    together = [(i, j) for i, j in pairwise(short.tolist()) if j == i + 1 and first[i] == first[j]]
    assert len(together) > 20
    assert all(int((middles[i] - times[0]) / width) == int((middles[j] - times[0]) / width) for i, j in together)


def test_steps_know_their_middles_sides_and_pieces() -> None:
    """Assert states in the middle of steps of x = t**3 mm, the side of a switch there, the piece of a table, and ranges."""
    model = xd.Model(
        name="cubic",
        coordinates={"x": "mm"},
        mass={"x": "1*kilogram"},
        forces={"push": {"x": "6e-3*newton*t/second + 0*newton*sign(x - edge) + 0*pull"}},
        drives={"pull": {"csv": "t [s],pull [N]\n0,0\n1,3\n1.5,4\n5,0\n", "table": "a.csv"}},
        initial={"x": "0 mm", "v_x": "0 mm s-1", "q": "0 g"},
        states={"q": {"unit": "g", "rate": "2*gram/second"}},
        parameters={"edge": "1.1 mm"},
    )
    path = Along(xd.simulate(model, method="rk4", step=0.25, until=2.0), None)
    middles, times = (path.times[1:] + path.times[:-1]) / 2, path.times
    for name, wanted in (("t", middles), ("x", 1e-3 * middles**3), ("v_x", 3e-3 * middles**2), ("q", 2e-3 * middles)):
        moving = np.diff(times) > 0.0
        assert path._middles[name][moving] == pytest.approx(wanted[moving], rel=1e-5, abs=1e-12), name
    assert path.sizes == pytest.approx([8e-3, 12e-3, 4e-3], rel=1e-6)
    assert path.states[-1] == pytest.approx([8e-3, 12e-3, 4e-3], rel=1e-6)
    assert path._switch_sides[:, 0].tolist() == np.sign(path._middles["x"] - 1.1e-3).tolist()
    assert {-1.0, 1.0} <= set(path._switch_sides[:, 0].tolist())
    assert path._table_pieces[:, 0].tolist() == np.searchsorted([0.0, 1.0, 1.5], middles, side="right").tolist()


# ------------------------------------------------------------------------------------------------- linear systems


@pytest.mark.cases(400)
def test_linear_systems_have_the_real_parts_of_their_eigenvalues(case: int) -> None:
    """Assert it for random matrices of two to four states, at rest in the origin and away from it."""
    random = np.random.default_rng(case)
    n = int(random.integers(2, 5))
    matrix = random.normal(size=(n, n))
    names = "abcd"[:n]
    parameters = {f"m_{i}{j}": repr(float(matrix[i, j])) for i in range(n) for j in range(n)}
    rates = {name: " + ".join(f"m_{i}{j}*{other}" for j, other in enumerate(names)) for i, name in enumerate(names)}
    start = random.normal(size=n) * (case % 2)
    states = {one: {"unit": "1", "rate": text} for one, text in rates.items()}
    model = xd.Model(
        name="linear",
        time={"unit": "1"},
        parameters=parameters,
        states=states,
        initial=dict(zip(names, map(repr, start.tolist()), strict=True)),
    )
    found = exponents(marched(model, 100.0, rtol=1e-6))
    real = np.sort(np.linalg.eigvals(matrix).real)[::-1]
    off = np.abs(found.lyapunov_exponents.values - real)
    assert (off <= found.lyapunov_uncertainty.values + 1e-6).all()
    assert float(found.lyapunov_exponents.sum()) == pytest.approx(float(np.trace(matrix)), abs=1e-6)
    apart = np.diff(real).min() < -0.3 if len(set(real.round(9))) == n else False
    assert off.max() < (0.002 if apart else 0.05)


@pytest.mark.parametrize(
    ("method", "asked"),
    [("forward_euler", 0.01), ("rk4", 0.05), ("implicit_midpoint", 0.05), ("radau_iia", None), ("dop853", None)],
)
def test_damped_oscillator(method: str, asked: float | None) -> None:
    """Assert -c/2m twice, whatever the method of the run: equations are linear."""
    model = oscillator("-k*x - c*v_x", (1.0, 0.0), k=4.0, c=0.3)
    run = marched(model, 100.0, method=method, rtol=None if asked else 1e-6, step=asked)
    found = exponents(run)
    agree(found, [-0.15, -0.15], 1e-6)
    assert found.lyapunov_exponent.attrs["units"] == "1"
    assert math.isinf(found.lyapunov_time)


@pytest.mark.dear
def test_saddle_at_rest_and_stiff_decay() -> None:
    """Assert both exponents of a saddle at which nothing moves, and of decays 30,000 times apart."""
    saddle = exponents(marched(oscillator("4*x", (0.0, 0.0)), 30.0))
    agree(saddle, [2.0, -2.0], 1e-7)
    assert float(saddle.lyapunov_time) == pytest.approx(0.5)
    assert float(saddle.finite_time_growth) == pytest.approx(2.0, abs=0.03)
    said = [*exponents_in_words(saddle)]
    assert said[1] == "lyapunov_time = 0.5"
    assert said[-1].startswith("finite_time_growth = ")
    assert {
        str(name): variable.attrs["role"] for name, variable in saddle.data_vars.items() if "lyapunov" in str(name)
    } == {
        "lyapunov_exponents": "diagnostic",
        "lyapunov_exponent": "diagnostic",
        "lyapunov_time": "diagnostic",
        "lyapunov_uncertainty": "error",
    }
    short = exponents(marched(oscillator("4*x", (0.0, 0.0)), 3.0))  # e**6 is less than a thousand
    assert math.isinf(short.lyapunov_time)
    assert any(
        line.startswith("lyapunov_time = inf: the largest exponent is not") for line in exponents_in_words(short)
    )
    stiff = flow("stiff", {"x": "-30000*(x - y)", "y": "-y"}, {"x": 1.0, "y": 1.0})
    found = exponents(marched(stiff, 20.0, method="radau_iia", rtol=1e-5))  # less than 1e-100 in each of 2,048 parts
    agree(found, [-1.0, -30000.0], 1e-2)
    assert float(found.lyapunov_exponents[0]) == pytest.approx(-1.0, abs=1e-6)


def test_growth_by_a_power_of_time_has_no_time() -> None:
    """Assert that no time follows from the shear of a pendulum's swings or a free flight, however short or long."""
    pendulum = xd.Model.from_toml(MODELS / "pendulum.toml")
    for until in (10.0, 30.0, 100.0):
        assert math.isinf(exponents(marched(pendulum, until)).lyapunov_time)
        assert math.isinf(exponents(marched(oscillator("-1", (0.0, 3.0)), until)).lyapunov_time)


def test_units_of_a_model_with_seconds() -> None:
    """Assert s-1 and s, and the words of the lines."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    found = diagnosis(marched(model, 20.0))
    assert {
        found[name].attrs["units"] for name in ("lyapunov_exponents", "lyapunov_uncertainty", "finite_time_growth")
    } == {"s-1"}
    assert found.lyapunov_time.attrs["units"] == "s"
    assert any(line.startswith("lyapunov_exponents = ") and line.endswith(" s-1") for line in diagnosis_lines(found))


# ---------------------------------------------------------------------------------------------- periodic solutions


def multipliers(stiffness: str, period: float) -> np.ndarray:
    """Return the multipliers of x'' = -stiffness(t) x by plain steps of order four."""
    code = compile(stiffness, "stiffness", "eval")

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        return np.stack([state[1], -eval(code, {"cos": math.cos, "t": t}) * state[0]])

    state, steps = np.eye(2), 2000
    h = period / steps
    for k in range(steps):
        t = k * h
        k1 = rates(t, state)
        k2 = rates(t + h / 2, state + h / 2 * k1)
        k3 = rates(t + h / 2, state + h / 2 * k2)
        k4 = rates(t + h, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.linalg.eigvals(state)


@pytest.mark.parametrize(("a", "q"), [(1.0, 0.4), (0.3, 0.5), (2.0, 0.3), (4.0, 1.5)])
def test_mathieu_at_rest(a: float, q: float) -> None:
    """Assert Floquet's exponents of Mathieu's equation about the solution 0, in its tongues and between them."""
    found = exponents(marched(oscillator("-(a - 2*q*cos(2*t))*x", (0.0, 0.0), a=a, q=q), 400.0))
    expected = np.log(np.abs(multipliers(f"{a} - {2 * q}*cos(2*t)", math.pi))) / math.pi
    agree(found, expected, 3e-4)


def test_orbit_in_an_unstable_invariant_line() -> None:
    """Assert the exponent of a pendulum's motion in a line that it leaves when pushed aside."""
    # x = cos(2 t) solves the first equation; the second, about y = 0, is then Mathieu's
    model = xd.Model(
        name="line",
        time={"unit": "1"},
        coordinates={"x": "1", "y": "1"},
        mass={"x": "1", "y": "1"},
        forces={"all": {"x": "-4*x", "y": "-(1 - 0.8*x)*y"}},
        initial={"x": "1", "v_x": "0", "y": "0", "v_y": "0"},
    )
    run = marched(model, 300.0)
    assert not run.y.values.any()
    found = exponents(run)
    expected = np.log(np.abs(multipliers("1 - 0.8*cos(2*t)", math.pi))).max() / math.pi
    assert expected > 0.15
    agree(found, [expected, 0.0, 0.0, -expected], 2e-4)
    assert float(found.lyapunov_exponent) > 10.0 * float(found.lyapunov_uncertainty[0])


def test_limit_cycle_has_the_mean_divergence() -> None:
    """Assert 0 and the mean of mu (1 - x**2) over a cycle of van der Pol's oscillator."""
    run = marched(oscillator("mu*(1 - x**2)*v_x - x", (2.0, 0.0), mu=1.5), 300.0)
    cycles = xd.diagnose(run, companion=False).cycle_time.values
    times = np.linspace(cycles[-11], cycles[-1], 20001)
    divergence = 1.5 * (1.0 - xd.sample(run, times).x.values ** 2)
    mean = float(np.trapezoid(divergence, times) / (times[-1] - times[0]))
    agree(exponents(run), [0.0, mean], 2e-4)


# ----------------------------------------------------------------------------------------- impacts, switches, resets


@pytest.mark.cases(100)
def test_ball_bouncing_in_step_with_a_table(case: int) -> None:
    """Assert the multipliers of the map from impact to impact (Holmes 1982, J. Sound Vib. 84, 173), in closed form."""
    random = np.random.default_rng(case)
    e, w, g = float(random.uniform(0.3, 0.85)), 2.0 * math.pi, 10.0
    speed = g / 2.0  # behind an impact, of flights that last a period of the table, 1 s
    slow = speed * (1.0 - e) / (1.0 + e)  # of the table there
    # stable where 0 < A w**2 sin(phase) < 2 (1 + e**2) g/(1 + e)**2
    steep = float(random.uniform(0.05, 0.9)) * 2.0 * (1.0 + e**2) * g / (1.0 + e) ** 2
    amplitude, phase = math.hypot(slow / w, steep / w**2), math.atan2(steep / w**2, slow / w)
    height = amplitude * math.sin(phase) + speed / 2.0 - g / 8.0
    model = xd.Model(
        name="table",
        coordinates={"y": "m"},
        mass={"y": "m"},
        parameters={
            "m": "1 kg",
            "g": f"{g!r} m s-2",
            "A": f"{amplitude!r} m",
            "w": f"{w!r} s-1",
            "p": repr(phase),
            "e": repr(e),
        },
        forces={"gravity": {"potential": "m*g*y"}},
        contacts={"table": {"gap": "y - A*sin(w*t + p)", "restitution": "e"}},
        initial={"t": "0.5 s", "y": f"{height!r} m", "v_y": "0 m s-1"},
    )
    run = marched(model, 100.5)
    assert 98 <= run.sizes["event"] <= 102
    dt = 1.0 / (speed + slow)
    matrix = np.array([[1.0, dt], [-(1 + e) * steep, -(1 + e) * steep * dt - e + e * g * dt]])
    size = np.abs(np.linalg.eigvals(matrix))
    found = exponents(run)
    off = np.abs(found.lyapunov_exponents.values - np.sort(np.log(size))[::-1])
    assert (off <= 3.0 * found.lyapunov_uncertainty.values + 1e-6).all()
    assert off.max() < 0.05
    assert float(found.lyapunov_exponents.sum()) == pytest.approx(2.0 * math.log(e), abs=0.01)


@pytest.mark.cases(100)
def test_switching_back_and_forth(case: int) -> None:
    """Assert 0 for x' = a x -+ b between two bounds: the switches take what the flow adds (saltation f+/f-)."""
    random = np.random.default_rng(case)
    a, b, h = float(random.uniform(-0.9, 0.9)), 1.0, float(random.uniform(0.2, 1.0))
    states = {"x": {"unit": "1", "rate": "a*x + push"}, "push": {"unit": "1", "rate": "0"}}
    events = {
        "top": {"function": "x - h", "direction": "rising", "action": "reset", "set": {"push": "-b"}},
        "bottom": {"function": "x + h", "direction": "falling", "action": "reset", "set": {"push": "b"}},
    }
    parameters = {"a": repr(a), "b": repr(b), "h": repr(h)}
    model = xd.Model(
        name="relay",
        time={"unit": "1"},
        parameters=parameters,
        states=states,
        events=events,
        initial={"x": repr(float(random.uniform(-0.9, 0.9)) * h), "push": "1"},
    )
    found = exponents(marched(model, 60.0))
    assert abs(float(found.lyapunov_exponents[0])) <= 3.0 * float(found.lyapunov_uncertainty[0]) + 1e-6
    assert abs(float(found.lyapunov_exponents[0])) < 0.01
    assert float(found.lyapunov_exponents[1]) == -math.inf  # of `push`, which every reset sets anew
    assert float(found.lyapunov_uncertainty[1]) == 0.0


@pytest.mark.cases(100)
def test_ball_that_is_kicked(case: int) -> None:
    """Assert 0 and log(e) over the flight's time of a ball whose reset makes e v + k of its speed v."""
    random = np.random.default_rng(case)
    e, kick = float(random.uniform(0.2, 0.9)), float(random.uniform(1.0, 5.0))
    speed = kick / (1.0 - e)
    model = xd.Model(
        name="kicked",
        coordinates={"y": "m"},
        mass={"y": "m"},
        parameters={"m": "1 kg", "g": "10 m s-2", "e": repr(e), "k": f"{kick!r} m s-1"},
        forces={"gravity": {"potential": "m*g*y"}},
        events={
            "floor": {
                "function": "y",
                "direction": "falling",
                "action": "reset",
                "set": {"y": "0*metre", "v_y": "k - e*v_y"},
            }
        },
        initial={"y": f"{speed**2 / 20.0!r} m", "v_y": "0 m s-1"},
    )
    flight = 2.0 * speed / 10.0
    found = exponents(marched(model, 60.0 * flight))
    off = np.abs(found.lyapunov_exponents.values - [0.0, math.log(e) / flight])
    assert (off <= 3.0 * found.lyapunov_uncertainty.values + 1e-6).all()
    assert off.max() * flight < 0.02


def test_piecewise_springs_and_relays() -> None:
    """Assert -c/m as the sum where a spring bends, and that a relay's swings grow like none."""
    bent = exponents(marched(oscillator("-x - 3*max(x, 0) - 0.2*v_x + cos(1.3*t)", (1.0, 0.0)), 200.0))
    assert float(bent.lyapunov_exponents.sum()) == pytest.approx(-0.2, abs=1e-6)
    relay = exponents(xd.simulate(xd.Model.from_toml(MODELS / "relay_oscillator.toml"), until=200.0))
    assert float(relay.lyapunov_exponents.sum()) == pytest.approx(0.0, abs=1e-6)
    assert abs(float(relay.lyapunov_exponent)) < 2.0 * float(relay.lyapunov_uncertainty[0])
    assert math.isinf(relay.lyapunov_time)


def test_steps_from_switch_to_switch() -> None:
    """Assert the damping of the side that a step is on, though it begins and ends at the switch."""
    run = marched(oscillator("where(x > 0, -1 - 0.3*v_x, 1)", (1.0, 0.0)), 9.0, rtol=1e-4)
    rows = run.event_row_before.values[1:] - run.event_row_after.values[:-1]
    assert (rows == 1).any()
    begin, edges = 0.9, [0.0, *run.event_time.values.tolist(), 9.0]
    parts = np.clip((np.array(edges) - begin) / (9.0 - begin), 0.0, 1.0)
    weights = np.diff(parts - np.sin(2.0 * math.pi * parts) / (2.0 * math.pi))  # of sin(pi s)**2, in all 1
    assert float(exponents(run).lyapunov_exponents.sum()) == pytest.approx(-0.3 * weights[::2].sum(), abs=1e-4)


def shaken(case: int) -> xd.Model:
    """Return two driven bodies with a mass matrix that moves, and one kind of event."""
    random = np.random.default_rng(case)
    ranges = {
        "a": (0.5, 2),
        "b": (0, 1),
        "c": (0, 0.3),
        "d": (0.2, 1),
        "w": (1, 3),
        "f": (1, 2.5),
        "e": (0.5, 0.95),
        "g": (0.2, 0.6),
        "j": (0.1, 0.4),
    }
    force = {"x": "-a*x - b*x**3 - d*(x - y) - c*v_x**3 + f*cos(w*t)", "y": "-y - d*(y - x) - c*v_y"}
    hit = {"function": "x - 0.4 + 0.1*y*y", "direction": "rising", "action": "reset"}
    event: dict[str, Any] = (
        {"contacts": {"wall": {"gap": "0.4 - x + 0.2*y", "restitution": "e"}}},
        {},
        {"events": {"hit": hit | {"set": {"v_x": "-e*v_x + 0.1*y", "v_y": "v_y - 0.2*v_x"}}}},
        {},
    )[case % 4]
    force["x"] += " - g*abs(x - 0.1*y)" if case % 4 == 1 else ""
    force["y"] += " - g*sign(x + 0.2)" if case % 4 == 3 else ""
    return xd.Model(
        name="shaken",
        time={"unit": "1"},
        coordinates={"x": "1", "y": "1"},
        mass={"matrix": [["1.5 + j*cos(y)", "j"], ["j", "1"]]},
        forces={"all": force},
        parameters={name: repr(float(random.uniform(*ends))) for name, ends in ranges.items()},
        initial={name: repr(float(random.uniform(-0.5, 0.2))) for name in ("x", "y", "v_x", "v_y")},
        **event,
    )


@pytest.mark.dear
@pytest.mark.cases(200)
def test_growth_is_that_of_runs_that_start_beside(case: int) -> None:
    """Assert the growth over impacts, resets, kinks and jumps of forces against differences of whole runs."""
    model, names = shaken(case), ("x", "y", "v_x", "v_y")
    run = marched(model, 8.0, rtol=1e-11, atol=1e-12)
    ranges = np.array([float(np.ptp(run[name].values)) for name in names])
    grown = []
    for part in (1e-6, 3e-6):
        columns = []
        for name, size in zip(names, (part * ranges).tolist(), strict=True):
            ends = []
            for moved in (size, -size):
                beside = model.replace(initial={name: repr(float(run[name][0]) + moved)})
                end = marched(beside, 8.0, rtol=1e-11, atol=1e-12).isel(step=-1)
                ends.append([float(end[other]) for other in names])
            columns.append(np.subtract(*ends) / (2.0 * part) / ranges)
        grown.append(math.log(np.linalg.norm(np.array(columns), 2)))
    found = float(exponents(run).finite_time_growth) * 8.0
    assert abs(found - grown[0]) <= 1e-6 + 10.0 * abs(grown[0] - grown[1])


def test_regimes_with_other_forces() -> None:
    """Assert 0 and 0 for a speed that two regimes drive up and down between bounds, though each alone grows it."""
    model = xd.Model(
        name="thermostat",
        time={"unit": "1"},
        coordinates={"x": "1"},
        mass={"x": "1"},
        forces={"gain": {"x": "0.4*v_x"}, "up": {"x": "1"}, "down": {"x": "-1"}},
        regimes={"rise": {"forces": ["gain", "up"]}, "fall": {"forces": ["gain", "down"]}},
        events={
            "top": {"function": "v_x - 0.5", "direction": "rising", "action": "switch", "to": "fall"},
            "bottom": {"function": "v_x + 0.5", "direction": "falling", "action": "switch", "to": "rise"},
        },
        initial={"x": "0", "v_x": "0"},
    )
    found = exponents(marched(model, 200.0))
    values, doubts = found.lyapunov_exponents.values, found.lyapunov_uncertainty.values
    assert (np.abs(values) <= 2.0 * doubts + 1e-6).all()
    assert (np.abs(values) < 0.02).all()


# ------------------------------------------------------------------------------------------------ published digits

PUBLISHED = {  # J. C. Sprott, Chaos and Time-Series Analysis (2003), appendix A
    "lorenz": (flow("Lorenz", LORENZ, {"x": 1.0, "y": 1.0, "z": 1.0}), 1000.0, (0.9056, 0.0, -14.5723)),
    "roessler": (
        flow("Rössler", {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"}, {"x": -9.0, "y": 0.0, "z": 0.0}),
        3000.0,
        (0.0714, 0.0, -5.3943),
    ),
    "ueda": (oscillator("-x**3 - 0.05*v_x + 7.5*sin(t)", (2.5, 0.0)), 3000.0, (0.1034, -0.1534)),
    "duffing": (oscillator("x - x**3 - 0.25*v_x + 0.4*cos(t)", (0.2, 0.0)), 3000.0, (0.1572, -0.4072)),
    "jerk": (
        flow("jerk", {"x": "y", "y": "z", "z": "y**2 - x - 2.017*z"}, {"x": 0.0, "y": 0.0, "z": 1.0}),
        3000.0,
        (0.0551, 0.0, -2.0721),
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_exponents(name: str) -> None:
    """Assert published digits within three uncertainties, which are small, and the sum of all by the divergence."""
    model, until, expected = PUBLISHED[name]
    found = exponents(marched(model, until))
    values, doubts = found.lyapunov_exponents.values, found.lyapunov_uncertainty.values
    assert (np.abs(values - expected) <= 3.0 * doubts).all()
    assert (doubts <= 0.02 + 0.005 * np.abs(expected)).all()
    assert doubts[0] < 0.2 * expected[0]
    if name != "roessler":  # whose divergence is none of all places
        assert values.sum() == pytest.approx(sum(expected), abs=2e-4)
    assert float(found.lyapunov_time) == 1.0 / values[0]
    assert float(found.finite_time_growth) == pytest.approx(values[0], abs=0.05 + 5.0 / until)


def test_henon_heiles() -> None:
    """Assert pairs of opposite exponents, a positive one in the chaotic sea at E = 1/8 and none on a torus."""
    model = xd.Model(
        name="Hénon-Heiles",
        time={"unit": "1"},
        coordinates={"x": "1", "y": "1"},
        mass={"x": "1", "y": "1"},
        forces={"all": {"potential": "(x**2 + y**2)/2 + x**2*y - y**3/3"}},
        initial={"x": "0", "y": "-0.25", "v_x": "0.42081", "v_y": "0"},
    )
    chaotic = exponents(marched(model, 20000.0))  # long enough for any orbit of the sea
    calm = exponents(marched(model.replace(initial={"y": "0.55", "v_x": "0.2417"}), 4000.0))
    for found in (chaotic, calm):
        values, doubts = found.lyapunov_exponents.values, found.lyapunov_uncertainty.values
        assert (np.abs(values + values[::-1]) < 1e-4).all()
        assert (np.abs(values[1:3]) <= 2.0 * doubts[1:3] + 1e-4).all()
    assert 0.03 < float(chaotic.lyapunov_exponent) < 0.07
    assert float(chaotic.lyapunov_exponent) > 3.0 * float(chaotic.lyapunov_uncertainty[0])
    assert abs(float(calm.lyapunov_exponent)) <= 2.0 * float(calm.lyapunov_uncertainty[0]) < 0.01
    assert math.isinf(calm.lyapunov_time)


# --------------------------------------------------------------------------------------------------- the run itself


def test_archive_says_the_same(tmp_path: Path) -> None:
    """Assert the same numbers of a run and its archive, the rules in words, and that the diagnosis is kept."""
    run = marched(flow("Lorenz", LORENZ, {"x": 1.0, "y": 1.0, "z": 1.0}), 50.0)
    xd.save(run, tmp_path / "lorenz.nc")
    fresh, opened = diagnosis(run), diagnosis(xd.open_run(tmp_path / "lorenz.nc"))
    xr.testing.assert_equal(fresh, opened)
    about = fresh.lyapunov_exponents.attrs
    assert "Benettin" in about["rule"]
    assert "first tenth" in about["transient"]
    assert about["transient_end"] == 5.0
    assert "standard error" in fresh.lyapunov_uncertainty.attrs["long_name"]
    xd.save(fresh, tmp_path / "diagnosis.nc")
    xr.testing.assert_equal(xr.open_dataset(tmp_path / "diagnosis.nc"), fresh)


PLAIN = """
import numpy as np, xdynamics as xd
rates = {"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 8/3*z"}
model = xd.Model(name="L", time={"unit": "1"}, states={k: {"unit": "1", "rate": v} for k, v in rates.items()},
                 initial={"x": "1", "y": "1", "z": "1"})
found = xd.diagnose(xd.simulate(model, method="rk4", step=0.02, until=1.0), companion=False, lyapunov=1)
print(*(float(found[one].values.ravel()[0]).hex() for one in ("lyapunov_exponents", "lyapunov_uncertainty", "finite_time_growth")))
"""


@pytest.mark.dear
def test_the_same_bits_without_a_compiler() -> None:
    """Assert that compiled code and Python find the same numbers, to the bit."""
    said = [
        subprocess.run(
            [sys.executable, "-c", PLAIN], env=os.environ | more, capture_output=True, text=True, check=True
        ).stdout
        for more in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert said[0].count("0x1.") == 3
    assert said[0] == said[1]


def test_figure_of_exponents() -> None:
    """Assert every exponent with its digits in a panel, and the rule of the transient below."""
    found = diagnosis(marched(flow("Lorenz", LORENZ, {"x": 1.0, "y": 1.0, "z": 1.0}), 50.0))
    figure = xd.plot(found)
    axes = figure.axes[0]
    assert [text.get_text().split(" ± ")[1] for text in axes.texts] == [
        line.split(" ± ")[1].split(",")[0] for line in _parts(found)
    ]
    assert axes.get_ylabel() == "Lyapunov exponent"
    assert "the first tenth" in figure._supxlabel.get_text()


def _parts(found: xr.Dataset) -> list[str]:
    line = next(one for one in diagnosis_lines(found) if one.startswith("lyapunov_exponents = "))
    return line.removeprefix("lyapunov_exponents = ").split(", ")


def test_some_of_the_largest() -> None:
    """Assert that the largest exponents are those of all."""
    run = marched(flow("Lorenz", LORENZ, {"x": 1.0, "y": 1.0, "z": 1.0}), 100.0)
    every, two = exponents(run), exponents(run, wanted=2)
    assert two.sizes["exponent"] == 2
    assert two.lyapunov_exponents.values == pytest.approx(every.lyapunov_exponents.values[:2], rel=1e-6, abs=1e-6)


@pytest.mark.dear
def test_force_in_python() -> None:
    """Assert that a force without derivatives is followed by differences."""

    def push(x: float, v_x: float) -> float:
        return -4.0 * x - 0.3 * v_x

    written = xd.Model(
        name="python",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces={"all": {"x": push}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    run = marched(written, 60.0, rtol=1e-8)
    agree(diagnosis(run, functions={"push": push}), [-0.15, -0.15], 1e-5)


def test_drives_are_followed() -> None:
    """Assert -c/2m beside a force from a table in time, and from one of the coordinate the slope that it has there."""
    csv = "t [s],push [N]\n0,0\n1,1\n2,-1\n3,0.5\n100,0\n"
    spring = "x [m],pull [N]\n-5,20\n0,0\n5,-20\n"
    model = xd.Model(
        name="driven",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        parameters={"c": "0.3 kg s-1"},
        drives={
            "push": {"table": "push.csv", "csv": csv},
            "pull": {"table": "pull.csv", "csv": spring, "argument": "x"},
        },
        forces={"push": {"x": "push"}, "pull": {"x": "pull"}, "drag": {"x": "-c*v_x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    agree(exponents(marched(model, 90.0)), [-0.15, -0.15], 1e-5)


def test_events_that_do_nothing_and_many_rows() -> None:
    """Assert that recorded crossings change nothing, and that short steps are taken together."""
    watched = xd.Model(
        name="watched",
        time={"unit": "1"},
        coordinates={"x": "1"},
        mass={"x": "1"},
        forces={"all": {"x": "-4*x - 0.3*v_x"}},
        events={"zero": {"function": "x", "action": "record"}},
        initial={"x": "1", "v_x": "0"},
    )
    run = marched(watched, 50.0, method="rk4", step=0.005, rtol=None)
    assert run.sizes["event"] > 20
    agree(exponents(run), [-0.15, -0.15], 1e-5)


# ------------------------------------------------------------------------------------------------------- and refusals


@pytest.mark.parametrize(
    ("file", "until", "said"),
    [
        ("moving_table.toml", 0.5, "contact 'table' is not open from t = 0 on"),
        ("rocking_block.toml", 0.5, "is not open from t = "),
        ("stick_slip_belt.toml", 2.0, "friction element 'belt' slips or sticks all the time"),
    ],
)
def test_runs_without_variational_equations(file: str, until: float, said: str) -> None:
    """Assert that what cannot be followed is named, and is not 0."""
    run = xd.simulate(xd.Model.from_toml(MODELS / file), until=until)
    with pytest.raises(xd.InputError, match=said):
        exponents(run)


def test_impulses_over_whole_steps_are_refused() -> None:
    """Assert that moreau_jean's contacts are named."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), method="moreau_jean", step=0.01, until=0.3)
    with pytest.raises(xd.InputError, match="moreau_jean locates no impacts"):
        exponents(run)


@pytest.mark.parametrize("wanted", [0, -1, 1.5, "all"])
def test_counts_that_are_none(wanted: object) -> None:
    """Assert that a count of exponents is one."""
    run = marched(oscillator("-x", (1.0, 0.0)), 5.0)
    with pytest.raises(xd.InputError, match="needs true for all exponents, or how many of the largest"):
        diagnosis(run, lyapunov=wanted)
