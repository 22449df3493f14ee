"""Names of methods as other programs and textbooks have them lead to the methods here."""

import pytest

import xdynamics as xd
from cases.problems import particle
from xdynamics.methods import METHODS, unknown_method

MEANT = {
    "RK4": ["rk4"],
    "verlet": ["velocity_verlet", "position_verlet", "implicit_velocity_verlet"],
    "leapfrog": ["velocity_verlet", "position_verlet"],
    "Euler": ["forward_euler", "euler_cromer"],
    "symplectic Euler": ["euler_cromer"],
    "rk45": ["dormand_prince"],
    "ode45": ["dormand_prince"],
    "RK23": ["bogacki_shampine"],
    "DOP853": ["dop853"],
    "LSODA": ["radau_iia"],
    "Radau": ["radau_iia"],
    "rk2": ["midpoint", "heun"],
    "runge-kutta": ["rk4"],
    "stoermer_verlet": ["velocity_verlet", "position_verlet"],
    "dorpri853": ["dop853"],
}


@pytest.mark.parametrize("name", MEANT)
def test_the_method_that_was_meant_is_named(name: str) -> None:
    """Assert that the question names these methods, and no other."""
    expected = " or ".join(map(repr, MEANT[name]))
    assert unknown_method(name, METHODS) == f"method {name!r} is not known; did you mean {expected}? "


def test_a_name_like_none_is_not_guessed_at() -> None:
    """Assert that of a name that is like none the list alone is given."""
    assert unknown_method("zzz", METHODS) == "method 'zzz' is not known; "


def test_methods_that_refuse_the_model_are_not_named() -> None:
    """Assert that where velocity forces act Verlet's explicit methods are not what was meant."""
    model = particle("-1*newton*second/metre*v_x")
    with pytest.raises(xd.InputError, match="did you mean 'implicit_velocity_verlet'. these fit"):
        xd.simulate(model, method="verlet", step="1 ms", until="1 s")
