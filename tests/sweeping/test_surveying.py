"""What a grid of runs tells, against closed forms and against evidence of single runs."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, ROOT
from cases.stages import assert_described, assert_same_bits, no_march, without_dates
from xdynamics.evidence.stages import is_lazy
from xdynamics.record.flag_words import words_of_flag

END = 2.0  # s


def falling(**events: Any) -> xd.Model:
    """A body thrown upward without drag: y = y0 + v0 t - g t^2/2."""
    return xd.Model(
        name="thrown",
        coordinates={"y": {"unit": "m"}},
        parameters={"m": "1 kg", "g": "10 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": "0 m", "v_y": "5 m s-1"},
        events=events,
    )


GRID = {"v_y": "5:25:5 m s-1", "g": ["8 m s-2", "10 m s-2", "12 m s-2"], "method": ["euler_cromer", "velocity_verlet"]}


@pytest.fixture(scope="module")
def thrown() -> xr.Dataset:
    """Lazy grid of thrown bodies, stopped at the ground."""
    ground = {"function": "y", "direction": "falling", "action": "stop"}
    return xd.sweep(falling(ground=ground), GRID, keep=["end", "event_count_ground"], step=0.01, until=END)


@pytest.fixture(scope="module")
def free() -> xr.Dataset:
    """The same without a ground."""
    return xd.sweep(falling(), GRID, step=0.01, until=END)


def test_slopes_are_those_of_the_closed_form(free: xr.Dataset) -> None:
    """Assert d end_y/d v = t and d end_y/d g = -t^2/2, lazily, with their units."""
    found = xd.sensitivities(free)
    assert found.slope_end_y_v_y.chunks is not None
    verlet = found.sel({"solver_method": "velocity_verlet"}).compute()
    np.testing.assert_allclose(verlet.slope_end_y_v_y, END, rtol=1e-11)
    np.testing.assert_allclose(verlet.slope_end_y_g, -(END**2) / 2, rtol=1e-11)
    assert found.slope_end_y_v_y.attrs["units"] == "s"
    assert found.slope_end_y_g.attrs["units"] == "s2"


def test_where_two_methods_part(free: xr.Dataset) -> None:
    """Assert the difference of Euler-Cromer from Verlet, -g h t/2, lazily, and zero for the reference itself."""
    found = xd.contrast(free, "method", reference="velocity_verlet")
    assert found.difference_end_y.chunks is not None
    apart = found.difference_end_y.sel({"solver_method": "euler_cromer"}).compute()
    expected = -found.g * 0.01 * END / 2
    np.testing.assert_allclose(apart, expected.broadcast_like(apart).transpose(*apart.dims), rtol=1e-9)
    assert not found.difference_end_y.sel({"solver_method": "velocity_verlet"}).any()
    assert not found.outcome_differs.any()


def test_what_changes_an_outcome(thrown: xr.Dataset) -> None:
    """Assert the shares of neighbours that end otherwise, counted by hand from 2 v/g < t."""
    grid = thrown.compute()
    stopped = (2 * grid.v_y / grid.g < END).values
    told = (grid.run_outcome == "stopped_by_event").values
    assert (told == stopped[..., None]).mean() > 0.9  # of the rest the end is that of the flight
    found = xd.influences(grid)
    assert found.axis_name.values.tolist() == ["v_y", "g", "solver_method"]
    shares = [np.mean(np.diff(told, axis=k) != 0) for k in range(3)]
    assert found.outcome_changes.values.tolist() == shares
    assert shares[0] > shares[2]
    effects = xd.influences(xd.sweep(falling(), GRID, step=0.01, until=END).compute()).main_effect_end_y.values
    speeds, pulls = END * np.array([5, 10, 15, 20, 25.0]), -(END**2) / 2 * np.array([8, 10, 12.0])
    assert effects[:2] == pytest.approx(np.array([speeds.var(), pulls.var()]) / (speeds.var() + pulls.var()), rel=1e-2)


@pytest.mark.dear
def test_shares_of_variance_of_a_linear_number() -> None:
    """Assert Sobol indices of y0 + v0 t - g t^2/2: variances of its three terms over their sum."""
    ranges = {"y": (0.0, 3.0), "v_y": ("5 m s-1", "7 m s-1"), "g": (9.0, 11.0)}

    def shares() -> xr.Dataset:
        return xd.sobol_indices(
            falling(), ranges, "end_y", draws=1024, seed=3, method="velocity_verlet", step=0.1, until=END
        )

    found = shares()
    widths = np.array([3.0, 2.0 * END, 2.0 * END**2 / 2])
    truth = widths**2 / np.sum(widths**2)
    assert found.parameter_name.values.tolist() == ["y", "v_y", "g"]
    for name in ("first_order", "total_order"):
        assert found[name].values == pytest.approx(truth, abs=0.03)
        low, high = found[f"{name}_interval"].values.T
        assert ((low <= truth) & (truth <= high) & (high - low < 0.3)).all()
    again = shares()
    assert all(again[name].variable.equals(variable) for name, variable in found.variables.items())


def test_members_are_refined_as_alone() -> None:
    """Assert order, verdict, limit and uncertainty of a member against `refine` of its model."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    grid = xd.sweep(
        model,
        {"step": "80, 40, 20, 10 ms", "v_y": [10.0, 20.0]},
        keep=["y"],
        times=[1.0],
        method="midpoint",
        until="1.2 s",
    )
    found = xd.convergence(grid, "step")
    assert found.order_y.chunks is not None
    alone = xd.refine(
        model.replace(initial={"v_y": 10.0}),
        method="midpoint",
        steps=[0.08, 0.04, 0.02, 0.01],
        at=[1.0],
        observables=["y"],
        until="1.2 s",
    )
    mine = found.sel(v_y=10.0).compute()
    assert float(mine.order_y[0]) == pytest.approx(float(alone.order_y[-2, 0]), rel=1e-12)
    assert words_of_flag(mine.verdict_y) == words_of_flag(alone.verdict_y) == ["asymptotic"]
    assert float(mine.limit_y[0]) == pytest.approx(float(alone.limit_y[0]), rel=1e-12)
    assert float(mine.uncertainty_y[0]) == pytest.approx(float(alone.uncertainty_y[0]), rel=1e-2)


def test_evidence_of_grids_is_saved(tmp_path: Any, free: xr.Dataset) -> None:
    """Assert that a survey is written, verified and read like other evidence."""
    found = xd.sensitivities(free.compute())
    xd.save(found, tmp_path / "s.nc")
    xd.verify(tmp_path / "s.nc")
    with xd.open_run(tmp_path / "s.nc") as kept:
        assert kept.slope_end_y_g.values.tolist() == found.slope_end_y_g.values.tolist()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda grid: xd.contrast(grid, "m"), "the sweep has no axis 'm'; there are v_y, g, solver_method"),
        (lambda grid: xd.contrast(grid, "method", reference="heun"), "axis 'solver_method' has no 'heun'"),
        (lambda grid: xd.convergence(grid, "g"), "'g' has 3 values of a parameter, needs 3 or more of step or rtol"),
        (lambda grid: xd.sensitivities(grid.isel(v_y=[0], g=[0])), "no axis of the sweep has two numbers"),
        (lambda _: xd.influences(xr.Dataset()), "Dataset is no sweep"),
        (lambda _: xd.sobol_indices(falling(), {"k": (1, 2)}, "end_y"), "'k' is no parameter or initial value"),
        (
            lambda _: xd.sobol_indices(falling(), {"g": (1.0, 2.0, 3.0)}, "end_y"),
            "'g' needs two numbers, first the lowest",
        ),
        (lambda _: xd.sobol_indices(falling(), {"g": (2.0, 1.0)}, "end_y"), "'g' needs two numbers, first the lowest"),
        (lambda _: xd.sobol_indices(falling(), {"g": ("1 kg", "2 kg")}, "end_y"), "needs the unit 'm s-2'"),
        (
            lambda _: xd.sobol_indices(falling(), {"g": (1.0, 2.0)}, "end", step=0.1, until=1.0, method="heun"),
            "needs a word that stands for one number",
        ),
    ],
)
def test_wrong_questions_are_named(free: xr.Dataset, call: Any, message: str) -> None:
    """Assert one clear error for what cannot be asked of a sweep."""
    with pytest.raises(xd.InputError, match=message):
        call(free)


@pytest.mark.dear
def test_work_against_precision() -> None:
    """Assert errors against the closed form and against the finest of the highest order, beside what each run cost."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    grid = xd.sweep(model, {"method": ["velocity_verlet", "rk4"], "step": "100, 50, 25 ms"}, until=2.0)
    found = xd.precision(grid, exact={"end_x": np.cos(4.0)})
    assert found.off_end_x.chunks is not None
    found, grid = found.compute(), grid.compute()
    np.testing.assert_array_equal(found.off_end_x, np.abs(grid.end_x - np.cos(4.0)))
    np.testing.assert_array_equal(found.off_end_v_x, np.abs(grid.end_v_x - grid.end_v_x[1, 2]))
    assert found.run_force_evaluations.values.tolist() == [[21, 41, 81], [81, 161, 321]]
    halved = found.off_end_x.values[:, :-1] / found.off_end_x.values[:, 1:]
    assert np.log2(halved[0]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(halved[1]) == pytest.approx(4.0, abs=0.4)
    assert xd.plot(found).axes[0].get_xlabel() == "force evaluations"
    with pytest.raises(xd.InputError, match="exact names 'end_y', which is none of"):
        xd.precision(grid, exact={"end_y": 1.0})


LAZY: dict[str, Any] = {
    "contrast": lambda grid, **asked: xd.contrast(grid, "step", **asked),
    "sensitivities": xd.sensitivities,
    "convergence": lambda grid, **asked: xd.convergence(grid, "step", **asked),
    "precision": xd.precision,
    "influences": xd.influences,
}


@pytest.mark.parametrize("name", LAZY)
def test_a_survey_is_lazy_or_computed_as_it_is_asked_for(name: str) -> None:
    """Assert dask arrays where compute is False and numbers where it is True, of lazy sweeps and others, the same bits."""
    axes = {"g": "9:11:3 m s-2", "step": "40, 20, 10 ms"}
    lazy_sweep = xd.sweep(falling(), axes, until=END, method="velocity_verlet", keep=["end"])
    whole = lazy_sweep.compute()
    with no_march():
        stages = [LAZY[name](grid, compute=False) for grid in (lazy_sweep, whole)]
    found = LAZY[name](lazy_sweep, compute=True)
    assert not is_lazy(found)
    for stage in stages:
        assert is_lazy(stage)
        assert {*found.data_vars} == {*stage.data_vars}
        assert_same_bits(stage, found)


def test_lazy_influences_of_a_part_are_not_those_of_the_sweep() -> None:
    """Assert that what is remembered of a sweep in memory is not taken for the result of a part of it."""
    whole = xd.sweep(
        falling(), {"g": "9:11:3 m s-2", "m": "1:3:3 kg"}, until=END, method="rk4", step=0.01, keep=["end"]
    )
    for grid in (whole.compute(), whole.compute().isel(g=slice(2))):
        assert_same_bits(xd.influences(grid, compute=False), xd.influences(grid))


def test_a_survey_is_asked_for_by_true_or_false(free: xr.Dataset) -> None:
    """Assert the value that is none of them."""
    with pytest.raises(xd.InputError, match="compute is 3, needs true or false"):
        xd.sensitivities(free, compute=3)  # type: ignore[arg-type]


def test_lazy_indices_have_the_numbers_of_eager_ones() -> None:
    """Assert the description while every march fails, what is known, and the same shares and intervals."""
    asked: dict[str, Any] = {"method": "rk4", "step": 0.01, "until": END, "draws": 32, "resamples": 20}
    ranges = {"g": ("9 m s-2", "11 m s-2"), "v_y": ("1 m s-1", "2 m s-1")}
    with no_march():
        stage = xd.sobol_indices(falling(), ranges, "end_y", compute=False, **asked)
        assert stage.parameter_name.values.tolist() == [*ranges]
    eager = xd.sobol_indices(falling(), ranges, "end_y", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)


def test_axes_of_settings_are_called_as_in_a_record() -> None:
    """Assert dimensions that collide with no keyword of xarray, and both words for them in questions to a sweep."""
    axes = {"method": ["rk4", "velocity_verlet"], "step": "40, 20, 10 ms", "g": "9:11:2 m s-2"}
    grid = xd.sweep(falling(), axes, until=END, keep=["end"]).compute()
    assert dict(grid.sizes) == {"solver_method": 2, "solver_step": 3, "g": 2}
    assert grid.sel(solver_method="rk4", g=9.0).end_y.dims == ("solver_step",)
    for words in ("method", "step"), ("solver_method", "solver_step"):
        method, step = words
        for verb, called, usual in (xd.convergence, step, "step"), (xd.contrast, method, "method"):
            found, expected = (without_dates(verb(grid, axis)) for axis in (called, usual))
            xr.testing.assert_identical(found, expected)
        assert float(xd.member(grid, **{method: "rk4", step: "20 ms"}, g=9.0).y[-1]) == float(
            grid.end_y.sel(solver_method="rk4", solver_step=20.0, g=9.0)
        )


def test_methods_that_vary_with_steps_have_their_own_orders() -> None:
    """Assert the order of each method in a column beside others, where the finest of the best one counts as exact."""
    together = {"method": ["midpoint", "rk4"], "until": [END, END]}
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    grid = xd.sweep(model, {"way": together, "step": "0.1, 0.05, 0.025 s"}).compute()
    alone = xd.sweep(model, {"method": together["method"], "step": "0.1, 0.05, 0.025 s"}, until=END).compute()
    for verb in xd.convergence, xd.precision:
        found, expected = (verb(each, "step") for each in (grid, alone))
        for name in expected.data_vars:
            np.testing.assert_array_equal(found[name].values, expected[name].values)


def test_a_sweep_of_before_has_the_axes_that_it_was_marched_with(tmp_path: Path) -> None:
    """Assert that a catalogue of version 0.2 is read, asked by both words and marched again, and refuses to be added to."""
    folder = tmp_path / "methods_and_steps"
    shutil.copytree(ROOT / "data/golden/0.2/methods_and_steps", folder)
    old = xd.open_sweep(folder)
    assert dict(old.sizes) == {"k": 2, "method": 2, "step": 3, "at": 2}
    run = xd.member(old, k="2 N m-1", method="rk4", step="0.05 s")
    assert float(run.x[-1]) == float(old.end_x.sel({"k": 2.0, "method": "rk4", "step": 0.05}))
    found, expected = (without_dates(xd.convergence(old, axis)) for axis in ("solver_step", "step"))
    xr.testing.assert_identical(found, expected)
    with pytest.raises(
        xd.InputError, match="its axis is 'method', as versions before called what is 'solver_method' here"
    ):
        xd.sweep(
            xd.Model.from_record(old.model_toml.item()),
            {"k": ["1 N m-1", "2 N m-1"], "method": ["rk4", "velocity_verlet"], "step": ["0.1 s", "0.05 s", "0.025 s"]},
            keep=["end", "x"],
            times=[0.5, 1.0],
            until="1 s",
            path=folder,
        )


def test_what_varies_together_is_not_called_as_settings_are() -> None:
    """Assert one line for a name that begins as those of settings do."""
    with pytest.raises(xd.InputError, match="'solver_way'.*begins as settings do, 'solver_…'"):
        xd.sweep(falling(), {"solver_way": {"method": ["rk4"], "step": [0.1]}})
