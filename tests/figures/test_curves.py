"""Lines between rows: every quantity on states of the method's own steps, whatever the steps are."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.faults import DOT
from xdynamics.figures import curves
from xdynamics.figures.curves import (
    StatePolynomials,
    _hermite,
    _inner_times,
    derivative_chain,
    energy_changes,
    has_chords,
    plotted_lines,
    rows_along,
    thinned_rows,
    ways_along,
)
from xdynamics.figures.plane import views

Floats = Any


def spring(x: float, v: float, k: float, damping: float = 0.0) -> xd.Model:
    """A mass of 1 kg on a spring, with a drag where there is one."""
    forces: dict[str, Any] = {"spring": {"potential": "k*x**2/2"}}
    if damping:
        forces["drag"] = {"x": "-c*v_x"}
    return xd.Model(
        name="spring",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces=forces,
        parameters={"k": f"{k!r} N m-1"} | ({"c": f"{damping!r} kg s-1"} if damping else {}),
        initial={"x": f"{x!r} m", "v_x": f"{v!r} m s-1"},
        observables={"power": "-k*x*v_x"},
    )


def bent(run: xr.Dataset, name: str, times: Floats, rows: Floats) -> Floats | None:
    """A state on the polynomials of a run, if its derivatives are known."""
    known = derivative_chain({*run.variables}, name)
    return StatePolynomials(run, times, rows, {name: None})[name] if known else None


def test_elements_are_evaluated_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that 600 elements take three evaluations, to the bits of each alone; where one has no acceleration, four."""
    count, names, called = 600, [f"u{DOT}{i}" for i in range(600)], []
    inside = curves._inner_polynomials

    def counted(*arguments: Any) -> Any:
        called.append(arguments)
        return inside(*arguments)

    random, time = np.random.default_rng(3), np.array([0.0, 1.0, 1.5, 3.0])
    columns = {f"{head}u{DOT}{i}": ("step", random.normal(size=4)) for head in ("", "v_", "a_") for i in range(count)}
    run = xr.Dataset({"time": ("step", time), **columns})
    times, rows = np.array([0.25, 0.5, 1.25, 2.0]), np.array([0, 0, 1, 2])
    monkeypatch.setattr(curves, "_inner_polynomials", counted)
    for lacking, evaluations in ((run, 3), (run.drop_vars(f"a_u{DOT}7"), 4)):
        together = StatePolynomials(lacking, times, rows, dict.fromkeys(names))
        called.clear()
        lines = [together[name] for name in names]
        assert len(called) == evaluations
        for name, line in zip(names, lines, strict=True):
            alone = bent(lacking, name, times, rows)
            assert alone is not None
            assert line.tobytes() == alone.tobytes(), name


def uneven(random: np.random.Generator, span: float) -> list[float]:
    """Steps from tiny to long that come to a time, one of a few spacings of t in any place."""
    steps = 10.0 ** random.uniform(-4, 0, int(random.integers(3, 40)))
    steps = (steps * span / steps.sum()).tolist()
    return [*steps[: (place := int(random.integers(len(steps))))], 10.0 ** random.uniform(-14, -11), *steps[place:]]


def euler(x: Floats, v: Floats, h: Floats, k: float) -> tuple[Floats, Floats]:
    """One step of Euler's method."""
    return x + h * v, v - h * k * x


def verlet(x: Floats, v: Floats, h: Floats, k: float) -> tuple[Floats, Floats]:
    """One step of velocity Verlet."""
    x1 = x + h * v - h**2 / 2 * k * x
    return x1, v - h / 2 * k * (x + x1)


def midpoint(x: Floats, v: Floats, h: Floats, k: float) -> tuple[Floats, Floats]:
    """One step of the explicit midpoint rule."""
    return x + h * (v - h / 2 * k * x), v - h * k * (x + h / 2 * v)


STEPS: dict[str, Callable[..., tuple[Floats, Floats]]] = {
    "forward_euler": euler,
    "velocity_verlet": verlet,
    "midpoint": midpoint,
}


def test_parts_polynomials_have_values_and_slopes_of_both_ends() -> None:
    """Assert that Hermite's polynomials are those of degree five and three that they are made from, also of the record's rows."""
    w, u = np.array([0.5, 2.0]), np.array([0.3, 0.8])
    for degree in (5, 3):
        one = np.polynomial.Polynomial(np.arange(1.0, degree + 2.0) * (-1.0) ** np.arange(degree + 1))
        ends = [
            [part(x) for part in (one, one.deriv(1), one.deriv(2))[: (degree + 1) // 2]] for x in (1.0 + 0 * w, 1.0 + w)
        ]
        assert _hermite(ends[0], ends[1], w, u) == pytest.approx(one(1.0 + w * u), rel=1e-12)
    time = np.array([0.0, 0.5, 2.5])
    flight = np.polynomial.Polynomial([1.0, -2.0, 3.0, 0.5, -0.25, 0.125])
    run = xr.Dataset(
        {name: ("step", flight.deriv(k)(time)) for k, name in enumerate(("x", "v_x", "a_x"))} | {"time": ("step", time)}
    )
    run["s"], run["rate_s"] = ("step", time**3), ("step", 3.0 * time**2)
    times, rows = np.array([0.2, 1.0, 2.4]), np.array([0, 1, 1])
    assert bent(run, "x", times, rows) == pytest.approx(flight(times), rel=1e-12)
    assert bent(run, "s", times, rows) == pytest.approx(times**3, rel=1e-12)
    speeds = np.polynomial.Polynomial([1.0, -2.0, 3.0, 0.5])
    moved = run.assign(v_x=("step", speeds(time)), a_x=("step", speeds.deriv()(time)))
    assert bent(moved, "v_x", times, rows) == pytest.approx(speeds(times), rel=1e-12)
    slow = run.assign(x=("step", speeds(time)), v_x=("step", speeds.deriv()(time))).drop_vars("a_x")
    assert bent(slow, "x", times, rows) == pytest.approx(speeds(times), rel=1e-12)
    assert bent(slow, "v_x", times, rows) is None
    assert bent(run.drop_vars("v_x"), "x", times, rows) is None


def test_parts_points_are_dealt_out_by_rows_and_by_time() -> None:
    """Assert 40 points in a short step and 2,000 in proportion to time, evenly between both ends, none where time stands."""
    run = xr.Dataset({"time": ("step", np.array([0.0, 1e-3, 1e-3, 0.5, 1.0]))})
    times, rows = _inner_times(run)
    assert [int((rows == k).sum()) for k in range(4)] == [40, 0, 998, 1000]
    for k, (begin, end) in ((0, (0.0, 1e-3)), (3, (0.5, 1.0))):
        mine = times[rows == k]
        assert mine == pytest.approx(np.linspace(begin, end, mine.size + 2)[1:-1], rel=1e-12)
    assert _inner_times(run.isel(step=[0]))[0].size == 0
    many = xr.Dataset({"time": ("step", np.arange(1001.0))})
    assert np.bincount(_inner_times(many)[1]).tolist() == [2] * 1000


def test_parts_what_is_thinned_keeps_both_ends_and_every_peak() -> None:
    """Assert rows of the least and greatest of stretches of rows and of time, in order, and all where they are few."""
    values = np.zeros(100_000)
    values[[12_345, 67_890]] = 5.0, -7.0
    kept = thinned_rows(values)
    assert {0, 12_345, 67_890, 99_999} <= set(kept.tolist())
    assert 1990 <= kept.size <= 4003
    assert (np.diff(kept) > 0).all()
    assert thinned_rows(values[:4000]).size == 4000
    assert thinned_rows(values[:4001], max_points=400).size <= 402
    times = np.concatenate([np.linspace(0.0, 1e-3, 99_000), np.linspace(0.01, 1.0, 1000)])
    late = thinned_rows(values, times=times)
    assert (late >= 99_000).sum() > 900
    assert late.size <= 4002
    assert np.diff(times[late]).max() < 3e-3 + 9e-3


def test_parts_lines_are_in_the_records_unit() -> None:
    """Assert places in mm and accelerations in mm s-2 between long steps, of a spring."""
    model = xd.Model(
        name="spring",
        coordinates={"x": "mm"},
        mass={"x": "1*kilogram"},
        forces={"spring": {"x": "-k*x"}},
        parameters={"k": "4 N m-1"},
        initial={"x": "5 mm", "v_x": "0 mm s-1"},
    )
    run = xd.simulate(model, method="dop853", step=0.5, until=2.0)
    times, (line, places) = plotted_lines(run, "a_x", "x")
    assert times.size > 100
    assert places == pytest.approx(5.0 * np.cos(2.0 * times), abs=1e-6)
    assert line == pytest.approx(-4.0 * places, rel=1e-9, abs=1e-12)


def test_parts_energy_is_changed_by_forces_events_and_the_method() -> None:
    """Assert drag's loss by its closed form, Euler's gain of a fall, and what bounces lose, in the record's unit."""
    slide = xd.simulate(spring(0.0, 2.0, 1e-9, 0.4), method="dop853", rtol=1e-11, step=None, until=2.0)
    found = energy_changes(slide)
    assert found is not None
    assert found["forces"] == pytest.approx(2.0 * (1.0 - np.exp(-1.6)), rel=1e-4)
    assert found["events"] == 0.0
    assert found["the method's error"] < 1e-4
    swing = energy_changes(run := xd.simulate(spring(1.0, 0.0, 4.0), method="forward_euler", step=0.01, until=2.0))
    assert swing is not None
    assert swing["the method's error"] == pytest.approx(float(run.total_energy[-1] - run.total_energy[0]), rel=1e-9)
    assert max(swing["forces"], swing["events"]) < 1e-9
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        mass={"y": "2*kilogram"},
        parameters={"g": "10 m s-2"},
        forces={"gravity": {"potential": "2*kilogram*g*y"}},
        initial={"y": "1 m"},
        contacts={"floor": {"gap": "y", "restitution": 0.5}},
    )
    bounced = energy_changes(xd.simulate(ball, method="dop853", rtol=1e-9, until=1.0))
    assert bounced is not None
    assert bounced["events"] == pytest.approx(20.0 * (1.0 - 1.0 / 16.0), rel=1e-6)  # of two bounces
    assert max(bounced["forces"], bounced["the method's error"]) < 1e-6


@pytest.mark.cases(300)
def test_lines_are_of_the_methods_own_states(case: int) -> None:
    """Assert energies and an observable at every drawn time, by a second implementation of the step from the row before."""
    random = np.random.default_rng(case)
    method = [*STEPS][case % len(STEPS)]
    x, v, k = random.uniform(-2, 2), random.uniform(-2, 2), 10.0 ** random.uniform(-1, 1)
    span = random.uniform(0.5, 3.0)
    run = xd.simulate(spring(x, v, k), method=method, step=uneven(random, span), until=span)
    energies = "potential_energy", "kinetic_energy", "total_energy", "power", "force_spring_x", "a_x"
    times, lines = plotted_lines(run, *energies)
    time = run.time.values
    assert np.diff(times).max() <= span / 1000  # whatever the steps are, no line is a polygon
    assert np.isin(time, times).all()
    row = np.searchsorted(time, times, side="right") - 1
    here, speed = STEPS[method](run.x.values[row], run.v_x.values[row], times - time[row], k)
    power, force = -k * here * speed, -k * here
    true = k * here**2 / 2, speed**2 / 2, k * here**2 / 2 + speed**2 / 2, power, force, force
    size = 1.0 + float(run.total_energy.max()) * (1.0 + k)
    for name, line, values in zip(energies, lines, true, strict=True):
        assert np.abs(line - values).max() < 1e-11 * size, name
    assert not has_chords(run, *energies)


@pytest.mark.cases(200)
def test_energies_of_long_steps_are_those_of_the_closed_form(case: int) -> None:
    """Assert the heights of a flight's energies by v0 and g, of any method of second order at least, however few its steps."""
    random = np.random.default_rng(case)
    methods = [name for name, method in xd.METHODS.items() if method.order > 1 and name != "moreau_jean"]
    speed, g = random.uniform(1, 30), random.uniform(1, 20)
    flight = xd.Model(
        name="flight",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        parameters={"g": f"{g!r} m s-2"},
        forces={"gravity": {"potential": "1*kilogram*g*y"}},
        initial={"y": "0 m", "v_y": f"{speed!r} m s-1"},
    )
    end, count = 2 * speed / g, int(random.integers(1, 4))
    run = xd.simulate(flight, method=str(random.choice(methods)), step=end / count, until=end)
    times, (potential, kinetic) = plotted_lines(run, "potential_energy", "kinetic_energy")
    height = speed * times - g * times**2 / 2
    assert np.abs(potential - g * height).max() < 1e-9 * speed**2
    assert potential.max() == pytest.approx(speed**2 / 2, rel=1e-5)
    assert kinetic.min() < 1e-5 * speed**2


@pytest.mark.every(3)
@pytest.mark.cases(150)
def test_contact_forces_are_evaluated_between_rows(case: int) -> None:
    """Assert the normal and the sticking force of a block that a rocking load presses and pulls, by the forces' own sum."""
    random = np.random.default_rng(case)
    load, pull, w = random.uniform(0.1, 5), random.uniform(0.1, 1.0), random.uniform(1, 10)
    block = xd.Model(
        name="block",
        coordinates={"x": "m", "y": "m"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        parameters={"g": "9.81 m s-2", "load": f"{load!r} N", "pull": f"{pull!r} N", "w": f"{w!r} s-1"},
        forces={"weight": {"potential": "1*kilogram*g*y"}, "push": {"x": "pull*sin(w*t)", "y": "load*cos(w*t)"}},
        contacts={"floor": {"gap": "y", "restitution": 0.0, "tangential": "coulomb", "slip": "v_x", "friction": 0.9}},
        initial={"x": "0 m", "y": "0 m"},
    )
    run = xd.simulate(
        block, method=("dop853", "rk4", "bogacki_shampine")[case % 3], step=random.uniform(0.2, 1.0), until=2.0
    )
    times, (normal, friction) = plotted_lines(run, "contact_force_floor", "friction_force_floor")
    assert len(times) > 1000
    assert np.abs(normal - (9.81 - load * np.cos(w * times))).max() < 1e-9
    assert np.abs(friction + pull * np.sin(w * times)).max() < 1e-9


@pytest.mark.cases(100)
def test_what_changes_the_energy_is_named(case: int) -> None:
    """Assert the title over exchanged energies: the method's error, forces, events, or two of these."""
    random = np.random.default_rng(case)
    x, k, kind = random.uniform(0.5, 2), random.uniform(1, 9), case % 3
    if kind == 2:
        ball = xd.Model(
            name="ball",
            coordinates={"y": "m"},
            mass={"y": "1*kilogram"},
            parameters={"g": f"{k!r} m s-2"},
            forces={"gravity": {"potential": "1*kilogram*g*y"}},
            initial={"y": f"{x!r} m"},
            contacts={"floor": {"gap": "y", "restitution": random.uniform(0.3, 0.8)}},
        )
        run = xd.simulate(ball, method="dop853", rtol=1e-8, until=1.5 * np.sqrt(2 * x / k))
    else:
        model = spring(x, 0.0, k, random.uniform(0.2, 0.5) if kind else 0.0)
        run = xd.simulate(model, method="rk4" if kind else "forward_euler", step=0.02, until=4.0)
    titles = {axis.get_title(loc="left") for axis in xd.plot(run, only="energy").axes}
    assert titles == {f"energy, changed by {('the method’s error alone', 'forces', 'events')[kind]}".replace("’", "'")}


@pytest.mark.parametrize(("keep_every", "note"), [(1, ""), (4, ", straight between those")])
def test_forces_over_impacts_are_level_over_their_steps(keep_every: int, note: str) -> None:
    """Assert that forces of `moreau_jean` are drawn as what they are: the load at the middle of each step, all over that step."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        initial={"y": "0 m"},
        forces={"load": {"y": "-newton*(5 + sin(t/second))"}},
        contacts={"floor": {"gap": "y", "restitution": 0.0}},
    )
    run = xd.simulate(ball, method="moreau_jean", step=0.125, until=3.0, keep_every=keep_every)
    axes = xd.plot(run, only="contact").axes[0]
    times, forces = np.array(axes.lines[-1].get_data())
    ends = run.time.values[1:]
    assert axes.get_title(loc="left") == f"contact and friction; means over the step before each row{note}"
    assert np.array_equal(times[2:], np.stack([ends - 0.125, ends], axis=1).ravel())
    assert np.abs(forces[2:] - np.repeat(5 + np.sin(ends - 0.0625), 2)).max() < 1e-14 * 6


def test_a_body_at_rest_is_drawn_at_rest() -> None:
    """Assert that a ball on the floor does not sink between rows of `moreau_jean`, as gravity alone would have it.

    Its positions are rounding of what each step adds and takes; what two steps differ by is no share of their range.
    """
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m", "x": "m"},
        mass={"y": "1*kilogram", "x": "1*kilogram"},
        initial={"y": "0 m", "x": "0 m", "v_x": "0.3 m s-1"},
        forces={"load": {"y": "-newton*(5 + sin(t/second))", "x": "3*newton*sin(t/second)"}},
        contacts={"floor": {"gap": "y", "restitution": 0.0, "tangential": "coulomb", "slip": "v_x", "friction": 0.3}},
    )
    run = xd.simulate(ball, method="moreau_jean", step=0.25, until=6.0)
    times, (line,) = plotted_lines(run, "y")
    assert times.size > 1000
    assert np.abs(line).max() < 1e-15


def slider(**settings: Any) -> xr.Dataset:
    """A mass that slides to rest on a belt, by given steps."""
    mass: dict[str, Any] = {
        "coordinates": {"x": "m"},
        "mass": {"x": "1*kilogram"},
        "initial": {"x": "0 m", "v_x": "1 m s-1"},
    }
    belt = {"belt": {"slip": "v_x", "kinetic": "newton*(2 + t/second)"}}
    return xd.simulate(xd.Model(name="slider", frictions=belt, **mass), until=1.0, **settings)


def test_frictions_over_whole_steps_are_level_too() -> None:
    """Assert that friction of `moreau_jean` without contacts is drawn level, and named beside a run that locates stops."""
    stepped, located = slider(method="moreau_jean", step=0.125), slider(method="dop853", rtol=1e-8)
    axes = xd.plot(stepped, only="contact").axes[0]
    times, forces = np.array(axes.lines[-1].get_data())
    assert np.array_equal(times[2:], np.repeat(stepped.time.values, 2)[1:-1])
    assert np.array_equal(forces[2:], np.repeat(stepped.friction_force_belt.values[1:], 2))
    assert axes.get_title(loc="left") == "contact and friction; means over the step before each row"
    for runs in ([stepped, located], [located, stepped]):
        title = xd.plot(runs, only="contact").axes[0].get_title(loc="left").replace("\n", " ")
        assert title == "contact and friction; means over the step before each row of moreau_jean"


@pytest.mark.parametrize(("count", "note"), [(3, ""), (30, "; of many links: solved at rows, straight between them")])
def test_forces_of_many_contacts_are_joined_and_the_reason_is_said(count: int, note: str) -> None:
    """Assert that a few normal forces are evaluated inside steps, and that the panel of many says why they are not."""
    balls = xd.Model(
        name="balls",
        dimensions={"ball": count},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        mass={"y": "1*kilogram"},
        initial={"y": "0 m"},
        forces={"load": {"y": "-newton*(5 + sin(t/second))"}},
        contacts={"floor": {"gap": "y", "restitution": 0.0}},
    )
    axes = xd.plot(xd.simulate(balls, method="rk4", step=0.2, until=3.0), only="contact").axes[0]
    assert axes.get_title(loc="left").replace("\n", " ").endswith(note or "contact and friction")


def bodies(count: int) -> xr.Dataset:
    """A run of so many bodies on springs in the plane."""
    names = [f"{axis}{k}" for k in range(count) for axis in "xy"]
    model = xd.Model(
        name="bodies",
        coordinates=dict.fromkeys(names, "m"),
        mass=dict.fromkeys(names, "1*kilogram"),
        forces={"springs": {"potential": " + ".join(f"{name}**2*newton/metre" for name in names)}},
        figure={"plane": [[f"x{k}", f"y{k}"] for k in range(count)]},
        initial=dict.fromkeys(names, "0 m")
        | {f"x{k}": f"{k + 1} m" for k in range(count)}
        | {f"v_y{k}": "1 m s-1" for k in range(count)},
    )
    return xd.simulate(model, method="velocity_verlet", step=0.2, until=1.0)


@pytest.mark.dear
def test_every_body_is_drawn() -> None:
    """Assert a path for each of twenty bodies, and of very many that the picture says how many it shows."""
    run = bodies(20)
    axes = xd.plot(run, only="plane").axes[0]
    assert sum(line.get_linestyle() == "-" for line in axes.lines) == 20
    assert axes.get_title(loc="left") == "the plane (dot: start, not to scale)"  # they hardly move
    (view,) = views(run)
    assert len(view) == 20


@pytest.mark.dear
def test_a_bar_of_zero_has_no_length() -> None:
    """Assert a bar for each term that is not 0, and for each term its number."""
    model = spring(1.0, 0.0, 4.0).replace(parameters={"k": "4.0 ± 0.1 N m-1"})
    budget = xd.error_budget(model, "x", at=1.0, method="dop853", rtol=1e-9, until=1.0)
    sizes = budget.standard_uncertainty.values
    axes = xd.plot(budget).axes[0]
    assert (sizes == 0.0).any()
    assert len(axes.patches) == np.count_nonzero(sizes > sizes.max() / 1e6)
    assert len(axes.texts) == len(sizes)
    assert min(patch.get_width() for patch in axes.patches) == sizes[sizes > sizes.max() / 1e6].min()


def spiral(step: float, until: float) -> xr.Dataset:
    """Return an oscillation by forward Euler or, with wide steps, one by rk4 that dies away."""
    model = spring(1.0, 0.0, 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.StabilityWarning)
        return xd.simulate(model, method="forward_euler" if step < 0.1 else "rk4", step=step, until=until)


def test_a_spiral_of_many_rows_is_one_curve() -> None:
    """Assert no gap, chords that are those of the record to what a picture shows, and that the last row is there."""
    run = spiral(0.02, 628.0)
    assert run.sizes["step"] > 30_000
    x, v = np.asarray(max((line.get_xydata() for line in xd.plot(run, only="phase").axes[-1].lines), key=len)).T
    assert np.isfinite(x).all()
    assert (x[-1], v[-1]) == (float(run.x[-1]), float(run.v_x[-1]))
    rows = rows_along(ways_along(run.x.values, run.v_x.values))
    assert len(rows) < run.sizes["step"]  # the first turns are finer than the picture
    shown = [np.interp(np.arange(run.sizes["step"]), rows, values[rows]) for values in (run.x.values, run.v_x.values)]
    off = [
        np.abs(one - values).max() / np.ptp(values)
        for one, values in zip(shown, (run.x.values, run.v_x.values), strict=True)
    ]
    assert max(off) < 2e-3


def test_wide_steps_of_a_long_run_are_dots() -> None:
    """Assert that no line joins rows a third of a turn apart, and that every row is there."""
    run = spiral(0.6, 6000.0)
    lines = xd.plot(run, only="phase").axes[-1].lines
    dots = max((line for line in lines if line.get_linestyle() == "None"), key=lambda line: len(line.get_xdata()))
    assert np.array_equal(np.asarray(dots.get_xydata()), np.stack([run.x.values, run.v_x.values], axis=1))
    assert not any(
        np.isfinite(np.diff(np.asarray(line.get_xdata()))).any() for line in lines if line.get_linestyle() == "-"
    )


def test_rows_along_a_curve_keep_ends_and_gaps() -> None:
    """Assert both ends, every gap, an upper bound, and a point that stays where it is."""
    t = np.linspace(0.0, 1.0, 3_000_001)
    x, y = np.cos(4000.0 * t), np.sin(4000.0 * t)
    x[1_000_000] = np.nan
    rows = rows_along(ways_along(x, y))
    assert (rows[0], rows[-1], 1_000_000 in rows) == (0, 3_000_000, True)
    assert len(rows) <= 100_003
    assert rows_along(ways_along(np.zeros(9), np.ones(9))).tolist() == [0, 8]
