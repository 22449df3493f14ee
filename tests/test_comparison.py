"""Two runs side by side."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from problems import oscillator
from xdynamics.evidence.comparison import lines_of


def made(step: float, **changes: float) -> xr.Dataset:
    """An oscillator run."""
    model = oscillator().model.replace(parameters=changes) if changes else oscillator().model
    return xd.simulate(model, step=step, until=1.0, force_samples="none")


def test_same_runs_are_the_same() -> None:
    """Assert that two marches of one input agree to the bit."""
    table = xd.compare(made(0.01), made(0.01))
    assert table.attrs["identical"] == 1
    assert (table.same == 1).all()
    assert lines_of(table) == [f"the same: {table.sizes['variable']} variables and every setting, bit for bit"]


def test_refined_runs_meet_at_common_times() -> None:
    """Assert that all coarse times are common, and the difference is the refinement's, in its units."""
    table = xd.compare(made(0.01), made(0.005))
    assert table.sizes["common"] == 101
    assert table.difference_x.attrs["units"] == "m"
    assert np.abs(table.difference_x).max() == pytest.approx(0.75 * (0.02**2 / 24) * np.sin(2.0) * 2, rel=0.05)
    assert table.attrs["settings"] == "solver_step: 0.01 | 0.005"
    assert table.attrs["first_difference"].startswith("variable 'time', row 1")


def test_a_parameter_apart_is_named() -> None:
    """Assert that another spring constant shows in the model's digest and in the first row where states part."""
    table = xd.compare(made(0.01), made(0.01, k=4.1))
    assert "model_digest" in table.attrs["settings"]
    assert table.attrs["first_difference"].startswith("variable 'a_x', row 0")
    assert any(line.startswith("largest   difference_x") for line in lines_of(table))


def test_what_is_no_run_is_refused() -> None:
    """Assert that compare asks for records."""
    with pytest.raises(xd.InputError, match="compare needs two run records"):
        xd.compare(made(0.01), xr.Dataset())


def test_a_rerun_says_how_far_it_is() -> None:
    """Assert that the largest difference is told of variables that were zero, and of a number against none."""
    from xdynamics.evidence.comparison import reproduced

    kept = made(0.01)
    still = kept.assign(x=kept.x * 0.0)
    for value, words in (
        (5.0, "the largest difference is 5 m in 'x', row 3: inf of its largest value"),
        (float("nan"), "the largest difference is inf m in 'x', row 3"),
    ):
        again = still.copy(deep=True)
        again["x"].values[3] = value
        table = reproduced(still, again)
        assert table.attrs["identical"] == 0
        assert table.attrs["arithmetic"].startswith(words)
    assert reproduced(kept, kept.copy(deep=True)).attrs["arithmetic"] == ""


ODD = {
    "times of whole seconds": lambda run: run.assign_coords(time=run.time.astype("M8[s]", keep_attrs=True)),
    "one time": lambda run: run.drop_vars("time").assign_coords(time=1.0),
    "fewer times": lambda run: run.drop_vars("time").assign_coords(time=("q", np.arange(5.0), run.time.attrs)),
    "kinds along another dimension": lambda run: run.drop_vars("row_kind").assign(row_kind=("q", np.zeros(500, "i1"), run.row_kind.attrs)),
    "a text for a state": lambda run: run.assign(x=("step", np.array(["a"] * run.sizes["step"], object), run.x.attrs)),
    "a plane of states": lambda run: run.assign(x=(("step", "bound"), np.zeros((run.sizes["step"], 2)), run.x.attrs)),
    "no units": lambda run: run.assign(x=("step", run.x.values, {"role": "coordinate", "long_name": "x"})),
}  # fmt: skip


@pytest.mark.parametrize("what", ODD)
def test_an_edited_record_is_one_error(what: str) -> None:
    """Assert that a record which was edited to be none is refused on either side."""
    run = xd.simulate(oscillator().model, step=0.1, until=1.0)
    odd = ODD[what](run)
    for pair in ((run, odd), (odd, run), (odd, odd)):
        with pytest.raises(xd.InputError, match="no run record"):
            xd.compare(*pair)
