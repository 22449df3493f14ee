"""Tables of states name elements as people write them, and are read again."""

from __future__ import annotations

from pathlib import Path

import xdynamics as xd
from xdynamics.interchange.tables import states_as_csv

SITES = """
name = "Sites on springs of their own"
[dimensions]
site = ["a", "b"]
axis = 2
[coordinates]
r = { unit = "m", dims = ["site", "axis"] }
[parameters]
k = "4 N m-1"
[mass]
r = "1*kilogram"
[forces.spring]
r = "-k*r"
[initial]
r = { value = [[1, 0.5], [0.7, -0.2]], unit = "m" }
[run]
method = "rk4"
step = "10 ms"
until = "1 s"
"""


def test_columns_of_elements_are_named_as_people_write_them(tmp_path: Path) -> None:
    """Assert the header of a table of elements, and that a comparison reads it, to the last bit."""
    run = xd.simulate(xd.Model.from_text(SITES))
    table = tmp_path / "sites.csv"
    table.write_text(states_as_csv(xd.sample(run, ["0.3 s", "0.7 s"])), encoding="utf-8")
    header = table.read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith('time [s],"r[a, 0] [m]","r[a, 1] [m]","r[b, 0] [m]","r[b, 1] [m]","v_r[a, 0] [m s-1]"')
    assert (xd.compare(run, table).difference_r == 0.0).all()
