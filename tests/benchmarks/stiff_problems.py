"""Stiff problems of the Test Set for IVP Solvers, release 2.4 (Mazzia, Magherini), and a chain of masses on springs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from adaptive_problems import PROBLEMS, Benchmark, Words

SOURCE = "Test Set for Initial Value Problem Solvers, release 2.4"


def _hires() -> Benchmark:
    names = tuple(f"y{i}" for i in range(1, 9))
    start = (1.0, *[0.0] * 6, 0.0057)
    rates = (
        "-1.71*y1 + 0.43*y2 + 8.32*y3 + 0.0007",
        "1.71*y1 - 8.75*y2",
        "-10.03*y3 + 0.43*y4 + 0.035*y5",
        "8.32*y2 + 1.71*y3 - 1.12*y4",
        "-1.745*y5 + 0.43*y6 + 0.43*y7",
        "-280*y6*y8 + 0.69*y4 + 1.71*y5 - 0.43*y6 + 0.69*y7",
        "280*y6*y8 - 1.81*y7",
        "-280*y6*y8 + 1.81*y7",
    )

    def numbers(s: Any, _words: Words) -> list[Any]:
        y1, y2, y3, y4, y5, y6, y7, y8 = s
        return [
            -1.71 * y1 + 0.43 * y2 + 8.32 * y3 + 0.0007,
            1.71 * y1 - 8.75 * y2,
            -10.03 * y3 + 0.43 * y4 + 0.035 * y5,
            8.32 * y2 + 1.71 * y3 - 1.12 * y4,
            -1.745 * y5 + 0.43 * y6 + 0.43 * y7,
            -280 * y6 * y8 + 0.69 * y4 + 1.71 * y5 - 0.43 * y6 + 0.69 * y7,
            280 * y6 * y8 - 1.81 * y7,
            -280 * y6 * y8 + 1.81 * y7,
        ]

    statement = {
        "name": "HIRES",
        "parameters": {"tau": "1 s"},
        "states": {name: {"unit": "1", "rate": f"({rate})/tau"} for name, rate in zip(names, rates, strict=True)},
        "initial": dict(zip(names, start, strict=True)),
    }
    reference = (
        0.7371312573325668e-3,
        0.1442485726316185e-3,
        0.5888729740967575e-4,
        0.1175651343283149e-2,
        0.2386356198831331e-2,
        0.6238968252742796e-2,
        0.2849998395185769e-2,
        0.2850001604814231e-2,
    )
    return Benchmark("HIRES", statement, names, start, 321.8122, reference, numbers, SOURCE, stiff=True)


def _robertson() -> Benchmark:
    reference = (0.2083340149701255e-7, 0.8333360770334713e-13, 0.9999999791665050)
    return replace(PROBLEMS["robertson"], end=1e11, reference=reference, source=SOURCE)


def _van_der_pol() -> Benchmark:
    names, start = ("x", "v_x"), (2.0, 0.0)

    def numbers(s: Any, _words: Words) -> list[Any]:
        return [s[1], 1000.0 * (1.0 - s[0] * s[0]) * s[1] - s[0]]

    statement = {
        "name": "Van der Pol, mu = 1000",
        "coordinates": {"x": "m"},
        "parameters": {"m": "1 kg", "k": "1 N m-1", "c": "1000 N s m-1", "d": "1 m"},
        "mass": {"x": "m"},
        "forces": {"total": {"x": "c*(1 - (x/d)**2)*v_x - k*x"}},
        "initial": {"x": "2 m", "v_x": "0 m s-1"},
    }
    reference = (0.1706167732170483e1, -0.8928097010247975e-3)
    return Benchmark("Van der Pol", statement, names, start, 2000.0, reference, numbers, SOURCE, stiff=True)


def chain(masses: int = 50, end: float = 10.0) -> Benchmark:
    """Return masses on springs between two walls, the first displaced."""
    names = tuple(f"u{i}" for i in range(masses))
    ends = ("0", *names, "0")
    pulls = {
        name: f"k*(({right}) - {name}) - k*({name} - ({left}))"
        for left, name, right in zip(ends[:-2], names, ends[2:], strict=True)
    }
    velocities = tuple(f"v_{name}" for name in names)
    start = (0.1, *[0.0] * (2 * masses - 1))

    def numbers(s: Any, _words: Words) -> list[Any]:
        u = [0.0, *s[:masses], 0.0]
        return [*s[masses:], *(100.0 * (u[i + 2] - 2.0 * u[i + 1] + u[i]) for i in range(masses))]

    statement = {
        "name": f"chain of {masses} masses on springs",
        "coordinates": dict.fromkeys(names, "m"),
        "parameters": {"m": "1 kg", "k": "100 N m-1"},
        "mass": dict.fromkeys(names, "m"),
        "forces": {"springs": pulls},
        "initial": dict.fromkeys(names, "0 m") | dict.fromkeys(velocities, "0 m s-1") | {"u0": "0.1 m"},
    }
    return Benchmark("chain", statement, (*names, *velocities), start, end, (), numbers, "", stiff=False)


STIFF: dict[str, Benchmark] = {"hires": _hires(), "robertson": _robertson(), "van_der_pol": _van_der_pol()}
