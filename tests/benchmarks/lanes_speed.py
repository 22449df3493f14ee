"""Many small runs, last states kept: lanes against one lane, and against heyoka, diffrax and scipy where they are installed.

Two families of 8,192 members, t to 50: Duffing oscillators over their cubic stiffness, damped pendulums over their start.
Each competitor has the tolerance at which its root-mean-square error at the end, against a run of tolerance 1e-13, is
about 1e-9 (heyoka's order goes in steps: on pendulums it is 3e-10). One thread each but where a name says two; best of
five, interleaved; times in microseconds a run, and over ours.

python tests/benchmarks/lanes_speed.py [members]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

import xdynamics as xd
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for

END = 50.0
DUFFING, PENDULUM = "Duffing oscillators", "damped pendulums"
OURS = {DUFFING: 6.6e-10, PENDULUM: 1.9e-9}
TAYLOR = {
    DUFFING: (2e-9, 18),
    PENDULUM: (3e-9, 16),
}  # with an order above that of the tolerance: coefficients cost little
HEYOKA = {DUFFING: 1.9e-8, PENDULUM: 1.0e-7}
DIFFRAX = {DUFFING: 2.6e-10, PENDULUM: 1.9e-9}
SCIPY = {DUFFING: 4.2e-10, PENDULUM: 1.0e-9}

Run = Callable[[], np.ndarray]


def model_of(family: str) -> xd.Model:
    """State one of the two families."""
    if family == PENDULUM:
        return xd.Model(
            name=family,
            coordinates={"x": {"unit": "rad"}},
            parameters={"m": "1 kg m2"},
            mass={"x": "m"},
            forces={"gravity": {"x": "-1*newton*metre*sin(x)"}, "damping": {"x": "-0.1*newton*metre*second*v_x"}},
            initial={"x": "1 rad", "v_x": "0 rad s-1"},
        )
    forces = {"spring": "-1*newton/metre*x", "cubic": "-k*x**3", "damping": "-0.1*newton*second/metre*v_x"}
    return xd.Model(
        name=family,
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": "0 N m-3"},
        mass={"x": "m"},
        forces={name: {"x": text} for name, text in forces.items()},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


def varied(family: str, n: int) -> np.ndarray:
    """Return what members differ in: stiffness, or start."""
    return np.linspace(0.05, 3.0, n) if family == PENDULUM else 8.192 * np.arange(n) / n


def ours(family: str, values: np.ndarray, lanes: int | None, rtol: float, threads: int = 1, **asked: Any) -> Run:
    """Set up our own march."""
    model, asked = model_of(family), {"method": "dop853"} | asked
    settings = settings_for(model, rtol=rtol, atol=rtol, until=END, force_samples="none", **asked)
    given = {"initial": {"x": values}} if family == PENDULUM else {"parameters": {"k": values}}
    return lambda: march_many(model, settings, lanes=lanes, threads=threads, **given).state[:, 0]


def with_heyoka(family: str, values: np.ndarray, batch: int) -> Run:
    """Set up heyoka's batch integrator."""
    import heyoka as hy

    x, v = hy.make_vars("x", "v")
    force = -hy.sin(x) if family == PENDULUM else -x - hy.par[0] * x**3
    start = np.zeros((2, batch))
    more = {} if family == PENDULUM else {"pars": np.zeros((1, batch))}
    stepper = hy.taylor_adaptive_batch([(x, v), (v, force - 0.1 * v)], start, tol=HEYOKA[family], **more)

    def run() -> np.ndarray:
        found = np.empty(len(values))
        for first in range(0, len(values), batch):
            mine = values[first : first + batch]
            stepper.set_time(0.0)
            stepper.state[0], stepper.state[1] = (mine, 0.0) if family == PENDULUM else (1.0, 0.0)
            if family == DUFFING:
                stepper.pars[0] = mine
            stepper.propagate_until(END)
            found[first : first + batch] = stepper.state[0]
        return found

    return run


def with_diffrax(family: str, values: np.ndarray, batch: int) -> Run:
    """Set up diffrax under vmap, in batches that fit its caches."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def field(_t: Any, y: Any, k: Any) -> Any:
        force = -jnp.sin(y[0]) if family == PENDULUM else -y[0] - k * y[0] ** 3
        return jnp.stack([y[1], force - 0.1 * y[1]])

    def one(value: Any) -> Any:
        start = jnp.stack([value, 0.0 * value]) if family == PENDULUM else jnp.stack([1.0 + 0.0 * value, 0.0 * value])
        control = diffrax.PIDController(rtol=DIFFRAX[family], atol=DIFFRAX[family])
        return diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            0.0,
            END,
            None,
            start,
            args=value,
            stepsize_controller=control,
            max_steps=100_000,
        ).ys[0, 0]

    many = jax.jit(jax.vmap(one))
    return lambda: np.concatenate([np.asarray(many(part)) for part in np.split(values, len(values) // batch)])


def with_scipy(family: str, values: np.ndarray) -> Run:
    """Set up solve_ivp, one member after the other."""
    from scipy.integrate import solve_ivp

    def field(_t: float, y: Any, k: float) -> list[float]:
        return [y[1], (-np.sin(y[0]) if family == PENDULUM else -y[0] - k * y[0] ** 3) - 0.1 * y[1]]

    def one(value: float) -> float:
        start = [value, 0.0] if family == PENDULUM else [1.0, 0.0]
        return float(
            solve_ivp(field, (0.0, END), start, "DOP853", rtol=SCIPY[family], atol=SCIPY[family], args=(value,)).y[
                0, -1
            ]
        )

    return lambda: np.array([one(value) for value in values.tolist()])


def competitors(family: str, values: np.ndarray) -> dict[str, tuple[Run, np.ndarray]]:
    """Return everybody who is here, each with the members that it marches."""
    few, (rtol, order) = values[:: max(1, len(values) // 32)], TAYLOR[family]
    found = {
        "xdynamics, lanes": (ours(family, values, None, OURS[family]), values),
        "xdynamics, one lane": (ours(family, values, 1, OURS[family]), values),
        "xdynamics taylor, lanes": (ours(family, values, None, rtol, method="taylor", order=order), values),
        "xdynamics taylor, one lane": (ours(family, values, 1, rtol, method="taylor", order=order), values),
        "xdynamics, lanes, two threads": (ours(family, values, None, OURS[family], threads=2), values),
        "scipy DOP853": (with_scipy(family, few), few),
    }
    if find_spec("heyoka"):
        found |= {f"heyoka, batches of {k}": (with_heyoka(family, values, k), values) for k in (1, 4, 8, 16)}
    if find_spec("diffrax"):
        found["diffrax Dopri8, vmap"] = (with_diffrax(family, values, min(1024, len(values))), values)
    return found


def main(members: int = 8192) -> None:
    """Measure, and print one table for each family."""
    for family in (DUFFING, PENDULUM):
        values = varied(family, members)
        exact = dict(zip(values.tolist(), ours(family, values, None, 1e-13)().tolist(), strict=True))
        everybody = competitors(family, values)
        least = dict.fromkeys(everybody, np.inf)
        off = {name: run() - [exact[one] for one in mine.tolist()] for name, (run, mine) in everybody.items()}
        for _ in range(5):
            for name, (run, mine) in everybody.items():
                begun = time.perf_counter()
                run()
                least[name] = min(least[name], (time.perf_counter() - begun) / len(mine) * 1e6)
        print(f"\n{members} {family}{'us a run':>24}{'/ ours':>9}{'rms error':>12}")
        for name, cost in least.items():
            print(
                f"  {name:<34}{cost:>12.2f}{cost / least['xdynamics, lanes']:>9.2f}{np.sqrt(np.mean(off[name] ** 2)):>12.1e}"
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
