"""Problems for adaptive marches: models with units, plain rates for the peers, and reference solutions.

Every number is the dimensionless one of the literature: unit masses, lengths and times, constants with dimensions.

Where no source is named, a reference is the state that a Taylor series march (heyoka 7.13.2) of 160 bits with
tolerance 1e-36 reaches from these very double-precision inputs, and `python tests/benchmarks/adaptive_problems.py`
integrates each problem again by scipy's DOP853 or Radau and prints how far it comes. This file needs numpy alone
until a model or that check is asked for, so that peers in another environment can import it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

    import xdynamics as xd

Floats = NDArray[np.float64]


class Words(NamedTuple):
    """The functions that rates are written in: of numbers, of jax arrays or of heyoka expressions."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    inverse_cube: Callable[[Any], Any]  # of a squared distance: r2**-1.5


def plain_inverse_cube(r2: float) -> float:
    """Return r2**-1.5 by a product and a square root."""
    return 1.0 / (r2 * math.sqrt(r2))


PLAIN = Words(math.sin, math.cos, plain_inverse_cube)


@dataclass(frozen=True)
class Benchmark:
    """An initial-value problem three ways: a model's statement, first-order rates, and where it ends.

    Attributes
    ----------
    statement : dict
        Keywords of `xdynamics.Model`.
    names : tuple of str
        Record names in the order of the state: coordinates, velocities, or first-order states.
    start, reference : tuple of float
        The state at time zero and at `end`.
    rates : callable
        ``rates(y, words)``: the derivative of every entry of the state, autonomous.
    stiff : bool
        Whether an explicit method is limited by stability.
    """

    title: str
    statement: dict[str, Any] = field(repr=False)
    names: tuple[str, ...]
    start: tuple[float, ...]
    end: float
    reference: tuple[float, ...]
    rates: Callable[[Any, Words], Sequence[Any]]
    source: str
    stiff: bool = False

    def model(self) -> xd.Model:
        """Return the problem as a model."""
        import xdynamics as xd

        return xd.Model(**self.statement)

    def error(self, last: Sequence[float] | Floats) -> float:
        """Return the largest error of a final state, absolute below one and relative above."""
        exact = np.array(self.reference)
        return float(np.max(np.abs(np.asarray(last) - exact) / np.maximum(1.0, np.abs(exact))))

    def last_of(self, run: xr.Dataset) -> Floats:
        """Return the final state of a run record."""
        return np.array([float(run[name].values[-1]) for name in self.names])


def _initial(names: Sequence[str], values: Sequence[float], units: Sequence[str]) -> dict[str, str]:
    return {name: f"{value!r} {unit}" for name, value, unit in zip(names, values, units, strict=True)}


def _plane(names: tuple[str, ...], start: tuple[float, ...], unit: str = "m") -> dict[str, str]:
    half = len(names) // 2
    return _initial(names, start, [unit] * half + [f"{unit} s-1"] * half)


ORBIT = ("x", "y", "v_x", "v_y")


def _arenstorf() -> Benchmark:
    start, mu = (0.994, 0.0, 0.0, -2.00158510637908252240537862224), 0.012277471

    def rates(s: Any, words: Words) -> list[Any]:
        x, y, u, v = s[0], s[1], s[2], s[3]
        e, f = x + mu, x - (1.0 - mu)
        earth = (1.0 - mu) * words.inverse_cube(e * e + y * y)
        moon = mu * words.inverse_cube(f * f + y * y)
        return [u, v, x + 2.0 * v - earth * e - moon * f, y - 2.0 * u - (earth + moon) * y]

    statement = {
        "name": "Arenstorf orbit",
        "coordinates": {"x": "m", "y": "m"},
        "parameters": {"m": "1 kg", "k": "1 m3 s-2", "w": "1 s-1", "d": "1 m", "mu": mu},
        "definitions": {
            "to_earth": "sqrt((x + mu*d)**2 + y**2)",
            "to_moon": "sqrt((x - (1 - mu)*d)**2 + y**2)",
            "earth": "k*(1 - mu)/to_earth**3",
            "moon": "k*mu/to_moon**3",
        },
        "mass": {"x": "m", "y": "m"},
        "forces": {
            "total": {
                "x": "m*(w**2*x + 2*w*v_y - earth*(x + mu*d) - moon*(x - (1 - mu)*d))",
                "y": "m*(w**2*y - 2*w*v_x - (earth + moon)*y)",
            }
        },
        "initial": _plane(ORBIT, start),
    }
    # The period is known to 1e-14; the state after it differs from the start, for which the orbit is ill-conditioned.
    reference = (0.99399999999997399577, -8.8551346201210835e-14, -1.4388667357318094e-11, -2.0015851063831290198)
    source = "Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.0"
    return Benchmark(
        "Arenstorf orbit", statement, ORBIT, start, 17.0652165601579625588917206249, reference, rates, source
    )


def _kepler() -> Benchmark:
    start = (0.1, 0.0, 0.0, math.sqrt(19.0))

    def rates(s: Any, words: Words) -> list[Any]:
        k = -words.inverse_cube(s[0] * s[0] + s[1] * s[1])
        return [s[2], s[3], k * s[0], k * s[1]]

    statement = {
        "name": "Kepler ellipse of eccentricity 0.9",
        "coordinates": {"x": "m", "y": "m"},
        "parameters": {"m": "1 kg", "mu": "1 m3 s-2"},
        "definitions": {"r": "sqrt(x**2 + y**2)", "pull": "m*mu/r**3"},
        "mass": {"x": "m", "y": "m"},
        "forces": {"gravity": {"x": "-pull*x", "y": "-pull*y"}},
        "initial": _plane(ORBIT, start),
    }
    reference = (-1.2952662509874837271, 0.40039389637925143265, -0.67753909247082954247, -0.12708381542784492664)
    source = "Hull, Enright, Fellen, Sedgwick (1972), SIAM J. Numer. Anal. 9, 603, problem D5"
    return Benchmark("Kepler, e = 0.9", statement, ORBIT, start, 20.0, reference, rates, source)


PLEIADES_X = (3.0, 3.0, -1.0, -3.0, 2.0, -2.0, 2.0)
PLEIADES_Y = (3.0, -3.0, 2.0, 0.0, 0.0, -4.0, 4.0)
PLEIADES_U = (0.0, 0.0, 0.0, 0.0, 0.0, 1.75, -1.5)
PLEIADES_V = (0.0, 0.0, 0.0, -1.25, 1.0, 0.0, 0.0)
# Mazzia, Magherini, Test Set for Initial Value Problem Solvers, release 2.4 (2008), University of Bari, problem
# Pleiades: the published digits at t = 3. The Taylor march of 160 bits agrees with each to 2e-15.
PLEIADES_END = (
    *(0.3706139143970502, 3.237284092057233, -3.222559032418324, 0.6597091455775310, 0.3425581707156584),
    *(1.562172101400631, -0.7003092922212495, -3.943437585517392, -3.271380973972550, 5.225081843456543),
    *(-2.590612434977470, 1.198213693392275, -0.2429682344935824, 1.091449240428980, 3.417003806314313),
    *(1.354584501625501, -2.590065597810775, 2.025053734714242, -1.155815100160448, -0.8072988170223021),
    *(0.5952396354208710, -3.741244961234010, 0.3773459685750630, 0.9386858869551073, 0.3667922227200571),
    *(-0.3474046353808490, 2.344915448180937, -1.947020434263292),
)


def _pleiades() -> Benchmark:
    stars = range(1, 8)
    q = tuple(f"{axis}{i}" for axis in "xy" for i in stars)
    names = (*q, *(f"v_{one}" for one in q))
    start = PLEIADES_X + PLEIADES_Y + PLEIADES_U + PLEIADES_V

    def rates(s: Any, words: Words) -> list[Any]:
        x, y = [s[i] for i in range(7)], [s[7 + i] for i in range(7)]
        ax, ay = [0.0 * x[0]] * 7, [0.0 * y[0]] * 7
        for i in range(7):
            for j in range(i):
                dx, dy = x[j] - x[i], y[j] - y[i]
                k = words.inverse_cube(dx * dx + dy * dy)
                ax[i], ay[i] = ax[i] + (j + 1.0) * k * dx, ay[i] + (j + 1.0) * k * dy
                ax[j], ay[j] = ax[j] - (i + 1.0) * k * dx, ay[j] - (i + 1.0) * k * dy
        return [*(s[14 + i] for i in range(14)), *ax, *ay]

    def pull(axis: str, i: int) -> str:
        pairs = [(j, f"f{min(i, j)}{max(i, j)}") for j in stars if j != i]
        return " + ".join(f"{pair}*({axis}{j} - {axis}{i})" for j, pair in pairs)

    pairs = [(i, j) for i in stars for j in stars if i < j]
    distances = {f"r{i}{j}": f"sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in pairs}
    statement = {
        "name": "Pleiades",
        "description": "Seven stars of masses 1 to 7 in a plane",
        "coordinates": dict.fromkeys(q, "m"),
        "parameters": {"G": "1 m3 kg-1 s-2"} | {f"m{i}": f"{i} kg" for i in stars},
        "definitions": distances | {f"f{i}{j}": f"G*m{i}*m{j}/r{i}{j}**3" for i, j in pairs},
        "mass": {f"{axis}{i}": f"m{i}" for axis in "xy" for i in stars},
        "forces": {"gravity": {f"{axis}{i}": pull(axis, i) for axis in "xy" for i in stars}},
        "initial": _plane(names, start),
    }
    source = "Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.10"
    return Benchmark("Pleiades", statement, names, start, 3.0, PLEIADES_END, rates, source)


def _double_pendulum() -> Benchmark:
    names, start, g = ("th1", "th2", "v_th1", "v_th2"), (math.pi / 2, math.pi / 2, 0.0, 0.0), 9.81

    def rates(s: Any, words: Words) -> list[Any]:
        sine, cosine = words.sin(s[0] - s[1]), words.cos(s[0] - s[1])
        first = -sine * (s[3] * s[3]) - 2.0 * g * words.sin(s[0])
        second = sine * (s[2] * s[2]) - g * words.sin(s[1])
        k = 1.0 / (2.0 - cosine * cosine)
        return [s[2], s[3], k * (first - cosine * second), k * (2.0 * second - cosine * first)]

    statement = {
        "name": "Double pendulum from the horizontal",
        "coordinates": {"th1": "rad", "th2": "rad"},
        "parameters": {"m1": "1 kg", "m2": "1 kg", "l1": "1 m", "l2": "1 m", "g": f"{g} m s-2"},
        "definitions": {"c": "m2*l1*l2*cos(th1 - th2)", "s": "m2*l1*l2*sin(th1 - th2)"},
        "mass": {"matrix": [["(m1 + m2)*l1**2", "c"], ["c", "m2*l2**2"]]},
        "forces": {
            "total": {
                "th1": "-s*v_th2**2 - (m1 + m2)*g*l1*sin(th1)",
                "th2": "s*v_th1**2 - m2*g*l2*sin(th2)",
            }
        },
        "initial": _plane(names, start, "rad"),
    }
    reference = (-0.56847466401594533662, -0.52639372793124124871, 6.0783848857619719387, -9.6813606817088868126)
    return Benchmark(
        "Double pendulum", statement, names, start, 10.0, reference, rates, "Lagrange's equations; chaotic"
    )


def _van_der_pol() -> Benchmark:
    names, start = ("x", "v_x"), (2.0, 0.0)

    def rates(s: Any, _words: Words) -> list[Any]:
        return [s[1], 1000.0 * ((1.0 - s[0] * s[0]) * s[1] - s[0])]

    statement = {
        "name": "Van der Pol, 1/eps = 1000",
        "coordinates": {"x": "m"},
        "parameters": {"m": "1 kg", "k": "1000 kg s-2", "c": "1000 kg s-1", "a": "1 m"},
        "mass": {"x": "m"},
        "forces": {"damping": {"x": "c*(1 - (x/a)**2)*v_x"}, "spring": {"x": "-k*x"}},
        "initial": _plane(names, start),
    }
    reference = (1.7632345402034457038, -0.83568868167767739133)
    source = "Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.1, with eps = 1e-3"
    return Benchmark("Van der Pol, eps = 1e-3", statement, names, start, 2.0, reference, rates, source, stiff=True)


def _brusselator() -> Benchmark:
    names, start = ("x", "y"), (1.5, 3.0)

    def rates(s: Any, _words: Words) -> list[Any]:
        turned = s[0] * s[0] * s[1]
        return [1.0 + turned - 4.0 * s[0], 3.0 * s[0] - turned]

    statement = {
        "name": "Brusselator",
        "parameters": {"A": 1.0, "B": 3.0, "tau": "1 s"},
        "definitions": {"turned": "x**2*y"},
        "states": {
            "x": {"unit": "1", "rate": "(A + turned - (B + 1)*x)/tau"},
            "y": {"unit": "1", "rate": "(B*x - turned)/tau"},
        },
        "initial": _initial(names, start, ("1", "1")),
    }
    reference = (0.49863707126834784865, 4.5967803494520111832)
    source = "Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.4"
    return Benchmark("Brusselator", statement, names, start, 20.0, reference, rates, source)


def _robertson() -> Benchmark:
    names, start = ("a", "b", "c"), (1.0, 0.0, 0.0)

    def rates(s: Any, _words: Words) -> list[Any]:
        slow, back, fast = 0.04 * s[0], 1e4 * s[1] * s[2], 3e7 * s[1] * s[1]
        return [back - slow, slow - back - fast, fast]

    statement = {
        "name": "Robertson's reactions",
        "parameters": {"k1": "0.04 s-1", "k2": "3e7 s-1", "k3": "1e4 s-1"},
        "definitions": {"slow": "k1*a", "fast": "k2*b**2", "back": "k3*b*c"},
        "states": {
            "a": {"unit": "1", "rate": "back - slow"},
            "b": {"unit": "1", "rate": "slow - back - fast"},
            "c": {"unit": "1", "rate": "fast"},
        },
        "initial": _initial(names, start, ("1", "1", "1")),
    }
    reference = (0.71582706871940508694, 9.1855347645577639421e-06, 0.28416374574583035530)
    source = "Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.1"
    return Benchmark("Robertson", statement, names, start, 40.0, reference, rates, source, stiff=True)


PROBLEMS: dict[str, Benchmark] = {
    "arenstorf": _arenstorf(),
    "kepler": _kepler(),
    "pleiades": _pleiades(),
    "double_pendulum": _double_pendulum(),
    "van_der_pol": _van_der_pol(),
    "brusselator": _brusselator(),
    "robertson": _robertson(),
}


def main() -> None:
    """Print how far scipy at its tightest is from every reference, and how far a march of the model in fixed steps."""
    import scipy
    from scipy.integrate import solve_ivp

    import xdynamics as xd

    print(f"scipy {scipy.__version__} at rtol 3e-14 and atol 1e-15; xdynamics midpoint in 200 000 steps")
    for name, problem in PROBLEMS.items():
        found = solve_ivp(
            lambda _t, y, rates=problem.rates: rates(y, PLAIN),
            (0.0, problem.end),
            problem.start,
            method="Radau" if name == "robertson" else "DOP853",
            rtol=3e-14,
            atol=1e-15,
        )
        run = xd.simulate(
            problem.model(), method="midpoint", step=problem.end / 200_000, until=problem.end, force_samples="none"
        )
        ours = problem.error(problem.last_of(run)) if run.attrs["run_outcome"] == "completed" else math.nan
        print(
            f"{name:16} scipy {problem.error(found.y[:, -1]):8.1e}   midpoint {ours:8.1e}   {run.attrs['run_outcome']}"
        )


if __name__ == "__main__":
    main()
