"""Bodies that rest under loads that grow, held by contacts, friction or constraints, and the closed forms of their release."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

import xdynamics as xd
from xdynamics.faults import AccuracyWarning, InputError

G = 9.80665
METHODS = ("dormand_prince", "dop853", "taylor", "radau_iia", "bogacki_shampine", "dprkn6", "rk4")
Draw = Callable[[float, float], float]  # a number between two


@dataclass(frozen=True)
class Resting:
    """A model at rest.

    Attributes
    ----------
    model : Model
    release : float
        Time at which it begins to move, s; infinite if nothing ever does.
    until : float
        End of its marches, s.
    """

    model: xd.Model
    release: float
    until: float


def resting(name: str, seed: int | None = None) -> Resting:
    """Return a case by its name: with round numbers, or random ones."""
    random = np.random.default_rng(seed)

    def drawn(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    return CASES[name](_middle if seed is None else drawn)


def _middle(low: float, high: float) -> float:
    return round(math.sqrt(low * high), 12)


def marched(case: Resting, method: str, **settings: Any) -> xr.Dataset | None:
    """March a case with rtol = 1e-8; None where the method refuses its model."""
    settings |= {"method": method, "rtol": 1e-8, "until": case.until}
    if method == "rk4":
        settings["estimator"] = "step_doubling"
    try:
        return xd.simulate(case.model, **settings)
    except InputError as refusal:
        if "radau_iia with jacobian = 'differences'" in str(refusal):
            return xd.simulate(case.model, **settings, jacobian="differences")
        if "refuses" not in str(refusal):
            raise
        return None


def marched_absolutely(case: Resting, method: str) -> xr.Dataset:
    """March a case with an absolute tolerance, too, which what rests is far below."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        run = marched(case, method, atol=1e-9)
    assert run is not None
    return run


def _case(release: float, text: str, **numbers: float) -> Resting:
    """Return a case of a model with these numbers, marched half as long again as it rests."""
    shown = {name: repr(number) for name, number in numbers.items()}
    model = xd.Model.from_text(f'name = "{text.split(maxsplit=1)[0]}"\n{text.partition(chr(10))[2].format_map(shown)}')
    return Resting(model, release, 1.5 * release if math.isfinite(release) else 2.0)


def _lift(draw: Draw) -> Resting:
    m, k = draw(2.0, 200.0), draw(15.0, 1500.0)
    return _case(m * G / k, LIFT, m=m, k=k)


def _pull(draw: Draw) -> Resting:
    m, k, mu = draw(2.0, 200.0), draw(3.0, 300.0), draw(0.1, 0.9)
    return _case(mu * m * G / k, PULL, m=m, k=k, mu=mu)


def _hinge(draw: Draw) -> Resting:
    m, k, arm, more = draw(0.5, 50.0), draw(1.0, 100.0), draw(0.2, 2.0), draw(0.1, 10.0)
    moment = m * G * arm * (1.0 + more)
    return _case((moment / arm - m * G) / k, HINGE, m=m, k=k, arm=arm, moment=moment)


def _slope(draw: Draw) -> Resting:
    m, w, mu = draw(0.5, 50.0), draw(0.03, 3.0), draw(0.2, 0.8)
    return _case(math.atan(mu) / w, SLOPE, m=m, w=w, mu=mu)


def _pile(draw: Draw) -> Resting:
    m, n, k = draw(1.0, 100.0), draw(1.0, 100.0), draw(15.0, 1500.0)
    return _case((m + n) * G / k, PILE, m=m, n=n, k=k)


def _corner(draw: Draw) -> Resting:
    m, k, mu, slant = draw(2.0, 200.0), draw(3.0, 300.0), draw(0.1, 0.9), draw(0.1, 1.0)
    load = k * (math.cos(slant) + mu * math.sin(slant))
    return _case(mu * m * G / load, CORNER, m=m, k=k, mu=mu, slant=slant)


def _rod(draw: Draw) -> Resting:
    m, k, length, turn = draw(0.5, 50.0), draw(1.0, 100.0), draw(0.3, 3.0), draw(0.1, 1.4)
    x, y = length * math.cos(turn), length * math.sin(turn)
    return _case(math.inf, ROD, m=m, k=k, L=math.hypot(x, y), x=x, y=y)


def _crate(draw: Draw) -> Resting:
    m, mu, first, last = draw(2.0, 200.0), draw(0.1, 0.9), draw(0.1, 0.9), draw(1.1, 4.0)
    most = mu * m * G  # reached between the second row and the third
    return _case(1.0 + (1.0 - first) / (last - first), CRATE, m=m, mu=mu, first=first * most, last=last * most)


def _three(draw: Draw) -> Resting:
    a, b = draw(0.05, 0.5), draw(0.05, 0.5)
    return _case(math.inf, THREE, m=draw(2.0, 200.0), k=draw(3.0, 300.0), a=a, b=b, c=a + b)


def _tank(draw: Draw) -> Resting:
    a, b = draw(0.05, 0.5), draw(0.05, 0.5)
    return _case(math.inf, TANK, k=draw(0.1, 10.0), a=a, b=b, c=a + b)


LIFT = """lift
[coordinates]
z = {{ unit = "m" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
k = "{k} N s-1"
[mass]
z = "m"
[forces]
weight = {{ z = "-m*g" }}
lift = {{ z = "k*t" }}
[contacts.floor]
gap = "z"
restitution = 0
[initial]
z = "0 m"
v_z = "0 m s-1"
"""
PULL = """pull
[coordinates]
x = {{ unit = "m" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
k = "{k} N s-1"
mu = "{mu}"
[mass]
x = "m"
[forces]
pull = {{ x = "k*t" }}
[frictions.ground]
slip = "v_x"
kinetic = "mu*m*g"
[initial]
x = "0 m"
v_x = "0 m s-1"
"""
HINGE = """hinge
[coordinates]
theta = {{ unit = "rad" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
k = "{k} N s-1"
arm = "{arm} m"
moment = "{moment} N m"
[mass]
theta = "m*arm**2/radian**2"
[forces]
weight = {{ theta = "m*g*arm*cos(theta)/radian" }}
load = {{ theta = "k*t*arm*cos(theta)/radian" }}
[frictions.bearing]
slip = "v_theta"
kinetic = "moment/radian"
[initial]
theta = "0 rad"
v_theta = "0 rad s-1"
"""
SLOPE = """slope
[coordinates]
s = {{ unit = "m" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
w = "{w} rad s-1"
mu = "{mu}"
[mass]
s = "m"
[forces]
weight = {{ s = "m*g*sin(w*t)" }}
[frictions.plane]
slip = "v_s"
kinetic = "mu*m*g*cos(w*t)"
[initial]
s = "0 m"
v_s = "0 m s-1"
"""
PILE = """pile
[coordinates]
low = {{ unit = "m" }}
high = {{ unit = "m" }}
[parameters]
m = "{m} kg"
n = "{n} kg"
g = "9.80665 m s-2"
k = "{k} N s-1"
[mass]
low = "m"
high = "n"
[forces]
weight = {{ low = "-m*g", high = "-n*g" }}
lift = {{ low = "k*t" }}
[contacts.floor]
gap = "low"
restitution = 0
[contacts.between]
gap = "high - low"
restitution = 0
[initial]
low = "0 m"
high = "0 m"
v_low = "0 m s-1"
v_high = "0 m s-1"
"""
CORNER = """corner
[coordinates]
x = {{ unit = "m" }}
z = {{ unit = "m" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
k = "{k} N s-1"
mu = "{mu}"
slant = "{slant} rad"
[mass]
x = "m"
z = "m"
[forces]
weight = {{ z = "-m*g" }}
pull = {{ x = "k*t*cos(slant)", z = "k*t*sin(slant)" }}
[contacts.floor]
gap = "z"
restitution = 0
tangential = "coulomb"
slip = "v_x"
friction = "mu"
[initial]
x = "0 m"
z = "0 m"
v_x = "0 m s-1"
v_z = "0 m s-1"
"""
ROD = """rod
[coordinates]
x = {{ unit = "m" }}
y = {{ unit = "m" }}
[parameters]
m = "{m} kg"
k = "{k} N s-1"
L = "{L} m"
[mass]
x = "m"
y = "m"
[forces]
load = {{ x = "k*t*x/L", y = "k*t*y/L" }}
[constraints.rod]
holds = "x**2 + y**2 - L**2"
[initial]
x = "{x} m"
y = "{y} m"
v_x = "0 m s-1"
v_y = "0 m s-1"
"""
CRATE = """crate
[coordinates]
x = {{ unit = "m" }}
[parameters]
m = "{m} kg"
g = "9.80665 m s-2"
mu = "{mu}"
[mass]
x = "m"
[forces]
pull = {{ x = "pull" }}
[drives.pull]
table = "pull.csv"
csv = "time [s],pull [N]\\n0,0\\n1,{first}\\n2,{last}\\n4,{last}\\n"
[frictions.ground]
slip = "v_x"
kinetic = "mu*m*g"
[initial]
x = "0 m"
v_x = "0 m s-1"
"""
THREE = """three
[coordinates]
x = {{ unit = "m" }}
[parameters]
m = "{m} kg"
k = "{k} N s-1"
[mass]
x = "m"
[forces]
pulls = {{ x = "{a}*k*t + {b}*k*t - {c}*k*t" }}
[initial]
x = "0 m"
v_x = "0 m s-1"
"""
TANK = """tank
[states.level]
unit = "m"
rate = "{a}*k*t + {b}*k*t - {c}*k*t"
[parameters]
k = "{k} m s-2"
[initial]
level = "0 m"
"""
CASES: dict[str, Callable[[Draw], Resting]] = {
    "lift": _lift,
    "pull": _pull,
    "hinge": _hinge,
    "slope": _slope,
    "pile": _pile,
    "corner": _corner,
    "rod": _rod,
    "crate": _crate,
    "three": _three,
    "tank": _tank,
}
