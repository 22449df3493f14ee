"""Motions at random from within an uncertain set, marched in floats, beside the tube that is proven of all of them.

Of ten models with 1,000 members each none is outside; tubes are 1.01 (Roessler) to 2.0 (a damped pendulum) times as wide as
their members are spread.
"""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.uncertain_motions import MOTIONS

MEMBERS = 1000  # of each model; the first are at the corners of the set
ROUNDING = 1e-11  # of the size of a quantity: the error of a march with rtol 1e-13


@pytest.mark.dear
@pytest.mark.cases(len(MOTIONS))
def test_members_are_inside(case: int) -> None:
    """Assert that every member ends between the bounds, and that these are hardly wider than the members are spread."""
    model, until, most = [*MOTIONS.values()][case]
    tube = xd.enclose(model, at=[until], order=14, rtol=1e-12)
    assert tube.attrs["outcome"] == "completed"
    spreads = {
        name: part for name, part in (model.statement.parameters | model.starts).items() if part.spread is not None
    }
    random = np.random.default_rng([32, case])
    signs = random.uniform(-1.0, 1.0, (len(spreads), MEMBERS))
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(spreads))).reshape(len(spreads), -1)
    signs[:, : corners.shape[1]] = corners
    drawn = {
        name: part.quantity.si + sign * part.spread.size.si
        for (name, part), sign in zip(spreads.items(), signs, strict=True)
    }
    members = xd.sweep(model, {"member": drawn}, keep=["end"], method="dop853", rtol=1e-13, until=until).load()
    for name in [str(key).removeprefix("end_") for key in members if f"lower_{str(key).removeprefix('end_')}" in tube]:
        values, low, high = (
            members[f"end_{name}"].values,
            float(tube[f"lower_{name}"][0]),
            float(tube[f"upper_{name}"][0]),
        )
        slack = ROUNDING * np.abs(values).max()
        assert ((low - slack <= values) & (values <= high + slack)).all(), name
        assert high - low < most * np.ptp(values), (name, (high - low) / np.ptp(values))
