"""The sizes of the terms of accelerations and rates: sums of absolute values, through the mass, reactions among them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.kernels.layout import layout_of
from xdynamics.kernels.program import AT
from xdynamics.kernels.python_text import python_of, python_of_set
from xdynamics.kernels.term_sizes import TERM_SIZES, term_sizes_program
from xdynamics.model.motion import constant_names, constant_values


def sizes_at(model: xd.Model, state: list[float], t: float = 0.0, **known: float) -> dict[str, float]:
    """Return the size of the terms of every acceleration and rate, by the program as Python."""
    layout = layout_of(model)
    scope: dict[str, Any] = {**python_of_set("xdynamics 2"), "_empty": np.empty, "_zero": np.float64(0.0)}
    exec(python_of(term_sizes_program(layout)), scope)
    p, at, z = constant_values(model).copy(), np.zeros(len(AT)), np.zeros(layout.record.size)
    for name, value in known.items():
        p[list(constant_names(model)).index(name)] = value
    at[0] = t
    y = np.append(state, np.zeros(layout.record.size - len(state)))
    scope[TERM_SIZES](at, y, p, None, None, z, None, None, None)
    return {name: z[layout.record.offset_of(name)] for name in (*layout.accelerations, *layout.rates)}


def mass(**parts: Any) -> xd.Model:
    """Return a mass of 2 kg with further sections."""
    return xd.Model(
        **{
            "name": "mass",
            "coordinates": {"x": {"unit": "m"}},
            "parameters": {"m": "2 kg", "k": "3 N m-1", "F": "10 N"},
            "mass": {"x": "m"},
            "initial": {"x": "0 m", "v_x": "0 m s-1"},
            **parts,
        }
    )


@pytest.mark.parametrize(
    ("force", "size"),
    [
        ("F - F", 10.0),
        ("F - k*x", 8.0),  # (10 + 3*2)/2
        ("-(F - k*x)", 8.0),
        ("k*(x - 4*metre)", 9.0),  # 3 (2 + 4)/2, though the force is -6
        ("(F - F)*(x/metre)", 20.0),
        ("(F - k*x)/2", 4.0),
        ("where(x > 1*metre, F - F, k*x)", 10.0),
        ("max(F - F, k*x)", 3.0),
        ("k*metre*(x/metre)**3", 12.0),
        ("F*sin(x/metre - x/metre)", 0.0),
    ],
)
def test_sums_have_the_sizes_of_their_terms(force: str, size: float) -> None:
    """Assert the size over the mass at x = 2 m of one force, by hand."""
    found = sizes_at(mass(forces={"pull": {"x": force}}), [2.0, 0.0])
    assert found["a_x"] == pytest.approx(size, rel=1e-15)


def test_forces_that_cancel_add_up() -> None:
    """Assert that force terms are terms of the acceleration, whatever their signs."""
    model = mass(forces={"one": {"x": "F"}, "other": {"x": "-F"}, "third": {"x": "-k*x"}})
    assert sizes_at(model, [2.0, 0.0])["a_x"] == 13.0


def test_a_contact_bears_what_it_is_pressed_with() -> None:
    """Assert that the force of a closed contact is a term, too."""
    model = mass(forces={"weight": {"x": "-F"}}, contacts={"floor": {"gap": "x", "restitution": 0}})
    assert sizes_at(model, [0.0, 0.0])["a_x"] == 5.0
    assert sizes_at(model, [0.0, 0.0], _holds_contact_force_floor=1.0)["a_x"] == 10.0


def test_a_full_mass_is_solved_with_sizes() -> None:
    """Assert that terms go through the inverse of a full mass by absolute values."""
    model = xd.Model(
        name="two",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "m"}},
        parameters={"m": "2 kg", "c": "1 kg", "F": "10 N"},
        mass={"matrix": [["m", "c"], ["c", "m"]]},
        forces={"pull": {"x": "F - F", "y": "F - F"}},
        initial={"x": "0 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
    )
    found = sizes_at(model, [0.0] * 4)
    # by L D L^T with absolute values: z = (20, 30), a_y = 30/1.5, a_x = 20/2 + a_y/2
    assert (found["a_x"], found["a_y"]) == pytest.approx((20.0, 20.0))


def test_rates_of_states_have_sizes() -> None:
    """Assert the size of the terms of a first-order state's rate."""
    state = {"level": {"unit": "m", "rate": "0.5*r*t + 0.25*r*t - 0.75*r*t"}}
    model = xd.Model(name="tank", states=state, parameters={"r": "2 m s-2"}, initial={"level": "0 m"})
    assert sizes_at(model, [0.0], t=3.0)["rate_level"] == 9.0


def test_a_bound_that_is_not_reached_has_no_size() -> None:
    """Assert that the size of the greater of two numbers is its own, however large the other is."""
    state = {"level": {"unit": "1", "rate": "(max(a - b, -1e300) + min(a - b, 1e300))/second", "smooth": True}}
    numbers = {"a": "2", "b": "1.5"}
    model = xd.Model(name="bounded", states=state, parameters=numbers, initial={"level": "0"})
    assert sizes_at(model, [0.0])["rate_level"] == 7.0


def test_elements_in_loops_have_sizes() -> None:
    """Assert sums over a dimension and gathered elements, in loops: a chain between equal pulls."""
    count = 40
    model = xd.Model(
        name="chain",
        dimensions={"body": count},
        coordinates={"u": {"unit": "m", "dims": ["body"]}},
        parameters={"m": "2 kg", "k": "3 N m-1"},
        mass={"u": "m"},
        forces={
            "bonds": {"u": "k*(shift(u, body, 1, 0*metre) - u) + k*(shift(u, body, -1, 0*metre) - u)"},
            "all": {"u": "k*(sum(u, body) - sum(u, body))"},
        },
        initial={"u": "0*metre", "v_u": "0*metre/second"},
    )
    u = np.arange(1.0, count + 1.0) * np.where(np.arange(count) % 2, 1.0, -1.0)
    found = sizes_at(model, [*u, *np.zeros(count)])
    sizes, padded = np.array([*found.values()]), np.abs(np.pad(u, 1))
    expected = 3.0 * (padded[:-2] + padded[2:] + 2.0 * padded[1:-1] + 2.0 * padded.sum()) / 2.0
    np.testing.assert_allclose(sizes, expected, rtol=1e-14)
