"""Diagnoses against the closed form of damped swings: which level, sign, factor and end each number is of."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.diagnosing import conservation, diagnosis
from xdynamics.evidence.diagnosing.cycles import Cycles, Turns, _choose_level, _rising_rows, _turning_points, cycles


class Swing:
    """x = middle + amplitude*exp(-d t)*cos(w t + phase), a mass of 1 kg on a spring with a drag."""

    def __init__(self, random: np.random.Generator) -> None:
        self.middle, self.amplitude = random.uniform(-3, 3), random.uniform(0.5, 2)
        self.d, self.w, self.phase = random.uniform(-0.05, 0.05), random.uniform(1, 4), random.uniform(-3, 3)
        self.end = random.uniform(4.2, 9.0) * 2 * np.pi / self.w
        self.k = self.w**2 + self.d**2

    def x(self, t: Any) -> Any:
        """The place."""
        return self.middle + self.amplitude * np.exp(-self.d * t) * np.cos(self.w * t + self.phase)

    def v(self, t: Any) -> Any:
        """The velocity."""
        size = self.amplitude * np.exp(-self.d * t)
        return -size * (self.d * np.cos(self.w * t + self.phase) + self.w * np.sin(self.w * t + self.phase))

    def energy(self, t: Any) -> Any:
        """The total energy."""
        return self.v(t) ** 2 / 2 + self.k * (self.x(t) - self.middle) ** 2 / 2

    @property
    def rises(self) -> Any:
        """When x rises through the middle: w t + phase = -pi/2 + 2 pi n."""
        turns = (-np.pi / 2 + 2 * np.pi * np.arange(-2, 12) - self.phase) / self.w
        return turns[(turns > 0) & (turns < self.end)]

    @property
    def maxima(self) -> int:
        """How often it turns from rising to falling."""
        lag = np.arctan2(self.d, self.w)
        turns = (2 * np.pi * np.arange(-2, 12) - lag - self.phase) / self.w
        return int(np.count_nonzero((turns > 0) & (turns < self.end)))

    def run(self, **more: Any) -> xr.Dataset:
        """The march."""
        model = xd.Model(
            name="swing",
            coordinates={"x": "m"},
            mass={"x": "1*kilogram"},
            parameters={"k": f"{self.k!r} kg s-2", "c": f"{2 * self.d!r} kg s-1", "x0": f"{self.middle!r} m"},
            forces={"spring": {"potential": "k*(x - x0)**2/2"}, "drag": {"x": "-c*v_x"}},
            observables={"clock": "2*newton*t/second"},
            initial={"x": f"{float(self.x(0.0))!r} m", "v_x": f"{float(self.v(0.0))!r} m s-1"},
        )
        return xd.simulate(model, until=self.end, **({"method": "dop853", "rtol": 1e-10, "atol": 1e-12} | more))


@pytest.mark.cases(100)
def test_every_number_of_a_diagnosis(case: int) -> None:
    """Assert sign, factor and run of each: cycles, drifts, extremes, turns, residuals, by closed forms and quadrature."""
    swing = Swing(np.random.default_rng(case))
    run = swing.run()
    exact = {"x": "x0 + 0.5*metre*t/second"}
    found = xd.diagnose(run, level=f"{swing.middle!r} m", exact=exact, companion=False)
    assert (found.attrs["level"], found.attrs["level_rule"]) == (pytest.approx(swing.middle), "given")
    assert found.attrs["maxima"] == swing.maxima
    rises = swing.rises
    assert found.cycle_time.values == pytest.approx(rises[1:], abs=1e-7)
    assert found.period.values == pytest.approx(2 * np.pi / swing.w, abs=1e-7)
    own = cycles(run, "x", level=swing.middle).uncertainties
    assert found.period_uncertainty.values == pytest.approx(own[1:] + own[:-1], rel=1e-12)
    means = [np.mean(swing.energy(np.linspace(*span, 20_001))) for span in (rises[:2], rises[-2:])]
    swung = float(np.ptp(run.total_energy.values))
    assert float(found.energy_drift) == pytest.approx(means[1] - means[0], abs=1e-4 * swung + 1e-9)
    assert float(found.energy_drift) * swing.d < 0  # what a drag takes is lost, what it brings is won
    middles = np.mean(rises[-2:]) - np.mean(rises[:2])
    assert float(found.drift_clock) == pytest.approx(2 * middles, rel=1e-9)
    assert float(found.band_clock) == pytest.approx(2 * swing.end, rel=1e-12)
    fine = np.linspace(0, swing.end, 200_001)
    for word, at in (("maximum", np.argmax), ("minimum", np.argmin)):
        place = at(swing.x(fine))
        assert float(found[f"{word}_x"]) == pytest.approx(swing.x(fine[place]), abs=1e-7)
        assert float(found[f"{word}_x_time"]) == pytest.approx(fine[place], abs=2e-3)
    off = run.x.values - swing.middle - 0.5 * run.time.values
    assert found.residual_x.values == pytest.approx(off, abs=1e-12)
    assert float(found.largest_residual_x) == np.abs(found.residual_x.values).max()
    assert float(found.rms_residual_x) == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-12)
    assert found.turning_point.values == pytest.approx(swing.x(found.turning_time.values), abs=1e-7)
    assert np.abs(swing.v(found.turning_time.values)).max() < 1e-6


@pytest.mark.cases(100)
def test_the_level_is_chosen_for_the_swings_and_said(case: int) -> None:
    """Assert cycles of the swings wherever their middle is, without a level, and a word where a level misses them."""
    swing = Swing(np.random.default_rng(case))
    run = swing.run()
    found = xd.diagnose(run, companion=False)
    assert found.sizes["cycle"] >= swing.maxima / 2 - 1
    assert ("cycle_doubt" in found.attrs) == (found.sizes["cycle"] + 1 < swing.maxima - 1)
    values, high = run.x.values, float(run.x.max())
    missed = high - 1e-3 * np.ptp(values)
    doubt = xd.diagnose(run, level=missed, companion=False).attrs.get("cycle_doubt", "")
    fine = swing.x(np.linspace(0, swing.end, 100_001))
    rises = int(np.count_nonzero((fine[:-1] < missed) & (fine[1:] >= missed)))
    assert bool(doubt) == (rises < swing.maxima - 1)
    assert not doubt or f"has {swing.maxima} maxima and rises through the level" in doubt


def rows_of(**columns: Any) -> Chunks:
    """Rows of an oscillator that never was, in chunks of two."""
    run = xr.Dataset({name: ("step", np.asarray(values, float)) for name, values in columns.items()})
    return Chunks(run.chunk(step=2), xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"))


@pytest.mark.parametrize(("dip", "turns"), [(1.1e-6, [1, -3, 4, -6]), (1.9e-6, [1, -3, 4, -6]), (0.9e-6, [1, 4, -6])])
def test_swings_of_less_than_a_millionth_are_none(dip: float, turns: list[int]) -> None:
    """Assert maxima positive and minima negative; one between two swings of less than a millionth of the range is left out."""
    values = np.array([0.0, 1.0, 1.0 - dip, 1.0, 1.0 - dip, 0.0, 0.5])
    turned = _turning_points(rows_of(x=values, v_x=[1.0, -1.0, 0.0, 1.0, -1.0, 0.0, 1.0]), "x")
    assert turned.rows.tolist() == turns
    assert turned.values.tolist() == values[np.abs(turns)].tolist()


def test_a_level_is_the_first_that_swings_rise_through() -> None:
    """Assert 0, the middle of the range, that of the smallest swing, or what is risen through oftenest, with as many rises."""
    time = np.arange(9.0)
    turns, zigzag = np.arange(1, 8), np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])

    def chosen(values: Any, rows: Any, maxima: int) -> tuple[float, str]:
        turned = Turns(rows, values[rows], float(values.min()), float(values.max()))
        return _choose_level(rows_of(x=values, time=time[: len(values)]), "x", turned, maxima)

    assert chosen(zigzag, turns, 3) == (0.0, "zero")
    assert chosen(5.0 + zigzag, turns, 3) == (5.0, "the middle of the range")
    high = np.array([0.0, 8.0, 7.0, 8.0, 7.0, 8.0, 7.0, 8.0, 6.5])
    assert chosen(high, turns, 4) == (7.5, "the middle of the smallest swing")
    assert chosen(high, turns[:1], 4)[0] == 4.0
    assert chosen(high[:2], turns[:0], 0) == (4.0, "the middle of the range")

    def risen(values: Any, times: Any, level: float) -> list[int]:
        return _rising_rows(rows_of(x=values, time=times), "x", [level])[0].tolist()

    assert risen(high, time, 7.5) == [0, 2, 4, 6]
    assert risen(high, [0, 0, 1, 2, 2, 3, 4, 5, 6.0], 7.0) == []
    assert risen([7.0, 8.0, 6.0, 7.0], time[:4], 7.0) == [2]


@pytest.mark.parametrize(
    ("rises", "maxima", "times"),
    [(0, 2, "never"), (1, 3, "once"), (2, 4, "2 times"), (2, 3, ""), (0, 1, ""), (0, 0, "")],
)
def test_a_level_that_is_missed_by_two_maxima_is_doubted(rises: int, maxima: int, times: str) -> None:
    """Assert the words from two maxima more than rises on, and phases of fewer than two rises."""
    found = Cycles("x", 0.5, np.arange(float(rises)), np.zeros(rises), "given", maxima)
    assert (
        found.doubt.startswith(f"x has {maxima} maxima and rises through the level {times}: ")
        if times
        else not found.doubt
    )
    phases = found.phase(np.array([0.0, 0.5]))
    assert phases.tolist() == [0.0, np.pi] if rises > 1 else np.isnan(phases).tolist() == [True, True]


def test_a_diagnosis_in_words() -> None:
    """Assert numbers with their digits, rule and scale, attention, and the first and the last cycle's."""
    role = {"role": "diagnostic", "units": "m"}
    found = xr.Dataset(
        {
            "energy_band": ((), 0.1234567, role | {"units": "1"}),
            "maximum_x": ((), 1.23456789, role),
            "maximum_x_uncertainty": ((), 0.002, {"role": "error", "units": "m"}),
        }
    )
    found["maximum_x_rule"] = ((), 1, {"role": "flag", "units": "1", "flag_meanings": "sampled interpolated"})
    found["largest_residual_x"] = ((), 0.5, {"role": "residual", "units": "m"})
    found["scaled_largest_residual_x"], found["residual_scale_x"] = (
        ((), 0.25, {"role": "scaled"}),
        ((), 2.0, {"role": "scale", "units": "m"}),
    )
    for name, values, units in (
        ("period", [2.0, 2.5], "s"),
        ("phase_offset", [-0.125, 0.25], "rad"),
        ("amplitude", [1.0, 0.75], "m"),
        ("phase_space_area", [3.0, 4.0], "m2 s-1"),
    ):
        found[name] = ("cycle", values, role | {"units": units})
    found["period_uncertainty"] = ("cycle", [0.25, 1e-12], {"role": "error", "units": "s"})
    found.attrs = {
        "coordinate": "x",
        "level": 0.5,
        "level_units": "m",
        "level_rule": "given",
        "reference": "none",
        "cycle_doubt": "few",
    }
    lines = list(diagnosis.diagnosis_lines(found))
    assert lines == [
        "              band      greatest",
        "total_energy  0.123457",
        "x                       1.235 m",
        "largest_residual_x = 0.5 m, scaled 0.25 by 2 m",
        "attention: few",
        "cycles of x, each from one rise through 0.5 m, given, to the next: 2, phases beside none",
        "period = 2 s in the first cycle, 2.5 s in the last",
        "phase_offset = -0.125 rad in the first cycle, 0.25 rad in the last",
        "amplitude = 1 m in the first cycle, 0.75 m in the last",
        "phase_space_area = 3 m2 s-1 in the first cycle, 4 m2 s-1 in the last",
    ]
    assert len(list(diagnosis.diagnosis_lines(found.isel(cycle=[])))) == 5
    del found.attrs["level_rule"]
    assert diagnosis.cycles_text(found) == "x, each from one rise through 0.5 m, to the next"


def test_amplitudes_are_of_located_turns_and_where_it_bounces_of_states_between() -> None:
    """Assert half of what a damped swing goes up and down by its closed form, and of a ball whose lowest point is no turn."""
    swing = Swing(np.random.default_rng(11))
    swing.d, swing.k = 0.3, swing.w**2 + 0.09
    found = xd.diagnose(swing.run(), level=swing.middle, companion=False)
    lag = np.arctan2(swing.d, swing.w)
    turns = (np.pi * np.arange(-9, 40) - lag - swing.phase) / swing.w
    rises = swing.rises
    for k, (begin, end) in enumerate(pairwise(rises)):
        inside = swing.x(turns[(turns > begin) & (turns < end)])
        assert float(found.amplitude[k]) == pytest.approx(np.ptp(inside) / 2, rel=1e-6)
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        parameters={"g": "2 m s-2"},
        forces={"gravity": {"potential": "1*kilogram*g*y"}},
        initial={"y": "1 m"},
        contacts={"floor": {"gap": "y", "restitution": 1.0}},
    )
    bounced = xd.diagnose(xd.simulate(ball, method="rk4", step=0.125, until=8.0), level=0.5, companion=False)
    assert bounced.sizes["cycle"] == 3
    assert bounced.amplitude.values == pytest.approx(0.5, abs=0.02)


def test_a_run_is_believed_until_it_is_off_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the first time that errors are beyond a tenth of a range and stay there, and the end where they never are."""
    run = xd.simulate(
        xd.Model.from_text(Swing(np.random.default_rng(7)).run().model_toml.values.item()),
        method="rk4",
        step=0.02,
        until=8.0,
    )
    span, speeds, end = float(np.ptp(run.x.values)), float(np.ptp(run.v_x.values)), float(run.time[-1])

    def believed(off: Any, companions_end: float = 8.0) -> float:
        """Return until when, of errors of x and v_x that are functions of time."""

        def beside(states: xr.Dataset) -> xr.Dataset:
            return xr.Dataset(
                {
                    f"global_error_{name}": ("at", off(states["time"].values if "time" in states else times)[k])
                    for k, name in enumerate(("x", "v_x"))
                }
            )

        other = run.isel(step=run.time.values <= companions_end)
        stub: Any = type(
            "Beside",
            (),
            {"run": other, "functions": None, "with_global_errors": staticmethod(beside), "holding": lambda *_: other},
        )()
        return float(conservation.belief_variables(Chunks.of(run), stub)["believed_until"][1])

    times = run.time.values
    monkeypatch.setattr(conservation, "sample_in_steps", lambda _, t, **__: xr.Dataset({"time": ("at", np.asarray(t))}))
    step = 2 * 0.02 + 1e-9
    late = times > 6.0  # by when the range is that of the whole run
    assert np.ptp(run.x.values[~late]) == pytest.approx(span, rel=0.005)
    assert believed(lambda t: (0.099 * span * (t > 6.0), -0.099 * speeds * (t > 6.0))) == end
    assert believed(lambda t: (np.where(t > 3.0, -0.101 * span, 0.0), 0 * t)) == pytest.approx(3.0, abs=step)
    assert believed(lambda t: (0 * t, np.where(t > 5.0, 0.101 * speeds, 0.0))) == pytest.approx(5.0, abs=step)
    assert believed(lambda t: (np.where(np.abs(t - 3.0) < 0.011, span, 0.0), 0 * t)) == end
    assert believed(lambda t: (np.where(t > 7.0, span, 0.0), 0 * t), 6.0) == pytest.approx(6.0, abs=1e-9)


@pytest.mark.dear
def test_what_the_command_says_of_levels(tmp_path: Path) -> None:
    """Assert that the verb says coordinate, level and why, that --level sets it, and what it says of a level that is missed."""
    swing = Swing(np.random.default_rng(7))
    swing.middle, swing.d, swing.phase, swing.amplitude, swing.end = 2.0, 0.02, 0.0, 1.0, 8.4 * 2 * np.pi / swing.w
    swing.k = swing.w**2 + swing.d**2
    xd.save(swing.run(), path := tmp_path / "run.nc")
    said = call("diagnose", path, "--no-companion").output
    assert "cycles of x, each from one rise through" in said
    assert "the middle of the range, to the next: 7, phases beside none" in said
    said = call("diagnose", path, "--no-companion", "--level", "290 cm").output
    assert "attention: x has 8 maxima and rises through the level" in said
    assert call("diagnose", path, "--level", "3 s").exit_code == 2


@pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")
def test_periods_of_a_study_are_of_one_level() -> None:
    """Assert that all runs of a refinement count cycles by the level of the finest, though each would choose another."""
    swing = Swing(np.random.default_rng(3))
    model, steps = xd.Model.from_text(swing.run()["model_toml"].values.item()), [0.02, 0.01, 0.005]
    runs = [xd.simulate(model, method="forward_euler", step=h, until=swing.end) for h in steps]
    own = [cycles(run, "x") for run in runs]
    assert len({one.level for one in own}) == len(runs)
    study = xd.refine(model, method="forward_euler", steps=steps, until=swing.end, observables=["period_x"])
    means = [float(cycles(run, "x", level=own[-1].level).periods.mean()) for run in runs]
    assert study.period_x.values == pytest.approx(means, rel=1e-14)
    assert study.period_x.values[0] != float(own[0].periods.mean())
    assert float(study.crossing_level_x) == own[-1].level
    assert "crossing_level_x upward, a level that the finest run chose for all" in study.period_x.attrs["long_name"]


@pytest.mark.parametrize(("start", "hardly"), [("1e-12 m", True), ("1e-6 m", False)])
def test_an_element_that_hardly_moves_beside_others_is_doubted(start: str, hardly: bool) -> None:
    """Assert that cycles of an element which moves as rounding does are said to say little; of one that moves, not."""
    model = xd.Model(
        name="two oscillators",
        dimensions={"site": 2},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N/m", "A": {"dims": ["site"], "value": [start, "1 m"]}},
        mass={"u": "1*kilogram"},
        forces={"spring": {"u": "-k*u"}},
        initial={"u": "A"},
    )
    run = xd.simulate(model, method="rk4", until="20 s", step="0.1 s")
    doubt = xd.diagnose(run, companion=False).attrs.get("cycle_doubt", "")
    assert doubt.startswith("u[0] moves by 2e-12 of the largest u alone, as rounding does") == hardly
    assert bool(doubt) == hardly
