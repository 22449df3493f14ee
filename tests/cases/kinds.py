"""Models of every pair of kinds that a model may have, and every stage that a model or its run may be given to.

A base of a spring and a ball without contacts is given what makes a kind: a controller, a delay, a constraint, contacts of one
body or of many, friction, dimensions, regimes, resets, a table. Whatever the pair, a stage answers, or refuses in one line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import xdynamics as xd

UNTIL = "0.6 s"
BASE: dict[str, Any] = {
    "coordinates": {"x": {"unit": "m"}, "y": {"unit": "m"}},
    "parameters": {"m": {"value": "1 kg", "uncertainty": "0.01 kg"}, "k": "40 N m-1", "g": "9.81 m s-2"},
    "mass": {"x": "m", "y": "m"},
    "forces": {"spring": {"x": "-k*x"}, "weight": {"y": "-m*g"}},
    "initial": {"x": "0.3 m", "y": "0.4 m", "v_x": "0.1 m s-1"},
}
KINDS: dict[str, dict[str, Any]] = {
    "controller": {
        "controllers": {
            "feedback": {
                "every": "50 ms",
                "outputs": {"u": {"unit": "N", "start": "0 N", "value": "-2*newton*second/metre*v_x"}},
            }
        },
        "forces": {"motor": {"x": "u"}},
    },
    "delay": {"forces": {"late": {"x": "-3*newton/metre*delayed(x, '70 ms')"}}, "history": {"x": "0.3*metre"}},
    "constraint": {
        "coordinates": {"p": {"unit": "m"}, "q": {"unit": "m"}},
        "mass": {"p": "m", "q": "m"},
        "forces": {"bob": {"q": "-m*g"}},
        "constraints": {"rod": {"holds": "sqrt(p**2 + q**2) - 0.5*metre"}},
        "initial": {"p": "0.3 m", "q": "-0.4 m"},
    },
    "joint": {
        "bodies": {
            "rod": {
                "mass": "2 kg",
                "inertia": ["0.2 kg m2", "0.2 kg m2", "0.002 kg m2"],
                "points": {"hole": ["0.3 m", "0 m", "0.5 m"]},
                "initial": {
                    "position": ["-0.3 m", "0.5 m", "0 m"],
                    "attitude": {"axis": [1, 0, 0], "angle": "90 degree"},
                },
            }
        },
        "joints": {"pin": {"hinge": ["rod", "space"], "at": ["hole", ["0 m", "0 m", "0 m"]], "axis": [1, 0, 0]}},
        "forces": {"weight_of_rod": {"potential": "20*newton*rod_r[z]"}},
    },
    "contact": {"contacts": {"floor": {"gap": "y", "restitution": 0.6}}},
    "heap": {
        "dimensions": {"ball": 3},
        "relations": {"pair": {"of": "ball"}},
        "coordinates": {"z": {"unit": "m", "dims": ["ball"]}},
        "mass": {"z": "0.1*kilogram"},
        "forces": {"falls": {"z": "-0.1*kilogram*g"}},
        "contacts": {
            "ground": {"gap": "z - 0.05*metre", "restitution": 0.3},
            "balls": {"gap": "second(z, pair) - first(z, pair) - 0.1*metre", "restitution": 0.3},
        },
        "initial": {"z": {"unit": "m", "value": [0.06, 0.2, 0.4]}},
    },
    "friction": {"frictions": {"rail": {"slip": "v_x", "kinetic": "0.8*newton", "static": "1*newton"}}},
    "shapes": {
        "dimensions": {"site": 4},
        "relations": {"link": {"of": "site", "neighbours": 1}},
        "states": {"T": {"unit": "K", "dims": ["site"], "rate": "sum(second(T, link) - first(T, link), link)/second"}},
        "initial": {"T": {"unit": "K", "value": [300, 310, 320, 330]}},
    },
    "regimes": {
        "forces": {"push": {"x": "1*newton"}, "brake": {"x": "-1*newton"}},
        "regimes": {
            "pushed": {"forces": ["spring", "weight", "push"]},
            "braked": {"forces": ["spring", "weight", "brake"]},
        },
        "events": {"turn": {"function": "x", "direction": "falling", "action": "switch", "to": "braked"}},
        "initial": {"regime": "pushed"},
    },
    "reset": {
        "events": {"kick": {"function": "x", "direction": "rising", "action": "reset", "set": {"v_x": "0.9*v_x"}}}
    },
    "table": {
        "drives": {"gust": {"csv": "time [s],gust [N]\n0,0\n0.2,1\n0.5,0\n1,0\n", "outside": "hold"}},
        "forces": {"wind": {"x": "gust"}},
    },
    "stop": {
        "events": {
            "low": {"function": "y + 1*metre", "direction": "falling", "action": "stop"},
            "middle": {"function": "x", "action": "record"},
        }
    },
}
MARCHES: dict[str, dict[str, Any]] = {
    "fixed": {"method": "rk4", "step": "5 ms"},
    "chosen": {"method": "dop853", "rtol": 1e-9},
    "double_double": {"method": "dormand_prince", "step": "10 ms", "precision": "double_double"},
    "taylor": {"method": "taylor", "rtol": 1e-10},
    "radau": {"method": "radau_iia", "rtol": 1e-8, "jacobian": "differences"},
    "time_stepping": {"method": "moreau_jean", "step": "2 ms"},
}
WITHOUT_DIMENSIONS = {"joint", "heap", "shapes"}  # delayed values are of single numbers
PAIRS = [
    pair
    for pair in [*((kind,) for kind in KINDS), *combinations(KINDS, 2)]
    if "delay" not in pair or not WITHOUT_DIMENSIONS & {*pair}
]
CASES = [(pair, march) for pair in PAIRS for march in MARCHES]


def joined(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables joined entry by entry."""
    both = dict(first)
    for key, value in second.items():
        both[key] = (
            joined(both[key], value) if isinstance(both.get(key), Mapping) and isinstance(value, Mapping) else value
        )
    return both


def model_of(pair: tuple[str, ...]) -> xd.Model:
    """Return the model of a pair of kinds."""
    sections = BASE
    for kind in pair:
        sections = joined(sections, KINDS[kind])
    if "regimes" in sections:
        common = [name for name in sections["forces"] if name not in ("push", "brake")]
        own = {"pushed": "push", "braked": "brake"}
        sections = sections | {"regimes": {name: {"forces": [*common, own[name]]} for name in sections["regimes"]}}
    return xd.Model(name=" and ".join(pair), **sections)


def _refined(model: xd.Model, asked: dict[str, Any], _: Path) -> Any:
    if "step" in asked:
        step = float(asked["step"].split()[0])
        others = {key: value for key, value in asked.items() if key != "step"}
        return xd.refine(
            model, steps=[f"{step} ms", f"{step / 2} ms", f"{step / 4} ms"], until=UNTIL, defects=False, **others
        )
    others = {key: value for key, value in asked.items() if key != "rtol"}
    return xd.refine(model, rtols=[asked["rtol"], asked["rtol"] / 10], until=UNTIL, **others)


def _of_run(stage: Callable[[Any], Any]) -> Callable[[xd.Model, dict[str, Any], Path], Any]:
    def call(model: xd.Model, asked: dict[str, Any], _: Path) -> Any:
        return stage(xd.simulate(model, until=UNTIL, **asked))

    return call


def _kept(model: xd.Model, asked: dict[str, Any], folder: Path) -> Any:
    path = folder / "run.nc"
    xd.simulate(model, until="0.3 s", path=path, **asked).close()
    again = xd.reproduce(path)
    assert again.attrs["identical"] == 1, again.attrs["first_difference"]
    with xd.open_run(path) as run:
        xd.plot(run, folder / "run.png")
    return xd.extend(path, until="0.4 s")


STAGES: dict[str, Callable[[xd.Model, dict[str, Any], Path], Any]] = {
    "refine": _refined,
    "diagnose": _of_run(xd.diagnose),
    "companion": _of_run(xd.companion),
    "sample": _of_run(lambda run: xd.sample(run, [0.11, 0.37])),
    "compare": _of_run(lambda run: xd.compare(run, run, times=[0.11, 0.37])),
    "error_budget": lambda model, asked, _: xd.error_budget(model, "x", at="0.5 s", until=UNTIL, draws=0, **asked),
    "sweep": lambda model, asked, _: xd.sweep(model, {"m": "0.9, 1.1 kg"}, until=UNTIL, **asked),
    "modes": lambda model, _, __: xd.modes(model),
    "enclose": lambda model, _, __: xd.enclose(model, until="0.1 s"),
    "kept": _kept,
}
