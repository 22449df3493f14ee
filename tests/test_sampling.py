"""Dense output: order, ends, events, laziness, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from problems import EPS, MODELS, damped


def run_of(method: str = "dormand_prince", **more: object) -> Any:
    """March the damped oscillator for five seconds."""
    return xd.simulate(damped().model, **{"method": method, "rtol": 1e-8, "atol": 1e-8, "until": 5.0} | more)


def test_accepted_states_come_back_to_the_bit() -> None:
    """Assert that at accepted times the accepted states are returned, with no error of interpolation."""
    run = run_of()
    found = xd.sample(run, run.time)
    for name in ("x", "v_x", "s"):
        assert np.array_equal(found[name], run[name])
        assert (found[f"error_{name}"] == 0).all()
    assert np.array_equal(found.row, np.arange(run.sizes["step"]))


def test_error_estimate_covers_the_error() -> None:
    """Assert that between steps values are as good as accepted ones plus what the second route tells."""
    run = run_of()
    times = np.random.default_rng(1).uniform(0, 5, 500)
    found, exact = xd.sample(run, times), damped().exact(times)
    on_grid = damped().exact(run.time.values)
    for name in ("x", "v_x", "s"):
        off = np.abs(found[name].values - exact[name])
        accepted = np.abs(run[name].values - on_grid[name]).max()
        assert (off <= accepted + 3 * found[f"error_{name}"].values).all(), name
        assert 0 < float(found[f"error_{name}"].max()) < 1e-5


def test_result_carries_rule_order_units_and_route() -> None:
    """Assert that every variable says how it came about."""
    found = xd.sample(run_of(), "1.5 s")
    assert found.sizes == {"instant": 1}
    assert found.x.attrs["units"] == "m"
    assert found.x.attrs["interpolation_order"] == 4
    assert "Shampine" in found.x.attrs["interpolation"]
    assert found.x.attrs["ancillary_variables"] == "error_x"
    assert "re-integration" in found.error_x.attrs["long_name"]
    assert found.error_v_x.attrs["units"] == "m s-1"


def test_an_archive_is_sampled_without_the_run(tmp_path: Any) -> None:
    """Assert that the file alone gives what the run in memory gives, bit for bit."""
    run = run_of("dop853")
    xd.save(run, tmp_path / "run.nc")
    times = np.linspace(0, 5, 101)
    whole, kept = xd.sample(run, times), xd.sample(xd.open_run(tmp_path / "run.nc"), times)
    assert all(np.array_equal(whole[name], kept[name]) for name in whole.variables)


def test_only_the_chunks_that_are_needed_are_read() -> None:
    """Assert that the result is lazy, and that its computing reads one chunk of each state and none in between."""
    import dask.array as da

    run = run_of("rk4", rtol=None, atol=None, step=0.005)
    read: list[tuple[str, int]] = []

    def watched(name: str) -> Any:
        values = run[name].values

        def load(block: np.ndarray, block_info: Any = None) -> np.ndarray:
            if block_info:
                read.append((name, block_info[0]["chunk-location"][0]))
            return block

        return da.from_array(values, chunks=100).map_blocks(load, dtype=float, meta=np.empty(0))

    lazy = run.assign({name: ("step", watched(name), run[name].attrs) for name in ("x", "v_x", "s", "step_size")})
    lazy["time"] = run["time"].chunk({"step": 100})
    found = xd.sample(lazy, [2.2501, 2.2502])
    assert not read
    assert found.x.chunks
    assert np.array_equal(found.x, xd.sample(run, [2.2501, 2.2502]).x)
    assert {chunk for _, chunk in read} == {4}


def test_a_step_never_reaches_over_an_event() -> None:
    """Assert that either side of an event is taken from its own steps, and that `side` picks the state at its time."""
    model = xd.Model.from_text(xd.Model.from_toml(MODELS / "ball_drag.toml").to_toml())
    run = xd.simulate(model, method="dormand_prince", rtol=1e-8, atol=1e-8)
    at, before, after = float(run.event_time[0]), int(run.event_row_before[0]), int(run.event_row_after[0])
    assert xd.sample(run, at, side="before").row.item() == before
    assert xd.sample(run, at, side="after").row.item() == after
    close = xd.sample(run, [at - 1e-4, at + 1e-4])
    assert (close.row.values < before).tolist() == [True, False]
    assert close.row.values[1] == after


def test_behind_a_jump_the_drive_s_new_piece_counts() -> None:
    """Assert that the step behind a node starts from the force on its far side."""
    model = xd.Model(
        name="pulled", coordinates={"x": "m"}, parameters={"m": "1 kg"}, mass={"x": "m"}, forces={"pull": {"x": "pull"}},
        drives={"pull": {"table": "p.csv", "csv": "time [s],pull [N]\n0,0\n1,2\n2,0\n", "interpolation": "previous"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )  # fmt: skip
    run = xd.simulate(model, method="velocity_verlet", step=0.5, until=2.0)
    found = xd.sample(run, [0.75, 1.25, 1.9])
    assert found.x.values == pytest.approx([0.0, 0.0625, 0.81], abs=4 * EPS)


@pytest.mark.parametrize("estimator", ["none", "embedded", "step_doubling", "step_doubling_extrapolated"])
def test_dense_output_ends_in_the_accepted_state(estimator: str) -> None:
    """Assert that just before the end of every step the interpolant is at the state that was accepted."""
    run = run_of("bogacki_shampine", rtol=None, atol=None, step=0.5, estimator=estimator)
    found = xd.sample(run, run.time.values[1:] * (1 - 1e-12))
    assert np.abs(found.x.values - run.x.values[1:]).max() < 1e-10


def test_a_thinned_or_converted_record_is_refused() -> None:
    """Assert that missing rows and other units are named, not interpolated over."""
    run = run_of()
    with pytest.raises(xd.InputError, match="rows are missing between t = .* s and .* s"):
        xd.sample(run.isel(step=slice(None, None, 2)), run.time.values[1])
    with pytest.raises(xd.InputError, match="'x' is in 'mm', needs 'm' as it was recorded"):
        xd.sample(run.assign(x=run.x.assign_attrs(units="mm")), 1.0)
    with pytest.raises(xd.InputError, match="the record has no variable 'x'"):
        xd.sample(run.drop_vars("x"), 1.0)
    with pytest.raises(xd.InputError, match="of size 0, needs rows along 'step'"):
        xd.sample(run.isel(step=slice(0, 0)), 1.0)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([1.0, 5.5], r"times\[1\] = 5.5 s is outside the run, from 0.0 s to 5.0 s"),
        ([-1e-9], r"times\[0\] = -1e-09 s is outside the run"),
        ([float("nan")], r"times\[0\] is nan, needs a time in s"),
        ([], r"times have the shape \(0,\)"),
        ([[1.0]], r"times have the shape \(1, 1\)"),
        (["soon"], r"times are \['soon'\], need numbers in s"),
        ("1 m", "times"),
    ],
)  # fmt: skip
def test_wrong_times_are_named(times: object, message: str) -> None:
    """Assert that what cannot be sampled is refused by its place and value; nothing is extrapolated."""
    with pytest.raises(xd.InputError, match=message):
        xd.sample(run_of(), times)


def test_other_faults_are_named() -> None:
    """Assert that a wrong side and a Dataset that is no run are refused."""
    with pytest.raises(xd.InputError, match="side is 'left'; there are before, after"):
        xd.sample(run_of(), 1.0, side="left")
    with pytest.raises(xd.InputError, match="this is no run record: it has no time, row_kind, step_size, model_toml"):
        xd.sample(xd.sample(run_of(), 1.0).drop_vars("time"), 1.0)


@pytest.mark.parametrize("side", ["after", "before"])
def test_times_at_the_borders_of_chunks(side: str) -> None:
    """Assert that a search over chunks finds the rows that one over the whole finds, at every accepted time and between."""
    run = run_of("rk4", rtol=None, atol=None, step=0.05)
    times = np.concatenate([run.time.values, (run.time.values[1:] + run.time.values[:-1]) / 2])
    lazy = run.chunk({"step": 7})
    whole, parts = xd.sample(run, times, side=side), xd.sample(lazy, times, side=side)
    assert np.array_equal(whole.row, parts.row)
    assert np.array_equal(whole.row[: run.sizes["step"]], np.arange(run.sizes["step"]))
    assert np.array_equal(whole.x, parts.x)
