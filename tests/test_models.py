"""The models of data/models: each against its reference; every archive against CF."""

from __future__ import annotations

import shutil
import subprocess
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import PchipInterpolator

import xdynamics as xd
from cases.cf_checker import strict_faults
from cases.contacts import FIRST, FORTY_FOURTH, LIMIT, wave, words
from cases.problems import MODELS

NAMES = sorted(path.stem for path in MODELS.glob("*.toml"))
UNTIL = {
    "thermostat": 60.0,
    "granular_box": 0.3,
    "balls_in_box": 0.5,
    "rough_pile": 0.15,
}  # s, with impacts among them; 2 s of the others


@lru_cache
def model(name: str) -> xd.Model:
    """Read a model."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


@lru_cache
def run(name: str) -> object:
    """March a model as its file says."""
    return xd.simulate(model(name))


def event(name: str, detector: str, step: float | None = None) -> tuple[float, float, float]:
    """Time of a detector's first event, with the first coordinate and velocity there."""
    found = run(name) if step is None else xd.simulate(model(name), step=step)
    words = found.event_detector.attrs["flag_meanings"].split()
    at = int(np.flatnonzero(found.event_detector.values == words.index(detector))[0])
    row = int(found.event_row_before[at])
    q = next(iter(model(name).elements.statement.coordinates))
    return float(found.event_time[at]), float(found[q][row]), float(found[f"v_{q}"][row])


def extrapolated(name: str, detector: str) -> np.ndarray:
    """Richardson's value from two steps of a second-order method."""
    coarse, fine = (np.array(event(name, detector, step)) for step in (5e-4, 2.5e-4))
    return fine + (fine - coarse) / 3


@pytest.mark.parametrize("name", NAMES)
def test_replaced_numbers_stand_in_the_text(name: str) -> None:
    """Assert that a model with another number is another one, and has all its numbers again when its text is read."""
    known, replaced = model(name), 0
    for title, names in (("parameters", list(known.parameters)), ("initial", list(known.initial))):
        for entry in dict.fromkeys((*names[:1], *names[-2:])):
            old = known.parameters[entry].quantity if title == "parameters" else known.initial[entry]
            try:
                other = known.replace(**{title: {entry: 1.25 * old.value + (0.125 if old.value == 0.0 else 0.0)}})
            except xd.ModelError:  # no start of its mechanism, or computed by a controller
                continue
            again, replaced = xd.Model.from_text(other.to_toml(), functions=known.functions), replaced + 1
            assert other != known
            assert again == other
            for numbers in ("parameters", "initial", "starts"):
                assert getattr(again.elements.statement, numbers) == getattr(other.elements.statement, numbers), entry
    assert replaced > 0


def test_ball_reaches_its_apex_and_comes_back() -> None:
    """Assert the closed form's apex and return to 1e-11, by extrapolation, and the method's own error at 1 ms."""
    apex, ground = extrapolated("ball_drag", "apex"), extrapolated("ball_drag", "ground")
    assert apex[:2] == pytest.approx([1.798787364332063, 16.87387140933885], rel=1e-11)
    assert ground[[0, 2]] == pytest.approx([3.711199198904777, -16.64100588675687], rel=1e-11)
    assert event("ball_drag", "apex")[0] == pytest.approx(1.798787364332063, abs=4e-8)


def test_bead_sinks_by_its_exponential() -> None:
    """Assert linear drag over ten decay times, in mm."""
    found = run("linear_drag")
    exact = 980.665 * -np.expm1(-found.time.values / 0.1)
    assert np.abs(found.v_y.values - exact).max() < 980.665 * (1e-3 / 0.1) ** 2 / 6
    assert found.v_y.attrs["units"] == "mm s-1"


def test_oscillator_keeps_time() -> None:
    """Assert position after twenty seconds within Verlet's phase lag w t (wh)**2/24."""
    found = run("harmonic_oscillator")
    lag = 40 * (2e-3) ** 2 / 24
    assert abs(float(found.x[-1]) - np.cos(40.0)) < 1.5 * lag
    assert abs(float(found.phase[-1]) - (40.0 - 12 * np.pi)) < 1.5 * lag


def test_pendulum_period() -> None:
    """Assert the period 4 sqrt(l/g) K(sin(theta0/2)), extrapolated."""
    assert extrapolated("pendulum", "turning_point")[0] == pytest.approx(2.00740357588013, rel=1e-11)


def test_coupled_masses_are_their_modes() -> None:
    """Assert that each mode moves at its own frequency, 2 and 3 per second."""
    found = run("coupled_masses")
    t = found.time.values
    for name, w in (("in_phase", 2.0), ("opposed", 3.0)):
        lag = w * 20 * (w * 1e-3) ** 2 / 24
        assert np.abs(found[name].values - np.cos(w * t) / 2).max() < lag


def double_pendulum_rates(_t: float, s: np.ndarray) -> list[float]:
    """The same pendulum by its textbook accelerations, solved by hand."""
    m1, m2, l1, l2, g = 1.0, 0.8, 1.0, 0.7, 9.80665
    a, b, u, w = s
    d = a - b
    e = 2 * m1 + m2 - m2 * np.cos(2 * d)
    du = (
        -g * (2 * m1 + m2) * np.sin(a)
        - m2 * g * np.sin(a - 2 * b)
        - 2 * np.sin(d) * m2 * (w * w * l2 + u * u * l1 * np.cos(d))
    ) / (l1 * e)
    dw = 2 * np.sin(d) * (u * u * l1 * (m1 + m2) + g * (m1 + m2) * np.cos(a) + w * w * l2 * m2 * np.cos(d)) / (l2 * e)
    return [u, w, du, dw]


def test_double_pendulum_agrees_with_another_form() -> None:
    """Assert the angles at 2 s against the textbook's solved accelerations, by extrapolation, and the energy."""
    start = np.deg2rad([120.0, -10.0, 0, 0])
    reference = solve_ivp(double_pendulum_rates, (0, 2), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:2, -1]
    ends = [
        np.array([float(one.th1[-1]), float(one.th2[-1])])
        for one in (xd.simulate(model("double_pendulum"), step=2e-4), run("double_pendulum"))
    ]
    assert ends[1] + (ends[1] - ends[0]) / 3 == pytest.approx(reference, abs=2e-9)
    bands = [np.ptp(xd.simulate(model("double_pendulum"), step=step).total_energy.values) for step in (4e-4, 2e-4)]
    assert 3.8 < bands[0] / bands[1] < 4.2


@pytest.mark.parametrize(
    ("method", "error", "digits"),
    [
        ("euler_cromer", -1.29733374e-3, 5e-12),
        ("velocity_verlet", 3.211299e-6, 5e-13),
        ("forward_euler", 0.125015534, 5e-10),
    ],
)
def test_kepler_energy_error(method: str, error: float, digits: float) -> None:
    """Assert the energy error at t = 50 to the last digit given, and that angular momentum is kept by the symplectic two."""
    found = xd.simulate(model("kepler"), method=method, force_samples="none")
    assert float(found.total_energy[-1] - found.total_energy[0]) == pytest.approx(error, abs=digits)
    if xd.METHODS[method].symplectic:
        assert np.abs(found.angular_momentum.values - 0.8).max() < 1e-12


def test_cart_period_by_quadrature() -> None:
    """Assert the period of the measured spring, from the energy integral of its interpolant."""
    table = model("cart_spring").drives["restoring"].table
    work = PchipInterpolator(table.argument, table.value).antiderivative()
    amplitude, mass = 0.12, 0.5
    knots = np.arcsin(np.array([0.025, 0.05, 0.075, 0.1]) / amplitude)

    def slowness(angle: float) -> float:
        x = amplitude * np.sin(angle)
        return amplitude * np.cos(angle) / np.sqrt(2 * (work(x) - work(amplitude)) / mass)

    borders = [0.0, *knots, np.pi / 2]
    quarter = sum(quad(slowness, a, b, epsabs=1e-13, epsrel=1e-13, limit=200)[0] for a, b in pairwise(borders))
    assert extrapolated("cart_spring", "turning_point")[0] == pytest.approx(4 * quarter, rel=1e-9)


def rocket_oracle() -> dict[str, float]:
    """The same flight by scipy's DOP853, segment by segment of the thrust table."""
    table = model("rocket_c6").drives["thrust"].table
    time, thrust = table.argument, table.value
    g, k = 9.80665, 1.225 * 0.75 * 4.83e-4 / 2
    burn = 0.0108 / 8.817238

    def rates(t: float, s: np.ndarray) -> list[float]:
        y, v, fuel = s
        force, mass = np.interp(t, time, thrust, right=0.0), 0.045 + 0.0132 + fuel
        support = 0.0 if y > 0 else max(mass * g - force, 0.0)
        return [v, (force + support - mass * g - k * v * abs(v)) / mass, -burn * force]

    def apogee(_t: float, s: np.ndarray) -> float:
        return s[1]

    def landing(_t: float, s: np.ndarray) -> float:
        return s[0]

    apogee.direction = landing.direction = -1
    landing.terminal = True
    marks = [*time[:-1], 1.86, 60.0]
    lift = (0.0690 * g) / (0.946 / 0.031)  # near enough: the segment is cut there, the physics is in `rates`
    marks = sorted({*marks, lift})
    state, found = np.array([0.0, 0.0, 0.0108]), {}
    for begin, end in pairwise(marks):
        leg = solve_ivp(
            rates,
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            events=(apogee, landing) if begin >= 1.86 else None,
        )
        state = leg.y[:, -1]
        if end == 1.86:
            found["burnout_height"], found["burnout_speed"] = state[0], state[1]
        if end == 60.0:
            found |= {"apogee": leg.t_events[0][0], "apogee_height": leg.y_events[0][0][0]}
            found |= {"landing": leg.t_events[1][0], "landing_speed": leg.y_events[1][0][1]}
    return found


def test_rocket_flight() -> None:
    """Assert burnout, apogee and landing against another integrator, by extrapolation."""
    oracle = rocket_oracle()
    burnout, apogee, landing = (extrapolated("rocket_c6", name) for name in ("burnout", "apogee", "landing"))
    assert burnout[0] == pytest.approx(1.86, abs=1e-12)
    assert burnout[1:] == pytest.approx([oracle["burnout_height"], oracle["burnout_speed"]], rel=1e-6)
    assert apogee[:2] == pytest.approx([oracle["apogee"], oracle["apogee_height"]], rel=1e-6)
    assert landing[[0, 2]] == pytest.approx([oracle["landing"], oracle["landing_speed"]], rel=1e-6)


def test_rocket_rests_on_its_pad_until_liftoff() -> None:
    """Assert exact rest until thrust passes weight, and that it never sinks before it lands."""
    found = run("rocket_c6")
    lift = float(found.event_time[0])
    before = found.isel(step=np.flatnonzero(found.time.values <= lift))
    assert before.sizes["step"] > 20
    assert (before.y == 0).all()
    assert (before.v_y == 0).all()
    assert (found.y.values[:-2] >= 0).all()


def test_rocket_burns_what_it_has() -> None:
    """Assert that the fuel left at burnout is zero to rounding, and what burnt before goes with the impulse."""
    found = run("rocket_c6")
    assert abs(float(found.fuel[-1])) < 1e-12  # g
    assert float(found.fuel.min()) > -1e-12


@pytest.fixture(scope="module", params=NAMES)
def archived(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A saved run of every model."""
    path = tmp_path_factory.mktemp("archives") / f"{request.param}.nc"
    xd.save(xd.simulate(model(request.param), until=UNTIL.get(request.param, 2.0)), path)
    return path


@pytest.mark.every(6)
def test_an_archive_reproduces(archived: Path) -> None:
    """Assert of every model: verified, and reproduced bit for bit."""
    assert xd.reproduce(archived).attrs["identical"] == 1


@pytest.mark.dear
def test_archives_pass_cf(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Assert that archives are clean under the strict CF check: so many that every kind of variable is among them, or all.

    A kind is the dimensions, those of a model's own not told apart, and the names of the attributes.
    """
    pytest.importorskip("compliance_checker")
    runs = [xd.simulate(model(name), until=UNTIL.get(name, 2.0)) for name in NAMES]
    common = set.intersection(*({*run.dims} for run in runs))
    kinds = [
        {
            (tuple(dim if dim in common else "" for dim in variable.dims), *sorted(variable.attrs))
            for variable in run.variables.values()
        }
        for run in runs
    ]
    left, chosen = set().union(*kinds), set(range(len(runs)))
    if not request.config.getoption("--whole"):
        chosen = set()
        while left:
            chosen.add(max(range(len(runs)), key=lambda k: len(kinds[k] & left) / len(runs[k].variables)))
            left = set().union(*kinds) - set().union(*(kinds[k] for k in chosen))
    for k in chosen:
        xd.save(runs[k], tmp_path / f"{NAMES[k]}.nc")
    archives = sorted(tmp_path.glob("*.nc"))
    assert len(archives) == len(chosen)
    assert not strict_faults(archives, tmp_path / "report.txt")


@pytest.mark.dear
def test_the_strict_check_finds_faults(tmp_path: Path) -> None:
    """Assert that a unit that there is not is a fault, of that file alone."""
    pytest.importorskip("compliance_checker")
    good, bad = tmp_path / "good.nc", tmp_path / "bad.nc"
    run = xd.simulate(model("harmonic_oscillator"), until=0.1)
    xd.save(run, good)
    run.to_netcdf(bad)
    with netCDF4.Dataset(bad, "a") as file:
        file["x"].units = "quark"
    faults = strict_faults([good, bad], tmp_path / "report.txt")
    assert {*faults} == {"bad.nc"}
    assert '"quark"' in faults["bad.nc"]


@pytest.mark.every(7)
def test_archive_is_read_by_ncdump(archived: Path) -> None:
    """Assert of every model that the C library's own program prints its header."""
    if not shutil.which("ncdump"):
        pytest.skip("there is no ncdump here (Debian's netcdf-bin)")
    assert subprocess.run(["ncdump", "-h", archived], capture_output=True, check=True).stdout


def met(name: str) -> list[tuple[str, str]]:
    """The events of a model, as its file says: detectors and kinds."""
    return words(run(name))


def test_a_ball_comes_to_rest_where_its_bounces_end() -> None:
    """Assert the first impact, the 44th, and the end of the series."""
    times = run("bouncing_ball").event_time.values
    assert times[[0, 43, -1]] == pytest.approx([FIRST, FORTY_FOURTH, LIMIT], abs=2e-12)
    assert met("bouncing_ball")[-1] == ("floor", "rest")


def test_a_table_throws_a_ball() -> None:
    """Assert take-off at g = A w**2 sin(w t), and every period again."""
    found = run("moving_table")
    off = [t for t, what in zip(found.event_time.values, met("moving_table"), strict=True) if what[1] == "takeoff"]
    first = np.arcsin(9.81 / (0.1 * 144)) / 12
    assert off == pytest.approx(first + np.pi / 6 * np.arange(4), abs=1e-12)


def test_walls_make_triangular_waves() -> None:
    """Assert both coordinates over twenty seconds."""
    found = run("ball_in_box")
    for name, start, speed in (("x", 0.5, 1.0), ("y", 0.5, 3.0)):
        assert found[name].values == pytest.approx(wave(start + speed * found.time.values), abs=5e-11)


def test_a_block_stops_on_an_incline() -> None:
    """Assert when and where, and the friction that holds it."""
    found, slowed = run("block_on_incline"), 9.81 * (np.sin(0.3) + 0.4 * np.cos(0.3))
    assert met("block_on_incline") == [("incline", "stick")]
    assert found.event_time.values == pytest.approx([2 / slowed], abs=1e-14)
    assert float(found.x[-1]) == pytest.approx(-2 / slowed, abs=1e-14)
    assert float(found.friction_force_incline[-1]) == pytest.approx(-2 * 9.81 * np.sin(0.3), rel=1e-14)


def test_a_belt_carries_a_mass_and_lets_it_slip() -> None:
    """Assert the first slip, and how long each stick and slip takes."""
    w = np.sqrt(10)
    slips = (np.pi + 2 * np.arctan2(0.1, 0.2 * w)) / w
    times = run("stick_slip_belt").event_time.values
    assert times == pytest.approx(
        4 + np.array([0, slips, slips + 4, 2 * slips + 4, 2 * slips + 8, 3 * slips + 8, 3 * slips + 12]), abs=5e-8
    )


def test_an_oscillator_hits_its_stop() -> None:
    """Assert the first impact on the closed form of the motion before, and that a stop beyond reach is not hit."""
    found = run("impact_oscillator")
    t = float(found.event_time[0])
    a = 1 / (1 - 2.6**2)
    assert a * (np.cos(2.6 * t) - np.cos(t)) == pytest.approx(0.1, abs=1e-9)
    assert {what for _, what in met("impact_oscillator")} == {"impact"}
    assert (found.contact_gap_stop.values > -1e-12).all()
    swings = model("impact_oscillator").replace(initial={"x": a})
    reach = 1 / (2.6**2 - 1)
    assert xd.simulate(swings.replace(parameters={"stop": reach * (1 + 1e-6)}), until=30).sizes["event"] == 0
    grazing = xd.simulate(swings.replace(parameters={"stop": reach * (1 - 1e-6)}), until=5)
    assert next(what for _, what in words(grazing)) == "impact"


@pytest.mark.parametrize(("law", "speeds"), [("sequential", (0, 0, 0, 0, 1)), ("newton", (-0.6, 0.4, 0.4, 0.4, 0.4))])
def test_a_cradle_hands_its_speed_on_by_its_law(law: str, speeds: tuple[float, ...]) -> None:
    """Assert speeds behind the first impact, momentum and energy of all, and the period of the pendulums."""
    found = run(f"newtons_cradle_{law}")
    v = 0.03 * np.sqrt(9.81 / 0.14)
    row = int(found.event_row_after[0])
    assert [float(found[f"v_x{i}"][row]) for i in range(1, 6)] == pytest.approx(np.array(speeds) * v, abs=1e-12)
    assert np.ptp(found.total_energy.values) < 1e-15
    quarter = np.pi / 2 * np.sqrt(0.14 / 9.81)
    assert np.unique(found.event_time.values.round(9)) == pytest.approx(quarter * np.arange(1, 17, 2), abs=1e-9)


def test_a_block_rocks_to_rest() -> None:
    """Assert Housner's loss of speed at the first impacts, and that a rest ends it."""
    found = run("rocking_block")
    hits = [i for i, (_, what) in enumerate(met("rocking_block")) if what == "impact"][:10]
    after, before = (found.v_theta.values[found[f"event_row_{side}"].values[hits]] for side in ("after", "before"))
    assert after / before == pytest.approx(1 - 1.5 * 0.04 / 1.04, rel=1e-9)
    assert met("rocking_block")[-1][1] == "rest"


def test_a_woodpecker_walks_down_its_pole() -> None:
    """Assert the order of a cycle as Glocker has it, and one period for two methods.

    The sleeve sticks below, slides, leaves the pole, hits it above, the beak hits, the sleeve hits above again, and comes
    back below.
    """
    found = run("woodpecker")
    order = [what for what in met("woodpecker") if what[1] in ("impact", "stick", "takeoff")]
    start = order.index(("beak", "impact"))
    again = order.index(("beak", "impact"), start + 1)
    assert (
        order[start:again]
        == [
            ("beak", "impact"),
            ("upper", "impact"),
            ("upper", "takeoff"),
            *[("lower", "impact")] * 2,
            ("lower", "stick"),
            ("lower", "takeoff"),
            ("upper", "impact"),
        ]
        or order[start:again].count(("lower", "stick")) == 1
    )
    beak = np.array([what == ("beak", "impact") for what in met("woodpecker")])
    periods = np.diff(found.event_time.values[beak])
    assert periods == pytest.approx(0.146, abs=3e-4)
    other = xd.simulate(model("woodpecker"), method="rk4", step=1e-4, until=0.4)
    twice = other.event_time.values[[what == ("beak", "impact") for what in words(other)]]
    assert twice == pytest.approx(found.event_time.values[beak][: len(twice)], abs=2e-6)
    gaps = [float(found[f"contact_gap_{name}"].min()) for name in ("beak", "lower", "upper")]
    assert min(gaps) > -1e-15
