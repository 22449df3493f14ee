"""Adaptive marches along a switch, of which there are too many to be located, end soon and say so."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.faults import AccuracyWarning
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.unlocated_switches import STEPS

RELAYS = """
name = "relays"
[dimensions]
relay = 41
[states.y]
unit = "1"
dims = ["relay"]
rate = "{rate}"
[initial]
y = "0.1 + index(relay)"
"""


def relays(rate: str) -> xd.Model:
    """Forty-one states, one more switch than is located."""
    return xd.Model.from_text(RELAYS.format(rate=rate))


def test_sliding_ends_soon() -> None:
    """Assert that a state driven to its switch from both sides ends the run there within a few hundred rows."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(relays("where(y > 0, -1, 1)/second"), method="dormand_prince", rtol=1e-6, until="2 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "the last 64 steps went to and fro across it" in run.attrs["run_outcome_text"]
    assert "- 0 = 0" not in run.attrs["run_outcome_text"]
    assert run.sizes["step"] < 2000
    assert 0.1 <= run.time.values[-1] < 0.12
    assert abs(run.y.values[-1, 0]) < 1e-4


def test_motion_through_switches_goes_on() -> None:
    """Assert that states which oscillate across their switches reach the end."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(
            relays("where(y > 0, 2, 1)*cos(40*t/second)/second"), method="dormand_prince", rtol=1e-6, until="2 s"
        )
    assert run.attrs["run_outcome"] == "completed"


DRIVEN_BACK = "where(y > 0, -k, 1)/second"  # from above k times as fast as from below


def driven_back(k: float) -> xd.Model:
    """Forty-one states that are driven to their switches from both sides."""
    return xd.Model.from_text(RELAYS.format(rate=DRIVEN_BACK) + f'[parameters]\nk = "{k}"\n')


@pytest.mark.parametrize("k", [0.01, 5.0, 1000.0])
def test_sliding_is_seen_from_one_side(k: float) -> None:
    """Assert that motion ends also where steps land on one side alone, as it is driven back with other speed there."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(driven_back(k), method="dormand_prince", rtol=1e-6, until="20 s", max_steps=5000)
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert run.sizes["step"] == 128
    assert abs(run.y.values[-1, 0]) < 1e-4


ALTERNATING = 1e-6 * (-0.9) ** np.arange(2 * STEPS)
SAWTOOTH = 1e-6 * (np.arange(2 * STEPS) % 5 - 5.0)  # as where an event sets it back


@pytest.mark.parametrize(
    ("rate", "values", "slides"),
    [
        ("-1000*y/second", ALTERNATING, False),
        ("-1000*y/second - sign(y)/second", ALTERNATING, True),
        ("1/second", SAWTOOTH, False),
        ("where(y > 0, -1, -1000*y)/second", SAWTOOTH, False),
        ("where(y > 0, -1, 1)/second", SAWTOOTH, True),
    ],
)
def test_speeds_tell_sliding(rate: str, values: np.ndarray, slides: bool) -> None:
    """Assert that states which return to a switch slide only where they meet it with a speed and are driven back."""
    model = xd.Model.from_text(RELAYS.format(rate=f"{rate} + 0*sign(y)/second"))
    march = March(model, settings_for(model, method="dormand_prince", rtol=1e-6, until="1 s"))
    rows = np.empty((2 + 41, 2 * STEPS))
    rows[0], rows[1], rows[2:] = np.arange(2 * STEPS) * 1e-3, 1e-3, values
    assert (march.passages.sliding(march.run, rows, 0) is not None) == slides


@pytest.mark.filterwarnings("ignore:41 switches")
def test_sliding_members_end() -> None:
    """Assert that members of a sweep end as each does alone, to the bit, and the one that does not slide completes."""
    axes = {"k": [-1.0, 2.0, 30.0]}
    sweep = xd.sweep(driven_back(1.0), axes=axes, method="dormand_prince", rtol=1e-6, until="0.3 s", check=1.0)
    computed = sweep.compute()
    assert computed.run_outcome.values.tolist() == ["completed", "sliding_mode", "sliding_mode"]
    assert computed.run_accepted_steps.values[1:].tolist() == [127, 127]


def test_a_march_that_goes_on_ends_where_the_whole_does() -> None:
    """Assert that a march put down among its last rows, and taken up again, ends with the same number of rows."""
    model = driven_back(30.0)
    settings = settings_for(model, method="dormand_prince", rtol=1e-6, until="2 s")
    first, rest = March(model, settings), March(model, settings)
    before = next(rows for rows in accumulate(block.rows for block in first.blocks(40)) if rows > 64)
    rest.go_on_from(first.memory())
    assert before + sum(block.rows for block in rest.blocks(40)) == 128
    assert rest.outcome.word == "sliding_mode"
