"""Bodies that turn, against closed forms and what is constant; quaternions of unit length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk, ellipkm1

import xdynamics as xd
from cases.bodies import FRAME, of_body
from cases.problems import MODELS

Array = NDArray[np.float64]


def rotation(run: xr.Dataset, body: str, row: Any = slice(None)) -> Rotation:
    """Attitudes of a body as scipy has them."""
    parts = np.column_stack([run[f"{body}_q0"].values, run[f"{body}_q"].values])
    return Rotation.from_quat(parts[row], scalar_first=True)


def lengths(run: xr.Dataset, body: str) -> Array:
    """Lengths of the quaternions of a body."""
    return np.sqrt(run[f"{body}_q0"].values ** 2 + (run[f"{body}_q"].values ** 2).sum(axis=-1))


def test_free_symmetric_top_has_its_closed_form() -> None:
    """Assert angular velocity and attitude of the model file over 10 s, and that its centre moves on."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "free_top.toml"))
    t = run.time.values
    wobble = (0.8 / 0.5 - 1) * 3 * t
    momentum = np.hypot(0.5 * 1.2, 0.8 * 3)
    axis = np.array([0.5 * 1.2, 0, 0.8 * 3]) / momentum
    exact = Rotation.from_rotvec(np.outer(momentum / 0.5 * t, axis)) * Rotation.from_rotvec(
        np.outer(-wobble, [0, 0, 1])
    )
    assert (rotation(run, "top") * exact.inv()).magnitude().max() < 2e-11
    found = np.column_stack([1.2 * np.cos(wobble), 1.2 * np.sin(wobble), np.full(t.size, 3.0)])
    assert np.abs(run.v_top_turn.values - found).max() < 2e-11
    assert np.abs(run.top_r.values - np.outer(t, [0.1, 0, 0])).max() < 1e-14


def elliptic(inertia: Array, start: tuple[float, float], t: Any) -> tuple[Array, float]:
    """Angular velocity by Landau and Lifshitz, Mechanics, (37.10), from the least first component on; its period.

    `inertia` ascends, and `start` is the first and the second component; L**2 < 2 E I_2, so that 1 and 3 change roles.
    """
    i1, i2, i3 = inertia
    w1, w2 = start
    energy, square = i1 * w1**2 + i2 * w2**2, (i1 * w1) ** 2 + (i2 * w2) ** 2
    assert square < energy * i2
    a, b = energy * i3 - square, square - energy * i1
    rate = np.sqrt((i2 - i1) * a / (i1 * i2 * i3))
    m = (i3 - i2) * b / ((i2 - i1) * a)
    quarter = ellipkm1((i3 - i1) * (energy * i2 - square) / ((i2 - i1) * a))
    sn, cn, dn, _ = ellipj(rate * np.asarray(t) + quarter, m)
    s1, s2, s3 = np.sqrt(a / (i1 * (i3 - i1))), np.sqrt(b / (i2 * (i2 - i1))), np.sqrt(b / (i3 * (i3 - i1)))
    return np.stack([s1 * dn, s2 * sn, s3 * cn], axis=-1), float(4 * quarter / rate)


def test_tennis_racket_turns_over_by_elliptic_functions() -> None:
    """Assert the angular velocity over three turns, and the attitude after a period, of which the angle is an integral."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "tennis_racket.toml"))
    inertia, start = np.array([1.2e-3, 16.4e-3, 17.6e-3]), (0.1, 6.0)
    exact, period = elliptic(inertia, start, run.time.values)
    assert np.abs(run.v_racket_turn.values - exact).max() < 3e-9
    assert run.sizes["event"] == int(2 * 10 / period + 0.5)
    assert run.event_time.values == pytest.approx(period * (0.25 + 0.5 * np.arange(run.sizes["event"])), abs=1e-10)

    def precession(t: float) -> float:
        w, _ = elliptic(inertia, start, t)
        return float(
            momentum * (inertia[0] * w[0] ** 2 + inertia[2] * w[2] ** 2) / ((inertia[[0, 2]] * w[[0, 2]]) ** 2).sum()
        )

    momentum = float(np.hypot(*(inertia[:2] * np.array(start))))
    angle = quad(precession, 0, period, epsabs=1e-12, limit=200)[0]
    turned = rotation(xd.simulate(xd.Model.from_toml(MODELS / "tennis_racket.toml"), until=period), "racket", -1)
    along = np.array([inertia[0] * start[0], inertia[1] * start[1], 0]) / momentum
    assert (turned * Rotation.from_rotvec(-angle * along)).magnitude() < 1e-8


def test_heavy_top_swerves_between_the_roots_of_its_cubic() -> None:
    """Assert the heights between which the model file's top nods, energy and both momenta."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "heavy_top.toml"))
    a, along, weight, spin, top = 0.1, 0.02, 9.81 * 0.3, 80.0, np.cos(np.pi / 6)
    # let go at u = cos(tilt): 2*a*weight*(1 - u**2) = (along*spin)**2*(top - u), Goldstein (5.72)
    k = (along * spin) ** 2 / (4 * a * weight)
    lowest = k - np.sqrt(k**2 - 2 * k * top + 1)
    height = run.bob.sel(axis="z").values / 0.3
    assert height.max() == pytest.approx(top, abs=1e-12)
    assert lowest - 1e-12 < height.min() < lowest + 1e-4
    for name in ("total_energy", "about_vertical", "about_axis"):
        assert np.ptp(run[name].values) < 1e-11, name
    assert np.abs(lengths(run, "top") - 1).max() < 1e-15


@pytest.mark.dear
def test_heavy_top_keeps_its_constants_over_a_hundred_thousand_steps() -> None:
    """Assert energy and momenta to 1e-11 of themselves over 10**5 steps, unit quaternions to rounding."""
    model = xd.Model.from_toml(MODELS / "heavy_top.toml")
    run = xd.simulate(model, method="dop853", step="1 ms", rtol=None, until="100 s", keep_every=100)
    for name in ("total_energy", "about_vertical", "about_axis"):
        values = run[name].values
        assert np.abs(values - values[0]).max() < 1e-11 * abs(values[0]), name
    assert np.abs(lengths(run, "top") - 1).max() < 1e-15


SPIN = {"initial": {"angular_velocity": ["0.3 rad s-1", "5 rad s-1", "0.2 rad s-1"]}}


def test_products_of_inertia_are_those_of_principal_axes() -> None:
    """Assert that a body in axes that are not principal turns as in those that are."""
    axes = Rotation.from_euler("xyz", [0.3, 0.5, -0.2])
    whole = axes.as_matrix() @ np.diag([1.0, 2.0, 2.5]) @ axes.as_matrix().T
    rows = [[f"{moment!r} kg m2" for moment in row] for row in ((whole + whole.T) / 2).tolist()]
    rates = [f"{rate!r} rad s-1" for rate in axes.apply([0.3, 5, 0.2]).tolist()]
    start = {"attitude": axes.inv().as_quat(scalar_first=True).tolist(), "angular_velocity": rates}
    settings: dict[str, Any] = {"method": "rk4", "step": "5 ms", "until": "2 s"}
    plain = xd.simulate(of_body(SPIN, observables={"spin": "frame_spin"}), **settings)
    turned = xd.simulate(of_body({"inertia": rows, "initial": start}, observables={"spin": "frame_spin"}), **settings)
    assert (rotation(plain, "frame") * axes.inv() * rotation(turned, "frame").inv()).magnitude().max() < 1e-7
    np.testing.assert_allclose(turned.spin.values, np.tile([0.3, 10, 0.5], (plain.sizes["step"], 1)), atol=2e-7)
    np.testing.assert_allclose(turned.kinetic_energy, plain.kinetic_energy, rtol=1e-8)


@pytest.mark.parametrize("method", ["rk4", "implicit_midpoint", "radau_iia", "taylor"])
def test_quaternions_have_unit_length_after_every_step(method: str) -> None:
    """Assert lengths to rounding, with how far they were off beside them."""
    settings: dict[str, Any] = {"rtol": 1e-6} if method in ("radau_iia", "taylor") else {"step": "20 ms"}
    run = xd.simulate(of_body(SPIN), method=method, until="1 s", **settings)
    assert np.abs(lengths(run, "frame") - 1).max() < 1e-15
    assert run.attitude_deviation.dims == ("step",)
    assert float(run.attitude_deviation[0]) == 0.0
    assert (float(run.attitude_deviation.max()) < 1e-14) == (method == "implicit_midpoint")  # it keeps squares itself


def test_deviations_fall_with_the_error_of_a_step() -> None:
    """Assert the fifth power of the step, the order of the error of a step, or a higher one."""
    off = [
        float(xd.simulate(of_body(SPIN), method="rk4", step=h, until="1 s").attitude_deviation.max())
        for h in ("20 ms", "10 ms")
    ]
    assert 4.9 < np.log2(off[0] / off[1]) < 6.1


def test_what_a_projected_step_leaves_is_what_the_next_begins_with() -> None:
    """Assert that rates in a row are those of the unit quaternion in it, to the bit."""
    run = xd.simulate(of_body(SPIN), method="rk4", step="50 ms", until="1 s")
    q0, q, w = run.frame_q0.values, run.frame_q.values, run.v_frame_turn.values
    product = q[:, 0] * w[:, 0] + q[:, 1] * w[:, 1] + q[:, 2] * w[:, 2]
    np.testing.assert_array_equal(run.rate_frame_q0.values, -(product / 2))
    np.testing.assert_array_equal(
        run.rate_frame_q.values[:, 0], (q0 * w[:, 0] + (q[:, 1] * w[:, 2] - q[:, 2] * w[:, 1])) / 2
    )


def test_states_at_events_have_unit_length_too() -> None:
    """Assert lengths on both sides of events that are located inside steps."""
    model = of_body(SPIN, events={"level": {"function": "frame_tip[z]"}})
    run = xd.simulate(model, method="rk4", step="100 ms", until="3 s")
    assert run.sizes["event"] > 3
    assert np.abs(lengths(run, "frame") - 1).max() < 1e-15
    assert np.abs(run.event_residual.values).max() < 1e-12


def test_many_bodies_are_each_of_them() -> None:
    """Assert that bodies along a dimension turn as single ones do, to the bit."""
    rates = ["(1 + index(link))*radian/second", "5*radian/second", "0.2*radian/second"]
    many = of_body({"dims": ["link"], "initial": {"angular_velocity": rates}}, dimensions={"link": 3})
    settings: dict[str, Any] = {"method": "rk4", "step": "10 ms", "until": "0.5 s"}
    run = xd.simulate(many, **settings)
    assert run.frame_q.dims == ("step", "link", "axis")
    one = of_body({"initial": {"angular_velocity": ["2 rad s-1", "5 rad s-1", "0.2 rad s-1"]}})
    found = xd.simulate(one, **settings)
    np.testing.assert_array_equal(run.frame_q.isel(link=1), found.frame_q)
    np.testing.assert_array_equal(run.v_frame_turn.isel(link=1), found.v_frame_turn)


def test_two_precisions_agree() -> None:
    """Assert that sums of two floats are left as the method has them, and are near the projected run."""
    settings: dict[str, Any] = {"method": "taylor", "rtol": 1e-14, "until": "1 s"}
    fine = xd.simulate(of_body(SPIN), precision="double_double", **settings | {"rtol": 1e-20})
    run = xd.simulate(of_body(SPIN), **settings)
    assert np.abs(fine.frame_q[-1].values - run.frame_q[-1].values).max() < 1e-13
    assert float(fine.attitude_deviation.max()) < 2.3e-16


def test_inertias_sweep_and_archives_repeat(tmp_path: Any) -> None:
    """Assert a sweep over a moment of inertia against single runs, and that an archive proves itself."""
    model, settings = of_body(SPIN), {"method": "rk4", "step": "20 ms", "until": "0.4 s"}
    axes = {"frame_inertia_x": ["1 kg m2", "1.5 kg m2"]}
    swept = xd.sweep(model, axes=axes, keep=["end"], **settings)
    run = xd.simulate(model.replace(parameters={"frame_inertia_x": 1.5}), **settings)
    np.testing.assert_array_equal(swept.end_frame_q.isel(frame_inertia_x=1), run.frame_q[-1])
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_inertias_of_a_sweep_are_checked() -> None:
    """Assert that a moment that no body has is refused where a model is made with it."""
    with pytest.raises(xd.ModelError, match="moments 1, 2, 9 kg m2, and none is larger"):
        of_body().replace(parameters={"frame_inertia_z": "9 kg m2"})


def test_pivots_hold_a_point() -> None:
    """Assert that a body with a pivot has no position, and turns about it as a pendulum: its period."""
    rod = FRAME | {"pivot": ["0 m", "0 m", "1 m"], "inertia": ["4 kg m2", "4 kg m2", "0.1 kg m2"]}
    del rod["mass"]
    swing = rod | {
        "points": {"bob": ["0 m", "0 m", "-2 m"]},
        "initial": {"attitude": {"axis": [1, 0, 0], "angle": "40 degree"}},
    }
    model = xd.Model(
        name="pendulum",
        bodies={"rod": swing},
        forces={"weight": {"potential": "(1*kilogram)*(9.81*metre/second**2)*rod_bob[z]"}},
        events={"lowest": {"function": "rod_bob[y]"}},
    )
    run = xd.simulate(model, method="rk4", step="5 ms", until="4 s")
    quarter = np.sqrt(4 / (9.81 * 2)) * ellipk(np.sin(np.deg2rad(20)) ** 2)
    assert run.event_time.values[:2] == pytest.approx([quarter, 3 * quarter], abs=1e-9)
    assert "rod_r" not in run
