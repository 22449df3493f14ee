"""Times in the unit that a model says: shown in it everywhere, recorded in seconds, and the same bits."""

from __future__ import annotations

from pathlib import Path

import pytest

import xdynamics as xd
from xdynamics.documenting.summary import summary
from xdynamics.figures.run import foot_of

COOLING = """
name = "Cooling"
states.T = { unit = "K", rate = "-(T - 280*kelvin)/hour" }
initial.T = "300 K"
events.warm = { function = "T - 290*kelvin", direction = "falling" }
run = { method = "dop853", rtol = 1e-10, until = "2 h" }
"""


def cooling(unit: str) -> xd.Model:
    return xd.Model.from_text(f'{COOLING}\n[time]\nunit = "{unit}"\n')


def test_hours_are_drawn_and_printed_and_seconds_recorded(tmp_path: Path) -> None:
    """Assert the axis, the footer, the lines of the summary, the bits, and what the file keeps."""
    run, plain = xd.simulate(cooling("h")), xd.simulate(xd.Model.from_text(COOLING))
    assert run.time.attrs["units"] == "s"
    assert (run.T.values == plain.T.values).all()
    assert (run.time.values == plain.time.values).all()
    axes = xd.plot(run, only=["state"]).axes[0]
    assert axes.get_xlabel() == "time (h)"
    assert foot_of(run) == "reached t = 7200 s (2 h)"
    lines = "\n".join(summary(run))
    assert "t = 7200 s (2 h)" in lines
    assert "(0.693147 h)" in lines  # log(2)
    xd.save(run, tmp_path / "cooling.nc")
    assert xd.open_run(tmp_path / "cooling.nc").time.attrs["shown_in"] == "h"
    assert xd.reproduce(tmp_path / "cooling.nc").attrs["identical"] == 1


@pytest.mark.parametrize(("unit", "shown"), [("min", "120 min"), ("hours", "2 h"), ("ms", "7.2e+06 ms")])
def test_any_unit_of_time_is_taken(unit: str, shown: str) -> None:
    """Assert the end in that unit, that the text of the model keeps it, and that changed models do."""
    model = cooling(unit)
    assert xd.Model.from_text(model.to_toml()).digest == model.digest
    assert model.digest != xd.Model.from_text(COOLING).digest
    run = xd.simulate(model.replace(initial={"T": "310 K"}))
    assert foot_of(run).endswith(f"({shown})")


@pytest.mark.parametrize("unit", ["m", "parsec", "", "K"])
def test_what_is_no_time_is_refused(unit: str) -> None:
    """Assert one line with what may stand there."""
    with pytest.raises(
        xd.ModelError, match="time is in 's', shown in another unit of time, like 'h', or a pure number"
    ):
        cooling(unit)
