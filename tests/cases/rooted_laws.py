"""Random laws with roots and broken powers behind switches, finite for every state: models, and the same for scipy."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import xdynamics as xd
from xdynamics.expressions import parse
from xdynamics.expressions.evaluation import evaluate

POWERS = {"x": ("1.5", "2.5", "0.5", "0.75", "1.25"), "w": ("0.5", "0.75")}  # of speeds none that ends in a pole
SPRING, DRAG = 4.0, 0.1


@dataclass(frozen=True)
class Case:
    """A law of a place x and a speed w, both pure numbers, with what it is marched by.

    Attributes
    ----------
    law, potential : str
        The force, in units of K; the potential energy of another, or nothing.
    start : (float, float)
    kind : {"plain", "elements", "regimes", "states"}
        What it is a force of.
    method : str
    """

    law: str
    potential: str
    start: tuple[float, float]
    kind: str
    method: str

    def model(self, *, smooth: bool = False) -> xd.Model:
        """Return the model; if smooth, one whose switches are stepped over."""
        x, v = self.start
        if self.kind == "states":
            total = self._texts("x", "w")
            states = {"x": {"unit": "1", "rate": "w/second"}, "w": {"unit": "1", "rate": f"({total})/second"}}
            states["w"]["smooth"] = smooth
            return xd.Model(name="rooted", states=states, initial={"x": f"{x}", "w": f"{v}"})
        dims = {"dims": ["body"]} if self.kind == "elements" else {}
        elements = {"dimensions": {"body": 2}} if dims else {}
        law = re.sub(r"\bw\b", "(v_x*second)", self.law)
        forces = {"law": {"x": f"K*({law})", "smooth": smooth}}
        forces["spring"] = {"x": f"-K*({SPRING}*x + {DRAG}*v_x*second)"}
        if self.potential:
            forces["stored"] = {"potential": f"K*({self.potential})", "smooth": smooth}
        regimes = {"one": {"forces": [*forces]}, "other": {"forces": [*forces]}} if self.kind == "regimes" else {}
        events = {"half": {"function": "t - 1.3*second", "direction": "rising", "action": "switch", "to": "other"}}
        return xd.Model(
            name="rooted",
            **elements,
            parameters={"K": "1 kg s-2"},
            coordinates={"x": {"unit": "1", **dims}},
            mass={"x": "1*kilogram"},
            forces=forces,
            **({"regimes": regimes, "events": events} if regimes else {}),
            initial=(
                {"x": f"{x} + 0.1*index(body)", "v_x": f"({v} + 0*index(body))/second"}
                if dims
                else {"x": f"{x}", "v_x": f"{v} s-1"}
            ),
        )

    def _texts(self, x: str, w: str) -> str:
        return f"({self.law}) - {SPRING}*{x} - {DRAG}*{w}"

    def slopes(self) -> Callable[[float, list[float]], list[float]]:
        """Return the rates of place and speed in plain numbers, for scipy; without the potential's."""
        tree = parse(self._texts("x", "w"))
        return lambda _, y: [y[1], evaluate(tree, {"x": y[0], "w": y[1]})]


def random_case(seed: int) -> Case:
    """Return a law of one to three terms, nested up to twice."""
    rng = np.random.default_rng(seed)
    kind = ("plain", "elements", "regimes", "states")[rng.integers(4)]
    law = " + ".join(_term(rng, ("x", "w")[rng.integers(4) // 3]) for _ in range(rng.integers(1, 3)))
    stored = rng.random() < 0.3 and kind in ("plain", "regimes")
    potential = f"{rng.uniform(0.2, 1):.2f}*({_positive(rng, 'x')})**2.5" if stored else ""
    steep = re.search(r"sqrt|acos|\*\*0", law) is not None  # a series has no radius beside such a zero
    method = ("dormand_prince", "dop853", "radau_iia", "taylor")[rng.integers(3 if steep else 4)]
    start = (round(rng.uniform(0.7, 1.4), 2), round(rng.uniform(-1.0, 1.0), 2))
    return Case(law, potential, start, kind, method)


def _term(rng: np.random.Generator, name: str) -> str:
    base, power, size = _positive(rng, name), POWERS[name][rng.integers(len(POWERS[name]))], rng.uniform(0.2, 1.5)
    sign = "-" if name == "w" else "+-"[rng.integers(2)]
    argument = _argument(rng, name) if name == "x" else f"(w - {rng.uniform(-0.5, 0.5):.2f})"  # a drag, no drive
    root = (
        f"({base})**{power}",
        f"sqrt({base})",
        f"where({argument} > 0, ({argument})**{power}, 0)",
        f"log(1 + ({base})**{power})",
        f"sign({argument})*abs({argument})**{power}",
        f"log(max({argument}, 0.3)/0.3)",
        f"acos(max(min(1 - ({base}), 1), -1))",
    )[rng.integers(7 if name == "x" else 6)]
    return f"{sign} {size:.2f}*{root}".removeprefix("+ ")


def _positive(rng: np.random.Generator, name: str, depth: int = 0) -> str:
    argument = _argument(rng, name)
    if depth < 1 and rng.random() < 0.3:
        inner = _positive(rng, name, depth + 1)
        return (f"max({inner} - 0.2, 0)", f"min({inner}, 0.6)", f"abs({inner} - 0.3)")[rng.integers(3)]
    return (
        f"max({argument}, 0)",
        f"abs({argument})",
        f"(abs({argument}) - ({argument}))/2",
        f"where({argument} > 0, {argument}, 0)",
    )[rng.integers(4)]


def _argument(rng: np.random.Generator, name: str) -> str:
    place, sign = rng.uniform(-0.5, 0.5), "+-"[rng.integers(2)]
    return f"({name} - {place:.2f})" if sign == "+" else f"({place:.2f} - {name})"
