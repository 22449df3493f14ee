"""Derivatives about a state of whole quantities, beside those of elements."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.model import linearisation


@pytest.mark.parametrize("bodies", [10, 14])
def test_derivatives_of_whole_quantities_are_those_of_elements(bodies: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert, where links far outnumber bodies, the matrices of elements to rounding, of several directions at a time and of all."""
    model = xd.Model(
        name="bodies with charges that leak",
        dimensions={"body": bodies, "axis": ["x", "y"]},
        coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
        parameters={"k": "2 N m2", "m": {"dims": ["body"], "value": "1*kilogram*(1 + index(body))"}, "d": "0.3 N s/m"},
        mass={"r": "m"},
        relations={"pair": {"of": "body"}},
        states={"c": {"dims": ["body"], "unit": "1", "rate": "-c*norm(r, axis)/(1*metre*second)"}},
        definitions={"apart": "second(r, pair) - first(r, pair)"},
        forces={
            "charge": {"over": "pair", "potential": "k*first(c, pair)*second(c, pair)/norm(apart, axis)"},
            "drag": {"r": "-d*v_r*norm(v_r, axis)/(1*metre/second)"},
        },
        initial={
            "r": "1*metre*(sin(index(body)*(1 + index(axis))) + 2*index(body) + 1)",
            "v_r": "1*metre/second",
            "c": "1 + 0.1*index(body)",
        },
    )
    assert linearisation.is_densely_linked(model)
    state = linearisation.initial_state(model)
    whole = linearisation.linearise(model, state)
    monkeypatch.setattr("xdynamics.model.linearisation.MAX_TOGETHER", 7 * bodies * (bodies - 1) // 2)
    parted = linearisation.linearise(model, state)
    monkeypatch.setattr(linearisation, "is_densely_linked", lambda _: False)
    elements = linearisation.linearise(model, state)
    assert np.abs(elements.jacobian[2 * bodies :, 4 * bodies :]).max() > 0.1  # forces depend on charges
    for name in ("mass", "stiffness", "acceleration", "jacobian"):
        expected = getattr(elements, name)
        for found in (whole, parted):
            assert getattr(found, name) == pytest.approx(expected, rel=1e-13, abs=1e-14 * np.abs(expected).max())
