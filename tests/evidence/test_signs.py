"""What a stage of evidence returns has the right sign and factor, and is of the right one of two runs: each by a closed form.

The sign, the factor and the run of every quantity that refinements, limits and comparisons return.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.diagnosing.cycles import cycles
from xdynamics.evidence.refining.convergence import observed_orders

G = 10.0  # m s-2
T = 2.0  # s
LOSS = 0.2  # s-1, of a speed


@cache
def fall(step: float = 0.1, height: float = 0.0, speed: float = 0.0, method: str = "forward_euler") -> xr.Dataset:
    """A body that falls, by Euler's y = y0 + v0 t - g t (t - h)/2 unless another method is named."""
    model = falling().replace(initial={"y": f"{height!r} m", "v_y": f"{speed!r} m s-1"})
    return xd.simulate(model, method=method, step=step, until=T)


@cache
def passing(step: float = 0.1, height: float = 0.0, method: str = "velocity_verlet") -> xr.Dataset:
    """The same from rest, with an event 5 m below 0."""
    text = falling().to_toml() + '[events.level]\nfunction = "y + 5*metre"\n'
    return xd.simulate(
        xd.Model.from_text(text).replace(initial={"y": f"{height!r} m"}), method=method, step=step, until=T
    )


def falling() -> xd.Model:
    """A body of 2 kg under gravity, downward negative."""
    return xd.Model(
        name="fall",
        coordinates={"y": "m"},
        parameters={"m": "2 kg", "g": f"{G!r} m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": "0 m", "v_y": "0 m s-1"},
    )


@cache
def slide() -> xr.Dataset:
    """A body of 2 kg that drag slows down: v = 3 exp(-t/5) m s-1; its only energy is kinetic."""
    model = particle(
        name="slide",
        parameters={"m": "2 kg", "c": f"{2 * LOSS!r} N s m-1"},
        forces={"drag": {"x": "-c*v_x"}, "none": {"potential": "0*joule + 0*c*x*metre/second"}},
        initial={"x": "0 m", "v_x": "3 m s-1"},
    )
    return xd.simulate(model, method="dop853", rtol=1e-12, until=T)


@cache
def swing(stiffness: float = 4.0, loss: float = 0.0, method: str = "dop853", **asked: Any) -> xr.Dataset:
    """An oscillator of 1 kg that starts at rest, 1 m from its middle; with a loss it is damped by exp(-loss t)."""
    model = particle(
        name="swing",
        parameters={"m": "1 kg", "k": f"{stiffness!r} N m-1", "c": f"{2 * loss!r} N s m-1"},
        forces={"spring": {"potential": "k*x**2/2"}} | ({"drag": {"x": "-c*v_x"}} if loss else {}),
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    return xd.simulate(model, method=method, until=20.0, **(asked or {"rtol": 1e-11}))


@cache
def diagnosed(name: str) -> xr.Dataset:
    """Diagnoses that several tests look at."""
    runs = {"fall": fall, "slide": slide, "damped": lambda: swing(loss=0.05)}
    return xd.diagnose(runs[name](), companion=False)


# ------------------------------------------------------------------------------------------------------------ diagnose


def test_energies_without_cycles_drift_from_the_start_to_the_end() -> None:
    """Assert the end less the start: m v0**2/2 (exp(-2 c t) - 1), a band of that size; of Euler's fall m g**2 h t/2."""
    lost = 9.0 * (1.0 - np.exp(-2.0 * LOSS * T))
    assert float(diagnosed("slide").energy_drift) == pytest.approx(-lost, rel=1e-9)
    assert float(diagnosed("slide").energy_band) == pytest.approx(lost, rel=1e-9)
    assert float(diagnosed("fall").energy_drift) == pytest.approx(2.0 * G**2 * 0.1 * T / 2, rel=1e-12)


def test_energy_lost_from_cycle_to_cycle_drifts_downward() -> None:
    """Assert that with cycles the drift is the mean over the last less that over the first, by the closed form."""
    w = np.sqrt(4.0 - 0.05**2)
    crossings = cycles(swing(loss=0.05), "x").times

    def mean(begin: float, end: float) -> float:
        t = np.linspace(begin, end, 20_001)
        x = np.exp(-0.05 * t) * (np.cos(w * t) + 0.05 / w * np.sin(w * t))
        v = -np.exp(-0.05 * t) * (4.0 / w) * np.sin(w * t)
        return float(np.trapezoid(v**2 / 2 + 2.0 * x**2, t) / (end - begin))

    expected = mean(*crossings[-2:]) - mean(*crossings[:2])
    assert expected < -0.5
    assert float(diagnosed("damped").energy_drift) == pytest.approx(expected, rel=2e-2)  # straight lines between steps


def test_momentum_drifts_by_the_impulse() -> None:
    """Assert that a falling body's momentum drifts by -m g t, and its band is that much."""
    found = diagnosed("fall")
    assert float(found.drift_momentum_y) == pytest.approx(-2.0 * G * T, rel=1e-12)
    assert float(found.band_momentum_y) == pytest.approx(2.0 * G * T, rel=1e-12)
    assert found.drift_momentum_y.attrs["units"] == "kg m s-1"


def test_periods_are_those_of_the_damped_oscillator() -> None:
    """Assert that every period is 2 pi/sqrt(k/m - loss**2), and the ends of cycles are that far apart from 3/4 of one on."""
    found, period = diagnosed("damped"), 2.0 * np.pi / np.sqrt(4.0 - 0.05**2)
    assert found.period.values == pytest.approx(period, rel=1e-9)
    assert np.diff(found.cycle_time.values) == pytest.approx(period, rel=1e-9)
    assert found.cycle_time.values - found.period.values == pytest.approx(
        cycles(swing(loss=0.05), "x").times[:-1], rel=1e-12
    )


def test_the_uncertainty_of_a_period_is_that_of_both_crossings() -> None:
    """Assert that each period is uncertain by the sum of what its two crossings are, which are not alike."""
    located = cycles(swing(loss=0.05, method="rk4", step=0.1), "x")
    found = xd.diagnose(swing(loss=0.05, method="rk4", step=0.1), companion=False)
    first, second = located.uncertainties[:-1], located.uncertainties[1:]
    assert (np.abs(first - second) > 1e-3 * first).any()
    assert found.period_uncertainty.values == pytest.approx(first + second, rel=1e-12, abs=0.0)


def test_a_crossing_is_uncertain_by_the_error_of_the_place_over_the_speed() -> None:
    """Assert that a crossing's uncertainty is what x may be off there, over the speed, and rounding of its time."""
    run = swing(method="rk4", step=0.1)
    located = cycles(run, "x")
    at = xd.sample(run, located.times, side="before")
    expected = (np.abs(at.error_x) + np.abs(at.x)) / np.abs(at.v_x)
    assert located.uncertainties == pytest.approx(
        expected.values + np.finfo(float).eps * located.times, rel=1e-9, abs=0.0
    )


def test_a_crossing_takes_few_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that Newton's steps come to all crossings of a swing at once in seven looks at the run, where halving takes fifty."""
    looks, look = list[int](), StepInterpolator.states_at

    def counted(*given: Any, **more: Any) -> Any:
        looks.append(1)
        return look(*given, **more)

    monkeypatch.setattr(StepInterpolator, "states_at", counted)
    assert cycles(swing(method="rk4", step=0.1), "x").times.size == 6
    assert 3 <= len(looks) <= 8


def about(middle: float, speed: float = 0.0, start: float = 1.0) -> xr.Dataset:
    """An oscillator of the frequency 2 rad s-1 about a point."""
    model = particle(
        name="about",
        parameters={"m": "1 kg", "k": "4 N m-1", "c": f"{middle!r} m"},
        forces={"spring": {"potential": "k*(x - c)**2/2"}},
        initial={"x": f"{middle + start!r} m", "v_x": f"{speed!r} m s-1"},
    )
    return xd.simulate(model, method="dop853", rtol=1e-11, until=7.0)


def test_a_level_that_is_not_passed_is_the_middle_of_the_range() -> None:
    """Assert that an oscillation from 4 m to 6 m has its cycles from 5 m on, at 3/4 of a period and each period behind."""
    found = cycles(about(5.0), "x")
    assert found.level == pytest.approx(5.0, abs=1e-2)  # of accepted states
    assert cycles(about(5.0), "x", level=5.0).times == pytest.approx(np.pi * (0.75 + np.arange(2)), rel=1e-8)


def test_a_level_that_is_passed_once_is_none() -> None:
    """Assert that where 0 is risen through once alone the middle of the range is the level."""
    run = about(0.5, start=-1.0)
    one_rise = run.isel(step=slice(0, int(np.searchsorted(run.time.values, 2.0))))
    values = one_rise.x.values
    assert cycles(one_rise, "x").level == (values.min() + values.max()) / 2


def test_a_start_on_the_level_is_no_crossing() -> None:
    """Assert that a motion that begins on its level has its first crossing a period later."""
    assert cycles(about(0.0, speed=2.0, start=0.0), "x").times == pytest.approx(np.pi * np.arange(1, 3), rel=1e-8)


def test_what_only_falls_has_no_cycle() -> None:
    """Assert that of a body that falls there are no crossings, and no uncertainties of any."""
    found = cycles(fall(), "y")
    assert (found.times.shape, found.uncertainties.shape, found.periods.shape) == ((0,), (0,), (0,))


def test_phases_are_whole_turns_at_crossings() -> None:
    """Assert that the phase is 2 pi a cycle, in proportion between crossings and not known outside."""
    found = cycles(about(0.0), "x")
    first, second = found.times[:2]
    assert found.phase(np.array([first, (first + second) / 2, second])) == pytest.approx([0.0, np.pi, 2 * np.pi])
    assert np.isnan(found.phase(np.array([first - 1e-3, found.times[-1] + 1e-3]))).all()


@pytest.mark.dear
def test_a_run_that_is_late_is_behind() -> None:
    """Assert that a run 1 % slower than its reference falls behind it by 2 pi (T/T0 - 1) rad a cycle from the start on."""
    run = swing(4.0 / 1.01**2)
    found = xd.diagnose(run, reference=swing(4.0))
    assert found.attrs["reference"].startswith("the run ")
    ends = (
        np.arange(found.sizes["cycle"]) + 1.75
    ) * 1.01  # in periods of the reference, which ends at whole ones less 1/4
    expected = 2.0 * np.pi * (np.arange(found.sizes["cycle"]) + 1.75 - ends)
    assert (expected < 0.0).all()
    assert found.phase_offset.values == pytest.approx(expected, rel=1e-6)


def test_a_run_that_is_early_is_ahead() -> None:
    """Assert that beside a period that is longer than its own a run comes ahead by 2 pi (1 - T/T0) a cycle."""
    run = swing()
    found = xd.diagnose(run, reference=f"{np.pi * 1.02!r} s")
    number = np.arange(1, found.sizes["cycle"] + 1)
    assert found.phase_offset.values == pytest.approx(2.0 * np.pi * number * (1.0 - 1.0 / 1.02), rel=1e-6)


def test_the_amplitude_is_half_of_what_is_gone_through() -> None:
    """Assert that an undamped swing of 1 m has the amplitude 1 m, and the area pi w A**2."""
    found = xd.diagnose(swing(), companion=False)
    assert found.amplitude.values == pytest.approx(1.0, rel=1e-8)
    assert found.phase_space_area.values == pytest.approx(2.0 * np.pi, rel=1e-8)


def test_the_maximum_is_the_apex_and_the_minimum_the_end() -> None:
    """Assert height, time and rule of both extremes of a throw, and that nothing but the one between states is uncertain."""
    found = xd.diagnose(fall(0.3, 0.0, 5.0, "velocity_verlet"), companion=False)
    assert (float(found.maximum_y), float(found.maximum_y_time)) == pytest.approx((1.25, 0.5), rel=1e-6)
    assert (float(found.minimum_y), float(found.minimum_y_time)) == pytest.approx((-10.0, 2.0), rel=1e-12)
    assert (int(found.maximum_y_rule), int(found.minimum_y_rule)) == (1, 0)
    assert float(found.minimum_y_uncertainty) == 0.0
    assert float(found.maximum_v_y) == 5.0


def test_a_residual_is_what_was_computed_less_what_is_true() -> None:
    """Assert that Euler's fall is above the true one by g h t/2, and its velocity is none."""
    found = xd.diagnose(fall(), companion=False, exact={"y": "-g*t**2/2", "v_y": "-g*t"})
    assert float(found.largest_residual_v_y) == pytest.approx(0.0, abs=1e-12)
    assert found.residual_y.values == pytest.approx(G * 0.1 * found.time.values / 2, abs=1e-13)
    assert float(found.largest_residual_y) == pytest.approx(G * 0.1 * T / 2)
    assert float(found.rms_residual_y) == pytest.approx(np.sqrt(np.mean((G * 0.05 * found.time.values) ** 2)))


# ------------------------------------------------------------------------------------------------------------- compare


def test_a_difference_is_the_second_run_less_the_first() -> None:
    """Assert that a start 3 m higher is a difference of +3 m, and of m g 3 m in energy, the other way round of -3 m."""
    higher = xd.compare(fall(), fall(height=3.0))
    assert higher.difference_y.values == pytest.approx(3.0)
    assert higher.difference_potential_energy.values == pytest.approx(2.0 * G * 3.0)
    assert xd.compare(fall(height=3.0), fall()).difference_y.values == pytest.approx(-3.0)


@pytest.mark.parametrize("order", [1, -1])
def test_interpolation_errors_of_both_runs_are_added(order: int) -> None:
    """Assert that what interpolation may be off is of both runs together, whichever is the coarse one."""
    runs, times = [swing(method="rk4", step=0.1), swing(method="rk4", step=0.07)][::order], [1.234, 2.345]
    errors = [np.abs(xd.sample(run, times).error_x.values) for run in runs]
    assert (np.abs(errors[0] - errors[1]) > 0.1 * errors[0]).all()
    assert xd.compare(*runs, times).interpolation_error_x.values == pytest.approx(
        errors[0] + errors[1], rel=1e-9, abs=0.0
    )


def test_what_comes_later_in_the_second_run_is_above_0() -> None:
    """Assert that a fall from 3 m higher passes the level sqrt(2*8/g) - sqrt(2*5/g) later, and the sign of the reverse."""
    runs = [passing(height=height) for height in (0.0, 3.0)]
    later = np.sqrt(1.6) - 1.0
    assert xd.compare(*runs).difference_event_time_level.values == pytest.approx([later], rel=1e-9)
    assert xd.compare(*runs[::-1]).difference_event_time_level.values == pytest.approx([-later], rel=1e-9)


def test_locations_in_both_runs_are_added() -> None:
    """Assert that the difference of event times is uncertain by both locations."""
    runs = [passing(height=height) for height in (0.0, 3.0)]
    both = [float(run.event_time_uncertainty[0]) for run in runs]
    assert both[0] != both[1]
    assert xd.compare(*runs).interpolation_error_event_time_level.values == pytest.approx(
        [sum(both)], rel=1e-12, abs=0.0
    )


def test_what_was_measured_less_what_was_computed() -> None:
    """Assert sign and size of residuals of data, their root mean square, and chi-square over the square of u."""
    run = fall()
    off = np.where(np.arange(run.sizes["step"]) % 2, 0.02, 0.04)
    data = pd.DataFrame(
        {"time [s]": run.time.values, "y [mm]": 1000 * (run.y.values + off), "u(y) [mm]": np.full(off.size, 10.0)}
    )
    found = xd.compare(run, data)
    assert found.difference_y.values == pytest.approx(off, abs=1e-12)
    assert float(found.rms_difference_y) == pytest.approx(np.sqrt(np.mean(off**2)))
    assert float(found.reduced_chi_square_y) == pytest.approx(np.mean((off / 0.01) ** 2))


def test_bits_are_those_of_the_first_and_of_the_second() -> None:
    """Assert that a difference names the value of the first run first."""
    found = xd.compare(fall(), fall(height=3.0))
    assert found.attrs["initial"] == "y: 0.0 m | 3.0 m"
    assert found.attrs["first_difference"].startswith("variable 'y', row 0: 0.0 | 3.0")


# -------------------------------------------------------------------------------------------------------------- refine


@cache
def study() -> xr.Dataset:
    """Euler's fall with steps of 0.2, 0.1, 0.05 and 0.025 s."""
    return xd.refine(
        falling(), method="forward_euler", steps=[0.2, 0.1, 0.05, 0.025], until=T, at=[T], observables=["y"]
    )


def test_differences_are_the_finer_level_less_the_coarser() -> None:
    """Assert that halving h lowers Euler's fall by g t h/4."""
    steps = np.array([0.2, 0.1, 0.05])
    assert study().difference_y.values[:3, 0] == pytest.approx(-G * T * steps / 4, rel=1e-9)


def test_the_order_of_euler_is_1() -> None:
    """Assert that observed orders are +1."""
    assert study().order_y.values[1:3, 0] == pytest.approx(1.0, abs=1e-9)


def test_the_limit_is_the_true_fall() -> None:
    """Assert that the extrapolated value is -g t**2/2, and the finest is off by no more than its uncertainty."""
    found = study()
    assert float(found.limit_y[0]) == pytest.approx(-G * T**2 / 2, rel=1e-9)
    off = abs(float(found.y[-1, 0]) - float(found.limit_y[0]))
    assert off == pytest.approx(G * T * 0.025 / 2, rel=1e-9)
    assert off <= float(found.uncertainty_y[0]) <= 4.0 * off


# ----------------------------------------------------------------------------------------------------------- companion


# --------------------------------------------------------------------------------------------------------------- modes


def test_decay_is_below_0_and_growth_above() -> None:
    """Assert that eigenvalues of a damped oscillator are -loss and +-w, of one that is driven by its speed +loss."""
    for loss in (0.05, -0.05):
        model = xd.Model.from_text(swing(loss=abs(loss)).model_toml.values.item()).replace(
            parameters={"c": f"{2 * loss!r} N s m-1"}
        )
        found = xd.modes(model)
        assert found.eigenvalue_real.values == pytest.approx([-loss, -loss], rel=1e-9)
        assert np.sort(found.eigenvalue_imag.values) == pytest.approx(
            np.array([-1, 1]) * np.sqrt(4.0 - loss**2), rel=1e-9
        )


def test_frequencies_are_in_radians() -> None:
    """Assert the frequency sqrt(k/m), the period 2 pi over it, and the stable step 2/w of Verlet's method."""
    found = xd.modes(xd.Model.from_text(swing().model_toml.values.item()))
    assert (float(found.frequency[0]), float(found.period[0])) == pytest.approx((2.0, np.pi), rel=1e-12)
    row = found.method_name.attrs["flag_meanings"].split().index("velocity_verlet")
    where = int(np.flatnonzero(found.method_name.values == found.method_name.attrs["flag_values"][row])[0])
    assert float(found.largest_stable_step[where]) == pytest.approx(1.0, rel=1e-9)


# ------------------------------------------------------------------------------------- limiting, manufactured, validate


def test_distances_are_values_less_the_limit() -> None:
    """Assert that with less gravity a body falls less: distances -(g - g0) t**2/2, below 0 where g is above its limit."""
    from xdynamics.evidence.validating.limiting import limiting, limiting_lines

    found = limiting(falling(), "g", [12.0, 11.0, 10.5], 10.0, at=[1.0], method="velocity_verlet", step=0.1, until=1.0)
    assert found.distance_y.values[:, 0] == pytest.approx([-1.0, -0.5, -0.25], rel=1e-9)
    assert found.order_y.values[1:, 0] == pytest.approx(1.0, abs=1e-9)
    assert float(found.limit_y[0]) == pytest.approx(-5.0)
    assert next(iter(limiting_lines(found))) == "y at t = 1 s: -0.25 m from its limit, order 1, approached"
    apart = found.assign(approached_y=0 * found.approached_y, order_y=np.nan * found.order_y)
    assert next(iter(limiting_lines(apart))) == "y at t = 1 s: -0.25 m from its limit, not approached"


def test_distances_have_an_order_where_they_get_nearer_by_a_hundredth() -> None:
    """Assert order 1 of distances 1.5 % apart and none of those 0.5 % apart, and in what it is where one value is 0 or far off."""
    asked: dict[str, Any] = {"at": [1.0], "method": "velocity_verlet", "step": 0.5, "until": 1.0}
    near = xd.limiting(falling(), "g", [11.0, 10.0 + np.exp(-0.015), 10.0 + np.exp(-0.02)], 10.0, **asked)
    assert near.order_y.values[1:, 0] == pytest.approx([1.0, np.nan], nan_ok=True, abs=1e-6)
    for values, order_in in (
        ([0.0, 10.0, 20.0], "g"),
        ([5.0, 10.0, 20.0], "1/g"),
        ([5.0, 10.0, 9.9e5], "1/g"),
        ([1e5, 8e5, 9.9e5], "g"),
    ):
        far = xd.limiting(falling(), "g", values, 1e6, **asked)
        assert far.attrs["order_in"] == order_in
        size = np.abs(
            np.array(
                [(1 / value if value else np.nan) - 1e-6 if order_in == "1/g" else value - 1e6 for value in values]
            )
        )
        fallen = np.log((1e6 - np.array(values[:-1])) / (1e6 - np.array(values[1:])))
        ratio = np.log(size[:-1] / size[1:])
        known = ratio > 0.01
        assert far.order_y.values[1:, 0][known] == pytest.approx((fallen / ratio)[known], rel=1e-7)
    with pytest.raises(xd.InputError, match="need 2 or more that come closer to 10"):
        xd.limiting(falling(), "g", [12.0, 11.0, 10.0], 10.0, **asked)
    low = '\n[events.low]\nfunction = "y + 5*metre"\naction = "stop"\n'
    stopped = xd.Model.from_text(falling().to_toml() + low)
    with pytest.raises(xd.InputError, match="with g = 13.0 m s-2 the run ends before: event 'low' stopped"):
        xd.limiting(stopped, "g", [13.0, 11.0], 9.0, **asked | {"at": [0.1, 1.0]})


def test_the_manufactured_force_is_what_is_missing() -> None:
    """Assert that for y = A sin(t) the force added is m a less all others: -m A sin(t) + m g."""
    from xdynamics.evidence.validating.manufacturing import manufactured

    model = manufactured(falling(), {"y": "3*metre*sin(t/second)"})
    run = xd.simulate(model, method="dop853", rtol=1e-10, until=T)
    t = run.time.values
    assert run.force_manufactured_y.values == pytest.approx(-2.0 * 3.0 * np.sin(t) + 2.0 * G, rel=1e-9)
    assert run.y.values == pytest.approx(3.0 * np.sin(t), abs=1e-8)


def test_a_ledger_has_the_largest_size_of_a_residual() -> None:
    """Assert that of a run that is too low everywhere the residual is above 0: g h t/2 of Euler at its end."""
    text = (
        falling().to_toml()
        + '\n[run]\nmethod = "forward_euler"\nstep = "0.1 s"\nuntil = "2 s"\n[validation.y]\nexpression = "-g*t**2/2 + 4*metre"\nbound = "10 m"\n'
    )
    found = xd.validate(xd.Model.from_text(text))
    assert float(found.residual[0]) == pytest.approx(4.0, rel=1e-12)
    assert float(found.bound[0]) == 10.0


OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # cos 2t
DRAG = xd.Model.from_toml(MODELS / "ball_drag.toml")


def test_errors_of_interpolation_are_of_their_level() -> None:
    """Assert that each level has its own run's, and differences are of the finer level less the coarser."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.2, 0.1, 0.05], at=[1.23], until=2.0)
    for k, step in enumerate((0.2, 0.1, 0.05)):
        inside = xd.sample(xd.simulate(OSCILLATOR, method="rk4", step=step, until=2.0), [1.23])
        assert float(study.interpolation_error_x[k, 0]) == float(inside.error_x[0])
        assert float(study.x[k, 0]) == float(inside.x[0])
    assert float(study.difference_x[0, 0]) == float(study.x[1, 0] - study.x[0, 0])
    scale = float(study.difference_scale_x)
    finest = xd.simulate(OSCILLATOR, method="rk4", step=0.05, until=2.0)
    assert scale == float(np.abs(finest.x).max())
    assert float(study.scaled_difference_x[1, 0]) == float(study.difference_x[1, 0]) / scale


def test_orders_have_their_sign() -> None:
    """Assert that orders are positive where differences fall, and negative where they grow, by the same number."""
    h = np.array([0.4, 0.2, 0.1])
    assert observed_orders(1 + h**1.5, h)[1] == pytest.approx(1.5)
    assert observed_orders(1 - h**-1.5, h)[1] == pytest.approx(-1.5)


def test_states_behind_events_and_their_doubt() -> None:
    """Assert that what is behind a reset is, with the location's uncertainty times the rate, and counts of each level."""
    model = xd.Model(
        name="reset",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
        events={
            "back": {
                "function": "y",
                "direction": "falling",
                "action": "reset",
                "set": {"v_y": "-0.5*v_y"},
                "time_tolerance": "1e-6 s",
            }
        },
    )
    study = xd.refine(model, method="rk4", steps=[0.04, 0.02], until=0.9)
    speed = np.sqrt(2 * 9.81)
    assert study.after_back_v_y.values[:, 0] == pytest.approx(0.5 * speed, rel=1e-5)
    for k, step in enumerate((0.04, 0.02)):
        run = xd.simulate(model, method="rk4", step=step, until=0.9)
        assert int(study.event_count_back[k]) == int((run.event_detector == 0).sum())
        doubt = float(run.event_time_uncertainty[0])
        assert float(study.interpolation_error_event_time_back[k, 0]) == doubt
        assert float(study.interpolation_error_after_back_v_y[k, 0]) == pytest.approx(9.81 * doubt)


@pytest.mark.parametrize(("limit", "said"), [("1e9 m s-1", "1/vt"), ("1e7 m s-1", "1/vt")])
def test_a_limit_that_stands_for_infinity_has_an_order(limit: str, said: str) -> None:
    """Assert order two of drag in 1/vt, and that distances have the sign of y less that of the limit."""
    found = xd.limiting(
        DRAG, "vt", ["100 m s-1", "1000 m s-1", "10000 m s-1"], limit, at=["1 s"], method="dop853", rtol=1e-12
    )
    assert found.attrs["order_in"] == said
    assert found.order_y.values[1:, 0] == pytest.approx(2.0, abs=0.01)
    assert np.isnan(found.order_y.values[0, 0])
    assert (found.distance_y.values < 0.0).all()  # drag keeps it lower
    assert found.distance_y.values == pytest.approx(found.y.values - found.limit_y.values)
    assert float(found.limit_y[0]) == pytest.approx(20.0 - 9.80665 / 2, rel=1e-9)
    assert found.approached_y.values.tolist() == [1]


def test_a_limit_that_is_near_has_its_own_order() -> None:
    """Assert order one in a stiffness that comes to a finite one, from above and below."""
    for values in ([4.4, 4.2, 4.1], [3.6, 3.8, 3.9]):
        found = xd.limiting(OSCILLATOR, "k", values, 4.0, at=["1 s"], method="dop853", rtol=1e-12)
        assert found.attrs["order_in"] == "k"
        assert found.order_x.values[1:, 0] == pytest.approx(1.0, abs=0.15)


def test_no_run_is_begun_that_has_no_room(tmp_path: Path) -> None:
    """Assert what is said of a grid that memory or the disk has no room for, at once, and of sizes that are none."""
    asked: dict[str, Any] = {"method": "rk4", "until": 10.0}
    with pytest.raises(
        xd.InputError, match=r"the run makes 1e\+13 rows, which take .* TB, and .* of memory can be had"
    ):
        xd.simulate(OSCILLATOR, step=1e-12, **asked)
    with pytest.raises(xd.InputError, match="1 kB of memory were allowed; give path="):
        xd.simulate(OSCILLATOR, step=1e-3, memory="1 kB", **asked)
    with pytest.raises(xd.InputError, match="and the disk of .* free; take a longer step"):
        xd.simulate(OSCILLATOR, step=1e-14, path=tmp_path / "run.nc", **asked)
    for memory in ("much", -1, "2 m", True, "nan", "0 B"):
        with pytest.raises(xd.InputError, match="memory is .*, needs a positive size like '2 GB'"):
            xd.simulate(OSCILLATOR, step=0.1, memory=memory, **asked)
    with pytest.raises(xd.InputError, match=r"which take .*, and .* of memory can be had"):
        xd.limiting(OSCILLATOR, "k", [4.4, 4.2], 4.0, at=["1 s"], step=1e-12, **asked)


def test_levels_are_not_added_beyond_bounds() -> None:
    """Assert that a change that no machine could come to ends at once, with the step, rows and bytes it would need."""
    study = xd.refine(OSCILLATOR, method="midpoint", steps=[0.1], until=3.0, until_change={"x": 1e-18}, most_rows=1e4)
    assert "rounding alone moves x by" in study.attrs["stopped"]
    study = xd.refine(OSCILLATOR, method="forward_euler", steps=[0.01], until=3.0, until_change={"x": 1e-12})
    assert study.sizes["level"] <= 4
    assert "x would need a step_size of about " in study.attrs["stopped"]
    assert "e-13 s: 1e+13 rows (" in study.attrs["stopped"]
    assert "more than most_rows = 10000000" in study.attrs["stopped"]
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1e-12}, memory="20 kB")
    assert "20 kB of memory were allowed" in study.attrs["stopped"]
    with pytest.raises(xd.InputError, match="there is no second one: the next one would have 62 rows"):
        xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1e-12}, most_rows=50)
    with pytest.raises(xd.InputError, match="most_rows is 0, needs a number of rows"):
        xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1.0}, most_rows=0)


def test_a_level_that_ended_badly_is_named() -> None:
    """Assert that of levels whose steps are used up before the times of comparison the first is named, with its outcome."""
    with pytest.raises(
        xd.InputError, match="the level with rtol = 1e-07 ended before t = 2 s, as 'step_limit': .* raise max_steps"
    ):
        xd.refine(OSCILLATOR, method="forward_euler", rtols=[1e-3, 1e-4, 1e-7], until=3.0, at=[2.0], max_steps=20_000)
    study = xd.refine(
        OSCILLATOR, method="forward_euler", rtols=[1e-2], until=3.0, max_steps=20_000, until_change={"x": 1e-5}
    )
    assert "as 'step_limit'" in study.attrs["stopped"] or "more than" in study.attrs["stopped"]
