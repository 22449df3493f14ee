"""Models with many coordinates: chains, lattices with conserved quantities, the outer solar system.

Every number is the dimensionless one of the literature: unit masses, lengths and times, constants with dimensions.
"""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import xdynamics as xd


def at_rest(places: dict[str, float]) -> dict[str, str]:
    """Return the initial values of coordinates that do not move."""
    return {name: f"{value!r} m" for name, value in places.items()} | {f"v_{name}": "0 m s-1" for name in places}


def chain(n: int) -> xd.Model:
    """Return masses on springs between two walls, the first displaced; each force is an expression by coordinate."""
    names = [f"u{i}" for i in range(n)]
    ends = ["0", *names, "0"]
    pulls = {
        name: f"k*(({right}) - {name}) - k*({name} - ({left}))"
        for left, name, right in zip(ends[:-2], names, ends[2:], strict=True)
    }
    return xd.Model(
        name=f"chain of {n} masses on springs",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass=dict.fromkeys(names, "m"),
        forces={"springs": pulls},
        initial=at_rest(dict.fromkeys(names, 0.0) | {"u0": 1.0}),
    )


def fput(n: int = 32, alpha: float = 0.25) -> xd.Model:
    """Return the alpha chain of Fermi, Pasta, Ulam and Tsingou in its lowest mode, as one potential.

    E. Fermi, J. Pasta, S. Ulam, Studies of nonlinear problems, Los Alamos report LA-1940 (1955), figure 1.
    """
    names = [f"u{i}" for i in range(1, n + 1)]
    bonds = [f"({right} - {left})" for left, right in pairwise(names)]
    bonds = [names[0], *bonds, f"(-{names[-1]})"]
    potential = " + ".join(f"k*{bond}**2/2 + alpha*{bond}**3/3" for bond in bonds)
    return xd.Model(
        name=f"chain of {n} masses with quadratic forces",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "k": "1 N m-1", "alpha": f"{alpha!r} N m-2"},
        mass=dict.fromkeys(names, "m"),
        forces={"bonds": {"potential": potential}},
        initial=at_rest({name: math.sin(math.pi * i / (n + 1)) for i, name in enumerate(names, start=1)}),
    )


def toda(n: int = 100) -> xd.Model:
    """Return a ring of masses with exponential springs, that moves as a whole and starts with a wave of velocities.

    Besides its energy it keeps the trace of every power of the matrix L of Flaschka (Phys. Rev. B 9, 1974, 1924), of
    which `momentum` and `cubic` are the first and, but for factors, the third.
    """
    names = [f"q{i}" for i in range(n)]
    bonds = [(one, other, f"exp(({one} - {other})/d)") for one, other in pairwise([*names, names[0]])]
    wave = {f"v_{name}": f"{0.5 + math.sin(2 * math.pi * i / n)!r} m s-1" for i, name in enumerate(names)}
    return xd.Model(
        name=f"Toda lattice of {n} masses",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "d": "1 m", "k": "1 N m-1"},
        mass=dict.fromkeys(names, "m"),
        forces={"bonds": {"potential": " + ".join(f"k*d**2*{stretch}" for _, _, stretch in bonds)}},
        initial=at_rest(dict.fromkeys(names, 0.0)) | wave,
        observables={
            "momentum": " + ".join(f"m*v_{name}" for name in names),
            "cubic": " + ".join(
                f"v_{one}**3 + 3*k*d**2/m*{stretch}*(v_{one} + v_{other})" for one, other, stretch in bonds
            ),
        },
    )


# Mass, position and velocity of the Sun with the inner planets, Jupiter, Saturn, Uranus, Neptune and Pluto on 5 September
# 1994, in solar masses, astronomical units and days: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration,
# 2nd ed. (2006), section I.2.4, table 2.2.
BODIES = {
    "sun": (1.00000597682, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "jupiter": (0.000954786104043, (-3.5023653, -3.8169847, -1.5507963), (0.00565429, -0.00412490, -0.00190589)),
    "saturn": (0.000285583733151, (9.0755314, -3.0458353, -1.6483708), (0.00168318, 0.00483525, 0.00192462)),
    "uranus": (0.0000437273164546, (8.3101420, -16.2901086, -7.2521278), (0.00354178, 0.00137102, 0.00055029)),
    "neptune": (0.0000517759138449, (11.4707666, -25.7294829, -10.8169456), (0.00288930, 0.00114527, 0.00039677)),
    "pluto": (1.0 / 1.3e8, (-15.5387357, -25.2225594, -3.1902382), (0.00276725, -0.00170702, -0.00136504)),
}
GRAVITY = 2.95912208286e-4


def outer_solar_system() -> xd.Model:
    """Return six bodies in space, with the three components of their angular momentum as observables."""
    masses = {name: f"m_{name}" for name in BODIES}
    names = [f"{axis}_{name}" for name in BODIES for axis in "xyz"]
    pairs = [
        f"G*{masses[one]}*{masses[other]}/sqrt("
        + " + ".join(f"({axis}_{one} - {axis}_{other})**2" for axis in "xyz")
        + ")"
        for one, other in combinations(BODIES, 2)
    ]
    initial = {}
    for name, (_, place, speed) in BODIES.items():
        initial |= {f"{axis}_{name}": f"{value!r} m" for axis, value in zip("xyz", place, strict=True)}
        initial |= {f"v_{axis}_{name}": f"{value!r} m s-1" for axis, value in zip("xyz", speed, strict=True)}
    turning = {
        f"angular_momentum_{axis}": " + ".join(
            f"m_{name}*({a}_{name}*v_{b}_{name} - {b}_{name}*v_{a}_{name})" for name in BODIES
        )
        for axis, a, b in ("xyz", "yzx", "zxy")
    }
    return xd.Model(
        name="outer solar system",
        coordinates=dict.fromkeys(names, "m"),
        parameters={masses[name]: f"{body[0]!r} kg" for name, body in BODIES.items()}
        | {"G": f"{GRAVITY!r} m3 kg-1 s-2"},
        mass={name: masses[name[2:]] for name in names},
        forces={"gravity": {"potential": "-(" + " + ".join(pairs) + ")"}},
        initial=initial,
        observables=turning,
    )
