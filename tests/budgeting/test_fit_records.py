"""Fits to event times, to several records, with outliers, and their intervals: against closed forms and scipy's fits."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq, least_squares
from scipy.stats import norm
from scipy.stats import t as student

import xdynamics as xd
from cases.command_line import call
from cases.problems import particle
from xdynamics.budgeting.fit_problem import FitRecord
from xdynamics.budgeting.multistart import Loss, loss_by_name, quantile, search_from_start
from xdynamics.documenting.summary import summary
from xdynamics.evidence.comparing.measured import read_measured_data
from xdynamics.units import parse_unit

G = 9.81
LINE: dict[str, Any] = {"method": "rk4", "step": "0.5 s", "until": "4 s"}
BOUNCES: dict[str, Any] = {"method": "rk4", "step": "0.05 s", "until": "5 s"}  # exact on a parabola


def ball() -> xd.Model:
    """A ball that falls on a floor from a height that is not quite known."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "50 g", "g": f"{G} m s-2", "e": "0.8"},
        mass={"y": "m"},
        forces={"weight": {"potential": "m*g*y"}},
        initial={"y": "0.95 m"},
        contacts={"floor": {"gap": "y", "restitution": "e"}},
    )


def clicks(e: float, h: float, count: int) -> np.ndarray:
    """Times of impacts: the fall, then flights of twice its time, each shorter by the restitution."""
    fall = np.sqrt(2.0 * h / G)
    return np.concatenate([[fall], fall + 2.0 * fall * np.cumsum(e ** np.arange(1, count))])


def free(name: str = "free") -> xd.Model:
    """A body that no force acts on."""
    return particle(
        name=name,
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "3 m", "v_x": "1 m s-1"},
    )


def line(rng: np.random.Generator, times: np.ndarray, begin: float, noise: float, *, told: bool = True) -> pd.DataFrame:
    """A record of x = begin + 1.2 t."""
    values = begin + 1.2 * times + noise * rng.standard_normal(times.size)
    return pd.DataFrame({"t [s]": times, "x [m]": values} | ({"u(x) [m]": np.full(times.size, noise)} if told else {}))


def test_the_zero_of_a_recording_is_found_too() -> None:
    """Assert restitution, height and the clock's offset, with uncertainties and correlation, against scipy's fit of the closed form."""
    noise, zero = 2e-4, 17.3
    heard = zero + clicks(0.82, 1.0, 8) + noise * np.random.default_rng(3).standard_normal(8)
    data = pd.DataFrame({"event_time_floor [ms]": 1e3 * heard, "u(event_time_floor) [ms]": np.full(8, 1e3 * noise)})
    found = xd.fit(ball(), data, ["e", "y", "offset"], **BOUNCES)
    right = least_squares(
        lambda p: (p[2] + clicks(*p[:2], 8) - heard) / noise, [0.8, 0.95, 17.0], xtol=1e-15, x_scale=[1e-3, 1e-3, 1e-3]
    )
    covariance = np.linalg.inv(right.jac.T @ right.jac)
    deviations = np.sqrt(np.diag(covariance))
    assert found.parameter_name.values.tolist() == ["e", "y", "offset"]
    assert found.parameter_units.values.tolist()[2] == "s"
    assert found.estimate.values == pytest.approx(right.x, rel=1e-7)
    assert found.standard_uncertainty.values == pytest.approx(deviations, rel=1e-4)
    assert found.correlation.values == pytest.approx(covariance / np.outer(deviations, deviations), abs=1e-4)
    fitted = xd.Model.from_text(found.model_toml.values.item())
    assert "offset" not in {*fitted.parameters, *fitted.initial}
    assert float(fitted.parameters["e"].quantity.si) == pytest.approx(0.82, abs=1e-3)


def test_each_recording_has_a_zero_of_its_own() -> None:
    """Assert the offsets of two recordings of one ball, and that a clock which nobody fits has to agree with the run."""
    one, two = (
        pd.DataFrame({"event_time_floor [s]": zero + clicks(0.8, 0.95, count), "u(event_time_floor) [s]": 1e-4})
        for zero, count in ((-3.25, 5), (100.5, 6))
    )
    found = xd.fit(ball(), {"first": one, "second": two}, ["e"], own=["offset"], **BOUNCES)
    assert found.estimate.values == pytest.approx([0.8, -3.25, 100.5], abs=1e-7)
    assert found.parameter_record.values.tolist() == ["", "first", "second"]
    with pytest.raises(xd.InputError, match="is outside the run"):
        xd.fit(ball(), two, ["e"], **BOUNCES)


def swing(k: float, zero: float, at: np.ndarray) -> np.ndarray:
    """Positions of a spring of 2 kg, damped by 1.2 kg/s, that is let go at 1 m when the clock reads zero."""
    decay = 0.3
    rate = np.sqrt(k / 2.0 - decay**2)
    since = at - zero
    return np.exp(-decay * since) * (np.cos(rate * since) + decay / rate * np.sin(rate * since))


@pytest.fixture(scope="module")
def swung() -> Any:
    """A recording of 40 positions of such a spring, whose clock reads -4.37 s at the start, and its noise."""
    at = np.linspace(-4.2, 4.8, 40)
    noise = 0.01
    return at, swing(8.0, -4.37, at) + noise * np.random.default_rng(5).standard_normal(40), noise


def spring() -> xd.Model:
    """Such a spring, whose stiffness is not quite known."""
    return particle(
        name="spring",
        parameters={"m": "2 kg", "k": "7.7 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}, "damping": {"x": "-1.2*kilogram/second*v_x"}},
        initial={"x": "1 m"},
        run={"method": "dop853", "rtol": 1e-11, "until": "12 s"},
    )


def test_the_zero_of_a_recording_of_positions_is_found(swung: Any) -> None:
    """Assert stiffness, offset, uncertainties and correlation against scipy's fit of the closed form, and the fitted values."""
    at, heard, noise = swung
    found = xd.fit(spring(), pd.DataFrame({"time [s]": at, "x [m]": heard, "u(x) [m]": noise}), ["k", "offset"])
    right = least_squares(lambda p: (swing(*p, at) - heard) / noise, [8.0, -4.37], xtol=1e-15, ftol=1e-15)
    covariance = np.linalg.inv(right.jac.T @ right.jac)
    deviations = np.sqrt(np.diag(covariance))
    assert found.estimate.values == pytest.approx(right.x, rel=1e-7)
    assert found.standard_uncertainty.values == pytest.approx(deviations, rel=1e-4)
    assert float(found.correlation[0, 1]) == pytest.approx(covariance[0, 1] / deviations.prod(), abs=1e-4)
    assert found.residual_x.values == pytest.approx(heard - swing(*right.x, at), abs=1e-8)
    assert (found.parameter_units.values.tolist(), found.attrs["adequate"]) == (["N m-1", "s"], 1)
    assert "offset" not in xd.Model.from_text(found.model_toml.values.item()).parameters


def test_recordings_of_positions_have_zeros_of_their_own(swung: Any) -> None:
    """Assert the offsets of three parts of a recording, moved by known times, and the whole one's where there is no noise."""
    at = swung[0]
    parts = {
        f"part{k}": pd.DataFrame({"time [s]": at[k::3] + k, "x [m]": swing(8.0, -4.37, at[k::3])}) for k in range(3)
    }
    found = xd.fit(spring(), parts, ["k"], own=["offset"])
    assert found.estimate.values == pytest.approx([8.0, -4.37, -3.37, -2.37], abs=1e-7)


@pytest.mark.parametrize(
    ("until", "bounds", "said"),
    [
        (
            "9 s",
            {},
            r"no offset has all that was measured inside the runs: it would be from -4\.2 to -4\.2; end runs later",
        ),
        ("5 s", {}, r"from -0\.2 to -4\.2; end runs later by until, or leave out what was recorded before"),
        ("12 s", {"offset": ("1 s", "2 s")}, r"it would be from 1 to -4\.2"),
    ],
)
def test_offsets_without_room_are_refused(swung: Any, until: str, bounds: Any, said: str) -> None:
    """Assert the range and the remedy where readings would lie outside of the run."""
    data = pd.DataFrame({"time [s]": swung[0], "x [m]": swung[1]})
    with pytest.raises(xd.InputError, match=said):
        xd.fit(spring(), data, ["k", "offset"], until=until, bounds=bounds)


def test_many_offsets_are_marched_in_parts(swung: Any) -> None:
    """Assert the rows of twenty unlike offsets, in the order in which they were given."""
    model, at = spring(), swung[0]
    table = read_measured_data(pd.DataFrame({"time [s]": at, "x [m]": swung[1]}), ("x",), "refuse", model.time_unit)
    asked = FitRecord(model, ("k", "offset"), table, {"x": parse_unit("m")}, {})
    zeros = -4.2 - np.random.default_rng(2).permutation(20) / 10.0
    rows = asked.computed(np.column_stack([np.full(20, 8.0), zeros]))
    assert rows == pytest.approx(np.array([swing(8.0, zero, at) for zero in zeros]), abs=1e-8)


def test_the_sound_of_a_ball_gives_its_restitution() -> None:
    """Assert estimates, uncertainties and correlation from impact times against scipy's fit of the closed form."""
    noise = 2e-4
    heard = clicks(0.82, 1.0, 8) + noise * np.random.default_rng(3).standard_normal(8)
    data = pd.DataFrame({"event_time_floor [ms]": 1e3 * heard, "u(event_time_floor) [ms]": np.full(8, 1e3 * noise)})
    found = xd.fit(ball(), data, ["e", "y"], **BOUNCES)
    right = least_squares(lambda p: (clicks(*p, 8) - heard) / noise, [0.8, 0.95], xtol=1e-15, x_scale=[1e-3, 1e-3])
    covariance = np.linalg.inv(right.jac.T @ right.jac)
    assert found.estimate.values == pytest.approx(right.x, rel=1e-7)
    assert found.standard_uncertainty.values == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)
    assert found.attrs["chi_square"] == pytest.approx(2.0 * right.cost, rel=1e-6)
    assert found.residual_event_time_floor.values == pytest.approx(heard - clicks(*right.x, 8), abs=1e-9)
    assert found.at_occurrence.values.tolist() == [*range(1, 9)]
    later = data.assign(**{"occurrence [1]": np.arange(1, 9)}).iloc[[5, 2, 7]]
    part = xd.fit(ball(), later, ["e", "y"], **BOUNCES)
    assert part.estimate.values == pytest.approx(right.x, rel=2e-3)
    assert part.at_occurrence.values.tolist() == [6, 3, 8]


def test_records_share_what_they_share() -> None:
    """Assert a common velocity and each record's own start against linear least squares of all rows, and its figure."""
    rng = np.random.default_rng(7)
    times = [np.linspace(0.2, 4.0, 9), np.linspace(0.0, 3.0, 6)]
    data = {"one": line(rng, times[0], 3.1, 0.1), "two": line(rng, times[1], 2.7, 0.3)}
    found = xd.fit(free(), data, ["v_x"], own=["x"], bounds={"x": ("0 m", "5 m")}, **LINE)
    weights = np.concatenate([np.full(9, 10.0), np.full(6, 1 / 0.3)])
    ones = np.repeat(np.eye(2), [9, 6], axis=0)
    design = np.column_stack([np.concatenate(times), ones]) * weights[:, None]
    rows = np.concatenate([record["x [m]"] for record in data.values()])
    covariance = np.linalg.inv(design.T @ design)
    right = covariance @ design.T @ (rows * weights)
    assert found.estimate.values == pytest.approx(right, rel=1e-8)
    assert found.standard_uncertainty.values == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
    assert [*zip(found.parameter_name.values, found.parameter_record.values, strict=True)] == [
        ("v_x", ""),
        ("x", "one"),
        ("x", "two"),
    ]
    assert found.at_record.values.tolist() == [0] * 9 + [1] * 6
    models = [xd.Model.from_text(str(text)) for text in found.model_toml.values]
    assert [model.initial["x"].value for model in models] == found.estimate.values[1:].tolist()
    assert [model.initial["v_x"].value for model in models] == [found.estimate.values[0]] * 2
    assert models[0].elements.statement.correlations["v_x", "x"] == pytest.approx(float(found.correlation[0, 1]))
    assert "x of two  " in "\n".join(summary(found))


def test_records_of_unlike_bodies_and_of_events_are_one_fit() -> None:
    """Assert a gravity common to a swing's record and a ball's clicks, each with a model of its own, against scipy's fit."""
    rng = np.random.default_rng(11)
    times, noise = np.linspace(0.1, 4.0, 12), 1e-3
    heights = 2.0 - G / 2.0 * times**2 / 16.0
    slide = particle(
        name="slide",
        parameters={"m": "1 kg", "g": "9.7 m s-2"},
        forces={"slope": {"x": "-m*g/16"}},
        initial={"x": "2 m"},
    )
    data = {
        "slide": pd.DataFrame({"t [s]": times, "x [m]": heights + noise * rng.standard_normal(12), "u(x) [m]": noise}),
        "ball": pd.DataFrame({"event_time_floor [s]": clicks(0.8, 0.95, 3), "u(event_time_floor) [s]": 1e-4}),
    }
    found = xd.fit({"slide": slide, "ball": ball()}, data, ["g"], **BOUNCES)

    def residuals(p: np.ndarray) -> np.ndarray:
        slid = 2.0 - p[0] / 2.0 * times**2 / 16.0
        heard = clicks(0.8, 0.95, 3) * np.sqrt(G / p[0])
        return np.concatenate([(slid - data["slide"]["x [m]"]) / noise, (heard - clicks(0.8, 0.95, 3)) / 1e-4])

    right = least_squares(residuals, [9.7], xtol=1e-15)
    assert found.estimate.values == pytest.approx(right.x, rel=1e-8)
    assert found.standard_uncertainty.values == pytest.approx(1.0 / np.sqrt(right.jac.T @ right.jac)[0], rel=1e-5)
    assert np.isnan(found.residual_x.values[12:]).all()
    assert np.isfinite(found.residual_event_time_floor.values).tolist() == [False] * 12 + [True] * 3


@pytest.mark.dear
@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_outliers_do_not_lead_a_robust_loss_astray(loss: str) -> None:
    """Assert estimates of a line with three gross outliers against scipy's, with and without uncertainties, and marks."""
    rng = np.random.default_rng(5)
    times = np.linspace(0.0, 4.0, 41)
    data = line(rng, times, 3.0, 0.05)
    data.loc[[4, 20, 33], "x [m]"] += [4.0, -7.0, 9.0]
    design = np.column_stack([np.ones(41), times])
    found = xd.fit(free(), data, ["x", "v_x"], loss=loss, **LINE)
    width = {"soft_l1": 1.287, "huber": 1.345, "cauchy": 2.385}[loss]
    rows = data["x [m]"].to_numpy()
    fine = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
    right = least_squares(lambda p: (design @ p - rows) / 0.05, [3.0, 1.0], loss=loss, f_scale=width, **fine)
    assert found.estimate.values == pytest.approx(right.x, rel=1e-6)
    assert np.abs(found.estimate.values - [3.0, 1.2]).max() < 0.05
    assert np.flatnonzero(found.outlier_x.values).tolist() == [4, 20, 33]
    assert found.attrs["adequate"] == 1
    untold = xd.fit(free(), data.drop(columns="u(x) [m]"), ["x", "v_x"], loss=loss, **LINE)
    assert untold.estimate.values == pytest.approx(found.estimate.values, abs=0.01)
    assert untold.standard_uncertainty.values == pytest.approx(found.standard_uncertainty.values, rel=0.4)
    assert {4, 20, 33} <= {*np.flatnonzero(untold.outlier_x.values).tolist()}


@pytest.mark.parametrize("told", [True, False])
def test_intervals_of_a_linear_law_are_the_same_both_ways(told: bool) -> None:
    """Assert half widths by the normal or by Student's t distribution, from the covariance and from the profile."""
    data = line(np.random.default_rng(2), np.linspace(0.5, 3.5, 5), 3.0, 0.2, told=told)
    by = {rule: xd.fit(free(), data, ["x", "v_x"], intervals=rule, **LINE) for rule in ("covariance", "profile")}
    found = by["covariance"]
    half = (norm.ppf(0.975) if told else student.ppf(0.975, 3)) * found.standard_uncertainty.values
    wanted = found.estimate.values[:, None] + half[:, None] * [-1.0, 1.0]
    assert found.interval.values == pytest.approx(wanted, rel=1e-12)
    assert by["profile"].interval.values == pytest.approx(wanted, rel=1e-4)


@pytest.mark.dear
def test_a_profile_follows_a_law_that_is_not_linear() -> None:
    """Assert unlike sides of the interval of a rate, at a bound too, against the roots of its sum of squares."""
    model = xd.Model(
        name="decay", states={"n": {"unit": "1", "rate": "-k*n"}}, parameters={"k": "0.5 s-1"}, initial={"n": "1"}
    )
    times, rows = np.array([1.0, 2.0, 4.0]), np.array([0.75, 0.30, 0.25])
    data = pd.DataFrame({"t [s]": times, "n [1]": rows, "u(n) [1]": 0.15})
    settings: dict[str, Any] = {
        "method": "dop853",
        "rtol": 1e-10,
        "until": "4 s",
        "intervals": "profile",
        "coverage": 0.9,
    }
    found = xd.fit(model, data, ["k"], **settings)

    def squares(k: float) -> float:
        return float(np.sum(((np.exp(-k * times) - rows) / 0.15) ** 2))

    k, rise = float(found.estimate[0]), norm.ppf(0.95) ** 2
    ends = [brentq(lambda one: squares(one) - squares(k) - rise, *between) for between in ((0.05, k), (k, 3.0))]
    assert found.interval.values[0] == pytest.approx(ends, rel=2e-4)
    assert (ends[1] - k) / (k - ends[0]) > 1.2
    held = xd.fit(model, data, ["k"], bounds={"k": (0.1, 0.6)}, **settings)
    assert held.interval.values[0] == pytest.approx([ends[0], 0.6], rel=2e-4)


@dataclass(frozen=True)
class Line:
    """A straight line through six values, as a fit is to a search."""

    noise: np.ndarray
    loss: Loss
    design: np.ndarray = field(default_factory=lambda: np.column_stack([np.ones(6), np.linspace(0.0, 4.0, 6)]))

    def weighted_residuals(self, scaled: np.ndarray, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and slopes of a line against zero and noise."""
        assert share == 1.0
        return self.design @ scaled - self.noise, self.design

    def squares(self, scaled: np.ndarray, share: float) -> np.ndarray:
        """Not asked for: one search alone."""
        raise AssertionError(scaled, share)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("loss", "outliers", "known", "wanted"),
    [
        ("linear", 0.0, True, 0.9),
        ("linear", 0.0, False, 0.9),
        ("huber", 0.0, True, 0.9),
        ("huber", 0.1, True, 0.9),
        ("cauchy", 0.1, True, 0.9),
    ],
)
def test_intervals_hold_the_true_number(loss: str, outliers: float, known: bool, wanted: float) -> None:
    """Assert that about 90 % do, of six values with or without uncertainties, of forty where one in ten is an outlier."""
    rng, count, held, free_ends = np.random.default_rng(1), 300, 0, np.full(2, np.inf)
    size = 40 if loss != "linear" else 6
    design = np.column_stack([np.ones(size), np.linspace(0.0, 4.0, size)])
    for _ in range(count):
        noise = rng.standard_normal(size) * np.where(rng.random(size) < outliers, 10.0, 1.0)
        problem = Line(noise, loss_by_name(loss), design)
        found = search_from_start(problem, "own", np.zeros(2), -free_ends, free_ends)
        covariance = np.linalg.inv(found.slopes.T @ found.slopes)
        if not known or loss != "linear":
            covariance *= problem.loss.variance(found.residual, 2)
        half = quantile(wanted, size - 2, has_uncertainties=known) * np.sqrt(np.diag(covariance))
        held += int(np.sum(np.abs(found.end) < half))
    assert abs(held / (2 * count) - wanted) < 0.035  # two of the 300 spreads of a share


@pytest.mark.parametrize(
    ("data", "more", "said"),
    [
        ({"one": 1, "two": 1}, {"own": ["v_x"]}, "'v_x' is in parameters, shared by all records, and in own"),
        (["one"], {"own": ["x"]}, "own is x, and there is one record"),
        ({"one": 1, "two": 0}, {}, "one has uncertainties, u"),
        ([], {}, "empty list"),
        (["one"], {"loss": "l1"}, "loss is 'l1'; there are linear, soft_l1, huber, cauchy"),
        (["one"], {"intervals": "bayes"}, "intervals is 'bayes'"),
        (["one"], {"intervals": "profile", "loss": "huber"}, "leave one of them out"),
        (["one"], {"coverage": 95}, "coverage is 95, needs a probability"),
    ],
)
def test_what_cannot_be_is_named(data: Any, more: dict[str, Any], said: str) -> None:
    """Assert one clear error for each."""
    rng, times = np.random.default_rng(1), np.linspace(0.0, 4.0, 6)
    records = (
        {name: line(rng, times, 3.0, 0.1, told=bool(told)) for name, told in data.items()}
        if isinstance(data, dict)
        else [line(rng, times, 3.0, 0.1) for _ in data]
    )
    with pytest.raises(xd.InputError, match=said):
        xd.fit(free(), records, ["v_x"], **LINE | more)


def test_event_times_that_cannot_be_used_are_named() -> None:
    """Assert one clear error each: rows of both kinds, an unknown event, an occurrence that is none, one too many."""
    heard = clicks(0.8, 0.95, 3)
    for columns, said in (
        ({"t [s]": heard, "event_time_floor [s]": heard}, "give them as two records"),
        ({"event_time_wall [s]": heard}, "column 'event_time_wall .s.' is no quantity of the model"),
        ({"event_time_floor [s]": heard, "occurrence [1]": [0, 1, 2]}, "row 1: occurrence is 0, needs a whole number"),
        ({"event_time_floor [m]": heard}, "column of times is in 'm', needs a time"),
    ):
        with pytest.raises(xd.InputError, match=said):
            xd.fit(ball(), pd.DataFrame(columns), ["e"], **BOUNCES)
    late = pd.DataFrame({"event_time_floor [s]": heard, "occurrence [1]": [1, 2, 40]})
    with pytest.raises(xd.InputError, match="has no occurrence 40 of 'floor', which was measured"):
        xd.fit(ball(), late, ["e"], starts=1, method="rk4", step="0.05 s", until="2 s")


@pytest.mark.dear
def test_the_verb_takes_several_files_and_writes_their_models(tmp_path: Path) -> None:
    """Assert a fit of two files by the command line, with a model for each, intervals said, a figure; and the files' names."""
    rng, times = np.random.default_rng(4), np.linspace(0.0, 4.0, 6)
    (tmp_path / "free.toml").write_text(free().to_toml())
    for name, begin in (("up", 3.1), ("down", 2.8)):
        line(rng, times, begin, 0.05, told=False).to_csv(tmp_path / f"{name}.csv", index=False)
    files = [tmp_path / name for name in ("free.toml", "up.csv", "down.csv")]
    march = ["--method", "rk4", "--step", "0.5 s", "--until", "4 s"]
    ways = ["--parameter", "v_x", "--own", "x", "--intervals", "profile", "--coverage", 0.9]
    done = call("fit", *files, *ways, *march, "-o", tmp_path / "F.nc", "--model", tmp_path / "found.toml")
    assert done.exit_code == 0, done.output
    assert "interval  x of down: 2." in done.output
    assert "0.9 by the profile of the sum of squares" in done.output
    found = xd.open_run(tmp_path / "F.nc")
    assert found.record_name.values.tolist() == ["up", "down"]
    begun = [xd.Model.from_toml(tmp_path / f"found_{name}.toml").initial["x"].value for name in ("up", "down")]
    assert begun == found.estimate.values[1:].tolist()
    assert call("plot", tmp_path / "F.nc", "-o", tmp_path / "F.png").exit_code == 0


def test_the_variance_of_a_robust_estimate_is_hubers() -> None:
    """Assert his formula by hand: influences 0.5, -0.5, 1.345, -0.2 and slopes 1, 1, 0, 1, of two numbers from four values."""
    residuals = np.array([0.5, -0.5, 3.0, -0.2])
    squares, mean, spread = 0.5**2 + 0.5**2 + 1.345**2 + 0.2**2, 0.75, 0.1875
    wanted = (1.0 + 2 / 4 * spread / mean**2) ** 2 * squares / 2 / mean**2
    assert loss_by_name("huber").variance(residuals, 2) == pytest.approx(wanted, rel=1e-14)
    assert loss_by_name("linear").variance(residuals, 2) == pytest.approx(float(residuals @ residuals) / 2, rel=1e-14)
    assert loss_by_name("huber").variance(np.full(4, 9.0), 2) == np.inf
