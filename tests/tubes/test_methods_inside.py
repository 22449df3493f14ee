"""Every method beside bounds that are proven: a motion without a closed form, to the order that the method promises."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.methods import METHODS

ROUNDING = 1e-13  # of runs of some hundred steps
SLACK = 0.5  # of an order, as in the validation ledger


def swing() -> xd.Model:
    """Return a pendulum that swings far, whose forces are of its angle alone."""
    return xd.Model(
        name="swing",
        coordinates={"q": {"unit": "rad"}},
        parameters={"J": "1 kg m2", "M": "1 N m"},
        mass={"q": "J"},
        forces={"weight": {"q": "-M*sin(q)"}},
        initial={"q": "2 rad", "v_q": "0 rad s-1"},
    )


@pytest.mark.dear
@pytest.mark.parametrize("name", METHODS)
def test_runs_come_to_the_tube(name: str) -> None:
    """Assert that halving the step brings a run nearer to the tube by its order, less a half, until rounding is left."""
    model, method = swing(), METHODS[name]
    tube = xd.enclose(model, at=["1 s", "2 s"])
    assert float((tube.upper_q - tube.lower_q).max()) < 1e-13
    step = 2.0 ** -(6 if method.order < 3 else 4)
    errors = []
    for h in (2.0 * step, step):
        run = xd.simulate(model, method=name, step=h, until="2 s")
        rows = [int(np.flatnonzero(run.time.values == time)[0]) for time in (1.0, 2.0)]
        beyond = np.stack([tube.lower_q.values - run.q.values[rows], run.q.values[rows] - tube.upper_q.values])
        errors.append(float(np.maximum(beyond, 0.0).max()))
    assert errors[1] <= errors[0] * 2.0 ** -(method.order - SLACK) + ROUNDING
