"""Rows of balls by moreau_jean: Newton's cradle by the simultaneous law, and balls beside others that are far away."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd


@pytest.mark.parametrize("n", [5, 40])
def test_a_cradle_has_the_simultaneous_law_of_newton(n: int) -> None:
    """Assert velocities after one elastic impact on a row at rest: the row leaves together, at 2/n of the speed."""
    model = xd.Model(
        name="cradle",
        dimensions={"ball": n},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        mass={"y": "2*kilogram"},
        contacts={"meets": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 1.0}},
        initial={
            "y": {"value": [-0.5, *np.arange(1.0, n)], "unit": "m"},
            "v_y": {"value": [1.0, *[0.0] * (n - 1)], "unit": "m s-1"},
        },
    )
    run = xd.simulate(model, method="moreau_jean", step="10 ms", until="1 s")
    np.testing.assert_allclose(run.v_y[-1], [2.0 / n - 1.0, *[2.0 / n] * (n - 1)], rtol=1e-12)


def test_balls_far_away_change_nothing() -> None:
    """Assert rows and events of three balls that bounce and are kicked, written out, and among 37 that meet nothing."""
    runs = []
    for n in (3, 40):
        places = [0.7, 1.9, 3.2, *(1e3 + 10.0 * i for i in range(n - 3))]
        model = xd.Model(
            name="row",
            dimensions={"ball": n},
            relations={"pair": {"of": "ball", "neighbours": 1}},
            coordinates={"y": {"unit": "m", "dims": ["ball"]}},
            mass={"y": "2*kilogram"},
            forces={"weight": {"y": "-19.62*newton"}},
            contacts={
                "meets": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 0.6},
                "floor": {"gap": "y - 0.5*metre", "restitution": 0.6},
            },
            events={
                "kick": {
                    "function": "y - 0.6*metre",
                    "direction": "falling",
                    "action": "reset",
                    "set": {"v_y": "1.5*metre/second"},
                }
            },
            initial={
                "y": {"value": places, "unit": "m"},
                "v_y": {"value": [0.0, -0.5, -1.0, *[0.0] * (n - 3)], "unit": "m s-1"},
            },
        )
        runs.append(xd.simulate(model, method="moreau_jean", step="2 ms", until="1 s"))
    few, many = runs
    assert few.sizes["event"] > 5
    np.testing.assert_array_equal(few.time, many.time)
    np.testing.assert_array_equal(few.event_time, many.event_time)
    np.testing.assert_allclose(many.y[:, :3], few.y, rtol=1e-13)
    np.testing.assert_allclose(many.v_y[:, :3], few.v_y, rtol=0.0, atol=1e-12)
