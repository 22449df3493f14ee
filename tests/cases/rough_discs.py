"""Rough discs that bounce in a box whose walls move: their model, and an event-driven solution written for them alone.

Between impacts discs fly on parabolas. Pairs meet at the root of a quadratic; a disc and a wall that moves at a root that
Brent's method finds. An impact changes the rate of the gap to -e times itself, and either ends the slip, or has an
impulse of mu times the normal one against it: in closed form, as impulses at round bodies along the tangent leave the
rate of the gap alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

import xdynamics as xd

Floats = NDArray[np.float64]
G = 9.80665
SAMPLES = 2000  # of a gap to a wall, between which its first root is looked for
# of each wall: the normal into the box, and the tangent along which a slip is positive
WALLS = {
    "floor": (np.array([0.0, 1.0]), np.array([1.0, 0.0])),
    "left": (np.array([1.0, 0.0]), np.array([0.0, 1.0])),
    "right": (np.array([-1.0, 0.0]), np.array([0.0, 1.0])),
    "lid": (np.array([0.0, -1.0]), np.array([1.0, 0.0])),
}


@dataclass
class Solution:
    """Times, velocities behind, shape (disc, 3), and energies taken by each impact; places at the end; kinds of impulses."""

    times: list[float] = field(default_factory=list)
    after: list[Floats] = field(default_factory=list)
    lost: list[float] = field(default_factory=list)
    slowest: float = np.inf
    sticks: int = 0
    slides: int = 0
    last: Floats = field(default_factory=lambda: np.zeros(0))


class RoughDiscs:
    """Discs of several sizes, masses, restitutions and frictions at random places of a lattice in a box of 1 m."""

    def __init__(self, case: int, count: int, walls: tuple[str, ...], until: float) -> None:
        random = np.random.default_rng([30, 7, case, count])
        side = 2 if count <= 4 else 3 if count <= 7 else 4
        self.walls, self.until = walls, until
        self.radii = random.uniform(0.28, 0.42, count) / side
        self.masses = 10.0 ** random.uniform(-0.5, 0.5, count)
        cells = random.permutation(side * side)[:count]
        places = np.stack(np.divmod(cells, side), axis=1) + random.uniform(0.47, 0.53, (count, 2))
        self.places = np.column_stack([places / side, random.uniform(-1.0, 1.0, count)])
        self.speeds = np.column_stack([1.5 * random.normal(size=(count, 2)), 20.0 * random.normal(size=count)])
        self.pairs = list(combinations(range(count), 2))
        self.restitutions, self.frictions = (
            random.uniform(0.6, 1.0, len(self.pairs)),
            random.uniform(0.0, 0.6, len(self.pairs)),
        )
        self.restitution, self.friction = random.uniform(0.7, 1.0), random.uniform(0.05, 0.5)  # of walls
        self.stroke, self.pace, self.belt = 0.02, random.uniform(15.0, 25.0), random.uniform(-1.0, 1.0)
        self.inertias = self.masses * self.radii**2 / 2.0

    def model(self) -> xd.Model:
        """Return their model."""
        rough = {"restitution": repr(float(self.restitution)), "tangential": "coulomb", "friction": "mu"}
        shift = "stroke*sin(pace*t)"
        spin = "radius*v_theta/radian"
        walls = {
            "floor": {"gap": f"y - radius - {shift}", "slip": f"v_x + {spin} - belt", **rough},
            "left": {"gap": f"x - radius - {shift}", "slip": f"v_y - {spin}", **rough},
            "right": {"gap": f"metre - x - radius - {shift}", "slip": f"v_y + {spin}", **rough},
            "lid": {"gap": f"metre - y - radius - {shift}", "slip": f"v_x - {spin} - belt", **rough},
        }
        each = {"dims": ["disc"]}
        names = ("x", "y", "theta")
        units = ("m", "m", "rad")
        starts = {n: {"unit": u, "value": p.tolist()} for n, u, p in zip(names, units, self.places.T, strict=True)}
        speeds = {
            f"v_{n}": {"unit": f"{u} s-1", "value": v.tolist()}
            for n, u, v in zip(names, units, self.speeds.T, strict=True)
        }
        return xd.Model(
            name="rough discs",
            dimensions={"disc": len(self.radii)},
            relations={"pair": {"of": "disc"}},
            coordinates={n: {"unit": u, **each} for n, u in zip(names, units, strict=True)},
            parameters={
                "m": {"unit": "kg", "value": self.masses.tolist(), **each},
                "radius": {"unit": "m", "value": self.radii.tolist(), **each},
                "e": {"dims": ["pair"], "value": self.restitutions.tolist()},
                "rub": {"dims": ["pair"], "value": self.frictions.tolist()},
                "mu": repr(float(self.friction)),
                "stroke": f"{self.stroke!r} m",
                "pace": f"{float(self.pace)!r} s-1",
                "belt": f"{float(self.belt)!r} m s-1",
            },
            definitions={
                "dx": "second(x, pair) - first(x, pair)",
                "dy": "second(y, pair) - first(y, pair)",
                "apart": "hypot(dx, dy)",
                "across": "((second(v_y, pair) - first(v_y, pair))*dx - (second(v_x, pair) - first(v_x, pair))*dy)/apart",
                "turning": "(first(radius, pair)*first(v_theta, pair) + second(radius, pair)*second(v_theta, pair))/radian",
            },
            mass={"x": "m", "y": "m", "theta": "m*radius**2/2/radian**2"},
            forces={"weight": {"y": f"-{G}*m*metre/second**2"}},
            contacts={
                **{name: walls[name] for name in self.walls},
                "discs": {
                    "gap": "apart - first(radius, pair) - second(radius, pair)",
                    "restitution": "e",
                    "tangential": "coulomb",
                    "slip": "across - turning",
                    "friction": "rub",
                },
            },
            initial={**starts, **speeds},
        )

    def moved(self, q: Floats, v: Floats, s: float) -> tuple[Floats, Floats]:
        """Return places and velocities after a flight of a time."""
        fall = np.array([0.0, -G, 0.0])
        return q + v * s + fall * s * s / 2.0, v + fall * s

    def to_pair(self, q: Floats, v: Floats, i: int, j: int) -> float:
        """Return after what time two discs meet, which fall alike."""
        x, u = q[j, :2] - q[i, :2], v[j, :2] - v[i, :2]
        b, a, c = x @ u, u @ u, x @ x - (self.radii[i] + self.radii[j]) ** 2
        root = b * b - a * c
        return float(c / (np.sqrt(root) - b)) if b < 0.0 < root else np.inf

    def to_wall(self, q: Floats, v: Floats, t: float, i: int, wall: str) -> float:
        """Return after what time a disc meets a wall."""
        normal = WALLS[wall][0]
        fall, rate, place = (
            -G * normal[1],
            v[i, :2] @ normal,
            q[i, :2] @ normal - self.radii[i] - min(normal.sum(), 0.0),
        )

        def gap(s: Floats | float) -> Floats:
            shift = self.stroke * np.sin(self.pace * (t + np.asarray(s)))
            return np.asarray(place + s * (rate + s * fall / 2.0) - shift)

        last = 1.001 * max(self.until - t, 1e-8)
        s = np.unique(np.concatenate([np.linspace(0.0, last, SAMPLES)[1:], np.geomspace(1e-9, last, 100)]))
        below = np.flatnonzero(gap(s) <= 0.0)
        if below.size == 0:
            return np.inf
        assert below[0] > 0, "two impacts of a disc and a wall follow too soon upon each other"
        return float(brentq(gap, s[below[0] - 1], s[below[0]], xtol=1e-16, rtol=1e-15))

    def strike(
        self, v: Floats, rows: tuple[Floats, Floats], early: Floats, e: float, mu: float, result: Solution
    ) -> None:
        """Change velocities by an impact, of two rows, rates of gap and slip by each velocity, and what they have by time."""
        weights = np.column_stack([self.masses, self.masses, self.inertias])
        normal, tangent = rows
        rate, slip = (normal * v).sum() + early[0], (tangent * v).sum() + early[1]
        pressing = -(1.0 + e) * rate / (normal**2 / weights).sum()
        ends = -slip / (tangent**2 / weights).sum()
        rubbing = np.clip(ends, -mu * pressing, mu * pressing)
        v += (normal * pressing + tangent * rubbing) / weights
        after = (normal * v).sum() + early[0], (tangent * v).sum() + early[1]
        result.lost.append(-pressing * (rate + after[0]) / 2.0 - rubbing * (slip + after[1]) / 2.0)
        result.slowest = min(result.slowest, -rate)
        result.sticks += int(rubbing == ends)
        result.slides += int(rubbing != ends)

    def solution(self, most: int) -> Solution:
        """Return the motion until the end, which is set to one soon after so many impacts if there would be more."""
        q, v, t, result = self.places.copy(), self.speeds.copy(), 0.0, Solution()
        of_walls = [(i, wall) for i in range(len(q)) for wall in self.walls]
        while True:
            waits = [self.to_pair(q, v, i, j) for i, j in self.pairs] + [
                self.to_wall(q, v, t, i, w) for i, w in of_walls
            ]
            k = int(np.argmin(waits))
            if len(result.times) == most:
                self.until = min(self.until, round(t + waits[k] / 2.0, 12))
            if t + waits[k] > self.until:
                result.last = self.moved(q, v, self.until - t)[0]
                return result
            q, v = self.moved(q, v, waits[k])
            t += waits[k]
            normal, tangent, early = np.zeros_like(v), np.zeros_like(v), np.zeros(2)
            if k < len(self.pairs):
                i, j = self.pairs[k]
                n = (q[j, :2] - q[i, :2]) / np.linalg.norm(q[j, :2] - q[i, :2])
                normal[i, :2], normal[j, :2] = -n, n
                tangent[i], tangent[j] = [n[1], -n[0], -self.radii[i]], [-n[1], n[0], -self.radii[j]]
                e, mu = self.restitutions[k], self.frictions[k]
            else:
                i, wall = of_walls[k - len(self.pairs)]
                n, along = WALLS[wall]
                normal[i, :2], tangent[i, :2] = n, along
                tangent[i, 2] = -self.radii[i] * (n[0] * along[1] - n[1] * along[0])  # of the point at -radius times n
                early[:] = -self.stroke * self.pace * np.cos(self.pace * t), -self.belt * along[0]
                e, mu = self.restitution, self.friction
            self.strike(v, (normal, tangent), early, e, mu, result)
            result.times.append(t)
            result.after.append(v.copy())
