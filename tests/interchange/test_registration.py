"""`run.dynamics` and units of pint, whoever is imported first."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import xdynamics as xd

ORDERS = (
    "import xdynamics, xarray",
    "import xarray, xdynamics",
    "import xdynamics, pint_xarray, xarray",
    "import pint_xarray, xarray, xdynamics",
    "import xarray, pint_xarray, xdynamics",
)
ASKED = """
run = xarray.open_dataset(PATH)
assert "xdynamics.interchange.accessor" not in sys.modules
print(run.dynamics.events("floor").sizes["event"])
if "pint_xarray" in sys.modules:
    print(run.pint.quantify().v_y.pint.units)
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball that bounces."""
    run = xd.simulate(xd.Model.from_toml("data/models/bouncing_ball.toml"), until="1 s", method="rk4", step="10 ms")
    return Path(xd.save(run, tmp_path_factory.mktemp("order") / "ball.nc"))


@pytest.mark.parametrize("order", ORDERS)
def test_the_order_of_imports_does_not_matter(order: str, path: Path) -> None:
    """Assert that a file opened by xarray alone has the accessor, and units that pint reads."""
    code = f"import sys\n{order}\nPATH = {str(path)!r}\n{ASKED}"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split("\n")
    assert told[0] == "1"
    assert "pint" not in order or told[1] == "meter / second"


def test_an_import_alone_brings_neither_numpy_nor_xarray() -> None:
    """Assert that what is registered later costs nothing before."""
    code = "import sys, xdynamics; print(*{'numpy', 'xarray', 'importlib.abc'} & {*sys.modules})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == ""
