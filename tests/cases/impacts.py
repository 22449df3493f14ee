"""Bodies that strike a floor with one point, and what happens in that instant, by integration over the impulse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import xdynamics as xd

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rod:
    """A body of mass m and moment of inertia j, whose tip is at a distance r from its centre, at an angle to the floor."""

    m: float
    j: float
    r: float
    angle: float
    mu: float
    e: float
    speeds: tuple[float, float, float]  # of the centre along and up, of the angle, at the impact

    @property
    def rows(self) -> Floats:
        """The derivatives of the gap's rate and of the slip by the velocities."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[0.0, 1.0, -self.r * c], [1.0, 0.0, self.r * s]])

    @property
    def mass(self) -> Floats:
        """Mass matrix."""
        return np.diag([self.m, self.m, self.j])

    @property
    def before(self) -> float:
        """How long before the impact its model begins, s."""
        return -1e-4 * self.r / float(self.rows[0] @ np.array(self.speeds))

    def model(self, law: str, **contact: Any) -> xd.Model:
        """The rod an instant before the impact, without gravity: it flies freely, and turns."""
        (vx, vy, w), before = self.speeds, self.before
        height, angle = self.r * math.sin(self.angle) - vy * before, self.angle - w * before
        floor = {
            "gap": "y - l*sin(theta)",
            "restitution": "e",
            "law": law,
            "tangential": "coulomb",
            "slip": "v_x + l*sin(theta)*v_theta/radian",
            "friction": "mu",
        }
        return xd.Model(
            name="rod",
            coordinates={"x": "m", "y": "m", "theta": "rad"},
            parameters={
                "m": f"{self.m!r} kg",
                "j": f"{self.j!r} kg m2",
                "l": f"{self.r!r} m",
                "mu": f"{self.mu!r}",
                "e": f"{self.e!r}",
            },
            mass={"x": "m", "y": "m", "theta": "j/radian**2"},
            forces={},
            initial={
                "x": "0 m",
                "y": f"{height!r} m",
                "theta": f"{angle!r} rad",
                "v_x": f"{vx!r} m s-1",
                "v_y": f"{vy!r} m s-1",
                "v_theta": f"{w!r} rad s-1",
            },
            contacts={"floor": {key: value for key, value in (floor | contact).items() if value is not None}},
        )

    def struck(self, law: str, **contact: Any) -> Any:
        """A run through the impact."""
        return xd.simulate(self.model(law, **contact), method="rk4", step=self.before / 1.7, until=2.0 * self.before)

    def kinetic(self, speeds: Floats) -> float:
        """Kinetic energy."""
        return float(speeds @ self.mass @ speeds / 2.0)


def speeds_behind(run: Any, names: tuple[str, ...] = ("x", "y", "theta")) -> Floats:
    """Velocities in the row behind the first event."""
    row = int(run.event_row_after[0])
    return np.array([float(run[f"v_{name}"][row]) for name in names])


def random_rod(case: int) -> Rod:
    """A rod, or another plate, of any shape that comes down on its tip."""
    random = np.random.default_rng(case)
    m, r = float(10 ** random.uniform(-2, 2)), float(10 ** random.uniform(-1, 1))
    j = m * r**2 * float(10 ** random.uniform(-1.5, 0.5))
    angle, w = float(random.uniform(0.05, math.pi - 0.05)), float(random.choice([0.0, 1.0]) * random.uniform(-3, 3))
    rate, slip = -float(10 ** random.uniform(-1, 1)), float(random.choice([0.0, 1.0, 1.0, 1.0]) * random.uniform(-8, 8))
    mu = float(random.choice([0.0, 1.0, 1.0]) * random.uniform(0.02, 1.5))
    e = float(random.choice([0.0, 1.0, random.uniform(0, 1)]))
    return Rod(m, j, r, angle, mu, e, (slip - r * math.sin(angle) * w, rate + r * math.cos(angle) * w, w))


def integrated(rows: Floats, mass: Floats, speeds: Floats, mu: float, e: float) -> Floats:
    """Velocities behind an impact: dv/dp of the normal impulse p is integrated, with nothing in closed form.

    The work of the normal force is a state beside the rates of gap and slip. Friction acts against the slip, holds
    where there is none and it can, and the end is where e**2 of the work of compression is given back.
    """
    gram = rows @ np.linalg.solve(mass, rows.T)
    state = np.append(rows @ speeds, [0.0, 0.0, 0.0])  # gap's rate, slip, work, normal impulse, friction
    held, target, compressing = -gram[1, 0] / gram[1, 1], 0.0, True
    for _ in range(6):
        way = math.copysign(1.0, state[1]) if state[1] != 0.0 else 0.0
        if way == 0.0 and abs(held) > mu:
            way = -math.copysign(1.0, held)
        ratio = -way * mu if way else held

        def slope(_p: float, y: Floats, ratio: float = ratio) -> Floats:
            return np.array([*(gram @ [1.0, ratio]), y[0], 1.0, ratio])

        def halts(_p: float, y: Floats, way: float = way) -> float:
            return float(way * y[1]) if way else 1.0

        def over(_p: float, y: Floats, first: bool = compressing, target: float = target) -> float:
            return float(y[0] if first else y[2] - target)

        for event, direction in ((halts, -1.0), (over, 1.0)):
            event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
        found = solve_ivp(
            slope,
            (0.0, 1e9 / gram[0, 0]),
            state,
            "DOP853",
            events=[halts, over],
            rtol=1e-12,
            atol=1e-30,
            first_step=1e-6 * abs(rows[0] @ speeds) / gram[0, 0],
        )
        state = found.y[:, -1]
        if found.t_events[0].size:
            state[1] = 0.0
        elif compressing and e > 0.0:
            compressing, target = False, (1.0 - e**2) * state[2]
            state[0] = 0.0
        else:
            break
    return speeds + np.linalg.solve(mass, rows.T @ state[3:5])


def rods_together(rods: Sequence[Rod], law: str) -> xd.Model:
    """Rods of one model, as elements of a dimension, each an instant before its impact."""
    elements = {"m": "kg", "j": "kg m2", "r": "m", "mu": "1", "e": "1"}
    starts = [(rod.r * math.sin(rod.angle) - rod.speeds[1] * rod.before, rod.angle) for rod in rods]
    turned = [angle - rod.speeds[2] * rod.before for rod, (_, angle) in zip(rods, starts, strict=True)]
    return xd.Model(
        name="rods",
        dimensions={"rod": len(rods)},
        coordinates={name: {"unit": "m", "dims": ["rod"]} for name in "xy"}
        | {"theta": {"unit": "rad", "dims": ["rod"]}},
        parameters={
            name: {"dims": ["rod"], "value": [getattr(rod, name) for rod in rods], "unit": unit}
            for name, unit in elements.items()
        },
        mass={"x": "m", "y": "m", "theta": "j/radian**2"},
        forces={},
        contacts={
            "floor": {
                "gap": "y - r*sin(theta)",
                "restitution": "e",
                "law": law,
                "tangential": "coulomb",
                "slip": "v_x + r*sin(theta)*v_theta/radian",
                "friction": "mu",
            }
        },
        initial={
            "x": {"unit": "m", "value": [0.0] * len(rods)},
            "y": {"unit": "m", "value": [height for height, _ in starts]},
            "theta": {"unit": "rad", "value": turned},
        }
        | {
            name: {"unit": unit, "value": [rod.speeds[k] for rod in rods]}
            for k, (name, unit) in enumerate((("v_x", "m s-1"), ("v_y", "m s-1"), ("v_theta", "rad s-1")))
        },
    )
