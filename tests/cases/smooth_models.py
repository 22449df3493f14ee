"""Smooth models whose motions are known, or are marched beside bounds that are proven."""

from __future__ import annotations

from typing import Any

from xdynamics import Model


def of_rate(rate: str, **constants: str) -> Model:
    """Return a model of one number x, whose rate is an expression of t, x and of numbers that do not change."""
    states = {"x": {"unit": "1", "rate": f"({rate})/second"}}
    states |= {name: {"unit": "1", "rate": "0/second"} for name in constants}
    return Model(name="one number", states=states, initial={"x": "0", **constants})


def oscillator(k: Any = "4 N m-1", x: Any = "1 m") -> Model:
    """Return a mass on a spring: x0 cos(t sqrt(k))."""
    return Model(
        name="mass on a spring",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": k},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": x, "v_x": "0 m s-1"},
    )


def lorenz(**starts: Any) -> Model:
    """Return Lorenz's equations with 10, 28 and 8/3."""
    return Model(
        name="Lorenz",
        states={
            "x": {"unit": "1", "rate": "10*(y - x)/second"},
            "y": {"unit": "1", "rate": "(x*(28 - z) - y)/second"},
            "z": {"unit": "1", "rate": "(x*y - 8*z/3)/second"},
        },
        initial={"x": "1", "y": "1", "z": "1"} | starts,
    )
