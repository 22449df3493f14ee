"""Fits to measured data: known answers, coverage of their uncertainties, what cannot be told apart, wrong input."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import chi2

import xdynamics as xd
from cases.problems import MODELS, particle
from cases.verdicts import verified
from xdynamics.budgeting import fit_problem
from xdynamics.budgeting.fit_problem import FitRecord, FittedNumber, Fitting, with_slopes
from xdynamics.budgeting.fit_records import fit_bounds, number_scales
from xdynamics.budgeting.fitting import _covariance, _fitted_model
from xdynamics.budgeting.multistart import Search
from xdynamics.evidence.comparing.measured import Measured
from xdynamics.units import Unit, parse_unit

NAMES = ["L", "c", "theta", "v_theta"]
TRUE = np.array([1.03, 0.08, 0.35, 0.1])
TIMES = np.linspace(0.02, 10.0, 500)
MARCH: dict[str, Any] = {"method": "dop853", "rtol": 1e-8, "until": "10 s"}


def pendulum() -> xd.Model:
    """A damped pendulum, near the one that is measured."""
    return xd.Model(
        name="bench pendulum",
        coordinates={"theta": "rad"},
        parameters={"L": "1 m", "g": "9.81 m s-2", "c": "0.05 s-1"},
        mass={"theta": "1*kilogram*L**2"},
        forces={"weight": {"theta": "-1*kilogram*g*L*sin(theta)"}, "damping": {"theta": "-c*1*kilogram*L**2*v_theta"}},
        initial={"theta": "0.3 rad", "v_theta": "0 rad s-1"},
    )


def swung() -> np.ndarray:
    """What the one that is measured does."""
    changed = pendulum().replace(
        parameters={"L": TRUE[0], "c": TRUE[1]}, initial={"theta": TRUE[2], "v_theta": TRUE[3]}
    )
    found: np.ndarray = xd.sample(xd.simulate(changed, **MARCH), TIMES).theta.values
    return found


def bench(angles: np.ndarray, seed: int, *, told: bool = True) -> pd.DataFrame:
    """A bench record with noise of 2 mrad, in milliradian."""
    noisy = angles * 1e3 + np.random.default_rng(seed).normal(0.0, 2.0, angles.size)
    doubt = {"u(theta) [mrad]": np.full(angles.size, 2.0)} if told else {}
    return pd.DataFrame({"time [s]": TIMES, "theta [mrad]": noisy, **doubt})


def covered(count: int, *, told: bool) -> tuple[np.ndarray, float]:
    """Return for each parameter the share of fits whose 95 % interval holds the true one, and the mean of chi-square."""
    angles, model, inside, squares = swung(), pendulum(), [], []
    for seed in range(count):
        found = xd.fit(model, bench(angles, seed, told=told), NAMES, **MARCH)
        inside.append(np.abs(found.estimate.values - TRUE) <= 1.96 * found.standard_uncertainty.values)
        squares.append(found.attrs["residual_variance"])
    return np.mean(inside, axis=0), float(np.mean(squares))


@pytest.mark.dear
def test_uncertainties_hold_the_true_numbers() -> None:
    """Assert that about 95 % of intervals hold what is fitted, of 120 that are, and that chi-square is what it should be."""
    shares, square = covered(30, told=True)
    assert 0.89 <= shares.mean() <= 1.0
    assert square == pytest.approx(1.0, abs=0.04)


@pytest.mark.dear
def test_without_uncertainties_residuals_tell_them() -> None:
    """Assert the same uncertainties within their own scatter where the data tell none."""
    angles = swung()
    told, untold = (xd.fit(pendulum(), bench(angles, 3, told=flag), NAMES, **MARCH) for flag in (True, False))
    assert (np.abs(untold.estimate - told.estimate) < 1e-4 * told.standard_uncertainty).all()
    assert untold.standard_uncertainty.values == pytest.approx(told.standard_uncertainty.values, rel=0.1)
    assert math.isnan(untold.attrs["chi_square"])
    assert math.sqrt(untold.attrs["residual_variance"]) == pytest.approx(2e-3, rel=0.1)


class ByHand(FitRecord):
    """A fit of x = a t + b**3 and v = a, whose numbers are known without a march."""

    def computed(self, values: np.ndarray, *, require_all: bool = True) -> np.ndarray:
        """Rows of x at all times, then of v; nothing of a march is missing, `require_all` or not."""
        assert isinstance(require_all, bool)
        a, b = values[:, :1], values[:, 1:]
        return np.concatenate([a * self.data.times + b**3, np.tile(a, self.data.times.size)], axis=1)


def by_hand(*, told: bool = True) -> ByHand:
    """Five times from 2 s on, out of order, in cm and m s-1, with uncertainties of 1 to 5 cm and 0.5 m s-1."""
    mm, speed = parse_unit("mm"), parse_unit("m s-1")
    values = {"x": (np.array([1.0, 2.0, 3.0, 4.0, 5.0]), parse_unit("cm")), "v": (np.full(5, 3.0), speed)}
    doubts = {"x": (np.arange(1.0, 6.0), parse_unit("cm")), "v": (np.full(5, 0.5), speed)}
    data = Measured("bench", np.array([2.0, 12.0, 4.0, 6.0, 8.0]), parse_unit("s"), values, doubts if told else {})
    model = xd.Model(
        name="hand",
        parameters={"a": "2 mm s-1", "b": {"value": "0 g", "uncertainty": 0.25}, "c": "1 ± 0.1 kg", "d": "4 ± 1 m"},
        coordinates={"x": "mm"},
        mass={"x": "c"},
        forces={},
        initial={"x": {"value": "0 mm", "uncertainty": 3.0}, "v_x": "0 m s-1"},
        correlations={"c": {"d": 0.5}, "x": {"d": 0.25}},
    )
    return ByHand(model, ("a", "b"), data, {"x": mm, "v": speed}, {})


def test_what_is_fitted_has_the_models_units_and_its_weights() -> None:
    """Assert numbers, weights, parts of the time, weighted residuals and slopes, and sums of squares by hand."""
    asked = by_hand()
    measured, weights = (
        np.array([10.0, 20, 30, 40, 50, 3, 3, 3, 3, 3]),
        np.array([0.1, 0.05, 1 / 30, 0.025, 0.02, 2, 2, 2, 2, 2]),
    )
    assert asked.measured == pytest.approx(measured)
    assert asked.weights == pytest.approx(weights)
    assert by_hand(told=False).weights.tolist() == [1.0] * 10
    assert asked.in_first_share(0.2).tolist() == [True, False, True, False, False] * 2
    assert asked.in_first_share(0.39).sum() == 4
    assert asked.in_first_share(0.4).sum() == 6
    assert asked.in_first_share(1.0).all()
    problem = Fitting.of_record(asked, np.array([2.0, 0.5]))
    scaled, t = np.array([1.5, 4.0]), asked.data.times
    rows, slopes = np.concatenate([3.0 * t + 8.0, np.full(5, 3.0)]), np.zeros((10, 2))
    slopes[:5, 0], slopes[5:, 0], slopes[:5, 1] = t, 1.0, 12.0
    assert asked.computed(scaled[None] * problem.scales)[0] == pytest.approx(rows)
    for slope, wanted in zip(with_slopes(asked, scaled * problem.scales, problem.scales), (rows, slopes), strict=True):
        assert slope == pytest.approx(wanted, abs=1e-9)
    found, steep = problem.weighted_residuals(scaled)
    assert found == pytest.approx((rows - measured) * weights)
    assert steep == pytest.approx(slopes * weights[:, None] * [2.0, 0.5], abs=1e-9)
    part = asked.in_first_share(0.2)
    assert problem.weighted_residuals(scaled, 0.2)[0] == pytest.approx(((rows - measured) * weights)[part])
    assert problem.squares(scaled[None], 0.2) == pytest.approx([np.sum((((rows - measured) * weights)[part]) ** 2)])
    with pytest.raises(xd.InputError, match="2 numbers are too few"):
        problem.weighted_residuals(scaled, 0.0)


def test_a_run_that_ends_before_is_named_with_its_numbers() -> None:
    """Assert what a body comes to, out of order, nan where it is stopped before a time, and what is said where all are needed."""
    model = particle(
        name="line",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={"far": {"function": "x - 4.5*metre", "action": "stop"}},
    )
    data = Measured("bench", np.array([4.0, 1.0, 2.0]), parse_unit("s"), {"x": (np.zeros(3), parse_unit("m"))}, {})
    asked = FitRecord(model, ("x", "v_x"), data, {"x": parse_unit("m")}, {"method": "rk4", "step": 0.5, "until": 4.0})
    values = np.array([[0.25, 1.0], [0.0, 2.0], [0.5, 0.5]])
    found = asked.computed(values, require_all=False)
    assert found[[0, 2]] == pytest.approx(np.array([[4.25, 1.25, 2.25], [2.5, 1.0, 1.5]]))
    assert found[1] == pytest.approx([np.nan, 2.0, 4.0], nan_ok=True)
    assert asked.computed(values[[0, 2]]) == pytest.approx(found[[0, 2]])
    with pytest.raises(
        xd.InputError, match=r"with x = 0.0, v_x = 2.0 the run ends as 'stopped_by_event' at t = 2.25\d* s, before all"
    ):
        asked.computed(values)


def test_residuals_are_tested_quantity_by_quantity_in_the_order_of_time() -> None:
    """Assert degrees of freedom, sum of squares, and runs of signs of data whose rows are out of order."""
    times = np.concatenate([np.arange(0.0, 20.0, 2.0), np.arange(1.0, 20.0, 2.0)])
    speed, mm = parse_unit("m s-1"), parse_unit("mm")
    noise: dict[str, tuple[np.ndarray, Unit]] = {"x": (np.arange(20.0), mm), "v": (np.arange(20.0), speed)}
    doubts = {name: (np.ones(20), unit) for name, (_, unit) in noise.items()}
    own = by_hand()
    asked = FitRecord(
        own.model, own.names, Measured("bench", times, parse_unit("s"), noise, doubts), own.quantities, {}
    )
    signs = np.concatenate([np.where(times < 10, 1.0, -1.0), np.tile([1.0, -1.0], 10)])
    search = Search("", np.zeros(2), np.zeros(2), 40.0, 1, True, "", signs)
    found = Fitting.of_record(asked, np.ones(2)).residual_tests(search)
    assert (found.adequate, found.text[:36]) == (False, "residuals are not in a random order ")
    assert found.chi_square_probability == pytest.approx(float(chi2.sf(40.0, 38)))


def test_sizes_and_bounds_of_numbers() -> None:
    """Assert a number's own size, else half of what bounds leave, its uncertainty, or one; and bounds in its own unit."""
    own = by_hand()
    asked = FitRecord(own.model, ("a", "b", "x", "v_x"), own.data, own.quantities, {})
    free, alone = np.full(4, np.inf), ((asked,), [*map(FittedNumber, asked.names)])
    start = np.array([asked.declared(name).value for name in asked.names])
    assert start.tolist() == [2.0, 0.0, 0.0, 0.0]
    assert number_scales(*alone, -start, -free, free).tolist() == [2.0, 0.25, 3.0, 1.0]
    low, high = fit_bounds(*alone, {"b": ("-1 kg", "3 kg"), "v_x": (0.0, 5.0), "a": ("2 mm s-1", "1 m s-1")})
    assert low.tolist() == [2.0, -1000.0, -np.inf, 0.0]
    assert high.tolist() == pytest.approx([1000.0, 3000.0, np.inf, 5.0])
    assert number_scales(*alone, start, low, high).tolist() == [2.0, 2000.0, 3.0, 2.5]
    for ends in ((2.0, 2.0), (3.0, 1.0), (2.1, 3.0), (0.0, 1.9), (0.0, 1.0, 5.0)):
        with pytest.raises(xd.InputError, match="need the lowest, then the highest, and 2.0 mm s-1 between them"):
            fit_bounds(*alone, {"a": ends})


def test_a_covariance_is_the_inverse_of_the_normal_matrix() -> None:
    """Assert it and the condition of columns of one length by hand, and who is named where columns tell the same."""
    asked, slopes = by_hand(), np.array([[3.0, 0.0], [4.0, 2.0]])
    alone = Fitting.of_record(asked, np.ones(2))
    covariance, condition = _covariance(alone, slopes)
    assert covariance == pytest.approx(np.linalg.inv(slopes.T @ slopes))
    assert condition == pytest.approx(math.sqrt(1.8 / 0.2))  # columns of length 1 at an angle whose cosine is 0.8
    with pytest.raises(xd.InputError, match="do not change with 'b'"):
        _covariance(alone, np.array([[3.0, 0.0], [4.0, 0.0]]))
    three = Fitting.of_record(FitRecord(asked.model, ("a", "b", "c"), asked.data, asked.quantities, {}), np.ones(3))
    for off, said in ((1e-9, "do not tell a and c apart"), (3e-8, None)):
        columns = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2 * off]])
        if said is None:
            assert _covariance(three, columns)[1] == pytest.approx(2.0 / off, rel=1e-3)
        else:
            with pytest.raises(xd.InputError, match=said):
                _covariance(three, columns)


def test_a_fitted_model_has_what_was_found_and_keeps_the_rest() -> None:
    """Assert values, uncertainties and correlations of what was fitted, 1 at most, and those of others alone."""
    own = by_hand()
    asked = FitRecord(own.model, ("a", "c", "v_x"), own.data, own.quantities, {})
    correlation = np.array([[1.0, -0.5, 1.0 + 1e-12], [-0.5, 1.0, -0.5], [1.0 + 1e-12, -0.5, 1.0]])
    mark = fit_problem.ResidualTests(0.5, 0.5, True, "residuals are no more than noise")
    found = _fitted_model(asked, np.array([5.0, 6.0, 7.0]), np.array([0.5, 0.25, 0.125]), correlation, mark)
    numbers = {
        name: (found.uncertain[name].quantity.value, found.uncertain[name].uncertainty)
        for name in ("a", "c", "v_x", "x")
    }
    assert numbers == {"a": (5.0, 0.5), "c": (6.0, 0.25), "v_x": (7.0, 0.125), "x": (0.0, 3.0)}
    assert found.initial["v_x"].value == 7.0
    assert dict(found.elements.statement.correlations) == {
        ("a", "c"): -0.5,
        ("a", "v_x"): 1.0,
        ("c", "v_x"): -0.5,
        ("x", "d"): 0.25,
    }
    assert found.fit is not None
    assert (found.fit.data, found.fit.adequate, found.fit.description) == (
        "bench",
        True,
        "residuals are no more than noise",
    )
    known = _fitted_model(asked, np.array([5.0, 6.0, 7.0]), np.array([0.5, 0.0, 0.125]), correlation, mark)
    assert dict(known.elements.statement.correlations) == {("a", "v_x"): 1.0, ("x", "d"): 0.25}


def test_a_velocity_that_began_at_rest_begins_as_fitted() -> None:
    """Assert that the fitted model and its text have the velocity, with a contact that the motion strikes."""
    model = xd.Model(
        name="thrown",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        parameters={"g": "9.81 m s-2"},
        forces={"weight": {"potential": "1*kilogram*g*y"}},
        initial={"y": "1 m"},
        contacts={"floor": {"gap": "y", "restitution": 0.5}},
    )
    times = np.linspace(0.05, 0.25, 21)
    noise = np.random.default_rng(1).normal(0.0, 1e-4, times.size)
    bench = pd.DataFrame({"time [s]": times, "y [m]": 1.0 - 2.0 * times - 9.81 / 2.0 * times**2 + noise})
    assert model.elements.statement.at_rest == ("v_y",)
    result = xd.fit(model, bench, ["v_y"], method="rk4", step="10 ms", until="0.3 s")
    fitted = xd.Model.from_text(result.model_toml.values.item())
    assert fitted.initial["v_y"].value == float(result.estimate[0]) == pytest.approx(-2.0, rel=1e-3)
    spread = fitted.uncertain["v_y"].spread  # of 20 degrees of freedom: that of Student's t is wider than its scale
    assert spread is not None
    assert (spread.distribution, spread.degrees_of_freedom) == ("t", 20.0)
    assert spread.standard.value == pytest.approx(float(result.standard_uncertainty[0]) * math.sqrt(20 / 18), rel=1e-12)
    assert fitted.digest == result.attrs["fitted_digest"]


@pytest.mark.dear
def test_a_straight_line_is_that_of_the_normal_equations() -> None:
    """Assert estimates, uncertainties and correlation of x = x0 + v t against weighted linear least squares."""
    rng = np.random.default_rng(5)
    times, doubt = np.linspace(0.0, 4.0, 25), rng.uniform(0.5, 2.0, 25)
    data = xr.Dataset(
        {
            "time": ("row", times, {"units": "s"}),
            "x": ("row", 300.0 + 120.0 * times + doubt * rng.standard_normal(25), {"units": "cm"}),
            "u_x": ("row", doubt, {"units": "cm"}),
        }
    )
    model = particle(
        name="free",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
    )
    found = xd.fit(model, data, ["x", "v_x"], method="rk4", step="0.1 s", until="4 s")
    design = np.stack([np.ones(25), times], axis=1) / (doubt / 100)[:, None]
    covariance = np.linalg.inv(design.T @ design)
    right = covariance @ design.T @ (data.x.values / doubt)
    assert found.estimate.values == pytest.approx(right, rel=1e-10)
    assert found.standard_uncertainty.values == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-8)
    r = covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1])
    assert found.correlation.values == pytest.approx(np.array([[1, r], [r, 1]]), rel=1e-7)
    assert found.attrs["chi_square"] == pytest.approx(
        float(((design @ right - data.x.values / doubt) ** 2).sum()), rel=1e-8
    )
    assert found.residual_x.values == pytest.approx(data.x.values / 100 - right[0] - right[1] * times, abs=1e-12)
    assert found.at_bound.values.tolist() == [0, 0]
    for begin, ends in (("1 m s-1", (0.5, 1.1)), ("2 m s-1", (1.5, 3.0))):
        with pytest.warns(xd.AccuracyWarning, match="not adequate"):
            held = xd.fit(
                model.replace(initial={"v_x": begin}),
                data,
                ["x", "v_x"],
                bounds={"v_x": ends},
                starts=1,
                method="rk4",
                step="0.1 s",
                until="4 s",
            )
        assert held.at_bound.values.tolist() == [0, 1]


def test_the_fitted_model_goes_on_into_a_budget() -> None:
    """Assert that a budget of the fitted model knows the correlations: the uncertainty of x(2 s) is that of the line."""
    rng = np.random.default_rng(6)
    times = np.linspace(0.0, 4.0, 25)
    frame = pd.DataFrame(
        {"time [s]": times, "x [m]": 3 + 1.2 * times + 0.01 * rng.standard_normal(25), "u(x) [m]": 0.01}
    )
    model = particle(
        name="free",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "3 m", "v_x": "1 m s-1"},
    )
    found = xd.fit(model, frame, ["x", "v_x"], method="rk4", step="0.1 s", until="4 s")
    fitted = xd.Model.from_text(found.model_toml.values.item())
    assert fitted.digest == found.attrs["fitted_digest"]
    assert set(fitted.uncertain) == {"x", "v_x"}
    budget = xd.error_budget(fitted, "x", at="2 s", method="rk4", step="0.1 s", until="4 s")
    assert float(budget.physical_rss) == pytest.approx(0.01 / 5, rel=1e-6)  # at the mean of the times: u/sqrt(25)


def test_a_fit_is_saved_opened_and_told(tmp_path: Path) -> None:
    """Assert an archive, its summary, and the verb with the fitted model as a file."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    bench(swung(), 1).to_csv(tmp_path / "bench.csv", index=False)
    (tmp_path / "pendulum.toml").write_text(pendulum().to_toml())

    def call(*arguments: object) -> Any:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    asked = [
        "fit",
        tmp_path / "pendulum.toml",
        tmp_path / "bench.csv",
        "--method",
        "dop853",
        "--rtol",
        "1e-8",
        "--until",
        "10 s",
    ]
    asked += ["--parameter", "L", "--parameter", "c", "--parameter", "theta", "--parameter", "v_theta"]
    done = call(*asked, "-o", tmp_path / "F.nc", "--model", tmp_path / "fitted.toml", "--bounds", "c=0:1 s-1")
    assert done.exit_code == 0, done.output
    assert "L         1.0300" in done.output
    assert len(verified(tmp_path / "F.nc")) == 64
    assert xd.Model.from_toml(tmp_path / "fitted.toml").digest == xd.open_run(tmp_path / "F.nc").attrs["fitted_digest"]
    assert call("show", tmp_path / "F.nc").exit_code == 0
    assert call("plot", tmp_path / "F.nc", "-o", tmp_path / "F.png").exit_code == 0
    bad = call(*asked, "-o", tmp_path / "G.nc", "--bounds", "c=1:2 s-1")
    assert (bad.exit_code, (tmp_path / "G.nc").exists()) == (2, False)


@pytest.mark.parametrize(
    ("names", "more", "said"),
    [
        ([], {}, "need one name or more"),
        (["L", "L"], {}, "each once"),
        (["length"], {}, "'length' is no parameter or initial value"),
        (["L", "g"], {}, "do not tell L and g apart"),
        (["L"], {"bounds": {"c": (0, 1)}}, "bounds name 'c', which is not fitted"),
        (["L"], {"bounds": {"L": (2, 3)}}, "1.0 m between them"),
        (["L"], {"bounds": {"L": ("1 kg", "2 kg")}}, "needs the unit 'm'"),
        (["L"], {"bounds": {"L": 3}}, "need the lowest and the highest"),
        (["L"], {"until": "5 s"}, "row 251: t = 5.0.* s is outside the run"),
        (["L"], {"rtoll": 3}, "no setting 'rtoll'"),
        (["L"], {"starts": 0}, "starts is 0"),
        (["L"], {"starts": True}, "starts is True"),
        (["L"], {"starts": 2.5}, "starts is 2.5"),
        (["L"], {"seed": -1}, "seed is -1"),
    ],
)
def test_what_cannot_be_fitted_is_named(names: list[str], more: dict[str, Any], said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.InputError, match=said):
        xd.fit(pendulum(), bench(np.cos(TIMES), 1), names, **MARCH | more)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"time [s]": [1.0, 2.0], "phi [rad]": [1.0, 2.0]}, "column 'phi .rad.' is no quantity of the model"),
        ({"time [s]": [1.0, 2.0], "theta [m]": [1.0, 2.0]}, "column 'theta' is in 'm'"),
        ({"time [s]": [1.0], "theta [rad]": [1.0]}, "has 1 numbers for 1 parameters"),
        ({"time [s]": [1.0, np.nan], "theta [rad]": [1.0, 2.0]}, "leave out rows with gaps"),
        (
            {
                "time [s]": [1.0, 2.0],
                "theta [rad]": [1.0, 2.0],
                "v_theta [rad s-1]": [1.0, 2.0],
                "u(theta) [rad]": [1.0, 1.0],
            },
            "others have",
        ),
    ],
)
def test_data_that_cannot_be_used_are_named(columns: dict[str, list[float]], said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.InputError, match=said):
        xd.fit(pendulum(), pd.DataFrame(columns), ["L"], **MARCH)


def swing(seed: int) -> tuple[xd.Model, pd.DataFrame, dict[str, float], float]:
    """A damped oscillator whose stiffness, damping and start are off by up to three quarters, and noisy data of a true one."""
    rng = np.random.default_rng([seed, 6])
    w, zeta, m, x0 = (float(rng.uniform(*ends)) for ends in ((1.5, 6.0), (0.005, 0.08), (0.3, 3.0), (0.5, 2.0)))
    g, end = zeta * w, float(rng.uniform(4.0, 14.0)) * 2.0 * math.pi / w
    fast, times = math.sqrt(w * w - g * g), np.sort(rng.uniform(0.01, 1.0, 300)) * end
    exact = x0 * np.exp(-g * times) * (np.cos(fast * times) + g / fast * np.sin(fast * times))
    noise = 0.01 * x0
    frame = pd.DataFrame({"time [s]": times, "x [m]": exact + noise * rng.standard_normal(300), "u(x) [m]": noise})
    true = {"k": m * w * w, "c": 2.0 * g * m, "x": x0}
    off = dict(zip(true, (1.0 + rng.uniform(-0.75, 0.75, 3) * [1.0, 1.0, 0.5]).tolist(), strict=True))
    model = particle(
        name="swing",
        parameters={"m": f"{m!r} kg", "k": f"{off['k'] * true['k']!r} N m-1", "c": f"{off['c'] * true['c']!r} N s m-1"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "-c*v_x"}},
        initial={"x": f"{off['x'] * x0!r} m", "v_x": "0 m s-1"},
    )
    return model, frame, true, end


@pytest.mark.dear
@pytest.mark.every(3)
@pytest.mark.cases(100)
def test_a_start_that_is_off_does_not_lead_astray(case: int) -> None:
    """Assert that the true numbers are within five uncertainties, residuals noise, and every search in the record."""
    model, frame, true, end = swing(case)
    found = xd.fit(model, frame, list(true), method="dop853", rtol=1e-8, until=end)
    assert (np.abs(found.estimate.values - [*true.values()]) < 5.0 * found.standard_uncertainty.values).all()
    assert (found.attrs["converged"], found.attrs["adequate"]) == (1, 1)
    best = int(np.argmin(found.start_square.values))
    assert float(found.start_square[best]) == pytest.approx(found.attrs["chi_square"], rel=1e-9)
    assert found.start_estimate.values[best] == pytest.approx(found.estimate.values, rel=1e-12)
    assert found.start_value.values[0] == pytest.approx(
        [model.parameters["k"].quantity.si, model.parameters["c"].quantity.si, model.initial["x"].si]
    )


@pytest.mark.dear
@pytest.mark.filterwarnings("ignore::xdynamics.faults.AccuracyWarning")
def test_a_fit_that_residuals_speak_against_is_warned_of_refused_and_kept(tmp_path: Path) -> None:
    """Assert the warning, adequate 0, the model's mark, budgets that refuse it unless asked, and exit code 1 of the verb."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    model, frame, _, end = swing(3)
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-8, "until": end}
    with pytest.warns(xd.AccuracyWarning, match=r"not adequate: residuals are .* times as large as the uncertainties"):
        found = xd.fit(model, frame, ["c"], starts=3, **asked)
    assert (found.attrs["converged"], found.attrs["adequate"], found.sizes["start"]) == (1, 0, 3)
    assert found.attrs["chi_square_probability"] < 1e-3
    assert (found.start_square.values >= found.attrs["chi_square"] * (1 - 1e-9)).all()
    fitted = xd.Model.from_text(found.model_toml.values.item())
    assert fitted.fit is not None
    assert not fitted.fit.adequate
    where: dict[str, Any] = {"at": 1.0} | asked
    with pytest.raises(xd.InputError, match="the fit is not adequate: residuals are .* inadequate_fit=True"):
        xd.error_budget(fitted, "x", **where)
    assert xd.error_budget(fitted, "x", inadequate_fit=True, **where).attrs["inadequate_fit"] == 1
    frame.to_csv(tmp_path / "bench.csv", index=False)
    (tmp_path / "swing.toml").write_text(model.to_toml())
    verb = [
        "fit",
        tmp_path / "swing.toml",
        tmp_path / "bench.csv",
        "--parameter",
        "c",
        "--starts",
        2,
        "--method",
        "dop853",
        "--rtol",
        "1e-8",
    ]
    done = CliRunner().invoke(main, [*map(str, verb), "--until", f"{end!r} s", "-o", str(tmp_path / "F.nc")])
    assert done.exit_code == 1, done.output
    assert "verdict   not adequate: residuals are" in done.output
    assert (tmp_path / "F.nc").exists()


@pytest.mark.dear
@pytest.mark.filterwarnings("ignore::xdynamics.faults.AccuracyWarning")
def test_without_uncertainties_the_order_of_residuals_tells() -> None:
    """Assert that a damping that is left out is seen by the signs of residuals, and that noise is not."""
    model, frame, true, end = swing(5)
    bare = frame.drop(columns="u(x) [m]")
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-8, "until": end}
    whole = xd.fit(model, bare, list(true), **asked)
    assert whole.attrs["adequate"] == 1
    assert whole.attrs["runs_probability"] > 1e-3
    assert math.isnan(whole.attrs["chi_square_probability"])
    still = xd.fit(model.replace(parameters={"c": 0.0}), bare, ["k", "x"], starts=2, **asked)
    assert still.attrs["adequate"] == 0
    assert still.attrs["runs_probability"] < 1e-6
    assert "not in a random order" in still.attrs["adequate_text"]


@pytest.mark.cases(100)
def test_a_straight_line_without_uncertainties_is_that_of_the_normal_equations(case: int) -> None:
    """Assert the covariance: the residuals' sum of squares over n - 2 times the inverse of X^T X, and its correlation."""
    rng = np.random.default_rng([case, 7])
    count = int(rng.integers(4, 9))
    times = np.sort(rng.uniform(0.0, 4.0, count))
    data = pd.DataFrame({"time [s]": times, "x [m]": 3.0 + 1.2 * times + 0.3 * rng.standard_normal(count)})
    model = particle(
        name="free",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "3 m", "v_x": "1 m s-1"},
    )
    found = xd.fit(model, data, ["x", "v_x"], method="rk4", step="0.5 s", until="4 s")
    design = np.stack([np.ones(count), times], axis=1)
    right, squares, _, _ = np.linalg.lstsq(design, data["x [m]"].to_numpy(), rcond=None)
    covariance = np.linalg.inv(design.T @ design) * float(squares[0]) / (count - 2)
    assert found.estimate.values == pytest.approx(right, rel=1e-8)
    assert found.standard_uncertainty.values == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
    assert float(found.correlation[0, 1]) == pytest.approx(
        covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1]), rel=1e-6
    )
    assert found.attrs["residual_variance"] == pytest.approx(float(squares[0]) / (count - 2), rel=1e-8)
    assert found.attrs["degrees_of_freedom"] == count - 2


@pytest.mark.dear
def test_runs_of_one_sign() -> None:
    """Assert probabilities of few, usual and many runs, against all arrangements counted."""
    from itertools import combinations

    from xdynamics.budgeting.fit_problem import runs_probability

    def signs(places: tuple[int, ...]) -> np.ndarray:
        return np.where(np.isin(np.arange(16), places), 1.0, -1.0)

    def runs(row: np.ndarray) -> int:
        return 1 + int(np.count_nonzero(row[1:] != row[:-1]))

    every = np.array([runs(signs(one)) for one in combinations(range(16), 8)])
    for places in (
        (0, 1, 2, 3, 4, 5, 6, 7),
        (0, 2, 4, 6, 8, 10, 12, 14),
        (0, 1, 2, 3, 8, 9, 10, 11),
        (0, 1, 4, 5, 8, 9, 12, 13),
    ):
        row = signs(places)
        assert runs_probability(row * 3.0) == pytest.approx(float(np.mean(every <= runs(row))), abs=0.015)
    assert math.isnan(runs_probability(np.ones(15)))
    assert runs_probability(np.ones(20)) == 0.5**19


if __name__ == "__main__":
    print(
        "95 % intervals hold {} of the true numbers; chi-square over its freedom {:.4f}".format(
            *covered(int(sys.argv[1]), told=True)
        )
    )


def test_bands_are_those_of_the_closed_form() -> None:
    """Assert that a fit of x0 in x0 cos 2t is known by |cos 2t| u(x0), and one more measurement with its scatter too."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    times = np.linspace(0.1, 3.0, 25)
    scatter = 0.01 * np.random.default_rng(5).standard_normal(25)
    frame = pd.DataFrame({"time [s]": times, "x [m]": np.cos(2.0 * times) + scatter})
    found = xd.fit(model, frame, ["x"], until="3 s", step="2 ms")
    slope, doubt = np.abs(np.cos(2.0 * times)), float(found.standard_uncertainty[0])
    np.testing.assert_allclose(found.fitted_uncertainty_x, slope * doubt, rtol=1e-4)
    noise = np.sqrt((found.residual_x**2).sum() / found.attrs["degrees_of_freedom"])
    told = frame.assign(**{"u(x) [m]": 0.02})
    known = xd.fit(model, told, ["x"], until="3 s", step="2 ms")
    sizes = [np.hypot(found.fitted_uncertainty_x, noise), np.hypot(known.fitted_uncertainty_x, 0.02)]
    np.testing.assert_allclose(found.predicted_uncertainty_x, sizes[0], rtol=1e-12)
    np.testing.assert_allclose(known.predicted_uncertainty_x, sizes[1], rtol=1e-12)
    axes = xd.plot(found).axes
    assert "one more measurement, 95%" in [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert len(axes[1].collections) >= 2
