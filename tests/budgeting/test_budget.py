"""Error budgets against closed forms: bounds that hold, slopes, totals, draws, and what is refused."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, particle
from cases.uncertain_models import doubtful, slope
from cases.verdicts import verified
from xdynamics.budgeting.budget_summary import budget_lines as lines_of_budget
from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.montecarlo import draw_statistics, judge_linear, tolerance_of
from xdynamics.budgeting.numerical import reversal_distance
from xdynamics.units import parse_quantity

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
BOUNCING = xd.Model.from_toml(MODELS / "bouncing_ball.toml")


def test_slopes_of_event_times_with_drag() -> None:
    """Assert dt/dvt of apex and landing against differentiated closed forms, and the unit."""
    from mpmath import acosh, atan, diff, exp, log, mpf

    v0, g = mpf(20), mpf("9.80665")

    def apex(v: Any) -> Any:
        return v / g * atan(v0 / v)

    def landing(v: Any) -> Any:
        return apex(v) + v / g * acosh(exp(log(1 + (v0 / v) ** 2) / 2))

    for event, closed in (("apex", apex), ("ground", landing)):
        found, unit = slope(xd.error_budget(BALL, "t", event=event, method="dop853", rtol=1e-12), "vt")
        assert found == pytest.approx(float(diff(closed, mpf(30))), rel=1e-10)
        assert unit == "m-1 s2"


def test_slopes_across_ten_impacts() -> None:
    """Assert dt/de and dt/dh of the tenth impact of a bouncing ball."""
    model = doubtful(BOUNCING, e="uncertainty = 0.001", y="half_width = 0.001")
    budget = xd.error_budget(model, "t", event="floor", occurrence=10)
    e, fall = 0.9, math.sqrt(2.0 / 9.81)
    right = fall * 2 * sum(k * e ** (k - 1) for k in range(1, 10))
    assert slope(budget, "e")[0] == pytest.approx(right, rel=1e-10)
    time = fall * (1 + 2 * sum(e**k for k in range(1, 10)))
    assert slope(budget, "y")[0] == pytest.approx(time / 2, rel=1e-10)
    assert float(budget.value) == pytest.approx(time, rel=1e-12)
    parts = [right * 1e-3, time / 2 * 1e-3 / math.sqrt(3)]
    assert float(budget.physical_rss) == pytest.approx(math.hypot(*parts), rel=1e-9)


@pytest.mark.dear
def test_slopes_of_an_oscillator() -> None:
    """Assert dx/dk, dx/dm, dx/dx0 at a time, and of a zero crossing, with units of the inputs other than SI."""
    model = particle(
        name="spring",
        parameters={"m": {"value": "400 g", "uncertainty": "2 g"}, "k": {"value": "90 N m-1", "uncertainty": 0.5}},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": {"value": "30 mm", "uncertainty": "1 mm"}, "v_x": "0 m s-1"},
        events={"zero": {"function": "x", "direction": "falling"}},
    )
    budget = xd.error_budget(model, "x", at="2.3 s", method="dop853", rtol=1e-13, until="3 s")
    w, x0, t = math.sqrt(90 / 0.4), 0.03, 2.3
    swing = -x0 * math.sin(w * t) * t
    right = {"k": swing / (2 * math.sqrt(90 * 0.4)), "m": -swing * w / (2 * 0.4), "x": math.cos(w * t)}
    for name, value in right.items():
        assert slope(budget, name)[0] == pytest.approx(value, rel=1e-9)
    units = {name: slope(budget, name)[1] for name in right}
    assert units == {"k": "m2 N-1", "m": "kg-1 m", "x": "1"}
    crossing = xd.error_budget(model, "t", event="zero", method="dop853", rtol=1e-13, until="3 s")
    assert slope(crossing, "k")[0] == pytest.approx(-math.pi / 4 * math.sqrt(0.4) * 90**-1.5, rel=1e-10)
    assert slope(crossing, "x")[0] == pytest.approx(0.0, abs=1e-12)


def calibrated(draws: int) -> xr.Dataset:
    """The mass calibration of JCGM 101:2008, 9.3."""
    return xd.error_budget(xd.Model.from_toml(MODELS / "mass_calibration.toml"), "dm", at="1 s", draws=draws, seed=2)


@pytest.mark.dear
def test_the_mass_calibration_of_jcgm_101(request: pytest.FixtureRequest) -> None:
    """Assert 0.0539 mg by first order, 0.0755 mg drawn, the interval, and that the linear budget is not adequate."""
    budget = calibrated(200_000 if request.config.getoption("--whole") else 50_000)
    assert float(budget.value) == pytest.approx(1.234e-6, abs=1e-16)
    assert abs(float(budget.value) - 1.234e-6) <= float(budget.numerical_bound)
    assert float(budget.physical_rss) == pytest.approx(0.0539e-6, rel=2e-3)
    assert float(budget.monte_carlo_standard_uncertainty) == pytest.approx(0.0755e-6, rel=5e-3)
    assert budget.monte_carlo_symmetric.values == pytest.approx([1.084e-6, 1.383e-6], abs=0.003e-6)
    assert np.diff(budget.monte_carlo_shortest.values)[0] == pytest.approx(0.2992e-6, rel=0.01)
    assert budget.monte_carlo_shortest.attrs["coverage"] == 0.95
    flags = budget.linear_verdict.attrs["flag_meanings"].split()
    assert flags[int(budget.linear_verdict)] == "not_adequate"


def test_a_number_far_from_linear_is_the_interval_of_its_draws() -> None:
    """Assert that what the one line says holds 95 % of the draws, where twice the linear uncertainty would not."""
    budget = calibrated(2000)
    words = budget.linear_verdict.attrs["flag_meanings"].split()
    assert words[int(budget.linear_verdict)] == "not_adequate"
    low, high = budget.monte_carlo_symmetric.values
    said = re.fullmatch(r"(\S+) to (\S+) kg \(95 % of the draws, numerical part \S+ kg\)", budget.attrs["result"])
    assert said is not None
    assert [float(end) for end in said.groups()] == pytest.approx([low, high], abs=float(budget.monte_carlo_end_doubt))
    assert budget.attrs["result"] == str(budget.result.values)
    assert next(lines_of_budget(budget)) == f"result    dm at t = 1 s = {budget.attrs['result']}"


@pytest.mark.dear
def test_a_linear_number_has_an_adequate_linear_budget() -> None:
    """Assert sums with correlations, shares, and the verdict, of y = y0 + v t at 1 s."""
    text = doubtful(
        xd.Model(
            name="free",
            coordinates={"y": "m"},
            parameters={"m": "1 kg"},
            mass={"y": "m"},
            forces={},
            initial={"y": "1 m", "v_y": "2 m s-1"},
        ),
        y="uncertainty = 0.03",
        v_y="uncertainty = 0.04",
    ).to_toml()
    for correlation, total in ((0.0, 0.05), (0.5, math.sqrt(0.0025 + 0.0012)), (-1.0, 0.01)):
        model = xd.Model.from_text(text + f"\n[correlations]\ny = {{ v_y = {correlation} }}\n")
        budget = xd.error_budget(model, "y", at=1.0, step=0.1, until=1.0, method="rk4", draws=20_000)
        assert float(budget.physical_rss) == pytest.approx(total, rel=1e-9)
        assert float(budget.monte_carlo_standard_uncertainty) == pytest.approx(total, rel=0.03)
        assert float(budget.share.sum()) == pytest.approx(1.0)
        assert int(budget.linear_verdict) != 1
        assert float(budget.total_rss) == pytest.approx(
            math.hypot(float(budget.physical_rss), float(budget.numerical_rss))
        )


def test_uncertain_tables_and_discrepancies() -> None:
    """Assert what independent errors of a measured force do to a speed, and a declared discrepancy."""
    rows = "".join(f"{k / 10},2,0.1\n" for k in range(11))
    model = particle(
        name="pushed",
        parameters={"m": "2 kg"},
        forces={"push": {"x": "f"}},
        drives={"f": {"table": "f.csv", "csv": "t [s],f [N],u(f) [N]\n" + rows}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
        discrepancy={"v_x": {"standard": "3 mm s-1", "description": "the rail"}},
    )
    budget = xd.error_budget(model, "v_x", at="1 s", step="10 ms", until="1 s", method="rk4")
    table = {name: float(budget.standard_uncertainty[i]) for i, name in enumerate(budget.term_name.values.tolist())}
    weights = np.array([0.05, *[0.1] * 9, 0.05])  # of the trapezoidal rule, which is exact for straight pieces
    assert table["f"] == pytest.approx(0.1 / 2 * math.sqrt((weights**2).sum()), rel=1e-9)
    assert table["discrepancy"] == pytest.approx(3e-3)
    assert float(budget.physical_rss) == pytest.approx(math.hypot(table["f"], 3e-3))


@pytest.mark.dear
def test_declared_terms_are_of_this_very_number() -> None:
    """Assert that a term of another quantity, unit, time, event or occurrence is refused by name."""
    ok = xd.Declared("scale", "y", parse_quantity("1 mm"), at=1.0, description="reading the scale")
    budget = xd.error_budget(BALL, "y", at=1.0, method="dormand_prince", rtol=1e-8, terms=[ok])
    assert float(budget.standard_uncertainty[budget.term_name.values.tolist().index("scale")]) == 1e-3
    for bad, said in [
        (xd.Declared("clock", "t", parse_quantity("1 ms"), event="apex"), "'clock' is of time of apex"),
        (xd.Declared("scale", "y", parse_quantity("1 ms"), at=1.0), "has the unit 'm'"),
        (xd.Declared("scale", "y", parse_quantity("1 mm"), at=2.0), "y at t = 2 s"),
        (xd.Declared("scale", "v_y", parse_quantity("1 mm"), at=1.0), "v_y at t = 1 s"),
        (xd.Declared("scale", "y", parse_quantity("1 mm"), at=1.0, kind="moral"), "there are numerical, physical"),
        (xd.Declared("vt", "y", parse_quantity("1 mm"), at=1.0), "two terms 'vt'"),
        (xd.Declared("scale", "y", parse_quantity("-1 mm"), at=1.0), "non-negative"),
    ]:
        with pytest.raises(xd.InputError, match=said):
            xd.error_budget(BALL, "y", at=1.0, method="dormand_prince", rtol=1e-8, terms=[bad])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"quantity": "y"}, "give at='1 s' or event='ground', one of them"),
        ({"quantity": "y", "at": 1.0, "event": "apex"}, "one of them"),
        ({"quantity": "z", "at": 1.0}, "quantity is 'z'"),
        ({"quantity": "t", "at": 1.0}, "total_energy, at an event t, and without a time"),
        ({"quantity": "y", "event": "summit"}, "event is 'summit'; there are apex, ground"),
        ({"quantity": "y", "event": "apex", "occurrence": 2}, "met 1 times in the run, and number 2"),
        ({"quantity": "y", "event": "apex", "occurrence": 0}, "occurrence is 0"),
        ({"quantity": "y", "event": "apex", "side": "beside"}, "side is 'beside'"),
        ({"quantity": "y", "at": "1 kg"}, "1 kg"),
        ({"quantity": "y", "at": 99.0}, "outside the run"),
        ({"quantity": "y", "at": 1.0, "draws": 7}, "draws is 7"),
        ({"quantity": "y", "at": 1.0, "seed": -1}, "seed is -1"),
        ({"quantity": "y", "at": 1.0, "coverage": 95}, "coverage is 95"),
        ({"quantity": "y", "at": 1.0, "rtoll": 1e-6}, "no setting 'rtoll'"),
        ({"quantity": "y", "at": 1.0, "rtol": 3e-15}, "give a larger one"),
        ({"quantity": "y", "at": 1.0, "draws": 100, "coverage": 0.999}, "too few for an interval"),
    ],
)
def test_what_cannot_be_budgeted_is_named(given: dict[str, Any], said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.InputError, match=said):
        xd.error_budget(BALL, **{"method": "dormand_prince", "rtol": 1e-8} | given)


def test_an_input_that_may_undo_the_event_is_told() -> None:
    """Assert that a number which is not there any more for inputs a little off is no linear budget's."""
    model = doubtful(
        xd.Model(
            name="hop",
            coordinates={"y": "m"},
            parameters={"m": "1 kg", "g": "10 m s-2"},
            mass={"y": "m"},
            forces={"weight": {"y": "-m*g"}},
            initial={"y": "0 m", "v_y": "10 m s-1"},
            events={"line": {"function": "y - 4.9999*metre", "direction": "rising"}},
        ),
        v_y="uncertainty = 0.001",
    )
    with pytest.raises(xd.InputError, match="'v_y' is changed by .* less than its uncertainty"):
        xd.error_budget(model, "t", event="line", until="2 s", step="10 ms", method="rk4")


def test_intervals_and_verdicts_of_draws() -> None:
    """Assert intervals of a skew distribution, JCGM 101's tolerance, and that few draws leave the verdict open."""
    values = np.sort(np.random.default_rng(1).exponential(size=200_000))
    found = draw_statistics(np.random.default_rng(2).permutation(values), 0.95)
    assert found.shortest == pytest.approx((0.0, -math.log(0.05)), abs=0.03)
    assert found.symmetric == pytest.approx((-math.log(0.975), -math.log(0.025)), abs=0.04)
    assert found.standard == pytest.approx(1.0, rel=0.01)
    assert judge_linear(1.0, 1.0, found, 0.95)[0] == 1
    assert [tolerance_of(value) for value in (0.0755, 0.0968, 3.0, 12.0)] == pytest.approx([0.005, 0.05, 0.5, 5.0])
    normal = draw_statistics(5.0 + 0.3 * np.random.default_rng(3).standard_normal(200_000), 0.95)
    assert judge_linear(5.0, 0.3, normal, 0.95)[0] == 0
    assert (
        judge_linear(5.0, 0.3, draw_statistics(5.0 + 0.3 * np.random.default_rng(4).standard_normal(60), 0.9), 0.9)[0]
        == 2
    )


@pytest.mark.dear
def test_the_same_budget_twice_and_from_a_file(tmp_path: Any) -> None:
    """Assert that a budget is the same each time, and is saved, opened, verified, told and drawn."""
    from xdynamics.documenting.summary import summary

    one, other = (
        xd.error_budget(BALL, "t", event="ground", method="dormand_prince", rtol=1e-7, draws=400, seed=3) for _ in "ab"
    )
    assert all(other[name].variable.equals(one[name].variable) for name in one.variables)
    xd.save(one, tmp_path / "B.nc")
    assert len(verified(tmp_path / "B.nc")) == 64
    with xd.open_run(tmp_path / "B.nc") as found:
        assert found.bound.dims == ("term",)
        assert found.monte_carlo_shortest.dims == ("bound",)
        lines = summary(found)
        assert lines[2].startswith("result    time of ground = 3.711 ± 0.040 s (k = 2, numerical part ")
        xd.plot(found, tmp_path / "B.png")
    assert (tmp_path / "B.png").stat().st_size > 10_000


def test_the_verb(tmp_path: Any) -> None:
    """Assert a budget from the command line, its file, and errors in one line that write nothing."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    def call(*arguments: object) -> Any:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    asked = [
        "budget",
        MODELS / "ball_drag.toml",
        "--method",
        "dormand_prince",
        "--rtol",
        "1e-8",
        "-o",
        tmp_path / "B.nc",
    ]
    bad = call(*asked, "--quantity", "y", "--at", "1 kg")
    assert (bad.exit_code, len(bad.output.strip().split("\n"))) == (2, 1)
    assert not (tmp_path / "B.nc").exists()
    done = call(*asked, "--quantity", "t", "--event", "ground", "--draws", "200")
    assert done.exit_code == 0, done.output
    assert "result    time of ground = 3.711 ± 0.040 s" in done.output
    assert call("verify", tmp_path / "B.nc").exit_code == 0
    assert call("show", tmp_path / "B.nc").output.startswith("error budget of Ball thrown upward")
    assert call("plot", tmp_path / "B.nc", "-o", tmp_path / "B.svg").exit_code == 0


@pytest.mark.dear
def test_draws_go_on_until_intervals_are_known() -> None:
    """Assert that draws are doubled until the ends are known, and that what cannot be wanted is named."""
    asked: dict[str, Any] = {"quantity": "t", "event": "ground", "method": "dormand_prince", "rtol": 1e-6}
    coarse = xd.error_budget(BALL, **asked, until_uncertainty="10 ms at 95 %")
    fine = xd.error_budget(BALL, **asked, until_uncertainty="0.8 ms at 95 %")
    assert coarse.attrs["draws"] == 4096 < fine.attrs["draws"]
    assert 1.96 * float(fine.monte_carlo_end_doubt) <= 0.8e-3
    for bad in ("1 m", "-1 s", "1 s at 200 %", "1 s at many %"):
        with pytest.raises(xd.InputError, match="until_uncertainty is"):
            xd.error_budget(BALL, **asked, until_uncertainty=bad)


@pytest.mark.dear
def test_shares_of_a_number_that_is_not_linear() -> None:
    """Assert Sobol indices from declared distributions: of the mass calibration the densities count together alone."""
    model = xd.Model.from_toml(MODELS / "mass_calibration.toml")
    found = xd.sobol_indices(model, ["mR", "dmR", "ra", "rW", "rR"], "end_dm", draws=4096)
    table = {
        str(name): (float(found.first_order[i]), float(found.total_order[i]))
        for i, name in enumerate(found.parameter_name.values)
    }
    whole = 0.0755**2
    assert table["mR"] == pytest.approx((0.05**2 / whole, 0.05**2 / whole), abs=0.03)
    assert table["ra"][0] == pytest.approx(0.0, abs=0.03)
    assert table["ra"][1] == pytest.approx(1 - 0.0539**2 / whole, abs=0.03)
    with pytest.raises(xd.InputError, match="'g' has no uncertainty"):
        xd.sobol_indices(BALL, ["g"], "end_y", until="1 s", draws=64)


def tone(**spread: str) -> xd.Model:
    """A phase that grows with a rate, and its sine."""
    model = xd.Model(
        name="tone",
        parameters={"w": "6283.185307179586 s-1"},
        states={"ph": {"unit": "1", "rate": "w"}},
        initial={"ph": "0"},
        observables={"x": "sin(ph)", "kink": "abs(w/(6283.185307179586/second) - 1)"},
    )
    return doubtful(model, **spread)


def test_slopes_are_of_changes_as_large_as_the_uncertainty() -> None:
    """Assert the slope of a phase of thousands of turns, where a per cent of the rate is many whole turns."""
    budget = xd.error_budget(tone(w="uncertainty = 1e-3"), "x", at=10.0, step=0.01, until=10.0, method="rk4")
    assert slope(budget, "w")[0] == pytest.approx(10.0, rel=1e-6)
    assert float(budget.physical_rss) == pytest.approx(0.01, rel=1e-6)


def test_a_slope_that_is_none_is_warned_of() -> None:
    """Assert that a kink at the value itself is told where it counts."""
    with pytest.warns(xd.AccuracyWarning, match="does not change in proportion with 'w'"):
        xd.error_budget(tone(w="uncertainty = 1e-3"), "kink", at=1.0, step=0.01, until=1.0, method="rk4")


def test_numbers_in_other_units_by_inputs_without_one() -> None:
    """Assert the unit of a slope of grams by a pure number, and of a start in degrees."""
    model = xd.Model(
        name="leak",
        parameters={"n": {"value": "2", "uncertainty": 0.1}},
        states={"fuel": {"unit": "g", "rate": "-0.001*kilogram*n/second"}},
        initial={"fuel": {"value": "10 g", "uncertainty": "1 mg"}},
    )
    budget = xd.error_budget(model, "fuel", at=2.0, step=0.1, until=2.0, method="rk4")
    assert slope(budget, "n") == (pytest.approx(-2.0, rel=1e-9), "g")
    assert slope(budget, "fuel")[0] == pytest.approx(1000.0, rel=1e-9)
    assert budget.value.attrs["units"] == "g"


def test_terms_that_cancel_leave_nothing() -> None:
    """Assert zero, not nan, of a difference of two numbers that are one and the same."""
    model = xd.Model(
        name="free",
        coordinates={"y": "m"},
        parameters={"m": "1 kg"},
        mass={"y": "m"},
        forces={},
        initial={"y": {"value": "1 m", "uncertainty": 0.03}, "v_y": {"value": "2 m s-1", "uncertainty": 0.03}},
        correlations={"y": {"v_y": -1.0}},
    )
    budget = xd.error_budget(model, "y", at=1.0, step=0.1, until=1.0, method="rk4")
    assert float(budget.physical_rss) == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(budget.share).all()
    assert np.isfinite(float(budget.total_rss))


def test_draws_have_what_the_linear_budget_has() -> None:
    """Assert that tables, discrepancies and declared terms are in the draws too, also where nothing else is."""
    rows = "".join(f"{k / 10},2,0.1\n" for k in range(11))
    model = particle(
        name="pushed",
        parameters={"m": "2 kg"},
        forces={"push": {"x": "f"}},
        drives={"f": {"table": "f.csv", "csv": "t [s],f [N],u(f) [N]\n" + rows}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
        discrepancy={"v_x": "30 mm s-1"},
    )
    more = [xd.Declared("scale", "v_x", "20 mm s-1", at="1 s")]
    budget = xd.error_budget(model, "v_x", at="1 s", step="10 ms", until="1 s", method="rk4", draws=20_000, terms=more)
    assert float(budget.monte_carlo_standard_uncertainty) == pytest.approx(float(budget.physical_rss), rel=0.02)
    assert int(budget.linear_verdict) != 1


@pytest.mark.dear
def test_two_digits_of_the_uncertainty_ask_more() -> None:
    """Assert JCGM 101:2008, 9.2.4: one rectangular input that dominates is not adequate by two digits."""
    model = xd.Model(
        name="sum",
        parameters={
            f"a{k}": {"value": "0", "half_width": width}
            for k, width in enumerate((3**0.5, 3**0.5, 3**0.5, 10 * 3**0.5))
        },
        states={"s": {"unit": "1", "rate": "0/second"}},
        initial={"s": "0"},
        observables={"total": "a0 + a1 + a2 + a3"},
    )
    asked: dict[str, Any] = {"at": 1.0, "step": 1.0, "until": 1.0, "method": "forward_euler", "draws": 100_000}
    two = xd.error_budget(model, "total", digits=2, **asked)
    assert float(two.physical_rss) == pytest.approx(10.1, abs=0.05)
    assert two.monte_carlo_symmetric.values == pytest.approx([-17.0, 17.0], abs=0.2)
    assert int(two.linear_verdict) == 1
    assert draw_statistics(np.arange(1.0, 1001.0), 0.95).symmetric == (25.0, 975.0)


@pytest.mark.parametrize(
    "terms",
    [
        ["c"],
        [{}],
        xd.Declared("c", "y", "0.1", at=1.0),
        [xd.Declared(5, "y", "1 mm", at=1.0)],
        [xd.Declared("c", "y", "1 mm", at="1 kg")],
    ],
)  # type: ignore[arg-type]
def test_terms_that_are_none_are_named(terms: Any) -> None:
    """Assert one clear error for what is no declared term."""
    with pytest.raises(xd.InputError, match=r"needs Declared|has the unit|needs a word|1 kg"):
        xd.error_budget(BALL, "y", at=1.0, method="dormand_prince", rtol=1e-8, terms=terms)


@pytest.mark.parametrize("size", [1e-9, 1.0, 9.4607304725808e15])
def test_bounds_hold_with_absolute_tolerances_on_any_scale(size: float) -> None:
    """Assert that absolute tolerances get finer with the relative one: a nanometre, a metre, a light year."""
    model = particle(
        name="spring",
        parameters={"m": "1 kg", "k": "4 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": f"{size!r} m", "v_x": "0 m s-1"},
    )
    atol = {"x": f"{1e-9 * size!r} m", "v_x": f"{1e-9 * size!r} m s-1"}
    budget = xd.error_budget(model, "x", at="3 s", method="dop853", rtol=1e-9, atol=atol, until="4 s")
    off = abs(float(budget.value) - size * math.cos(6.0))
    assert off <= float(budget.numerical_bound) <= 4.0 * off


REVERSED = xd.Model(
    name="swing",
    coordinates={"x": "m", "y": "m"},
    parameters={"k": "4 s-2"},
    mass={"x": "1*kilogram", "y": "2*kilogram"},
    forces={"spring": {"potential": "k*1*kilogram*(x**2/2 + (x*y)**2/(1*metre)**2 + y**2/3 + x**3/(5*metre))"}},
    initial={"x": "0.7 m", "v_x": "0.1 m s-1", "y": "0.4 m", "v_y": "-0.2 m s-1"},
)


@pytest.mark.every(4)
@pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")
@pytest.mark.parametrize("method", [name for name, one in xd.METHODS.items() if not one.refusals(REVERSED)])
def test_symmetric_methods_march_back(method: str) -> None:
    """Assert that a method comes back to its start, but for rounding, just if it says that it is symmetric."""
    run = xd.simulate(REVERSED, method=method, step="250 ms", until="5 s")
    end = {name: float(run[name][-1]) * (-1 if name.startswith("v_") else 1) for name in ("x", "v_x", "y", "v_y")}
    back = xd.simulate(REVERSED.replace(initial=end), method=method, step="250 ms", until="5 s")
    off = max(abs(float(back[name][-1]) - float(run[name][0])) for name in ("x", "y"))
    assert (off < 1e-12) is xd.METHODS[method].symmetric


def test_rounding_of_a_symmetric_method_is_seen_by_marching_back() -> None:
    """Assert that the way back is told, is what rounding does, and that a time-dependent force has none."""
    asked: dict[str, Any] = {"method": "velocity_verlet", "step": 0.05, "until": 5.0, "scales": {"length": "1.5 m"}}
    budget = xd.error_budget(REVERSED, "x", at=4.02, summation="plain", **asked)  # scales have no twin of 31 digits
    rule = str(budget.term_rule.values[1])
    distance = float(rule.partition("back by its own steps the run comes to ")[2].split()[0])
    assert 0.0 < distance < 1e-12
    assert distance <= 1.01 * float(budget.bound[1])
    forced = (
        REVERSED.to_toml()
        .replace('[forces."spring"]', '[forces."push"]\n"x" = "1e-3*newton*sin(t/second)"\n[forces."spring"]')
        .replace("[forces.spring]", '[forces.push]\nx = "1e-3*newton*sin(t/second)"\n[forces.spring]')
    )
    model = xd.Model.from_text(forced)
    assert "push" in model.forces
    assert "marched back" not in str(xd.error_budget(model, "x", at=4.0, **asked).term_rule.values[1])


def test_what_steps_do_not_undo_is_not_marched_back() -> None:
    """Assert that one step is undone as far as rounding, and none of a run with an event, of energy, or of rk4."""
    asked: dict[str, Any] = {"method": "velocity_verlet", "step": 0.25, "until": 1.0, "summation": "plain"}
    run = xd.simulate(REVERSED, **asked)
    for quantity, at in (("x", 0.25), ("x", 0.3), ("v_y", 1.0)):
        assert reversal_distance(run, Measurand(REVERSED, Target(quantity, at), asked)) == pytest.approx(0.0, abs=1e-14)
    assert reversal_distance(run, Measurand(REVERSED, Target("x", 0.2), asked)) is None
    assert reversal_distance(run, Measurand(REVERSED, Target("total_energy", 1.0), asked)) is None
    assert reversal_distance(run, Measurand(REVERSED, Target("x", None, "never"), asked)) is None
    watched = xd.Model.from_text(REVERSED.to_toml() + '\n[events.never]\nfunction = "x - 9*metre"\n')
    fourth = asked | {"method": "rk4"}
    for model, how in ((watched, asked), (REVERSED, fourth)):
        assert reversal_distance(xd.simulate(model, **how), Measurand(model, Target("x", 1.0), how)) is None


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("given", "si", "slope_units"),
    [
        ("50 N s m-1", "N s m-1", "rad N-1 s-1 m"),
        ("50 mN s m-1", "N s m-1", "rad N-1 s-1 m"),
        ("3 kg s-1", "kg s-1", "rad kg-1 s"),
        ("2 N m", "N m", "rad N-1 m-1"),
        ("5 J", "J", "rad J-1"),
        ("20 degree s-1", "rad s-1", "s"),
        ("3 mrad", "rad", "1"),
        ("7 kW", "W", "rad W-1"),
        ("4 km h-1", "m s-1", "rad m-1 s"),
        ("3 g", "kg", "rad kg-1"),
        ("2 lbf", "N", "rad N-1"),
    ],
)
def test_units_of_inputs_are_spelled_as_they_were_declared(given: str, si: str, slope_units: str) -> None:
    """Assert the names that the model has, in SI: of a damping N s m-1 and not kg s-1, of a torque N m, of an angle rad."""
    value, unit = float(given.split(maxsplit=1)[0]), given.split(maxsplit=1)[1]
    model = xd.Model(
        name="turn",
        parameters={"p": {"value": given, "uncertainty": 0.1 * value}, "one": f"1 {unit}"},
        states={"phi": {"unit": "rad", "rate": "p/one*radian/second"}},
        initial={"phi": "0 rad"},
    )
    budget = xd.error_budget(model, "phi", at="2 s", step=0.1, until="2 s", method="rk4")
    i = budget["term_name"].values.tolist().index("p")
    assert (budget.input_units.values[i], budget.sensitivity_units.values[i]) == (si, slope_units)
    assert budget.value.attrs["units"] == "rad"
    factor = float(parse_quantity(f"1 {unit}").si)
    assert float(budget.sensitivity[i]) == pytest.approx(2.0 / factor, rel=1e-9)
    assert float(budget.input_uncertainty[i]) == pytest.approx(0.1 * value * factor)
    assert float(budget.standard_uncertainty[i]) == pytest.approx(0.2 * value, rel=1e-9)
