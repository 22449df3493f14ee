"""Models with contacts and friction, whose motions are known."""

from __future__ import annotations

from typing import Any

import numpy as np

import xdynamics as xd

G, E = 9.81, 0.9
FIRST, FORTY_FOURTH, LIMIT = 0.45152364098573090, 8.491374025647689, 8.57894917872888718
# methods of order one have other flights; implicit ones have no derivatives of contact forces
FITTING = [name for name, one in xd.METHODS.items() if one.order > 1 and not one.solves and one.stepper.locates]


def asked(method: str, step: float = 0.013, rtol: float = 1e-9) -> dict[str, Any]:
    """Settings that suit a method."""
    return {"method": method} | ({"step": step} if xd.METHODS[method].order < 5 else {"rtol": rtol})


def ball(e: Any = E, height: float = 1.0, g: float = G, **contact: Any) -> xd.Model:
    """A ball that falls on a floor."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "2 kg", "g": f"{g} m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": f"{height} m", "v_y": "0 m s-1"},
        contacts={"floor": {"gap": "y", "restitution": e} | contact},
    )


def cradle(law: str, e: float) -> xd.Model:
    """Three balls on a line, of which the first hits two that touch."""
    names = ("x1", "x2", "x3")
    return xd.Model(
        name="cradle",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "d": "0.1 m"},
        mass=dict.fromkeys(names, "m"),
        forces={},
        initial={"x1": "-1 m", "v_x1": "1 m s-1", "x2": "0 m", "v_x2": "0 m s-1", "x3": "0.1 m", "v_x3": "0 m s-1"},
        contacts={
            "first": {"gap": "x2 - x1 - d", "restitution": e, "law": law},
            "second": {"gap": "x3 - x2 - d", "restitution": e, "law": law},
        },
    )


def sliding(**more: Any) -> xd.Model:
    """A block on a plane that may be inclined."""
    statement: dict[str, Any] = {
        "name": "block",
        "coordinates": {"x": "m", "y": "m"},
        "parameters": {"m": "2 kg", "g": f"{G} m s-2", "mu": "0.3", "alpha": "0 rad", "pull": "0 N"},
        "mass": {"x": "m", "y": "m"},
        "forces": {"gravity": {"x": "m*g*sin(alpha)", "y": "-m*g*cos(alpha)"}, "pull": {"x": "pull"}},
        "initial": {"x": "0 m", "v_x": "3 m s-1", "y": "0 m", "v_y": "0 m s-1"},
        "contacts": {"floor": {"gap": "y", "restitution": 0, "tangential": "coulomb", "slip": "v_x", "friction": "mu"}},
    }
    return xd.Model(**statement | more)


def dry(x: float = 12.0, v: float = 6.0) -> xd.Model:
    """X'' + x = -sign(v), with true stick."""
    return xd.Model(
        name="dry",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1", "f": "1 N"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": f"{x} m", "v_x": f"{v} m s-1"},
        frictions={"plane": {"slip": "v_x", "kinetic": "f"}},
    )


def words(run: Any) -> list[tuple[str, str]]:
    """The detector and the kind of each event."""
    names, kinds = (run[f"event_{name}"].attrs["flag_meanings"].split() for name in ("detector", "kind"))
    found = zip(run.event_detector.values.tolist(), run.event_kind.values.tolist(), strict=True)
    return [(names[i], kinds[k]) for i, k in found]


def state_of(run: Any, name: str, row: int = -1) -> str:
    """What a contact, or friction, does in a row."""
    variable = run[name]
    meanings = dict(zip(variable.attrs["flag_values"].tolist(), variable.attrs["flag_meanings"].split(), strict=True))
    return str(meanings[int(variable[row])])


def wave(u: Any) -> Any:
    """Where a ball is between walls at 0 and 1 that goes on by u."""
    return np.abs((u + 1) % 2 - 1)
