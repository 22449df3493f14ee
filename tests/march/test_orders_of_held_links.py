"""A body slides down from another, among enough that their contacts are not written out: which methods keep their order."""

import numpy as np
import pytest

import xdynamics as xd

SLIDING = """
name = "A disc slides down from another, others lie apart"

[dimensions]
disc = 12
axis = ["x", "y"]

[relations.pair]
of = "disc"

[coordinates]
r = { unit = "m", dims = ["disc", "axis"] }

[parameters]
m = "1 kg"
g = "9.81 m s-2"
radius = "0.5 m"
up = { dims = ["axis"], values = { x = "0", y = "1" } }

[mass]
r = "m"

[forces.weight]
r = "-m*g*up"

[contacts.floor]
gap = "sum(r*up, axis) - radius"
restitution = 0

[contacts.discs]
gap = "norm(second(r, pair) - first(r, pair), axis) - 2*radius"
restitution = 0

[initial]
r = { unit = "m", value = PLACES }
v_r = { unit = "m/s", value = RESTS }
"""
PLACES = [[0, 0.5], [0.6, 1.3]] + [[10 * (k + 1), 0.5] for k in range(10)]
REFUSED = ["euler_cromer", "ruth3", "forest_ruth", "pefrl", "yoshida6", "kahan_li6", "yoshida8", "kahan_li8", "dprkn6"]
END = 0.2  # s; the disc lifts off at 0.277 s


def sliding(restitution: str = "0") -> xd.Model:
    """Return the discs, with a coefficient of restitution."""
    return xd.Model.from_text(filled(SLIDING).replace("restitution = 0", f"restitution = {restitution}"))


def filled(text: str) -> str:
    """Fill in where the discs begin, at rest."""
    return text.replace("PLACES", str(PLACES)).replace("RESTS", str([[0, 0]] * 12))


@pytest.mark.parametrize("method", REFUSED)
def test_methods_that_would_lose_their_order_are_refused(method: str) -> None:
    """Assert that the message names the contact, that a floor alone is none, nor balls that always bounce."""
    assert xd.METHODS[method].refusals(sliding()) == [
        "it is not defined for contacts of many links along curved gaps, whose forces depend on velocities (discs)"
    ]
    assert not xd.METHODS[method].refusals(sliding("1"))
    floor = SLIDING[: SLIDING.index("[contacts.discs]")] + SLIDING[SLIDING.index("[initial]") :]
    assert not xd.METHODS[method].refusals(xd.Model.from_text(filled(floor)))


@pytest.mark.parametrize(
    ("method", "order"), [("averaged_velocity", 1), ("velocity_verlet", 2), ("rk4", 4), ("radau_iia", 5)]
)
def test_methods_that_are_taken_keep_their_order(method: str, order: int) -> None:
    """Assert the order of the state, held all the time, by three steps beside an eighth-order method."""
    model, asked = sliding(), {"until": END, "log": "states", "force_samples": "none"}
    exact = xd.simulate(model, method="dop853", rtol=1e-13, **asked)
    errors = []
    for step in (0.02, 0.01):
        run = xd.simulate(model, method=method, step=step, **asked)
        assert run.sizes["event"] == 0
        errors.append(float(abs(run.r[-1] - exact.r[-1]).max() + END * abs(run.v_r[-1] - exact.v_r[-1]).max()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_bodies_that_bounce_for_ever_but_begin_in_touch_are_doubted() -> None:
    """Assert that the outcome says that the order was lost, of a method that loses it, and of no other."""
    asked = {"step": "10 ms", "until": END}
    with pytest.warns(
        xd.AccuracyWarning, match=r"curved gaps \(discs\), .*'yoshida6' is not of order 6, but of 2 or less"
    ):
        run = xd.simulate(sliding("1"), method="yoshida6", **asked)
    assert "held by contacts along curved gaps" in run.attrs["run_outcome_text"]
    run = xd.simulate(sliding("1"), method="rk4", **asked)
    assert "held by" not in run.attrs["run_outcome_text"]
