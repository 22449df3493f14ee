"""The parts of a budget by themselves, on numbers and functions made for them, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import chi2, norm

import xdynamics as xd
from xdynamics.budgeting import physical
from xdynamics.budgeting.budget import _doubt_slopes
from xdynamics.budgeting.budget_dataset import _check_draw_settings, _checked_declared, draw_variables, term_variables
from xdynamics.budgeting.budget_summary import budget_lines
from xdynamics.budgeting.fit_summary import fit_lines as fit_in_lines
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.montecarlo import (
    ADEQUATE,
    MAX_DRAWS,
    NOT_ADEQUATE,
    NOT_CHECKED,
    DrawStatistics,
    Propagation,
    draw_statistics,
    draw_until_known,
    end_tolerance_of,
    judge_linear,
)
from xdynamics.budgeting.multistart import Loss, drawn_starts, search_from_start, search_growing, searches
from xdynamics.budgeting.numerical import Estimate, LevelComparison
from xdynamics.budgeting.term import Declared, Term
from xdynamics.model import toml
from xdynamics.model.parts import Fitted
from xdynamics.units import parse_unit

EPS = float(np.finfo(float).eps)

# ---------------------------------------------------------------------------------------------------------------- draws


@pytest.mark.cases(240)
def test_intervals_are_windows_of_ordered_draws(case: int) -> None:
    """Assert the narrowest of all windows, the middle one by JCGM 101:2008, 7.7.2, and moments of random draws."""
    rng = np.random.default_rng(case)
    count, coverage = int(rng.integers(40, 90)), float(rng.uniform(0.3, 0.95))
    values = rng.standard_gamma(2.0, count)
    found, ordered, held = draw_statistics(values, coverage), np.sort(values).tolist(), round(coverage * count)
    windows = list(zip(ordered, ordered[held:], strict=False))
    assert found.shortest == min(windows, key=lambda one: one[1] - one[0])
    assert found.symmetric == windows[math.ceil((count - held) / 2) - 1]
    assert found.mean == pytest.approx(sum(ordered) / count)
    assert found.standard == pytest.approx(math.sqrt(sum((one - found.mean) ** 2 for one in ordered) / (count - 1)))
    parts = [np.std(one, ddof=1) for one in np.array_split(values, 20)]
    assert found.standard_doubt == pytest.approx(np.std(parts, ddof=1) / math.sqrt(20))


def test_an_interval_holds_one_draw_at_least_and_leaves_one_out() -> None:
    """Assert the least and the most that an interval may hold of 40 draws."""
    row = np.arange(40.0)
    assert (draw_statistics(row, 0.02).shortest, draw_statistics(row, 0.02).symmetric) == ((0.0, 1.0), (19.0, 20.0))
    assert (draw_statistics(row, 0.98).shortest, draw_statistics(row, 0.98).symmetric) == ((0.0, 39.0), (0.0, 39.0))
    for coverage in (0.01, 0.99):
        with pytest.raises(xd.InputError, match="too few"):
            draw_statistics(row, coverage)


def test_ends_of_intervals_are_as_sure_as_order_statistics() -> None:
    """Assert half of what lies between the draws a binomial deviation, and two of them, about each end; infinite beyond all."""
    even = draw_statistics(np.arange(10_000.0), 0.5)  # 2,500 and 7,500, each give or take sqrt(10,000/4*3/4) = 43.3
    assert (even.ends_doubt, even.ends_reach) == (44.0, 87.0)
    steep = draw_statistics(
        np.concatenate([np.arange(5000.0), 5000.0 + 3.0 * np.arange(5000.0)]), 0.5
    )  # the upper end is worse
    assert steep.ends_doubt == 3 * 44.0
    assert draw_statistics(np.arange(100.0), 0.88).ends_reach == 5.0  # from the 89th to the 99th
    assert (draw_statistics(np.arange(100.0), 0.9).ends_doubt, draw_statistics(np.arange(100.0), 0.9).ends_reach) == (
        3.0,
        math.inf,
    )


@pytest.mark.parametrize(
    ("low", "high", "reach", "verdict", "apart"),
    [
        (-0.25, 0.25, 0.25, ADEQUATE, 0.25),  # 0.5 is the tolerance of a standard uncertainty of 5.5
        (-0.25, 0.25, 0.26, NOT_CHECKED, 0.25),
        (-0.1, 1.25, 0.5, NOT_CHECKED, 1.25),
        (-1.26, 0.1, 0.5, NOT_ADEQUATE, 1.26),
        (0.0, 0.6, 0.0, NOT_ADEQUATE, 0.6),
        (-0.2, 0.1, math.inf, NOT_CHECKED, 0.2),
    ],
)
def test_a_linear_interval_is_held_against_both_ends(
    low: float, high: float, reach: float, verdict: int, apart: float
) -> None:
    """Assert the larger distance, and what it is beside the tolerance and one and a half times the reach of chance."""
    assert judge_linear(0.0, 0.0, DrawStatistics(0.0, 5.5, (0.0, 0.0), (low, high), 0.0, 0.0, reach), 0.95) == (
        verdict,
        apart,
    )


def test_a_linear_interval_has_the_quantile_of_its_coverage() -> None:
    """Assert value plus and minus 1.645 standard uncertainties at 90 %, and that what is certain is adequate."""
    found = DrawStatistics(0.0, 2.0, (0.0, 0.0), (7.0 - 2 * 1.6448536, 7.0 + 2 * 1.6448536 + 0.25), 0.0, 0.0, 0.0)
    assert judge_linear(7.0, 2.0, found, 0.9) == (ADEQUATE, pytest.approx(0.25, abs=1e-6))
    assert judge_linear(7.0, 2.0, found, 0.95)[1] == pytest.approx(2 * (1.9599640 - 1.6448536), abs=1e-6)
    still = DrawStatistics(7.0, 0.0, (7.0, 7.0), (7.0, 7.0), 0.0, 0.0, 0.0)
    assert judge_linear(7.0, 0.0, still, 0.95) == (ADEQUATE, 0.0)
    assert judge_linear(7.5, 0.0, still, 0.95)[0] == NOT_CHECKED


def propagated(model: Any, values: Any = None, added: Any = ()) -> Propagation:
    """Draws of a number that is 7 where nothing but what is added is uncertain; else those that are given."""
    measurand: Any = SimpleNamespace(
        model=model,
        target=SimpleNamespace(description="s at t = 1 s"),
        seed=5,
        numbers=lambda _: SimpleNamespace(values=values),
    )
    return Propagation(measurand, [*model.uncertain], 7.0, added)


def test_what_is_added_to_draws_is_normal() -> None:
    """Assert sizes and stream of terms that are no inputs, on top of the run's own number or of each draw."""
    points = norm.ppf(np.random.default_rng([5, 1]).random((40, 2)))
    wanted = 0.5 * points[:, 0] + 0.25 * points[:, 1]
    assert propagated(standing(), added=[0.5, 0.25]).values(40) == pytest.approx(7.0 + wanted, rel=1e-12)
    uncertain, marched = through("a", a="1 ± 0.1 g"), np.linspace(2.0, 3.0, 40)
    assert propagated(uncertain, marched, [0.5, 0.25]).values(40) == pytest.approx(marched + wanted, rel=1e-12)
    assert propagated(uncertain, marched).values(40).tolist() == marched.tolist()
    with pytest.raises(xd.InputError, match="nothing in the model has an uncertainty"):
        propagated(standing()).values(40)
    with pytest.raises(xd.InputError, match="s at t = 1 s does not exist in 3 of 40 draws"):
        propagated(uncertain, np.where(np.arange(40) < 3, np.nan, marched)).values(40)


def test_draws_are_doubled_until_the_ends_are_known() -> None:
    """Assert the first number of draws that does, the last that is tried, and what is said where it does not."""
    tried: list[int] = []

    def even(draws: int) -> np.ndarray:
        tried.append(draws)
        return np.arange(100.0) if draws >= MAX_DRAWS // 2 else np.linspace(0.0, 1.0, draws)

    source: Any = SimpleNamespace(values=even)
    doubts = {draws: draw_statistics(np.linspace(0.0, 1.0, draws), 0.5).ends_doubt for draws in (100, 200, 400, 800)}
    for draws, doubt in doubts.items():
        found, count = draw_until_known(source, 100, 0.5, doubt)
        assert (count, found.ends_doubt) == (draws, doubt)
    assert tried == [100, 100, 200, 100, 200, 400, 100, 200, 400, 800]
    tried.clear()
    with pytest.raises(xd.InputError, match="4194304 draws leave the ends of the interval uncertain by 5, and 4.5 is"):
        draw_until_known(source, MAX_DRAWS // 2, 0.5, 4.5)
    assert tried == [MAX_DRAWS // 2, MAX_DRAWS]


def test_how_well_ends_are_to_be_known() -> None:
    """Assert a standard uncertainty in the number's unit from a size and its level, and what is no such size."""
    unit, target = parse_unit("mm"), Target("y", 1.0)
    for told, wanted in (
        ("2 m", 2000 / 1.9599640),
        ("2 m at 90 %", 2000 / 1.6448536),
        ("5 um at 50%", 5e-3 / 0.6744898),
    ):
        assert end_tolerance_of(told, unit, target, 0.95) == pytest.approx(wanted, rel=1e-7)
    for told in ("2 s", "0 m", "-1 m", "2 m at 0 %", "2 m at 100 %", "2 m at most"):
        with pytest.raises(xd.InputError, match="needs a positive size of y at t = 1 s, like '1 mm at 95 %'"):
            end_tolerance_of(told, unit, target, 0.95)


# --------------------------------------------------------------------------------------------------------------- tables


def copies(number: Callable[[np.ndarray], float], unit: str = "mN") -> Any:
    """Copies of a run whose number is a function of the change of its table."""
    table = SimpleNamespace(value_unit=parse_unit(unit))
    seeded = SimpleNamespace(seed=3)
    return SimpleNamespace(
        name="f", table=table, measurand=seeded, number=number, odd=lambda one: (number(one) - number(-one)) / 2.0
    )


@pytest.mark.parametrize(("bend", "doubtful"), [(0.0, False), (0.01, False), (0.05, True)])
def test_independent_rows_add_their_squares(bend: float, doubtful: bool) -> None:
    """Assert size, bound and doubt of rows with slopes of their own, of which drawn tables are a little off by a square."""
    weights, sizes = np.array([1.0, -2.0, 0.5, 4.0]), np.array([0.1, 0.3, 0.0, 0.2])

    def number(change: np.ndarray) -> float:
        return 5.0 + float(weights @ change) + bend * float(weights @ change) ** 2

    found = physical.independent_rows_term(copies(number), sizes)
    assert found.standard == pytest.approx(math.sqrt(0.01 + 0.36 + 0.64))
    assert found.bound == pytest.approx(2.0 * found.standard)
    points = norm.ppf(np.random.default_rng(3).random((32, 4)))[:4] * sizes @ weights
    off = bend * math.sqrt(np.mean(points**4))
    assert found.standard_doubt == pytest.approx(off if doubtful else 0.0, abs=1e-9)
    assert "slopes by all 3; 8 tables with every row drawn" in found.rule


def test_rows_that_are_not_in_proportion_are_drawn() -> None:
    """Assert the root of the mean square of 64 tables, and an eighth of it as its doubt; more than 256 rows are drawn too."""
    sizes, slope = np.full(3, 0.5), np.array([1.0, 1.0, 2.0])
    points = norm.ppf(np.random.default_rng(3).random((32, 3))) * sizes

    def number(change: np.ndarray) -> float:
        return float(slope @ change) ** 2 - 3.0

    found = physical.independent_rows_term(copies(number), sizes)
    assert found.standard == pytest.approx(math.sqrt(np.mean((points @ slope) ** 4)))
    assert found.standard_doubt == pytest.approx(found.standard / 8.0)
    assert found.bound == pytest.approx(2.0 * found.standard)
    for rows, said in ((256, "slopes by all 256"), (257, "64 tables with every row drawn")):
        linear = physical.independent_rows_term(copies(lambda change: float(change.sum())), np.full(rows, 0.1))
        assert said in linear.rule
        assert abs(linear.standard - 0.1 * math.sqrt(rows)) <= 3.0 * linear.standard_doubt + 1e-9


@pytest.mark.parametrize(
    ("sizes", "size", "unit"), [([0.02, 0.02], 0.02, "N"), ([0.02, 0.03], 1.0, "1"), ([0.03, 0.02], 1.0, "1")]
)
def test_what_rows_have_together_is_one_input(sizes: list[float], size: float, unit: str) -> None:
    """Assert slope, size and doubt of a number that goes as -a p + b p**3 with the whole table's shift."""
    given = np.array(sizes)
    found = physical.common_term(
        copies(lambda change: 2.0 - 0.7 * (change[0] / given[0]) + 0.1 * (change[0] / given[0]) ** 3), given
    )
    assert found.standard == pytest.approx(0.7)
    assert found.bound == pytest.approx(2.0 * (0.7 + 0.1))
    assert (found.sensitivity, found.sensitivity_doubt) == pytest.approx((-0.7 / size, 0.1 / size))
    assert (found.input_uncertainty, found.input_unit and found.input_unit.text) == (size, unit)
    assert "over all of it 0.1 of the slope more or less" in found.rule


# ------------------------------------------------------------------------------------------------------------- searches


@dataclass
class Line:
    """A straight line through measured points, as a fit is to a search; what was asked for is kept."""

    times: np.ndarray = field(default_factory=lambda: np.linspace(0.0, 1.0, 50))
    fails: bool = False
    shares: list[float] = field(default_factory=list)
    loss: Loss = field(default_factory=Loss)

    def weighted_residuals(self, scaled: np.ndarray, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and slopes of a + b t against 2 + 3 t, with a residue of 0.1 that no line takes away."""
        if self.fails:
            raise xd.InputError("no run comes to its end")
        if not self.shares or self.shares[-1] != share:
            self.shares.append(share)
        t = self.times[self.times <= share]
        design = np.stack([np.ones(len(t)), t], axis=1)
        return design @ (scaled - [2.0, 3.0]) + 0.1 * (-1.0) ** np.arange(len(t)), design

    def squares(self, scaled: np.ndarray, share: float) -> np.ndarray:
        """Sums of squares of many starts."""
        assert share == 0.25
        return np.array([float(np.sum((one - [2.0, 3.0]) ** 2)) for one in scaled])


FREE = (np.full(2, -np.inf), np.full(2, np.inf))


def test_a_search_ends_in_the_least_sum_of_squares() -> None:
    """Assert estimates, the sum of squares and why it ended, free and between bounds."""
    line = Line()
    found = search_from_start(line, "own", np.array([0.5, 0.5]), *FREE)
    best, squares, *_ = np.linalg.lstsq(
        np.stack([np.ones(50), line.times], axis=1), 2 + 3 * line.times - 0.1 * (-1.0) ** np.arange(50), rcond=None
    )
    assert found.end == pytest.approx(best, rel=1e-9)
    assert found.square == pytest.approx(float(squares[0]), rel=1e-9)
    assert found.square == pytest.approx(float(found.residual @ found.residual))
    assert (found.converged, found.rule, found.slopes.shape) == (True, "own", (50, 2))
    assert found.evaluations >= 2
    bound = search_from_start(line, "own", np.array([9.0, 0.5]), np.array([0.0, 0.0]), np.array([1.0, 5.0]))
    assert bound.end[0] == pytest.approx(1.0, abs=1e-6)
    assert (found.bounded.tolist(), bound.bounded.tolist()) == ([False, False], [True, False])
    assert bound.square > 2 * found.square


def test_a_growing_search_goes_from_part_to_part() -> None:
    """Assert that each part of the time is searched once, from short to all, and evaluations are counted together."""
    line = Line()
    found = search_growing(line, "growing", np.array([9.0, -4.0]), *FREE)
    assert line.shares == [0.06, 0.12, 0.25, 0.5, 1.0]
    assert found.start.tolist() == [9.0, -4.0]
    assert found.end == pytest.approx(search_from_start(Line(), "own", np.array([0.5, 0.5]), *FREE).end, rel=1e-9)
    alone = search_from_start(Line(), "own", found.end, *FREE).evaluations
    assert found.evaluations >= 4 * alone > 0


@pytest.mark.parametrize("most", [1, 2, 3, 5])
def test_as_many_searches_as_are_asked_for(most: int) -> None:
    """Assert the model's own start first, then growing parts, then the best of the starts that are drawn, the best first."""
    start = np.array([1.0, 2.0])
    found = list(searches(Line(), start, *FREE, most, 7))
    assert [one.rule.split()[0] for one in found] == ["the", "fits", "drawn", "drawn", "drawn"][:most]
    assert all(one.start.tolist() == start.tolist() for one in found[:2])
    tried = drawn_starts(np.random.default_rng(7), start, *FREE)
    order = np.argsort(np.sum((tried - [2.0, 3.0]) ** 2, axis=1))
    assert [one.start.tolist() for one in found[2:]] == tried[order[: max(most - 2, 0)]].tolist()


def test_a_search_that_meets_no_end_stays_where_it_was() -> None:
    """Assert an infinite sum of squares, no evaluation, and the message of what stopped it."""
    (found,) = searches(Line(fails=True), np.array([1.0, 2.0]), *FREE, 1, 0)
    assert (found.square, found.evaluations, found.converged) == (math.inf, 0, False)
    assert (found.stopped, found.end.tolist()) == ("no run comes to its end", [1.0, 2.0])


def test_drawn_starts_are_near_and_far() -> None:
    """Assert a tenth, a half, and factors up to eight, in turn; from 0 within one; between bounds all of them."""
    start = np.array([-3.0, 0.0, 5.0])
    low, high = np.array([-np.inf, -np.inf, 4.0]), np.array([np.inf, np.inf, 9.0])
    found = drawn_starts(np.random.default_rng(1), start, low, high)
    assert found.shape == (96, 3)
    near, wide, far = (found[k::3] for k in range(3))
    for rows, width in ((near, 0.1), (wide, 0.5)):
        off = np.abs(rows[:, :2] - start[:2])
        assert 0.8 * width < off.max() <= width
    factors = far[:, 0] / start[0]
    assert 1 / 8 <= factors.min() < 0.25 < 4.0 < factors.max() <= 8.0
    assert 0.8 < np.abs(far[:, 1]).max() <= 1.0
    assert 4.0 <= far[:, 2].min() < 4.5 < 8.5 < far[:, 2].max() <= 9.0
    assert found[:, 2].min() >= 4.0
    assert not (far[:, 2] == 9.0).any()
    half = drawn_starts(np.random.default_rng(1), np.array([2.0]), np.zeros(1), np.full(1, np.inf))[2::3, 0]
    assert 0.25 <= half.min() < 0.5 < 8.0 < half.max() <= 16.0


# ------------------------------------------------------------------------------------------------------- the march's own


def standing(**more: Any) -> xd.Model:
    """A state that stays where it is: its number is off by rounding alone."""
    return xd.Model(name="standing", states={"s": {"unit": "g", "rate": "0*gram/second"}}, initial={"s": "1 g"}, **more)


def row(budget: xr.Dataset, name: str) -> xr.Dataset:
    """A term of a budget."""
    return budget.isel(term=budget.term_name.values.tolist().index(name))


def test_rounding_is_told_by_copies() -> None:
    """Assert that of whole roundings the bound is twice the largest, the size their mean square, each with half a spacing."""
    asked: dict[str, Any] = {"method": "implicit_midpoint", "step": "0.5 s", "until": "1 s"}
    found = row(xd.error_budget(standing(), "s", at="1 s", **asked), "roundoff")
    off = (float(found.bound) / EPS - 0.5) / 2.0
    assert off in (0.5, 1.0, 1.5, 2.0)
    squares = 8.0 * ((float(found.standard_uncertainty) / EPS) ** 2 - 0.25 / 3.0)
    assert squares * 4.0 == pytest.approx(round(squares * 4.0), abs=1e-6)
    assert off**2 - 1e-6 <= squares <= 8.0 * off**2 + 1e-6
    assert float(found.standard_uncertainty_doubt) == pytest.approx(float(found.standard_uncertainty) / 4.0)


@pytest.mark.parametrize(
    ("method", "more", "event"),
    [
        ("dormand_prince", {}, {"action": "record"}),
        ("taylor", {"order": 12}, {"action": "reset", "set": {"v_x": "-0.9*v_x"}}),
    ],
)
def test_rounding_is_measured_by_the_twin(method: str, more: dict[str, Any], event: dict[str, Any]) -> None:
    """Assert that a state, and the time of an event, are as far from those of 31 digits by the same steps as is told."""
    model = xd.Model(
        name="swing",
        coordinates={"x": "m"},
        parameters={"k": "0.1 N m-1", "m": "0.3 kg"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        events={"middle": {"function": "x"} | event},
        initial={"x": "0.2 m", "v_x": "-1.1 m s-1"},
    )
    asked: dict[str, Any] = {"method": method, "rtol": 1e-9, "until": "30 s"}
    run = xd.simulate(model, **asked)
    steps = run.step_size.values[run.step_size.values > 0.0]
    asked_of_twin = more | {"step": steps, "estimator": "none", "precision": "double_double"}
    twin = xd.simulate(model, method=method, until="30 s", **asked_of_twin)
    for quantity, where, number in (
        ("x", {"at": "30 s"}, lambda run: float(run.x[-1])),
        ("t", {"event": "middle"}, lambda run: float(run.event_time[0])),
    ):
        found = row(xd.error_budget(model, quantity, **where, **asked, only=["roundoff"]), "roundoff")
        off, spacing = abs(number(run) - number(twin)), EPS * abs(number(run)) / 2.0
        assert float(found.bound) == pytest.approx(off + spacing, rel=1e-12, abs=0.0)
        assert "measured: the same run with 31 digits, by the same steps" in str(found.term_rule.values)
    assert abs(float(run.x[-1] - twin.x[-1])) > 2.0 * EPS  # what rounding comes to, so that another rule would be seen


@pytest.mark.parametrize(("rtol", "ratio"), [(1e-6, 10.0), (1e-11, 10.0), (2e-13, None)])
def test_tolerances_of_finer_runs(rtol: float, ratio: float | None) -> None:
    """Assert three finer tolerances, each a tenth, or by as much as takes the last to twice the least that steps keep to."""
    budget = xd.error_budget(standing(), "s", at="1 s", method="dormand_prince", rtol=rtol, until="1 s")
    least = 2.0 * (10.0 * EPS)  # of a method whose estimate has its own order
    found = budget.rtol.values
    assert found[0] == rtol
    assert found[:-1] / found[1:] == pytest.approx(ratio or (rtol / found[-1]) ** (1 / 3))
    assert ratio or found[-1] == pytest.approx(least, rel=0.2)


def test_tolerances_that_leave_no_room_for_finer_runs_are_refused() -> None:
    """Assert that three halvings have to be left down to the least tolerance, 20 spacings of 1."""
    asked: dict[str, Any] = {"at": "1 s", "method": "dormand_prince", "until": "1 s"}
    assert xd.error_budget(standing(), "s", rtol=8.1 * 20.0 * EPS, **asked).sizes["level"] == 4
    with pytest.raises(xd.InputError, match="needs three tolerances under it that differ"):
        xd.error_budget(standing(), "s", rtol=7.9 * 20.0 * EPS, **asked)


@pytest.mark.dear
def test_an_extreme_says_how_it_was_found() -> None:
    """Assert rule, place and what interpolation does of an apex between states, of a start, and of a landing."""
    model = xd.Model(
        name="thrown",
        coordinates={"y": "m"},
        parameters={"g": "10 m s-2"},
        mass={"y": "1*kilogram"},
        forces={"weight": {"y": "-g*1*kilogram"}},
        initial={"y": "1 m", "v_y": "5 m s-1"},
        events={"ground": {"function": "y", "direction": "falling", "action": "stop"}},
    )
    for quantity, where, rule, value in (
        (
            "maximum_y",
            "interpolated between accepted states, at t = 0.5",
            "interpolated between accepted states: a shortened step",
            2.25,
        ),
        ("maximum_v_y", "sampled at an accepted state, at t = 0", "sampled at an accepted state; none between", 5.0),
        ("minimum_y", "located by an event, at t = 1.17", "located by an event; none between", 0.0),
    ):
        budget = xd.error_budget(model, quantity, method="rk4", step="0.3 s", until="3 s")
        assert str(row(budget, "interpolation").term_rule.values).startswith(rule)
        assert next(line for line in budget_lines(budget) if line.startswith("found")).startswith(f"found     {where}")
        assert float(budget.value) == pytest.approx(value, abs=1e-6)
        assert (float(row(budget, "interpolation").bound) > 0.0) is (quantity == "maximum_y")
    number = row(xd.error_budget(model, "y", at="0.4 s", method="rk4", step="0.3 s", until="3 s"), "interpolation")
    assert str(number.term_rule.values).startswith("a shortened step against two")


# ---------------------------------------------------------------------------------------------------------------- words


def budget_in_words(**more: Any) -> xr.Dataset:
    """A budget made by hand: three terms, of which the second has the largest share and the third was drawn."""
    terms = {
        "term_name": ["truncation", "g", "f"],
        "term_kind": [0, 1, 1],
        "share": [0.1, -0.7, 0.2],
        "standard_uncertainty": [0.0123456, 0.02, 0.5],
        "standard_uncertainty_doubt": [0.0, 0.0, 0.0625],
        "sensitivity": [math.nan, -2.5, 3.0],
        "sensitivity_units": ["", "m-1 s2", "1"],
        "input_uncertainty": [math.nan, 0.008, 1.0],
        "input_units": ["", "m s-2", "1"],
    }
    found = xr.Dataset({name: ("term", np.array(term)) for name, term in terms.items()})
    found["term_kind"].attrs = {"flag_values": np.array([0, 1]), "flag_meanings": "numerical physical"}
    totals = {"numerical_rss": 0.0123456, "numerical_bound": 0.03, "physical_rss": 0.51, "total_rss": 0.52}
    found = found.assign({name: ((), total) for name, total in totals.items()})
    found["value"] = ((), 3.0, {"units": "s"})
    return found.assign_attrs({"of": "time of apex", "result": "3 s", **more})


def test_a_budget_in_words_begins_with_the_largest_share() -> None:
    """Assert order, numbers, signs and units of every line of a budget that was not drawn."""
    assert list(budget_lines(budget_in_words())) == [
        "result    time of apex = 3 s",
        "term        kind       standard uncertainty  of the variance  sensitivity times input",
        "g           physical   0.02 s                -70.0%           -2.5 m-1 s2 times 0.008 m s-2",
        "f           physical   0.50 ± 0.06 s         20.0%            3 times 1",
        "truncation  numerical  0.012 s               10.0%",
        "totals    numerical 0.012 s, at most 0.03 s; physical 0.51 s; together 0.52 s",
        "linear    not checked: draw, with --draws 10000",
    ]


def test_a_drawn_budget_in_words_says_both_intervals() -> None:
    """Assert intervals with the digits that their ends bear, the verdict, what settles it, and where an extreme is."""
    found = budget_in_words(
        coverage=0.95, draws=4000, linear_apart=0.004, draws_needed=23000.0, extreme_rule="located", extreme_time=1.5
    )
    drawn_too = {"shortest": [2.0111, 3.9], "symmetric": [2.0333, 3.955]}
    found = found.assign({f"monte_carlo_{name}": ("bound", np.array(value)) for name, value in drawn_too.items()})
    found["monte_carlo_end_doubt"], found["monte_carlo_standard_uncertainty"] = 0.012, 0.49876
    found["monte_carlo_standard_uncertainty_doubt"] = 0.006
    found["linear_verdict"] = (
        (),
        2,
        {"flag_values": np.array([0, 1, 2]), "flag_meanings": "adequate not_adequate not_checked"},
    )
    lines = list(budget_lines(found))
    assert lines[1] == "found     located by an event, at t = 1.5 s"
    assert lines[7:] == [
        "drawn     shortest 95% interval 2.01 to 3.90 s, its ends ± 0.01 s",
        "drawn     symmetric 95% interval 2.03 to 3.96 s, its ends ± 0.01 s",
        "drawn     standard uncertainty 0.499 ± 0.006 s, of 4000 draws",
        "linear    undecided: its interval ends 0.004 s from that of the draws; 4000 draws leave it open, about 23000 settle it",
    ]
    settled = found.drop_attrs(deep=False).assign_attrs(
        {key: attr for key, attr in found.attrs.items() if key != "draws_needed"}
    )
    assert list(budget_lines(settled))[-1].endswith("0.004 s from that of the draws")
    assert next(line for line in budget_lines(found.assign_attrs(time_units="1")) if line.startswith("found")).endswith(
        "t = 1.5"
    )


# -------------------------------------------------------------------------------------------------- terms and variables


def term_of(name: str, kind: str, standard: float, doubt: float = 0.0, **more: Any) -> Term:
    """A term with a bound of three of its standard uncertainties."""
    return Term(name, kind, standard, 3.0 * standard, "rule", standard_doubt=doubt, **more)


def test_terms_add_up_with_their_doubts() -> None:
    """Assert totals, doubts, shares and spelled units of terms made by hand, correlated and drawn among them."""
    model = xd.Model(
        name="two",
        parameters={"a": "1 ± 0.1 kg", "b": "2 ± 0.2 s"},
        states={"s": {"unit": "m", "rate": "0*a*b*metre/(kilogram*second**2)"}},
        initial={"s": "0 m"},
        correlations={"a": {"b": 0.5}},
    )
    kg, second = parse_unit("kg"), parse_unit("s")
    terms = [
        term_of("truncation", "numerical", 0.3),
        term_of("roundoff", "numerical", 0.4, 0.1),
        term_of(
            "a", "physical", 0.6, 0.2, sensitivity=6.0, input_uncertainty=0.1, input_unit=kg, sensitivity_doubt=0.5
        ),
        term_of(
            "b",
            "physical",
            0.2,
            0.3,
            sensitivity=-1.0,
            input_uncertainty=0.2,
            input_unit=second,
            sensitivity_doubt=0.25,
        ),
    ]
    found = term_variables(model, Target("s", 1.0), parse_unit("m"), 7.0, terms)
    variance = 0.36 + 0.04 - 2 * 0.5 * 0.6 * 0.2
    numbers = {
        name: float(found[name][1])
        for name in (
            "value",
            "numerical_bound",
            "physical_bound",
            "numerical_rss",
            "physical_rss",
            "physical_rss_doubt",
            "total_rss",
        )
    }
    doubt = math.sqrt(((0.6 * 0.2) ** 2 + (0.2 * 0.3) ** 2) / variance)
    assert list(numbers.values()) == pytest.approx(
        [7.0, 2.1, 2.4, 0.5, math.sqrt(variance), doubt, math.sqrt(variance + 0.25)]
    )
    shares = np.array([0.09, 0.16, 0.36 - 0.06, 0.04 - 0.06]) / (variance + 0.25)
    assert found["share"][1] == pytest.approx(shares)
    assert found["sensitivity_units"][1].tolist() == ["", "", "m kg-1", "m s-1"] or found["sensitivity_units"][
        1
    ].tolist() == ["", "", "kg-1 m", "m s-1"]
    assert found["term_kind"][1].tolist() == [0, 0, 1, 1]
    for name, unit in (
        ("sensitivity", "sensitivity_units"),
        ("sensitivity_doubt", "sensitivity_units"),
        ("input_uncertainty", "input_units"),
    ):
        assert found[name][2]["comment"] == f"in the unit that {unit} names"
    nothing = term_variables(model, Target("s", 1.0), parse_unit("m"), 7.0, [term_of("truncation", "numerical", 0.0)])
    assert (float(nothing["physical_rss_doubt"][1]), nothing["share"][1].tolist()) == (0.0, [0.0])


def test_units_of_slopes_keep_their_names_unless_all_are_base_units() -> None:
    """Assert base units in their own order, and other names as they were declared."""
    model = standing()
    for of, by, spelled in (
        ("s", "m s-1", "m-1 s2"),
        ("N", "kg s-1", "N kg-1 s"),
        ("m", "N m-1", "m2 N-1"),
        ("kg m", "m", "kg"),
    ):
        term = term_of("a", "physical", 0.1, sensitivity=1.0, input_uncertainty=0.1, input_unit=parse_unit(by))
        found = term_variables(model, Target("s", 1.0), parse_unit(of), 1.0, [term])["sensitivity_units"][1].tolist()
        assert found == [spelled]


def test_levels_and_draws_stand_in_their_units() -> None:
    """Assert the unit of what is varied: of steps the run's own, of tolerances none; and intervals with their coverage."""
    steps = budgeted_levels(step="0.5 s", method="rk4")
    assert steps.step_size.attrs["units"] == "s"
    assert steps.level_value.attrs["units"] == "g"
    assert budgeted_levels(rtol=1e-5, method="dop853").rtol.attrs["units"] == "1"
    found = draw_variables(DrawStatistics(1.0, 2.0, (3.0, 4.0), (5.0, 6.0), 7.0, 8.0, 9.0), parse_unit("g"), 0.9)
    values = {name: np.asarray(value[1]).tolist() for name, value in found.items()}
    assert values == {
        "monte_carlo_mean": 1.0,
        "monte_carlo_standard_uncertainty": 2.0,
        "monte_carlo_standard_uncertainty_doubt": 7.0,
        "monte_carlo_end_doubt": 8.0,
        "monte_carlo_shortest": [3.0, 4.0],
        "monte_carlo_symmetric": [5.0, 6.0],
    }
    assert {one[2]["units"] for one in found.values()} == {"g"}
    assert found["monte_carlo_shortest"][2]["coverage"] == found["monte_carlo_symmetric"][2]["coverage"] == 0.9


def budgeted_levels(**asked: Any) -> xr.Dataset:
    """A budget of what stays where it is."""
    return xd.error_budget(standing(), "s", at="1 s", until="1 s", **asked)


@pytest.mark.parametrize(
    ("standard", "said"), [("0 g", None), ("-1 g", "needs a non-negative number"), ("1 m", "has the unit")]
)
def test_declared_sizes_are_none_or_more(standard: str, said: str | None) -> None:
    """Assert that 0 is a size, and that a negative one and one of another unit are refused."""
    declared = Declared("scale", "s", standard, at="1 s")
    if said is None:
        found = declared.term(Target("s", 1.0), parse_unit("g"))
        assert (found.standard, found.bound, found.rule) == (0.0, 0.0, "declared")
        return
    with pytest.raises(xd.InputError, match=said):
        declared.term(Target("s", 1.0), parse_unit("g"))


@pytest.mark.parametrize("name", ["", 3, None])
def test_declared_terms_have_a_name(name: Any) -> None:
    """Assert that a term whose name is no word is refused."""
    with pytest.raises(xd.InputError, match="needs a word"):
        Declared(name, "s", "1 g", at="1 s").term(Target("s", 1.0), parse_unit("g"))
    kept = Declared("scale", "s", "1 g", at="1 s", description="by the maker")
    assert kept.term(Target("s", 1.0), parse_unit("g")).rule == "by the maker"


def test_numbers_are_named_with_their_places() -> None:
    """Assert times, sides, occurrences and extremes in words, and no seconds where time has none."""
    assert [
        target.description
        for target in (
            Target("y", 1.5),
            Target("y", 1.5, second="1"),
            Target("y", event="ground"),
            Target("y", event="apogee", is_parted=False),
            Target("v_y", event="floor", occurrence=3, side="after"),
            Target("t", event="ground"),
            Target("t", event="floor", occurrence=2),
            Target("maximum_v_y"),
            Target("minimum_force_drag_y"),
        )
    ] == [
        "y at t = 1.5 s",
        "y at t = 1.5",
        "y before ground",
        "y at apogee",
        "v_y after floor number 3",
        "time of ground",
        "time of floor number 2",
        "maximum of v_y",
        "minimum of force_drag_y",
    ]
    assert (Target("maximum_v_y").extreme, Target("minimum_y").extreme, Target("y", 1.0).extreme) == (
        ("v_y", 1.0),
        ("y", -1.0),
        None,
    )


@pytest.mark.parametrize(
    ("off", "standard", "other", "said"),
    [
        (0.0199, 1.0, 0.0, None),
        (0.0201, 1.0, 0.0, "0.02 of itself"),
        (0.5, 1.0, 0.0, "0.5 of itself"),
        (0.039, 1.0, 100.0, None),
        (0.041, 1.0, 100.0, "0.04 of itself"),
        (0.0025, 0.0, 6.0, "inf of itself"),
        (0.0023, 0.0, 6.0, None),
    ],
)
def test_slopes_that_are_in_doubt_are_warned_of(off: float, standard: float, other: float, said: str | None) -> None:
    """Assert a fiftieth of a term's size, or of a fiftieth of all, as what a slope may be off by without a word."""
    inputs: dict[str, Any] = {"sensitivity": 2.0, "input_uncertainty": 0.5, "input_unit": parse_unit("kg")}
    mine = term_of("a", "physical", standard, **inputs, sensitivity_doubt=2.0 * off)
    terms = [
        mine,
        term_of("b", "physical", other),
        term_of("c", "physical", 0.0, sensitivity_doubt=9.0, input_uncertainty=9.0),
    ]
    if said is None:
        _doubt_slopes(terms, Target("s", 1.0))
        return
    with pytest.warns(
        xd.AccuracyWarning, match=f"s at t = 1 s does not change in proportion with 'a'.*off by {said}; draw"
    ):
        _doubt_slopes(terms, Target("s", 1.0))


@pytest.mark.parametrize(
    ("draws", "seed", "coverage", "digits", "said"),
    [
        (0, 0, 0.95, 1, None),
        (100, 3, 0.5, 2, None),
        (99, 0, 0.95, 1, "draws is 99"),
        (-1, 0, 0.95, 1, "draws is -1"),
        (100.0, 0, 0.95, 1, "draws is 100.0"),
        (False, 0, 0.95, 1, "draws is False"),
        (0, -1, 0.95, 1, "seed is -1"),
        (0, True, 0.95, 1, "seed is True"),
        (0, 1.0, 0.95, 1, "seed is 1.0"),
        (0, 0, 0.0, 1, "coverage is 0.0"),
        (0, 0, 1.0, 1, "coverage is 1.0"),
        (0, 0, True, 1, "coverage is True"),
        (0, 0, "1", 1, "coverage is '1'"),
        (0, 0, 0.95, 3, "digits is 3"),
        (0, 0, 0.95, True, "digits is True"),
        (0, 0, 0.95, 0, "digits is 0"),
    ],
)
def test_what_a_budget_is_asked_is_checked(draws: Any, seed: Any, coverage: Any, digits: Any, said: str | None) -> None:
    """Assert borders and kinds of draws, seed, coverage and digits."""
    if said is None:
        _check_draw_settings(draws, seed, coverage, digits)
        return
    with pytest.raises(xd.InputError, match=said):
        _check_draw_settings(draws, seed, coverage, digits)


@pytest.mark.parametrize(
    ("adequate", "asked", "refused"),
    [
        (False, {}, True),
        (False, {"inadequate_fit": True}, False),
        (True, {}, False),
        (False, {"inadequate_fit": 1}, True),
        (None, {}, False),
    ],
)
def test_fits_that_are_not_adequate_have_no_budget(
    adequate: bool | None, asked: dict[str, Any], refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a fitted model is refused where residuals speak against it, unless it is asked for in so many words."""
    model = standing()
    if adequate is not None:
        model = xd.Model.from_text(
            toml.model_toml(replace(model.elements.statement, fit=Fitted("bench", adequate, "residuals swing")))
        )

    def begun(*_: Any) -> None:
        raise xd.InputError("a run began")

    monkeypatch.setattr("xdynamics.evidence.stages.results_of", begun)
    said = "fitted to 'bench', and the fit is not adequate: residuals swing" if refused else "a run began"
    with pytest.raises(xd.InputError, match=said):
        xd.error_budget(model, "s", at="1 s", method="rk4", step="0.5 s", until="1 s", **asked)


def test_declared_terms_are_declared() -> None:
    """Assert that nothing else is taken for one."""
    one = Declared("scale", "s", "1 g", at="1 s")
    assert _checked_declared(one) is one
    with pytest.raises(xd.InputError, match="terms has 'scale', needs Declared"):
        _checked_declared("scale")


def fitted_in_words(**more: Any) -> xr.Dataset:
    """A fit made by hand: two numbers, of which the second is on its bound, that are correlated by 0.95."""
    found = xr.Dataset(
        {
            "parameter_name": ("parameter", np.array(["k", "ratio"])),
            "parameter_units": ("parameter", np.array(["N m-1", "1"])),
            "estimate": ("parameter", np.array([4.0, 0.5])),
            "standard_uncertainty": ("parameter", np.array([0.0123, 0.2])),
            "at_bound": ("parameter", np.array([0, 1])),
            "correlation": (("parameter", "other"), np.array([[1.0, -0.95], [-0.95, 1.0]])),
            "start_square": ("start", np.array([9.0, 2.0, 5.0])),
            "start_rule": ("start", np.array(["own", "growing", "drawn"])),
        }
    )
    about = {
        "chi_square": 21.0,
        "degrees_of_freedom": 20,
        "residual_variance": 0.04,
        "adequate": 1,
        "adequate_text": "residuals are no more than noise",
        "runs_probability": 0.25,
        "evaluations": 17,
        "condition": 12.34,
        "stopped": "both",
        "converged": 1,
    }
    return found.assign_attrs(about | more)


def test_a_fit_in_words() -> None:
    """Assert every line of a fit with uncertainties, and those that change without, on another verdict, or with no end."""
    lines = list(fit_in_lines(fitted_in_words()))
    assert lines == [
        "k         4.000 ± 0.012 N m-1 (one standard uncertainty)",
        "ratio     0.50 ± 0.20 (one standard uncertainty); on its bound, and no more sure than that",
        "fit       chi-square 21 for 20 degrees of freedom; a larger one has the probability 0.397",
        "verdict   adequate: residuals are no more than noise; fewer changes of sign have the probability 0.25",
        "searches  3, the best of them number 2: growing",
        "together  k and ratio are correlated by -0.950",
        "search    17 evaluations, condition 12.3: both",
    ]
    other = list(fit_in_lines(fitted_in_words(chi_square=math.nan, adequate=0, runs_probability=math.nan, converged=0)))
    assert other[2] == "fit       residuals of 0.2, by which the uncertainties are scaled; 20 degrees of freedom"
    assert other[3] == "verdict   not adequate: residuals are no more than noise"
    assert other[-1].startswith("doubt     the search did not come to an end")
    for square, said in (
        (60.0, "the model or the uncertainties are not right (a larger one has the probability 7e-06)"),
        (3.0, "the uncertainties are larger than the residuals (a smaller one has the probability 4e-06)"),
    ):
        assert list(fit_in_lines(fitted_in_words(chi_square=square)))[2].split("; ")[1] == said
    for part, said in (
        (0.0015, "a larger one has the probability 0.00"),
        (0.9985, "a larger one has the probability 0.99"),
    ):
        assert list(fit_in_lines(fitted_in_words(chi_square=chi2.isf(part, 20))))[2].split("; ")[1].startswith(said)
    weak = (
        fitted_in_words()
        .isel(start=[0])
        .assign(correlation=(("parameter", "other"), np.array([[1.0, 0.9], [0.9, 1.0]])))
    )
    assert [line.split()[0] for line in fit_in_lines(weak)] == ["k", "ratio", "fit", "verdict", "search"]
    del weak.attrs["adequate"]
    assert [line.split()[0] for line in fit_in_lines(weak.drop_dims("start"))] == ["k", "ratio", "fit", "search"]


# -------------------------------------------------------------------------------------------------------------- slopes


def through(rate: str, **inputs: Any) -> xd.Model:
    """A state that is a function of its inputs after a second, in grams as they are."""
    return xd.Model(
        name="through", parameters=inputs, states={"s": {"unit": "g", "rate": f"({rate})/second"}}, initial={"s": "0 g"}
    )


def sloped(model: xd.Model) -> xr.Dataset:
    """The term of an input of the number at 1 s."""
    return row(xd.error_budget(model, "s", at="1 s", method="rk4", step="0.5 s", until="1 s"), "a")


@pytest.mark.filterwarnings("ignore:.*does not change in proportion")
@pytest.mark.cases(100)
def test_slopes_are_of_the_spacing_that_agrees_best(case: int) -> None:
    """Assert slope, doubt and spacing of a wavy number: from its own uncertainty on, wider or narrower while neighbours agree better."""
    rng = np.random.default_rng(case)
    size, wave, start = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.5, 30.0)), float(rng.uniform(5.0, 9.0))
    a0, u = round(start, 3), 0.05
    model = through(f"3*a + {size!r}*gram*sin({wave!r}*a/(0.05*gram))", a={"value": f"{a0!r} g", "uncertainty": u})
    shifts = u * 4.0 ** np.arange(-3, 5)
    shifts = shifts[shifts <= max(u, 1e-2 * a0)]
    points = a0 + shifts[:, None] * np.array([1.0, 2.0, 3.0])
    mirrored = 2.0 * a0 - points
    up, down = (3.0 * one + size * np.sin(wave * one / u) for one in (points, mirrored))
    slopes = ((up - down) @ np.array([45.0, -9.0, 1.0])) / (60.0 * shifts)
    off = np.abs(np.diff(slopes))
    own = min(2, off.size - 1)
    ends = []
    for way in (1, -1):
        k = own
        while 0 <= k + way < off.size and off[k + way] < off[k]:
            k += way
        ends.append(k)
    k = min(ends, key=lambda one: float(off[one]))
    slope, exact = float(slopes[k + 1]), 3.0 + size * wave / u * math.cos(wave * a0 / u)
    found = sloped(model)
    apart = abs(exact - slope)
    close = apart <= 0.02 * abs(slope)
    assert float(found.sensitivity) / 1e3 == pytest.approx(exact if close else slope, rel=1e-6)
    assert float(found.sensitivity_doubt) / 1e3 == pytest.approx(
        apart if close else max(float(off[k]), apart), rel=1e-4, abs=1e-7
    )
    assert float(found.standard_uncertainty) == pytest.approx(abs(exact if close else slope) * u, rel=1e-6)
    assert f"sixth order over {shifts[k + 1] / u:.3g} of its uncertainties" in str(found.term_rule.values)
    assert str(found.term_rule.values).startswith("slope by variational" if close else "slope by central")


def test_an_input_that_is_known_better_than_numbers_has_a_slope() -> None:
    """Assert the slope of a square of an input that is known to a part in 1e13, by changes of a part in 1e9 at most."""
    found = sloped(through("a**2/gram", a={"value": "3 g", "uncertainty": 3e-13}))
    assert float(found.sensitivity) / 1e3 == pytest.approx(6.0, rel=1e-6)
    assert float(found.standard_uncertainty) == pytest.approx(18e-13, rel=1e-6)
    spacing = float(str(found.term_rule.values).split("sixth order over ")[1].split()[0])
    assert 1e4 / 64.0 * 0.99 <= spacing <= 1e4 * 1.01


def test_a_slope_that_is_rounding_is_none() -> None:
    """Assert 0 without a doubt of an input that goes out of a large number again, and its rule."""
    found = sloped(through("(1e6*gram + 0.3*a) - 0.3*a", a={"value": "3 g", "uncertainty": 0.1}))
    assert (float(found.sensitivity), float(found.sensitivity_doubt), float(found.standard_uncertainty)) == (
        0.0,
        0.0,
        0.0,
    )
    assert str(found.term_rule.values) == "no slope but rounding's"


@pytest.mark.parametrize(("interpolation", "location", "verdict"), [(1e-9, 0.0, 4), (1e-9, 2e-9, 3), (0.0, 1e-9, 3)])
def test_what_levels_are_limited_by_is_named(interpolation: float, location: float, verdict: int) -> None:
    """Assert that events are blamed only where their location is more uncertain than what is between steps."""
    levels: Any = SimpleNamespace(
        are_restrained=lambda _: False,
        values=np.array([1e-6, 1e-7, 1e-8]),
        formal=1.0,
        order=8.0,
        varied=SimpleNamespace(keyword="rtols"),
    )
    found = [Estimate(1.0 + change, interpolation, location, 100, "") for change in (1e-8, 1e-9, 0.0)]
    assert LevelComparison.from_estimates(levels, *found).judgement.verdict == verdict
