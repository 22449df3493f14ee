"""What a message names as the remedy is taken at the next try."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS

BALL = MODELS / "ball_drag.toml"
CRATE = """\
name = "Crate"
coordinates.x = "m"
parameters.m = "40 kg"
mass.x = "m"
initial = {{ x = "0 m", v_x = "1 m s-1" }}
run = {{ method = "dop853", until = "9 s" }}
{wall}
"""
QUICK = {"method": "rk4", "step": "20 ms"}


def crate(wall: str) -> xd.Model:
    """A crate that slides from wall to wall."""
    return xd.Model.from_text(CRATE.format(wall=wall))


def test_a_gap_with_a_kink() -> None:
    """Assert that both remedies that the message names give the motion between two walls."""
    with pytest.raises(xd.ModelError, match=r"gap has a kink or a jump, abs; .* a contact for each") as refused:
        crate('contacts.wall = { gap = "1*metre - abs(x)", restitution = 0.4 }')
    left, right = re.findall(r"as '([^']+)' and '([^']+)' for", str(refused.value))[0]
    two = crate(
        "".join(
            f'contacts.{n} = {{ gap = "{gap}", restitution = 0.4 }}\n'
            for n, gap in zip("ab", (left, right), strict=True)
        )
    )
    assert "action = 'reset' and set" in str(refused.value)
    wall = 'events.w = { function = "1*metre - abs(x)", direction = "falling", action = "reset", set.v_x = "-0.4*v_x" }'
    ends = [float(xd.simulate(model).x[-1]) for model in (two, crate(wall))]
    assert ends == pytest.approx([-0.52, -0.52], abs=1e-12)


@pytest.mark.parametrize(("text", "remedy"), [("12 rad", "needs 's'"), ("2 fortnights", "min, h, day, month and year")])
def test_an_end_without_a_unit_of_time(text: str, remedy: str, tmp_path: Path) -> None:
    """Assert that the units of time are named; and of a pure number, too."""
    refused = call("run", BALL, "-o", tmp_path / "b.nc", "--until", text)
    assert (refused.exit_code, remedy in refused.output) == (2, True)


def test_a_budget_of_an_extreme_at_a_time() -> None:
    """Assert that an extreme with a time or event is refused with the remedy, which is then taken."""
    with pytest.raises(
        xd.InputError, match="'maximum_y', over the whole run, and at is '1 s': leave that out; .* until = '1 s'"
    ):
        xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", at="1 s", **QUICK)
    with pytest.raises(
        xd.InputError, match="and event is 'apex': leave that out; .* action = 'stop' of the event 'apex'"
    ):
        xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", event="apex", **QUICK)
    budget = xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", until="1 s", **QUICK)
    assert budget.attrs["quantity"] == "maximum_y"


def test_a_quantity_that_is_none_names_extremes_too() -> None:
    """Assert that the list of quantities goes on with extremes."""
    with pytest.raises(xd.InputError, match="maximum_… and minimum_… of these and of forces, like 'maximum_y'"):
        xd.error_budget(xd.Model.from_toml(BALL), "height", at="1 s", **QUICK)


def test_a_file_of_numbers_alone(tmp_path: Path) -> None:
    """Assert that a file without titles is refused with titles of as many columns, which are then taken."""
    run, table = tmp_path / "b.nc", tmp_path / "scope.csv"
    call("run", BALL, "-o", run, "--step", "20 ms")
    table.write_text("0.0,0.0\n0.1,1.9\n0.2,3.6\n")
    refused = call("compare", run, table)
    assert refused.exit_code == 2
    header = re.findall(r"--header '([^']+)'", refused.output)[0]
    assert header == "t [s],y [unit]"
    assert call("compare", run, table, "--header", header.replace("unit", "m")).exit_code == 0


def test_a_drive_of_numbers_alone(tmp_path: Path) -> None:
    """Assert the same of a drive's table, whose message has the key of the model file."""
    (tmp_path / "scope.csv").write_text("0.0,0.0\n0.1,1.9\n9.0,3.6\n")
    drive = 'forces.push.x = "push"\ndrives.push = {{ table = "scope.csv"{header} }}'
    path = tmp_path / "crate.toml"
    path.write_text(CRATE.format(wall=drive.format(header="")))
    titles = re.escape(
        """numbers alone, '0.0,0.0'; give one for each of its 2 columns, like header = ["t [s]", "x [m]"]"""
    )
    with pytest.raises(xd.ModelError, match=titles):
        xd.Model.from_toml(path)
    path.write_text(CRATE.format(wall=drive.format(header=', header = ["t [s]", "push [N]"]')))
    assert xd.Model.from_toml(path).drives["push"].table.value_unit.text == "N"
