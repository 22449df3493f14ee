"""A file where a folder should be, on the way to what is read or written."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main

MODELS = Path(__file__).parents[2] / "data/models"
RUN = ["--method", "rk4", "--step", "0.1 s", "--until", "1 s"]


@pytest.mark.parametrize(
    "call",
    [
        ["check", "FILE/x.toml"],
        ["run", "FILE/x/y.toml", *RUN, "-o", "run.nc"],
        ["run", str(MODELS / "harmonic_oscillator.toml"), *RUN, "-o", "FILE/run.nc"],
        ["new", "FILE/x.toml"],
        ["show", "FILE/run.nc"],
        ["verify", "FILE/deep/run.nc"],
        ["compare", "FILE/a.nc", "FILE/b.nc"],
        ["sweep", str(MODELS / "harmonic_oscillator.toml"), *RUN, "--axis", "m=1,2", "-o", "FILE/sweep"],
    ],
    ids=lambda call: call[0],
)
def test_the_file_that_stands_in_the_way_is_named(call: list[str], tmp_path: Path) -> None:
    """Assert one line that names the file, whatever was to be read or written below it."""
    file = tmp_path / "model.toml"
    file.write_text("")
    found = CliRunner().invoke(main, [part.replace("FILE", str(file)) for part in call])
    assert found.exit_code == 2, found.output
    (line,) = found.output.splitlines()
    assert f"'{file}' is a file, no folder" in line


def test_models_and_tables_name_the_file_in_the_way(tmp_path: Path) -> None:
    """Assert that a model file, and a table that a model names, say so to Python as well."""
    file = tmp_path / "model.toml"
    file.write_text('name = "x"\n[coordinates]\nx = "m"\n[drives]\np = { table = "model.toml/p.csv" }\n')
    with pytest.raises(xd.ModelError, match="x.toml' cannot be read: '.*model.toml' is a file, no folder$"):
        xd.Model.from_toml(file / "x.toml")
    with pytest.raises(xd.ModelError, match="p.csv' cannot be read: '.*model.toml' is a file, no folder"):
        xd.Model.from_toml(file)
