"""Records among xarray's neighbours: pint-xarray, cf-xarray, and xarray's own engines, the real packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::pint.UnitStrippedWarning")


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball that lands."""
    return xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), method="dop853", rtol=1e-8)


@pytest.mark.dear
def test_a_quantified_record_is_the_same_again(run: xr.Dataset) -> None:
    """Assert that units go into arrays and come out as they were, flags and texts untouched."""
    from xdynamics.record.pint_records import is_quantified, without_pint_units

    found = run.dynamics.quantify()
    assert is_quantified(found)
    assert not is_quantified(run)
    assert str(found.v_y.pint.units) == "meter / second"
    assert found.row_kind.dtype == run.row_kind.dtype
    back = without_pint_units(found)
    xr.testing.assert_identical(back.drop_attrs(deep=False), run.drop_attrs(deep=False))
    assert xd.content_digest(found) == xd.content_digest(run)


def test_pint_xarray_itself_reads_the_units(run: xr.Dataset) -> None:
    """Assert `run.pint.quantify()`, with cf-xarray's registry."""
    import cf_xarray.units  # noqa: F401
    import pint_xarray  # noqa: F401

    found = run[["y", "v_y", "a_y"]].pint.quantify()
    assert str(found.a_y.pint.units) == "meter / second ** 2"
    assert float(found.v_y.pint.to("km/h")[0].data.magnitude) == pytest.approx(72.0)


@pytest.mark.dear
def test_every_verb_takes_and_gives_units(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that stages take quantified records, converted ones too, and give quantified results."""
    found = run.dynamics.quantify()
    sampled = xd.sample(found, [1.0])
    assert str(sampled.y.data.units) == "meter"
    assert float(sampled.y.data.magnitude[0]) == float(xd.sample(run, [1.0]).y[0])
    for verb in (xd.diagnose, xd.companion, xd.modes):
        assert any("pint" in type(variable.data).__module__ for variable in verb(found).variables.values())
    assert float(xd.compare(found, run)["difference_y"].data.magnitude.max()) == 0.0
    xd.plot(found, tmp_path / "a.png")
    assert str(found.dynamics.at([1.0]).y.data.units) == "meter"
    assert str(found.dynamics.events("apex").event_time.data.units) == "second"
    found.dynamics.plot(tmp_path / "b.png")
    assert len(found.dynamics.frame("event")) == 2
    xd.save(found, tmp_path / "a.nc")
    assert verified(tmp_path / "a.nc") == xd.content_digest(run)
    opened = xd.open_run(tmp_path / "a.nc", quantify=True)
    assert str(opened.time.data.units) == "second"
    assert xd.simulate.__doc__
    assert xd.sample.__name__ == "sample"


def test_a_unit_of_another_kind_is_told(run: xr.Dataset) -> None:
    """Assert that a record in another unit is refused as an edited one is."""
    found = run.dynamics.quantify()
    found["y"] = found["y"].pint.to("km")
    with pytest.raises(xd.InputError, match="'y' is in 'km', needs 'm' as it was recorded"):
        xd.sample(found, [1.0])


def test_cf_xarray_finds_time(run: xr.Dataset) -> None:
    """Assert axes, coordinates and standard names."""
    import cf_xarray  # noqa: F401

    assert run.cf["time"].name == "time"
    assert run.cf.axes == {"T": ["time"]}
    assert xd.sample(run, [1.0, 2.0]).cf.axes == {"T": ["at_time"]}


def test_the_engine_verifies(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that xarray opens an archive by name, and that a damaged one is refused as by open_run."""
    path = xd.save(run, tmp_path / "ball.nc")
    found = xr.open_dataset(path, engine="xdynamics")
    assert xd.content_digest(found) == xd.content_digest(run)
    assert "force_drag_y" not in xr.open_dataset(path, engine="xdynamics", drop_variables=["force_drag_y"])
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(xd.ArchiveError, match="damaged"):
        xr.open_dataset(path, engine="xdynamics")
    assert not xr.backends.list_engines()["xdynamics"].guess_can_open(path)


@pytest.mark.dear
def test_the_engine_imports_light() -> None:
    """Assert that xarray's look at its engines loads neither the engine of the march nor pint."""
    script = "import sys, xarray as xr; xr.backends.list_engines(); print(*(one for one in ('numba', 'pint', 'scipy', 'matplotlib') if one in sys.modules and 'xdynamics' in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", script + "; print('xdynamics.interchange.backend' in sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "True" in done.stdout
    assert "numba" not in done.stdout


def test_what_is_public_is_seen(run: xr.Dataset) -> None:
    """Assert dir, and the page of a notebook: the summary first, variables by role."""
    assert dir(xd) == sorted(xd.__all__)
    page = run.dynamics._repr_html_()
    assert page.startswith("<pre>Ball ")
    assert "<summary>coordinate: 1</summary>" in page
    assert np.all([name in page for name in map(str, run.variables)])


def test_units_that_pint_orders_otherwise(tmp_path: Path) -> None:
    """Assert that a torque's `N m` comes back as it was recorded, so that the record is saved as it is."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="1 s")
    xd.save(run.dynamics.quantify(), tmp_path / "a.nc")
    assert verified(tmp_path / "a.nc") == xd.content_digest(run)


@pytest.mark.dear
def test_an_opened_run_has_its_accessor(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that the first verb of a process may be open_run, and that pint's registry is not read for it."""
    path = xd.save(run, tmp_path / "ball.nc")
    script = (
        f"import pint, xdynamics as xd; print(xd.open_run({str(path)!r}).dynamics.events('apex').sizes['event'],"
        " type(pint.application_registry.get()).__name__)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "LazyRegistry"]


@pytest.mark.dear
def test_pint_xarray_needs_no_other_word() -> None:
    """Assert `run.pint.quantify()` of a whole run, without cf-xarray, where pint-xarray was imported beside."""
    script = (
        "import warnings; warnings.simplefilter('ignore'); import pint_xarray, xdynamics as xd;"
        f"run = xd.simulate(xd.Model.from_toml({str(MODELS / 'ball_drag.toml')!r}), method='dop853', rtol=1e-6);"
        "print(run.pint.quantify().a_y.pint.units, xd.sample(run.pint.quantify(), [1.0]).y.pint.units)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "meter / second ** 2 meter"
