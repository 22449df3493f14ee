"""What `xdynamics help archives` says of xarray and of archives is what they do."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.manual import manual_text

ARCHIVES_PAGE = manual_text("archives.md")
TIMES = "0:2:5 s"
NESTED = {"engine": "xdynamics", "combine": "nested", "concat_dim": "run", "coords": "different", "compat": "equals"}


def ball(g: float = 9.81) -> xd.Model:
    """A ball that falls past a mark."""
    return xd.Model(
        name="Ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": f"{g} m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        events={"mark": {"function": "y", "direction": "falling"}},
        initial={"y": "10 m", "v_y": "0 m s-1"},
        run={"method": "rk4", "step": "125 ms", "until": "2 s"},
    )


def quoted(beginning: str) -> str:
    """Return the message between backticks on the page that begins so, as a pattern."""
    texts = re.findall(r"`([^`]+)`", re.sub(r"```.*?```", "", ARCHIVES_PAGE, flags=re.DOTALL))
    found = next(text for text in texts if text.startswith(beginning))
    return re.escape(" ".join(found.split()).removeprefix("AlignmentError: "))


def test_rows_by_time() -> None:
    """Assert rows of a span, one row, and both rows of an event, and the KeyError that the page quotes."""
    run = xd.simulate(ball())
    assert run.sel(time=slice(0.5, 1.0)).time.values.tolist() == [0.5, 0.625, 0.75, 0.875, 1.0]
    assert float(run.sel(time=1.0).y.squeeze()) == float(run.dynamics.at("1 s").y)
    assert run.sel(time=float(run.event_time[0])).sizes["step"] == 2
    with pytest.raises(KeyError, match=quoted("not all values")):
        run.sel(time=1.01)
    assert float(run.dynamics.at(1.01).y) == pytest.approx(10.0 - 9.81 / 2.0 * 1.01**2, rel=1e-12)


def test_what_xarray_refuses_by_time() -> None:
    """Assert the refusals that the page names: the nearest row where a time has two, and interpolation."""
    run = xd.simulate(ball())
    with pytest.raises(pd_error(), match=quoted("Reindexing only")):
        run.sel(time=1.01, method="nearest")
    with pytest.raises(ValueError, match="time"):
        run.interp(time=[1.01])


@pytest.mark.parametrize(
    "ask",
    [
        lambda run: run.sel(time=1.01),
        lambda run: run.sel({"time": 1.01}, method="nearest"),
        lambda run: run.interp(time=1.01),
        lambda run: run.y.sel(time=1.01),
        lambda run: run.y.interp(time=1.01),
        lambda run: run.y.drop_sel(time=1.01),
        lambda run: run.rolling({"time": 1.01}),
        lambda run: run.coarsen(time=1.01),
    ],
    ids=["sel", "nearest", "interp", "sel of a variable", "interp of a variable", "drop_sel", "rolling", "coarsen"],
)
def test_errors_by_time_name_what_gives_states(ask: Callable[[xr.Dataset], object]) -> None:
    """Assert that the error keeps its kind and message, and has a note with the call, which gives the state."""
    run = xd.simulate(ball())
    with pytest.raises((KeyError, ValueError, pd_error())) as refused:
        ask(run)
    (note,) = refused.value.__notes__
    call = re.findall(r"run(\.dynamics\.at\(.*?\))", note)[0]
    assert call == ".dynamics.at(1.01)"
    assert run.dynamics.at(1.01).at_time == 1.01


@pytest.mark.parametrize(
    "ask",
    [
        lambda run: run.reindex(time=[1.01]),
        lambda run: run.y.reindex({"time": [1.01]}),
        lambda run: run.reindex_like(xr.Dataset(coords={"time": [1.01]})),
        lambda run: run.y.interp_like(other=xr.DataArray([0.0], coords={"time": [1.01]}, dims="time")),
    ],
    ids=["reindex", "reindex of a variable", "reindex_like", "interp_like"],
)
def test_what_xarray_would_leave_undone_is_refused(ask: Callable[[xr.Dataset], object]) -> None:
    """Assert an error that names the call, where xarray gives the rows as they were; other names are xarray's own."""
    run = xd.simulate(ball())
    with pytest.raises(xd.InputError, match=re.escape("run.dynamics.at([1.01])")):
        ask(run)
    assert run.reindex().sizes == run.sizes
    assert xr.Dataset(coords={"time": [0.0, 1.0]}).reindex(time=[1.0]).sizes == {"time": 1}


def test_resample_names_what_gives_states() -> None:
    """Assert the note where no number was asked for."""
    with pytest.raises(TypeError) as refused:
        xd.simulate(ball()).resample(time="1s")
    assert "run.dynamics.at(times)" in refused.value.__notes__[0]


def test_other_errors_have_no_note() -> None:
    """Assert that neither another dimension nor another Dataset with a time is spoken of."""
    run, other = xd.simulate(ball()), xr.Dataset(coords={"time": [0.0, 1.0]})
    for ask in (lambda: run.sel(step="x"), lambda: other.sel(time=0.5)):
        with pytest.raises((KeyError, ValueError, TypeError)) as refused:
            ask()
        assert not getattr(refused.value, "__notes__", [])


def pd_error() -> type[Exception]:
    """Return what pandas raises of an index with one value twice."""
    from pandas.errors import InvalidIndexError

    return InvalidIndexError


@pytest.mark.dear
def test_runs_of_one_shape_are_put_together_by_xarray(tmp_path: Path) -> None:
    """Assert that without a preprocess runs with as many rows are along a new dimension, each with its bits."""
    runs = [xd.simulate(ball(g), path=tmp_path / f"{g}.nc") for g in (9.7, 9.8, 9.9)]
    with xr.open_mfdataset(str(tmp_path / "*.nc"), **NESTED) as together:
        assert together.y.dims == ("run", "step")
        assert together.y.values.tobytes() == np.stack([run.y.values for run in runs]).tobytes()
        assert together.g.values.tolist() == [9.7, 9.8, 9.9]


def test_sweeps_at_times_are_put_together_by_xarray(tmp_path: Path) -> None:
    """Assert the same of catalogues that keep a quantity at times and no log, with a common axis."""
    found = [
        xd.sweep(ball(), {"g": "9:10:3 m s-2"}, keep=["y"], times=TIMES, method=method, path=tmp_path / method)
        for method in ("rk4", "midpoint")
    ]
    with xr.open_mfdataset([tmp_path / name / "catalogue.nc" for name in ("rk4", "midpoint")], **NESTED) as together:
        assert together.y.dims == ("run", "g", "at")
        assert together.y.values.tobytes() == np.stack([one.y.values for one in found]).tobytes()


@pytest.mark.dear
def test_runs_of_other_shapes_are_sampled(tmp_path: Path) -> None:
    """Assert the AlignmentError that the page quotes, and that its two remedies give the states of each run."""
    steps = ["100 ms", "125 ms"]
    runs = [xd.simulate(ball(), step=step, path=tmp_path / f"{step}.nc") for step in steps]
    with pytest.raises(xr.AlignmentError, match=quoted("AlignmentError")):
        xr.open_mfdataset(str(tmp_path / "*.nc"), **NESTED)
    at = [xd.sample(run, TIMES).y.values for run in runs]
    with xr.open_mfdataset(str(tmp_path / "*.nc"), **NESTED, preprocess=lambda run: xd.sample(run, TIMES)) as together:
        assert together.y.values.tobytes() == np.stack(at).tobytes()
    xd.sweep(ball(), {"step": steps}, keep=["log"], path=tmp_path / "grid")
    assert xd.open_logs(tmp_path / "grid", TIMES).y.values.tobytes() == np.stack(at).tobytes()


def test_states_at_times_are_no_run(tmp_path: Path) -> None:
    """Assert that saving them names what archives the run, and what keeps them alone."""
    states = xd.simulate(ball(), times=TIMES)
    with pytest.raises(xd.InputError, match=r"states at times .* no run: path='run.nc' .*; states.to_netcdf"):
        xd.save(states, tmp_path / "states.nc")
    states.to_netcdf(tmp_path / "states.nc")
    with xr.open_dataset(tmp_path / "states.nc") as kept:
        assert kept.y.values.tobytes() == states.y.values.tobytes()


def test_the_page_names_what_there_is() -> None:
    """Assert that what the page names of the package is there."""
    names = {*re.findall(r"xd\.(\w+)", ARCHIVES_PAGE)}
    assert names == {"open_run", "verify", "save", "sample", "compare", "sweep", "open_logs"} <= {*dir(xd)}
