"""Time scales in the record, what starts at rest unsaid, rules of drives, and warnings of tolerances that lose the motion."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.cli import main
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.timescales import jacobian_at
from xdynamics.model.linearisation import initial_state, linearise
from xdynamics.stability import fastest_rate, rough_rate


def network(rng: np.random.Generator, n: int) -> xd.Model:
    """Masses that springs and dashpots join to each other and to the wall, at random."""
    names = [f"x{i}" for i in range(n)]
    root = rng.normal(size=(n, n))
    k, c = root @ root.T * 10.0 ** rng.uniform(-1, 3), np.diag(rng.uniform(0, 1, n)) * float(rng.random() < 0.5)
    pulls = {
        name: " ".join(
            f"- {float(k[i, j])!r}*k*{other} - {float(c[i, j])!r}*c*v_{other}" for j, other in enumerate(names)
        )
        .replace("- -", "+ ")
        .lstrip("+ ")
        for i, name in enumerate(names)
    }
    return xd.Model(
        name="network",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"k": "1 N m-1", "c": "1 N s m-1", "m": "1 kg"},
        mass=dict.fromkeys(names, "m"),
        forces={"joints": pulls},
        initial={name: f"{float(rng.uniform(-1, 1))!r} m" for name in names}
        | {f"v_{name}": "0 m s-1" for name in names},
    )


def ritz_rate(scaled: np.ndarray) -> float:
    """Return the largest eigenvalue of a matrix's compression on its fourth and fifth product with the first direction.

    The roots of the recurrence that fits three products best are these (Saad, Numerical Methods for Large Eigenvalue
    Problems, section 6.2: Arnoldi's method, of which the space is that of the last two products).
    """
    n = len(scaled) // 2
    parts = 0.6180339887498949 * np.tile(np.arange(n), 2) + np.repeat([0.0, 0.5], n)
    parts = 2.0 * (parts - np.floor(parts)) - 1.0
    last = np.linalg.matrix_power(scaled / np.abs(scaled).max(), 4) @ (parts + np.where(parts >= 0.0, 1.0, -1.0))
    space = np.stack([last, scaled @ last], axis=1)
    space, remains = np.linalg.qr(space / np.linalg.norm(space, axis=0))
    if remains[1, 1] ** 2 <= 1e-6:  # parallel: one decay is left
        space = (scaled @ last)[:, None] / np.linalg.norm(scaled @ last)
    return float(np.abs(np.linalg.eigvals(space.T @ scaled @ space)).max())


def marched(case: int) -> tuple[xd.Model, dict[str, Any], March]:
    """Return a random network, how it is marched, and its march."""
    rng = np.random.default_rng(case)
    model = network(rng, int(rng.integers(1, 7)))
    asked = {"until": 2e-3} | ({"method": "rk4", "step": 1e-4}, {"method": "dop853", "rtol": 1e-6})[case % 2]
    march = March(model, settings_for(model, **asked))
    list(march.blocks())
    return model, asked, march


@pytest.mark.dear
def test_rates_are_mostly_near_the_fastest() -> None:
    """Assert that of 300 networks 19 in 20 have a rate from 0.7 to 1.1 of the largest eigenvalue; and that not all have.

    No bound of one is to be had: a first direction may have as little of the fastest mode as one likes, and damped motions
    have rates above their eigenvalues.
    """
    near = 0
    for case in range(300):
        scaled = jacobian_at(marched(case)[-1], 0)
        near += 0.7 <= ritz_rate(scaled) / np.abs(np.linalg.eigvals(scaled)).max() <= 1.1
    assert 285 <= near < 300


@pytest.mark.every(3)
@pytest.mark.cases(300)
def test_rates_are_those_of_the_eigenvalues(case: int) -> None:
    """Assert that the fastest rate is Arnoldi's, of one coordinate the largest eigenvalue; and the slowest period."""
    model, asked, march = marched(case)
    found, h = xd.modes(model), 1e-4
    fastest = 1.0 / float(found.fastest_time_scale)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.StabilityWarning)
        run = xd.simulate(model, **asked, force_samples="none")
    rate, scaled = run.attrs["run_fastest_rate"], jacobian_at(march, 0)
    assert rate == pytest.approx(ritz_rate(scaled), rel=1e-5)
    assert rate <= np.linalg.norm(scaled, 2) * (1.0 + 1e-9)
    if len(model.elements.statement.coordinates) == 1:
        assert rate == pytest.approx(fastest, rel=1e-3)
    first = h if case % 2 == 0 else run.attrs["solver_first_step"]
    assert run.attrs["run_h_omega_start"] == pytest.approx(rate * first, rel=1e-12)
    assert run.attrs["run_h_omega_largest"] >= run.attrs["run_h_omega_start"] * (1 - 1e-9)
    turning = np.abs(found.eigenvalue_imag.values)
    turning = turning[(turning > 1e-5 * fastest) & (turning > np.abs(found.eigenvalue_real.values))]
    if turning.size:
        assert run.attrs["run_slowest_period"] == pytest.approx(2 * np.pi / turning.min(), rel=2e-2)
        assert run.attrs["run_slowest_periods"] == pytest.approx(20 * h / run.attrs["run_slowest_period"], rel=2e-2)
    else:
        assert "run_slowest_period" not in run.attrs


@pytest.mark.cases(60)
def test_derivatives_by_differences_have_the_eigenvalues(case: int) -> None:
    """Assert that the compiled derivatives bound no less than the fastest eigenvalue, and are similar to the exact ones."""
    rng = np.random.default_rng(case)
    model = network(rng, int(rng.integers(1, 7)))
    march = March(
        model, settings_for(model, method="rk4", step=1e-4, until=1e-3, scales={"time": "0.1 s"} if case % 2 else None)
    )
    list(march.blocks())
    found, exact = jacobian_at(march, 3), linearise(model, initial_state(model)).jacobian * (0.1 if case % 2 else 1.0)
    size = np.abs(np.linalg.eigvals(exact)).max()
    assert rough_rate(found) >= fastest_rate(found) * (1.0 - 1e-12) >= size * (1.0 - 1e-6)
    assert np.poly(found / size) == pytest.approx(np.poly(exact / size), abs=1e-5)


def test_the_largest_is_found_along_the_run() -> None:
    """Assert that a spring which stiffens in time has its largest h*omega at its end, in memory, streamed and extended."""
    model = particle(
        name="stiffening",
        parameters={"k": "1 N m-1", "m": "1 kg"},
        forces={"spring": {"x": "-k*x*(1 + t/second)**2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step="1 ms", until="9 s", force_samples="none")
    assert run.attrs["run_h_omega_start"] == pytest.approx(1e-3, rel=1e-3)
    assert 8e-3 < run.attrs["run_h_omega_largest"] <= 1.001e-2
    assert "at 16 rows" in run.attrs["run_h_omega_rule"]


def test_what_cannot_be_looked_at_is_said() -> None:
    """Assert that a large state has no slowest period, and several regimes the start alone."""
    rng = np.random.default_rng(1)
    large = xd.simulate(network(rng, 7), method="rk4", step=1e-4, until=1e-3, force_samples="none")
    assert large.attrs["run_slowest_period_rule"] == "not looked at: the state has more than 12 numbers"
    staged = xd.simulate(xd.Model.from_toml(MODELS / "staged_rocket.toml"), until="2 s", force_samples="none")
    assert "at 0 rows" in staged.attrs["run_h_omega_rule"]


@pytest.mark.parametrize("name", ["bouncing_ball", "stick_slip_belt", "relay_oscillator", "moving_table", "kepler"])
def test_looking_changes_nothing(name: str) -> None:
    """Assert that contacts, sides and memory are as they were once time scales were looked at."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    end, asked = float(model.run["until"].split()[0]) / 4, {"time_tolerance": "1 ps"}
    half, whole = (
        xd.simulate(model, until=end / part, nodes=nodes, **asked) for part, nodes in ((2, None), (1, [end / 2]))
    )
    assert half.attrs["run_outcome"] == "completed"
    assert xd.content_digest(xd.extend(half, until=end)) == xd.content_digest(whole)


@pytest.mark.dear
def test_a_velocity_that_is_not_given_is_said(tmp_path: Path) -> None:
    """Assert that the first line of check, and an attribute, name it, before and behind an archive; and that others are silent."""
    text = (MODELS / "harmonic_oscillator.toml").read_text()
    path = tmp_path / "model.toml"
    path.write_text("\n".join(line for line in text.split("\n") if not line.startswith("v_x")))
    line = "at rest   v_x: [initial] gives none, so that they are 0 at the start"
    checked = CliRunner().invoke(main, ["check", str(path)])
    assert checked.output.split("\n")[0] == line
    CliRunner().invoke(main, ["run", str(path), "-o", str(tmp_path / "run.nc"), "--until", "1 s"])
    kept = xd.open_run(tmp_path / "run.nc")
    assert kept.attrs["initial_velocities_not_given"] == "v_x"
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    model = xd.Model.from_toml(path)
    assert xd.Model.from_text(model.to_toml()) == model
    assert "v_x" not in model.to_toml().partition("[initial]")[2].partition("[")[0]
    given = model.replace(initial={"v_x": "0 m s-1"})
    assert "initial_velocities_not_given" not in xd.simulate(given, until="1 s").attrs
    assert "at rest" not in CliRunner().invoke(main, ["check", str(MODELS / "harmonic_oscillator.toml")]).output


def test_scales_are_shown(tmp_path: Path) -> None:
    """Assert that `show` has steps beside the fastest time scale, and a span that is short beside the slowest."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    xd.save(xd.simulate(model, method="rk4", step="10 ms", until="0.5 s"), tmp_path / "run.nc")
    shown = CliRunner().invoke(main, ["show", str(tmp_path / "run.nc"), "--all"]).output
    assert "resolved  the fastest motion by at least 314 steps a period" in shown
    assert "span      0.16 of the slowest period at the start, 3.14 s" in shown
    assert "run_fastest_rate = 2.0" in shown
    xd.save(xd.simulate(model, method="rk4", step="10 ms", until="5 s"), tmp_path / "long.nc")
    assert "span  " not in CliRunner().invoke(main, ["show", str(tmp_path / "long.nc")]).output


@pytest.mark.parametrize("rule", ["previous", "linear", "pchip", "cubic"])
def test_a_drive_says_how_it_is_read(rule: str, tmp_path: Path) -> None:
    """Assert that the column of a drive has its rule between the points of its table and beyond them."""
    (tmp_path / "push.csv").write_text("time [s],push [N]\n0,0\n1,1\n2,0\n3,1\n")
    (tmp_path / "model.toml").write_text(
        'name = "pushed"\n[coordinates]\nx = { unit = "m" }\n[parameters]\nm = "1 kg"\n[mass]\nx = "m"\n[forces.push]\nx = "push"\n'
        f'[drives.push]\ntable = "push.csv"\nargument = "t"\ninterpolation = "{rule}"\noutside = "hold"\n[initial]\nx = "0 m"\nv_x = "0 m s-1"\n'
    )
    run = xd.simulate(xd.Model.from_toml(tmp_path / "model.toml"), method="rk4", step="0.5 s", until="2 s")
    about = run.sample_push.attrs
    assert (about["interpolation"], about["outside"], about["argument"]) == (rule, "hold", "t")


def orbit(size: float, unit: str) -> xd.Model:
    """A circular orbit of one year, however large, in a unit."""
    speed = 2 * np.pi * size
    return xd.Model(
        name="orbit",
        coordinates={"x": unit, "y": unit},
        parameters={"m": "1 kg", "mu": f"{4 * np.pi**2 * size**3!r} {unit}3 s-2"},
        mass={"x": "m", "y": "m"},
        forces={"pull": {"potential": "-m*mu/hypot(x, y)"}},
        initial={
            "x": f"{size!r} {unit}",
            "y": f"0 {unit}",
            "v_x": f"0 {unit} s-1",
            "v_y": f"{float(speed)!r} {unit} s-1",
        },
    )


@pytest.mark.cases(200)
def test_warnings_are_of_what_is_lost(case: int) -> None:
    """Assert that a given absolute tolerance which loses the motion is warned of, and one that does not is not, by the closed form."""
    rng = np.random.default_rng(case)
    size, ratio, rtol = 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-12, -1), 10.0 ** rng.uniform(-12, -6)
    model = orbit(size, str(rng.choice(["m", "nm", "astronomical_unit", "Gm"])))
    method, until = str(rng.choice(["dop853", "dormand_prince"])), 2.0
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        run = xd.simulate(
            model, method=method, rtol=rtol, atol=ratio * size, until=until, max_steps=200_000, force_samples="none"
        )
    lost = np.hypot(float(run.x[-1]) / size - 1, float(run.y[-1]) / size)
    said = any(issubclass(one.category, xd.AccuracyWarning) and "did not control" in str(one.message) for one in heard)
    if lost > 0.05:
        assert said, (lost, ratio, rtol, run.sizes["step"])
    if lost < 1e-6:
        assert not said, (lost, ratio, rtol, run.sizes["step"])


def test_what_rounding_leaves_of_zero_is_no_news() -> None:
    """Assert that a coordinate of 1e-16 that stays so is silent, and so is a small one that a large one's error holds."""
    model = orbit(1.0, "m").replace(initial={"y": "6e-17 m", "v_x": "1e-16 m s-1"})
    flat = xd.Model(
        name="line",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass={"x": "m", "y": "m"},
        forces={"springs": {"x": "-k*x", "y": "-k*y"}},
        initial={"x": "1 m", "y": "6e-17 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for one in (model, flat):
            xd.simulate(one, method="dop853", rtol=1e-8, atol=1e-8, until="5 s")
            xd.simulate(one, method="dop853", rtol=1e-8, until="5 s")
    lever = xd.Model(
        name="lever",
        parameters={"tau": "1 s", "gain": "1e7 kg m-1 s-1"},
        states={"valve": {"unit": "m", "rate": "-valve/tau"}, "tank": {"unit": "kg", "rate": "gain*valve - tank/tau"}},
        initial={"valve": "1e-6 m", "tank": "0 kg"},
    )
    run = xd.simulate(lever, method="dop853", rtol=1e-10, atol=1e-8, until="5 s")
    t = run.time.values
    assert run.valve.values == pytest.approx(1e-6 * np.exp(-t), rel=1e-9)
    assert run.tank.values == pytest.approx(10.0 * t * np.exp(-t), abs=1e-8)


def test_what_constraints_keep_is_no_slow_motion() -> None:
    """Assert 2 pi/sqrt(6 g/(5 l)) of a linkage of four bars that hangs, and no slow period of one that stands upright."""
    text = (MODELS / "four_bar.toml").read_text().replace('"1 m s-1"', '"0 m s-1"')
    hanging = xd.Model.from_text(text.replace('"1 m"\nx1', '"-1 m"\nx1').replace('y1 = "1 m"', 'y1 = "-1 m"'))
    upright, hanging = (xd.simulate(model, until="10 ms") for model in (xd.Model.from_text(text), hanging))
    assert hanging.attrs["run_slowest_period"] == pytest.approx(2 * np.pi / np.sqrt(1.2 * 9.81), rel=5e-3)
    assert "run_slowest_period" not in upright.attrs
