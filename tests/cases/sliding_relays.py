"""Random relays: linear states that signs of linear functions switch, and an event-driven solution written for them alone.

x' = A x + d + B s, where s has the sign of each function C x, or where x slides along C x = 0 the value between -1 and 1
that keeps it there (Filippov 1988, chapter 2). Between events the motion is linear, and marched by SciPy to 12 digits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import xdynamics as xd

Floats = NDArray[np.float64]
SLIDES = 0
NEAR = 1e-9
MOST_EVENTS = 400


@dataclass
class Solution:
    """Times of events, how many began to slide or left, the state at the end; whether each event had one way on."""

    times: list[float] = field(default_factory=list)
    slides: int = 0
    leaves: int = 0
    end: Floats = field(default_factory=lambda: np.zeros(0))
    unique: bool = True


class Relays:
    """States that decay and turn, with one relay or two, each of which drives its function back or away."""

    def __init__(self, case: int, until: float = 6.0) -> None:
        random = np.random.default_rng([64, case])
        n, m = int(random.integers(2, 5)), int(random.integers(1, 3))
        self.until, self.n, self.m = until, n, m
        turn = random.normal(size=(n, n))
        self.a = turn - turn.T - np.diag(random.uniform(0.0, 0.5, n))
        self.d, self.start = random.normal(size=n), 2.0 * random.normal(size=n)
        self.c = random.normal(size=(m, n))
        self.b = -self.c.T * random.uniform(0.5, 3.0, m) + 0.4 * random.normal(size=(n, m))

    def model(self) -> xd.Model:
        """Return their model: states of one unit, each with its rate."""
        parts = [" + ".join(f"({float(c)!r})*x{i}" for i, c in enumerate(row)) for row in self.c]
        rates = {}
        for i in range(self.n):
            terms = [f"({float(a)!r})*x{j}" for j, a in enumerate(self.a[i])]
            terms += [f"({float(b)!r})*metre*sign(({parts[k]})/(1*metre))" for k, b in enumerate(self.b[i])]
            rates[f"x{i}"] = f"({' + '.join(terms)} + ({float(self.d[i])!r})*metre)/(1*second)"
        return xd.Model(
            name="relays",
            states={name: {"unit": "m", "rate": rate} for name, rate in rates.items()},
            initial={f"x{i}": f"{float(x)!r} m" for i, x in enumerate(self.start)},
        )

    def inputs(self, x: Floats, sides: tuple[int, ...]) -> Floats:
        """Return what each relay gives: its side, or the value with which its function stays where it is."""
        s, slid = np.array(sides, float), [k for k, side in enumerate(sides) if side == SLIDES]
        if slid:
            free = self.c[slid] @ (self.a @ x + self.d + self.b @ s)
            s[slid] = np.linalg.solve(self.c[slid] @ self.b[:, slid], -free)
        return s

    def rate(self, x: Floats, sides: tuple[int, ...]) -> Floats:
        """Return the rate of the state by the forces of these sides."""
        rate: Floats = self.a @ x + self.d + self.b @ self.inputs(x, sides)
        return rate

    def ways(self, x: Floats, sides: tuple[int, ...], met: set[int]) -> list[tuple[int, ...]]:
        """Return the sides with which the motion may go on where some functions are zero."""
        found = []
        for way in product((-1, SLIDES, 1), repeat=self.m):
            if any(way[k] != sides[k] for k in range(self.m) if k not in met):
                continue
            slid = [k for k in met if way[k] == SLIDES]
            if slid and (np.diag(self.c[slid] @ self.b[:, slid]) >= 0.0).any():
                continue
            s, going = self.inputs(x, way), self.c @ self.rate(x, way)
            if all(abs(s[k]) <= 1.0 + NEAR if way[k] == SLIDES else way[k] * going[k] > NEAR for k in met):
                found.append(way)
        return found

    def end_of(self, k: int, sides: tuple[int, ...]) -> Any:
        """Return the function that falls through zero where a relay leaves its side, or what it slides along."""

        def slid(_: float, x: Floats) -> float:
            return float(1.0 - abs(self.inputs(x, sides)[k]))

        def beside(_: float, x: Floats) -> float:
            return float(sides[k] * (self.c[k] @ x))

        function: Any = slid if sides[k] == SLIDES else beside
        function.terminal, function.direction = True, -1
        return function

    def solve(self) -> Solution:
        """Return the motion from its start."""
        found, t, x = Solution(), 0.0, self.start.copy()
        sides = tuple(int(side) for side in np.sign(self.c @ x))
        while t < self.until and len(found.times) < MOST_EVENTS:
            march = solve_ivp(
                lambda _, x, sides=sides: self.rate(x, sides),
                (t, self.until),
                x,
                "DOP853",
                rtol=1e-12,
                atol=1e-13,
                events=[self.end_of(k, sides) for k in range(self.m)],
                max_step=2e-3,
            )
            t, x = float(march.t[-1]), march.y[:, -1]
            if march.status != 1:
                break
            acting = {k for k in range(self.m) if march.t_events[k].size}
            found.times.append(t)
            left = {k for k in acting if sides[k] == SLIDES}
            fixed = list(sides)
            for k in left:
                fixed[k] = int(np.sign(self.inputs(x, sides)[k]))
            slid = {k for k in range(self.m) if sides[k] == SLIDES}
            ways = self.ways(x, tuple(fixed), (acting | slid) - left)
            if len(ways) != 1:
                found.unique = False
                break
            found.slides += sum(side == SLIDES for k, side in enumerate(ways[0]) if k not in slid)
            found.leaves += len(left)
            sides = ways[0]
        found.end = x
        return found
