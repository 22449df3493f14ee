"""Resets of single elements, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd

START = [1.0, 1.0, 2.0, 0.5]


def oscillators(function: str, **target: str) -> xd.Model:
    """Four oscillators of one radian per second, with an event that sets what is given, dots for brackets."""
    return xd.Model(
        name="oscillators",
        dimensions={"site": 4},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N m-1", "m": "1 kg"},
        mass={"u": "m"},
        forces={"spring": {"potential": "k*u**2/2"}},
        initial={"u": {"unit": "m", "value": START}, "v_u": "0*metre/second*index(site)"},
        events={"kick": {"function": function, "direction": "falling", "action": "reset", "set": target}},
    )


def test_one_element_is_set_and_the_others_go_on() -> None:
    """Assert that the third comes back with half its speed, twice, and the others are cos(t); archives say so."""
    model = oscillators("u[2]", **{"v_u[2]": "-0.5*v_u[2]"})
    run = xd.simulate(model, method="dop853", rtol=1e-12, until="5 s")
    assert run.event_time.values == pytest.approx([math.pi / 2, 1.5 * math.pi], abs=1e-10)
    others = [0, 1, 3]
    assert run.u.values[-1, others] == pytest.approx(np.cos(5.0) * np.array(START)[others], abs=1e-10)
    assert run.v_u.values[run.event_row_after.values, 2] == pytest.approx([1.0, 0.5], abs=1e-10)
    again = xd.Model.from_text(run.model_toml.values.item())
    assert again.digest == model.digest
    assert '"v_u[2]" = "-0.5*v_u[2]"' in again.to_toml()


def test_each_element_may_set_another_one() -> None:
    """Assert that four that pass at one time add 0.1, 0.2, 0.3 and 0.4 m/s to the last one's -0.5 m/s."""
    model = oscillators("u", **{"v_u[3]": "v_u[3] + 0.1*(index(site) + 1)*metre/second"})
    run = xd.simulate(model, method="dop853", rtol=1e-12, until="2 s")
    assert run.event_site.values.tolist() == [0, 1, 2, 3]
    late = 2.0 - math.pi / 2
    assert run.v_u.values[-1] == pytest.approx(-math.cos(late) * np.array([1.0, 1.0, 2.0, -0.5]), abs=1e-9)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({"v_u[7]": "0*metre/second"}, "dimension 'site' has no element 7; it has the elements 0 to 3"),
        (
            {"v_u[0, 1]": "0*metre/second"},
            r"'v_u\[0, 1\]': 'v_u' needs an entry for each of its dimensions, site, and 2 were given",
        ),
        ({"v_u[2]": "0*metre"}, r"sets 'v_u\[2\]' has units 'm', needs 'm s-1'"),
        ({"v_u[2]": "v_u"}, "'v_u' has the dimension 'site', and it needs none"),
        ({"v_u[2]": "-v_u[2]", "v_u": "-v_u"}, r"sets 'v_u', and 'v_u\[2\]' too; give each element one value"),
        ({"v_u": "-v_u", "v_u[2]": "-v_u[2]"}, r"sets 'v_u\[2\]', and 'v_u' too; give each element one value"),
        ({"w[2]": "0*metre"}, r"sets 'w\[2\]', which is no coordinate, velocity or state"),
    ],
)
def test_a_wrong_target_is_refused(target: dict[str, Any], message: str) -> None:
    """Assert one line that names it."""
    with pytest.raises(xd.ModelError, match=message):
        oscillators("u[2]", **target)
