"""Random equations with one to three delays, kicks and a controller, and their exact motions.

The motion that is 1 at t = 0 and zero before of y' = sum of a_i y(t - tau_i) is, by the method of steps,

    X(t) = sum over k of (|k|; k) prod a_i^k_i (t - k.tau)^|k| / |k|!,  over all k with k.tau <= t,

with multinomial coefficients (Hairer, Norsett, Wanner, Solving ODEs I, section II.17). A kick of size J at t_j adds J X(t -
t_j), and what a controller holds from a tick on adds it times the integral of X. All of it is evaluated with fractions.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import factorial

import numpy as np

import xdynamics as xd

EVERY = Fraction(1, 4)  # second, between ticks


@dataclass(frozen=True)
class Delayed:
    """A random equation.

    Attributes
    ----------
    delays, factors : tuple of Fraction
        In s and 1/s.
    kicks : tuple of (Fraction, Fraction)
        Times in s, and sizes.
    gain : Fraction
        Of the controller, 0 without one.
    """

    delays: tuple[Fraction, ...]
    factors: tuple[Fraction, ...]
    kicks: tuple[tuple[Fraction, Fraction], ...] = ()
    gain: Fraction = Fraction(0)

    @classmethod
    def drawn(cls, case: int) -> Delayed:
        """Draw the equation of a case: every second has two delays that nearly agree, or that are nearly commensurable."""
        rng = np.random.default_rng([59, case])
        count = 1 + case % 3
        delays = [Fraction(int(rng.integers(60, 400)), 1000) for _ in range(count)]
        if count > 1 and case % 2:
            delays[1] = delays[0] * int(rng.integers(1, 3)) + Fraction(
                int(rng.integers(1, 9)), 10 ** int(rng.integers(4, 7))
            )
        factors = [Fraction(int(rng.integers(-1500, 500)), 1000 * count) for _ in range(count)]
        kicks = [
            (Fraction(int(rng.integers(100, 900)), 1000), Fraction(int(rng.integers(-9, 10)), 10))
            for _ in range(case % 4 // 2)
        ]
        gain = Fraction(-1, 2) if case % 5 == 4 else Fraction(0)
        return cls(tuple(delays), tuple(factors), tuple(kicks), gain)

    @cached_property
    def model(self) -> xd.Model:
        """Return it as a model."""
        rates = [f"a{i}*delayed(y, tau{i})" for i in range(len(self.delays))] + ["u/second"] * bool(self.gain)
        parameters = {f"a{i}": f"{float(factor)!r} s-1" for i, factor in enumerate(self.factors)}
        parameters |= {f"tau{i}": f"{float(delay)!r} s" for i, delay in enumerate(self.delays)}
        sections: dict[str, object] = {"history": {"y": "0"}}
        if self.kicks:
            sections["events"] = {
                f"kick{i}": {
                    "function": f"t - {float(t)!r}*second",
                    "action": "reset",
                    "set": {"y": f"y + ({float(size)!r})"},
                }
                for i, (t, size) in enumerate(self.kicks)
            }
        if self.gain:
            outputs = {"u": {"unit": "1", "start": "0", "value": f"({float(self.gain)!r})*y"}}
            sections["controllers"] = {"feedback": {"every": f"{float(EVERY)!r} s", "outputs": outputs}}
        return xd.Model(
            name="random delays",
            states={"y": {"unit": "1", "rate": " + ".join(rates)}},
            parameters=parameters,
            initial={"y": "1"},
            **sections,
        )

    def response(self, t: Fraction, more: int = 0) -> Fraction:
        """Return X at a time, or its integral of some order."""
        total, rows = Fraction(0), [(0, t, Fraction(1))]  # of delays so far: how many, time that is left, factors
        for delay, factor in zip(self.delays, self.factors, strict=True):
            further = []
            for count, left, product in rows:
                k = 0
                while left - k * delay >= 0:
                    further.append((count + k, left - k * delay, product * factor**k / factorial(k)))
                    k += 1
            rows = further
        for count, left, product in rows:
            total += product * factorial(count) * left ** (count + more) / factorial(count + more)
        return total

    def exact(self, t: float) -> float:
        """Return the exact motion at a time; of a time of a kick or tick the value before it."""
        return float(self._at(Fraction(t)))

    def _at(self, t: Fraction) -> Fraction:
        y = self.response(t) if t >= 0 else Fraction(0)
        y += sum((size * self.response(t - at) for at, size in self.kicks if at < t), Fraction(0))
        for at, step in self._ticks:
            if at < t:
                y += step * self.response(t - at, 1)
        return y

    @cached_property
    def _ticks(self) -> list[tuple[Fraction, Fraction]]:
        """By how much the controller's output changes at each tick, up to 2 s."""
        ticks: list[tuple[Fraction, Fraction]] = []
        if not self.gain:
            return ticks
        held = Fraction(0)
        for k in range(9):
            at = k * EVERY
            y = Fraction(1) if k == 0 else self._before(at, ticks)
            y += sum((size for time, size in self.kicks if time == at), Fraction(0))
            ticks.append((at, self.gain * y - held))
            held = self.gain * y
        return ticks

    def _before(self, t: Fraction, ticks: list[tuple[Fraction, Fraction]]) -> Fraction:
        y = self.response(t) + sum((size * self.response(t - at) for at, size in self.kicks if at < t), Fraction(0))
        return y + sum((step * self.response(t - at, 1) for at, step in ticks), Fraction(0))
