"""A run that goes on behind its end is one march that also lands there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS, driven_decay, oscillator, particle
from cases.verdicts import verified
from xdynamics.archive import marched
from xdynamics.cli import main
from xdynamics.evidence.comparing.bits import compare_bits

ROCKET = xd.Model.from_toml(MODELS / "rocket_c6.toml")
PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")
CASES: dict[str, tuple[xd.Model, dict[str, Any], float]] = {
    "a grid": (PENDULUM, {"method": "pefrl", "step": 0.01}, 1.0),
    "off the grid": (PENDULUM, {"method": "rk4", "step": 0.01}, 0.937),
    "far beyond": (PENDULUM, {"method": "rk4", "step": 0.1}, 0.3),
    "chosen steps": (PENDULUM, {"method": "dop853", "rtol": 1e-8}, 1.0),
    "drives, nodes, events": (ROCKET, {"method": "dormand_prince", "rtol": 1e-6}, 1.9),
    "a span that ends on a breakpoint": (ROCKET, {"method": "midpoint", "step": 0.01}, 1.86),
    "step doubling": (PENDULUM, {"method": "velocity_verlet", "rtol": 1e-4}, 1.0),
    "kept factors": (PENDULUM, {"method": "radau_iia", "rtol": 1e-6}, 1.0),
    "Newton": (PENDULUM, {"method": "implicit_midpoint", "step": 0.02}, 1.0),
    "scales": (PENDULUM, {"method": "dop853", "rtol": 1e-8, "scales": {"time": "0.3 s"}}, 1.0),
    "bodies that have not met": (xd.Model.from_toml(MODELS / "granular_box.toml"), {}, 0.02),
    "states alone": (driven_decay().model, {"method": "dormand_prince", "rtol": 1e-8}, 1.0),
    "a start at rest, steps beyond the span": (
        particle("F", "0 m s-1", initial={"x": "0 m", "v_x": "0 m s-1"}),
        {"method": "dop853", "rtol": 1e-6},
        0.5,
    ),
}

LATER = {"far beyond": 30, "bodies that have not met": 0.03}


@pytest.mark.every(3)
@pytest.mark.parametrize("name", CASES)
def test_extended_is_one_march(name: str) -> None:
    """Assert that a run extended has the content of one march with a node at the old end, every attribute too."""
    model, asked, end = CASES[name]
    longer = xd.extend(xd.simulate(model, **asked, until=end), until=LATER.get(name, 2.2))
    located = longer.attrs.get("solver_time_tolerance")  # of a span below a second it is not that of a longer one
    whole = xd.simulate(model, **asked, until=float(longer.attrs["solver_until"]), nodes=[end], time_tolerance=located)
    assert compare_bits(longer, whole).attrs["first_difference"] == ""
    assert xd.content_digest(longer) == xd.content_digest(whole)
    assert float(longer.attrs["solver_nodes"][0]) == end


@pytest.mark.dear
def test_streamed_and_extended_twice(tmp_path: Path) -> None:
    """Assert that archives are extended to archives, again and again, and reproduced from the file alone."""
    first, second, third = (tmp_path / f"{n}.nc" for n in (1, 2, 3))
    xd.simulate(PENDULUM, method="dop853", rtol=1e-9, until=1.0, path=first)
    xd.extend(first, until="1500 ms", path=second)
    run = xd.extend(second, until="2 s", path=third)
    whole = xd.simulate(PENDULUM, method="dop853", rtol=1e-9, until=2.0, nodes=["1 s", 1.5])
    assert verified(third) == xd.content_digest(whole)
    assert run.attrs["solver_nodes"].tolist() == [1.0, 1.5]
    assert xd.reproduce(third).attrs["identical"] == 1


@pytest.mark.dear
def test_an_extension_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an extension that was interrupted goes on to the bits of the one march."""
    from xdynamics.archive import segments

    def interrupt(_done: float, t: float, _rows: int) -> None:
        if t > 30.0:
            raise RuntimeError("power cut")

    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 5_000)
    asked = {"method": "rk4", "step": 1e-3}
    start, path = tmp_path / "start.nc", tmp_path / "run.nc"
    xd.simulate(PENDULUM, **asked, until=20.0, path=start)
    with pytest.raises(xd.ArchiveError, match="power cut"):
        xd.extend(start, until=40.0, path=path, progress=interrupt)
    xd.extend(start, until=40.0, path=path, resume=True)
    assert verified(path) == xd.content_digest(xd.simulate(PENDULUM, **asked, until=40.0, nodes=[20.0]))


def blown_up() -> xr.Dataset:
    """A run that ends badly."""
    states = {"y": {"unit": "1", "rate": "k*y**2"}}
    model = xd.Model(name="blow", states=states, initial={"y": "1"}, parameters={"k": "1 s-1"})
    return xd.simulate(model, method="midpoint", step=0.01, until=2.0)


def other(**attributes: Any) -> xr.Dataset:
    """A good run that says something else of itself."""
    return marched(xd.simulate(oscillator().model, step=0.01, until=1.0).assign_attrs(attributes))


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (lambda: xd.simulate(ROCKET), "it is 'stopped_by_event' .*'landing'.*: what stops a run is its end"),
        (blown_up, "it is 'nonfinite_force' .*: a run that failed cannot be continued"),
        (lambda: other(run_outcome="interrupted"), "it is 'interrupted' .*: resume it first"),
        (lambda: xd.simulate(PENDULUM, step=[0.1] * 10, until=1.0), "its steps were given one by one"),
        (
            lambda: xd.simulate(PENDULUM, step=0.1, until=9.0),
            r"until is '2 s', needs a time after the end of the run at t = 9.0 s",
        ),
        (lambda: marched(other().drop_vars("end_memory")), "it keeps no 'end_memory'"),
        (lambda: other(xdynamics_version="9.9.9"), "made by version 9.9.9 of xdynamics"),
        (
            lambda: marched(other().isel(step=slice(50)).copy(deep=True)),
            "the run has 50 rows and its memory is of 101: it was cut",
        ),
        (lambda: other().isel(step=slice(50)), "this is a part of a run, 50 of 101 rows of 'step'; take the whole one"),
        (
            lambda: other().assign_attrs(title="mine"),
            "this is not the record that was computed:\n  1. attribute 'title' is 'mine'",
        ),
        (
            lambda: other(derived="halved", derived_from="ab"),
            "it is derived data, no run: halved; from run ab; extend the run itself",
        ),
        (lambda: xr.Dataset({"a": ("n", [1.0])}), "this is no run record"),
    ],
)
def test_what_cannot_be_extended(run: Any, message: str) -> None:
    """Assert one sentence that says why, and what to do."""
    with pytest.raises(xd.InputError, match=message):
        xd.extend(run(), until="2 s")


def test_from_the_command_line(tmp_path: Path) -> None:
    """Assert that `extend` writes another archive, and refuses to write over the one it reads."""

    def call(*arguments: object) -> Any:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    first, second, whole = (tmp_path / name for name in ("first.nc", "second.nc", "whole.nc"))
    model, asked = MODELS / "pendulum.toml", ("--step", "10 ms")
    assert call("run", model, "-o", first, *asked, "--until", "1 s").exit_code == 0
    assert call("extend", first, "--until", "2 s", "-o", second).exit_code == 0
    assert call("run", model, "-o", whole, *asked, "--until", "2 s", "--node", "1 s").exit_code == 0
    assert call("compare", second, whole).exit_code == 0
    refused = call("extend", first, "--until", "2 s", "-o", first)
    assert refused.exit_code == 2
    assert "is the archive that is extended; name another file" in refused.output


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ("1 s", "nodes are '1 s', need a row of times"),
        ([3.0], r"nodes has 3.0 s, needs times between the start at t = 0.0 s and until = 2.0 s"),
        (["1 m"], "nodes '1 m' has units 'm', needs 's'"),
    ],
)
def test_nodes_that_cannot_be_landed_on(nodes: Any, message: str) -> None:
    """Assert that a node is a time inside the run."""
    with pytest.raises(xd.InputError, match=message):
        xd.simulate(PENDULUM, step=0.01, until=2.0, nodes=nodes)


def test_nodes_are_landed_on_and_recorded() -> None:
    """Assert that asked times are rows of kind `node`, for chosen steps too, and come back from the record."""
    run = xd.simulate(PENDULUM, method="dop853", rtol=1e-6, until=2.0, nodes=["1.5 s", np.float64(0.25)])
    assert run.time[run.row_kind == 2].values.tolist() == [0.25, 1.5]
    assert run.attrs["solver_nodes"].tolist() == [0.25, 1.5]
