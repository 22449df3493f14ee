"""What rounding takes from a step's sums is carried to the next."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, damped, oscillator, particle
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.methods import METHODS, Method
from xdynamics.methods.scheme import updates
from xdynamics.record.arguments import recorded_arguments

COMPOSITIONS = [one for one in METHODS.values() if one.symplectic and updates(one)]


def kepler() -> xd.Model:
    """One unit mass on an ellipse of eccentricity 1/2, of period 2 pi."""
    return xd.Model(
        name="ellipse",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "m"}},
        parameters={"m": "1 kg", "mu": "1 N m2"},
        mass={"x": "m", "y": "m"},
        forces={"gravity": {"potential": "-mu/sqrt(x**2 + y**2)"}},
        initial={"x": "0.5 m", "y": "0 m", "v_x": "0 m s-1", "v_y": f"{3.0**0.5!r} m s-1"},
    )


def drift_of_momentum(run: xr.Dataset) -> float:
    """The rms of the error of the angular momentum, which symplectic methods keep but for rounding; in extended precision."""
    x, y, v_x, v_y = (run[name].values.astype(np.longdouble) for name in ("x", "y", "v_x", "v_y"))
    momentum = x * v_y - y * v_x
    return float(np.sqrt(np.mean((momentum - momentum[0]) ** 2)))


def marched(model: xd.Model, method: str, summation: str | None, **how: object) -> xr.Dataset:
    asked = {"step": 0.01, "until": 1000.0, "force_samples": "none"} | how
    return xd.simulate(model, method=method, summation=summation, **asked)


@pytest.mark.every(3)
@pytest.mark.parametrize("method", COMPOSITIONS, ids=lambda one: one.name)
def test_rounding_does_not_add_up(method: Method) -> None:
    """Assert that 100,000 steps lose less than a fifth of what plain sums do of the angular momentum, and it is the default."""
    plain, kept = (marched(kepler(), method.name, summation) for summation in ("plain", None))
    assert kept.attrs["solver_summation"] == "compensated"
    assert drift_of_momentum(kept) < 0.2 * drift_of_momentum(plain)
    assert drift_of_momentum(kept) < 5e-15


@pytest.mark.dear
def test_energy_keeps_its_digits() -> None:
    """Assert that of 10**6 steps by a high order the rms of the energy's error falls by a factor of 50."""
    errors = []
    for summation in ("plain", "compensated"):
        run = marched(kepler(), "kahan_li8", summation, until=10_000.0)
        x, y, v_x, v_y = (run[name].values.astype(np.longdouble) for name in ("x", "y", "v_x", "v_y"))
        energy = (v_x**2 + v_y**2) / 2 - 1 / np.sqrt(x**2 + y**2)
        errors.append(float(np.sqrt(np.mean((energy - energy[0]) ** 2))))
    assert errors[0] > 50 * errors[1]


def test_a_sum_of_tenths_is_exact() -> None:
    """Assert that 10,000 steps of a free particle end at the product, which plain sums miss by thousands of roundings."""
    off = []
    for summation in ("plain", "compensated"):
        run = xd.simulate(
            particle(v="0.1 m s-1"), method="position_verlet", step=0.1, until=1000.0, summation=summation
        )
        off.append(abs(float(run.x[-1]) - float(run.x[0]) - 100.0) / np.spacing(100.0))
    assert off[1] <= 1.0
    assert off[0] > 100.0


def test_other_methods_sum_plainly_unless_they_are_asked() -> None:
    """Assert the default of a Runge-Kutta method, that it may be asked for, and that it serves there too."""
    assert marched(oscillator().model, "rk4", None, until=1.0).attrs["solver_summation"] == "plain"
    plain, kept = (
        marched(kepler(), "rk4", summation, step=1e-3, until=100.0) for summation in ("plain", "compensated")
    )
    assert kept.attrs["solver_summation"] == "compensated"
    assert not np.array_equal(plain.x.values, kept.x.values)
    assert np.allclose(plain.x.values, kept.x.values, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"method": "rk4", "summation": "kahan"}, "summation is 'kahan'; there are plain, compensated"),
        (
            {"method": "implicit_midpoint", "summation": "compensated"},
            "is for methods that add to the state, and 'implicit_midpoint'",
        ),
    ],
)
def test_wrong_summations_are_named(asked: dict[str, str], said: str) -> None:
    """Assert one sentence with the value."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(oscillator().model, step=0.1, until=1.0, **asked)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    "how", [{"step": 0.02}, {"rtol": 1e-5, "step": None}, {"step": 0.02, "estimator": "step_doubling"}]
)
def test_archives_know_their_summation(how: dict[str, object], tmp_path: Path) -> None:
    """Assert equal bits from the file alone for both, and that one without the word is one of plain sums."""
    model = xd.Model.from_toml(MODELS / "coupled_masses.toml")
    for summation in ("plain", "compensated"):
        path = tmp_path / f"{summation}.nc"
        marched(model, "pefrl", summation, path=path, until=5.0, **how)
        assert xd.reproduce(path).attrs["identical"] == 1
    old = xd.open_run(tmp_path / "plain.nc").load()
    del old.attrs["solver_summation"]
    assert recorded_arguments(old)["summation"] == "plain"


def test_many_runs_carry_nothing_from_one_to_the_next() -> None:
    """Assert the bits of a run that follows another in one engine call."""
    model, asked = oscillator().model, {"method": "velocity_verlet", "until": 10.0, "force_samples": "none"}
    found = march_many(model, settings_for(model, step=0.01, **asked), steps=[0.01, 0.02, 0.01])
    assert found.state[0].tolist() == found.state[2].tolist()
    alone = xd.simulate(model, step=0.02, **asked)
    assert [float(alone.x[-1]), float(alone.v_x[-1])] == found.state[1].tolist()


def test_states_are_carried_too() -> None:
    """Assert that a first-order companion is summed with what it lost: fuel burnt at a constant rate."""
    model = damped()
    assert "s" in model.model.states
    run = marched(model.model, "rk4", "compensated", until=1.0)
    plain = marched(model.model, "rk4", "plain", until=1.0)
    assert np.allclose(run.s.values, plain.s.values, rtol=1e-12)
    assert not np.array_equal(run.s.values, plain.s.values)
