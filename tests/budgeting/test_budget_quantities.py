"""Every number of a budget by itself: its sign, its factor, and the run that it is of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import chi2, norm

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.budgeting import fit_problem
from xdynamics.budgeting.budget_summary import rounded_result
from xdynamics.budgeting.montecarlo import DrawStatistics, draw_statistics, draws_needed
from xdynamics.documenting.summary import summary
from xdynamics.evidence.diagnosing.cycles import cycles

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


def weighed(correlation: float, **more: Any) -> xd.Model:
    """A number 2 a - 3 b + c, of inputs that are correlated and one between bounds."""
    return xd.Model(
        name="weighed",
        parameters={
            "a": "1 ± 0.1 g",
            "b": {"value": "2 g", "uncertainty": 0.2},
            "c": {"value": "3 g", "half_width": 0.3},
        },
        states={"s": {"unit": "g", "rate": "(2*a - 3*b + c)/second"}},
        initial={"s": "0 g"},
        correlations={"a": {"b": correlation}},
        **more,
    )


def budgeted(model: xd.Model, quantity: str = "s", **more: Any) -> xr.Dataset:
    """A budget at 1 s by steps that are exact for what is linear in time."""
    return xd.error_budget(model, quantity, **{"at": "1 s", "method": "rk4", "step": "0.25 s", "until": "1 s"} | more)


def column(budget: xr.Dataset, name: str) -> dict[str, Any]:
    """A variable of the terms, by their names."""
    return dict(zip(budget["term_name"].values.tolist(), budget[name].values.tolist(), strict=True))


@pytest.mark.parametrize("correlation", [-0.8, 0.0, 0.5, 1.0])
def test_correlated_terms_keep_the_signs_of_their_slopes(correlation: float) -> None:
    """Assert variance, shares, slopes per kg, contributions and bounds of 2 a - 3 b + c."""
    budget = budgeted(weighed(correlation))
    parts, third = np.array([0.2, -0.6]), 0.3 / math.sqrt(3.0)
    cross = correlation * parts[0] * parts[1]
    variance = float(parts @ parts) + 2.0 * cross + third**2
    assert float(budget.value) == pytest.approx(-1.0)
    assert float(budget.physical_rss) == pytest.approx(math.sqrt(variance), rel=1e-9)
    shares = column(budget, "share")
    assert [shares[letter] for letter in "abc"] == pytest.approx(
        [(parts[0] ** 2 + cross) / variance, (parts[1] ** 2 + cross) / variance, third**2 / variance]
    )
    slopes, bounds = column(budget, "sensitivity"), column(budget, "bound")
    assert [slopes[letter] for letter in "abc"] == pytest.approx([2e3, -3e3, 1e3], rel=1e-9)
    assert [bounds[letter] for letter in "abc"] == pytest.approx([0.4, 1.2, 0.3], rel=1e-9)
    assert float(budget.physical_bound) == pytest.approx(1.9, rel=1e-9)
    inputs = column(budget, "input_uncertainty")
    assert [inputs[letter] for letter in "abc"] == pytest.approx([1e-4, 2e-4, 1e-3 * third])
    assert {letter: column(budget, "sensitivity_units")[letter] for letter in "abc"} == dict.fromkeys("abc", "g kg-1")


@pytest.mark.dear
def test_draws_are_those_of_correlated_inputs() -> None:
    """Assert mean, standard deviation and both intervals of 2 a - 3 b + c, and that another seed draws others."""
    model = weighed(0.5)
    budget, other = (budgeted(model, draws=10_000, seed=seed) for seed in (1, 2))
    standard = math.sqrt(0.04 + 0.36 - 0.12 + 0.03)
    assert float(budget.monte_carlo_mean) == pytest.approx(-1.0, abs=4 * standard / 100)
    assert float(budget.monte_carlo_standard_uncertainty) == pytest.approx(standard, rel=0.03)
    assert budget.monte_carlo_symmetric.values == pytest.approx([-1 - 1.96 * standard, -1 + 1.96 * standard], abs=0.06)
    assert np.diff(budget.monte_carlo_shortest.values)[0] == pytest.approx(2 * 1.96 * standard, rel=0.05)
    doubt = float(budget.monte_carlo_standard_uncertainty_doubt)
    assert 0.4 * standard / math.sqrt(20_000) < doubt < 2.5 * standard / math.sqrt(20_000)
    ends = standard * math.sqrt(0.025 * 0.975 / 10_000) / (math.exp(-(1.96**2) / 2) / math.sqrt(2 * math.pi))
    assert 0.5 * ends < float(budget.monte_carlo_end_doubt) < 2.0 * ends
    assert float(other.monte_carlo_mean) != float(budget.monte_carlo_mean)
    assert (budget.attrs["draws"], budget.attrs["seed"], other.attrs["seed"]) == (10_000, 1, 2)
    half = 1.959964 * float(budget.physical_rss)
    low, high = budget.monte_carlo_symmetric.values
    apart = max(abs(float(budget.value) - half - low), abs(float(budget.value) + half - high))
    assert budget.attrs["linear_apart"] == pytest.approx(apart, rel=1e-4)


def test_totals_are_of_squares_and_of_bounds() -> None:
    """Assert sums, roots of sums of squares and standard uncertainties of terms of the march and of the model."""
    budget = xd.error_budget(BALL, "v_y", event="ground", method="midpoint", step="0.2 s", time_tolerance="1 ms")
    kinds = np.array(budget.term_kind.attrs["flag_meanings"].split())[budget.term_kind.values]
    standards, bounds = budget.standard_uncertainty.values, budget.bound.values
    mine = kinds == "numerical"
    assert mine.tolist() == [True] * 4 + [False]
    assert float(budget.numerical_bound) == pytest.approx(float(bounds[mine].sum()), rel=1e-14)
    assert float(budget.numerical_rss) == pytest.approx(math.sqrt(float((standards[mine] ** 2).sum())), rel=1e-14)
    assert float(budget.total_rss) == pytest.approx(math.sqrt(float((standards**2).sum())), rel=1e-14)
    for name in ("truncation", "interpolation", "event_location"):
        assert column(budget, "standard_uncertainty")[name] == pytest.approx(
            column(budget, "bound")[name] / math.sqrt(3)
        )
    assert float(budget.share.sum()) == pytest.approx(1.0)
    assert column(budget, "share")["vt"] == pytest.approx(float(standards[4] ** 2 / (standards**2).sum()))
    assert math.isnan(column(budget, "sensitivity")["truncation"])


def test_levels_are_the_runs_own_and_three_finer_ones() -> None:
    """Assert values, digests, orders and verdict of four runs, and the truncation that follows from them."""
    asked: dict[str, Any] = {"method": "midpoint", "until": "1 s"}
    budget = xd.error_budget(BALL, "y", at="0.5 s", step="0.1 s", **asked)
    runs = [xd.simulate(BALL, step=0.1 / 2**k, force_samples="none", **asked) for k in range(4)]
    values = np.array([float(run.y.values[np.argmin(abs(run.time.values - 0.5))]) for run in runs])
    assert budget.level_value.values == pytest.approx(values, rel=1e-14)
    assert float(budget.value) == budget.level_value.values[0]
    assert budget.run_digest.values.tolist() == [
        run.attrs.get("content_digest", one) for run, one in zip(runs, budget.run_digest.values.tolist(), strict=True)
    ]
    assert budget.step_size.values == pytest.approx([0.1, 0.05, 0.025, 0.0125])
    change = np.diff(values)
    assert budget.observed_order.values[1:3] == pytest.approx(np.log2(change[:-1] / change[1:]), rel=1e-9)
    assert budget.observed_order.attrs["formal_order"] == 2.0
    spread = abs(float(np.diff(budget.observed_order.values[1:3])[0]))
    factor = min(3.0, 1.25 * 2.0 ** max(spread - 0.05, 0.0))
    away = factor * abs(values[0] - values[-1])
    bound = column(budget, "bound")["truncation"]
    assert away < bound < away + 1.25 * abs(values[0] - values[-1]) / 16.0
    assert f"{factor:.3g} times the finest value's distance" in column(budget, "term_rule")["truncation"]


def test_the_location_of_an_event_is_in_the_number_at_its_rate() -> None:
    """Assert that a speed at a landing located within a millisecond is uncertain by the acceleration times that, a time by itself."""
    asked: dict[str, Any] = {"method": "midpoint", "step": "0.2 s", "time_tolerance": "1 ms"}
    run = xd.simulate(BALL, **asked)
    place = len(run.event_time) - 1
    located, rate = float(run.event_time_uncertainty[place]), abs(float(run.a_y[-1]))
    fine = xd.simulate(BALL, **asked | {"time_tolerance": "0.1 ms"})
    moved = abs(float(run.event_time[place]) - float(fine.event_time[place]))
    time = column(xd.error_budget(BALL, "t", event="ground", **asked), "bound")["event_location"]
    assert time == pytest.approx(located + moved, rel=1e-6)
    speed = column(xd.error_budget(BALL, "v_y", event="ground", **asked), "bound")["event_location"]
    change = abs(float(run.v_y[-1]) - float(fine.v_y[-1]))
    assert speed == pytest.approx(rate * located + change, rel=2e-2)


def test_a_discrepancy_and_a_declared_term_are_contributions_as_they_are() -> None:
    """Assert sizes in the number's unit, bounds of two of them, and that each is of its own quantity alone."""
    model = weighed(0.0, discrepancy={"s": {"standard": "70 mg", "description": "buoyancy"}})
    budget = budgeted(model, terms=[xd.Declared("scale", "s", "5e-5 kg", at="1 s", kind="numerical")])
    assert column(budget, "standard_uncertainty")["discrepancy"] == pytest.approx(0.07)
    assert column(budget, "standard_uncertainty")["scale"] == pytest.approx(0.05)
    assert column(budget, "bound")["discrepancy"] == pytest.approx(0.14)
    assert column(budget, "bound")["scale"] == pytest.approx(0.1)
    assert column(budget, "term_rule")["discrepancy"] == "buoyancy"
    assert float(budget.numerical_rss) == pytest.approx(0.05, rel=1e-6)
    assert float(budget.physical_rss) == pytest.approx(math.sqrt(0.04 + 0.36 + 0.03 + 0.0049), rel=1e-9)


def test_lines_say_the_terms_from_the_largest_share_on() -> None:
    """Assert order, numbers and units of what is printed, with and without draws."""
    lines = summary(budgeted(weighed(0.0)))
    assert lines[2] == "result    s at t = 1 s = -1.0 ± 1.3 g (k = 2, numerical part 4e-16 g)" or lines[2].startswith(
        "result    s at t = 1 s = -1.0 ± 1.3 g (k = 2, numerical part "
    )
    assert [line.split()[0] for line in lines[4:7]] == ["b", "a", "c"]
    for words in (" 0.6 g ", " 83.7% ", " -3000 g kg-1 times 0.0002 kg"):
        assert words in lines[4]
    assert lines[-1] == "linear    not checked: draw, with --draws 10000"
    assert "physical 0.66 g; together 0.66 g" in lines[-2]


def test_a_periods_uncertainty_is_that_of_both_crossings() -> None:
    """Assert the sum of what the locations of its two ends are uncertain by, where these differ."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    run = xd.simulate(model, method="rk4", step="0.37 s", until="14 s")
    found, located = xd.diagnose(run, companion=False), cycles(run, "x")
    doubts = located.uncertainties
    assert np.ptp(doubts) > 0.1 * doubts.max()
    assert found.period_uncertainty.values == pytest.approx(doubts[:-1] + doubts[1:], rel=1e-12)
    assert found.period.values == pytest.approx(np.diff(located.times), rel=1e-12)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((16.87412, 0.0061, 3.1e-9, "m"), "16.874 ± 0.012 m (k = 2, numerical part 3e-9 m)"),
        ((-1234.5, 210.0, 0.0, "1"), "-1230 ± 420 (k = 2, numerical part 0)"),
        ((1.234e-6, 7.55e-8, 2e-20, "kg"), "(1.23 ± 0.15)e-6 kg (k = 2, numerical part 2e-20 kg)"),
        ((9.87654e12, 3.2e8, 0.5, "m"), "(9.87654 ± 0.00064)e12 m (k = 2, numerical part 0.5 m)"),
        ((2.5, 0.0, 4e-3, "s"), "2.5 s (k = 2, numerical part 0.004 s)"),
        ((2.5, math.inf, 4e3, "s"), "2.5 s, of unknown uncertainty"),
        ((0.0, 4.97, math.inf, "N"), "0.0 ± 9.9 N (k = 2, numerical part inf N)"),
        ((100.0, 49.9, 12345.0, "N"), "100 ± 100 N (k = 2, numerical part 1e4 N)"),
    ],
)
def test_a_number_is_rounded_by_its_expanded_uncertainty(given: tuple[float, float, float, str], text: str) -> None:
    """Assert two digits of twice the standard uncertainty, the value to the same place, and powers of ten."""
    assert rounded_result(*given) == text


def test_few_draws_are_refused_by_their_number() -> None:
    """Assert the fewest that an interval is taken of, and both ends of the mean and the standard deviation of numbers in a row."""
    found = draw_statistics(np.arange(40.0), 0.9)
    assert (found.mean, found.symmetric, found.shortest) == (19.5, (1.0, 37.0), (0.0, 36.0))
    assert found.standard == pytest.approx(math.sqrt(40 * 41 / 12))
    assert (found.ends_doubt, found.ends_reach) == (math.inf, math.inf)
    with pytest.raises(xd.InputError, match="39 draws are too few for an interval of 0.9"):
        draw_statistics(np.arange(39.0), 0.9)
    with pytest.raises(xd.InputError, match="too few for an interval of 0.99"):
        draw_statistics(np.arange(40.0), 0.99)


@pytest.mark.parametrize(("standard", "apart", "count"), [(0.061, 0.002, 4000), (0.02, 0.0, 400), (0.9, 0.2, 1000)])
def test_the_number_of_draws_that_settles_a_verdict(standard: float, apart: float, count: int) -> None:
    """Assert four and a half standard uncertainties of an end between the tolerance and the distance without its chance."""
    found = DrawStatistics(0.0, standard, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.0)
    single = standard * math.sqrt(0.025 * 0.975) / 0.0584451
    tolerance = {0.061: 0.005, 0.02: 0.005, 0.9: 0.05}[standard]
    away = math.sqrt(max(apart**2 - 2.0 * single**2 / count, 0.0))
    left = max(min(abs(tolerance - away), tolerance), 0.2 * tolerance)
    right = 1.05 * max((4.5 * single / left) ** 2, 2.0 * count)
    assert draws_needed(apart, found, count, 0.95) == pytest.approx(right, rel=0.05)


@pytest.mark.parametrize(
    ("size", "adequate", "said"),
    [(0.099, True, "no matter beside"), (0.101, False, "random order"), (5.0, False, "5 times as large")],
)
def test_residuals_far_below_their_uncertainties_are_no_matter(size: float, adequate: bool, said: str) -> None:
    """Assert a tenth of the uncertainties as the border, under which the order of residuals does not count."""
    row = size * np.repeat([1.0, -1.0], 20)
    found = fit_problem.judge_residuals(float(row @ row), 40, [row], [np.arange(40.0)], has_uncertainties=True)
    assert found.adequate is adequate
    assert said in found.text
    noise = np.tile([1.0, 1.0, -1.0, -1.0], 10) * 0.5
    assert (
        fit_problem.judge_residuals(float(noise @ noise), 40, [noise], [np.arange(40.0)], has_uncertainties=True).text
        == "residuals are no more than noise"
    )


@pytest.mark.parametrize(("probability", "adequate"), [(0.0015, True), (0.00101, True), (0.0009, False)])
def test_residuals_that_are_less_likely_than_a_thousandth_are_no_noise(probability: float, adequate: bool) -> None:
    """Assert the border of sums of squares, and that of runs of one sign of as many quantities as there are."""
    square, noise = float(chi2.isf(probability, 40)), np.tile([1.0, 1.0, -1.0, -1.0], 10)
    found = fit_problem.judge_residuals(square, 40, [noise], [np.arange(40.0)], has_uncertainties=True)
    assert found.adequate is adequate
    assert found.chi_square_probability == pytest.approx(probability, rel=1e-9)
    for above, below in ((30, 10), (1, 20), (8, 8), (0, 20)):
        row, n = np.concatenate([np.ones(above), -np.ones(below)]), above + below
        mean, variance = 1 + 2 * above * below / n, 2 * above * below * (2 * above * below - n) / (n**2 * (n - 1))
        wanted = norm.cdf((2.5 - mean) / math.sqrt(variance)) if above else 0.5 ** (n - 1)
        assert fit_problem.runs_probability(row) == pytest.approx(wanted, rel=1e-9)
    assert math.isnan(fit_problem.runs_probability(np.ones(15)))
    row = np.concatenate([np.repeat([1.0, -1.0], 11), np.tile([1.0, -1.0], 1)])
    one = fit_problem.runs_probability(row)
    assert 1.9e-4 < one < 2e-4
    for count, fits in ((1, False), (5, False), (6, True)):
        several = fit_problem.judge_residuals(
            40.0, 40, [row] * count, [np.arange(24.0)] * count, has_uncertainties=True
        )
        assert several.runs_probability == pytest.approx(count * one, rel=1e-12)
        assert several.adequate is fits


@pytest.mark.parametrize(("sizes", "adequate"), [((1e-4, 1e-4), True), ((1e-4, 1e-2), False), ((1e-2, 1e-2), False)])
def test_without_uncertainties_all_residuals_have_to_be_slight(sizes: tuple[float, float], adequate: bool) -> None:
    """Assert a thousandth of the deviation of the data as the border, for every quantity."""
    rows = [size * np.repeat([1.0, -1.0], 20) for size in sizes]
    measured = [np.tile([1.0, -1.0], 20)] * 2
    assert (
        fit_problem.judge_residuals(
            float(sum(row @ row for row in rows)), 80, rows, measured, has_uncertainties=False
        ).adequate
        is adequate
    )
