"""What users of xarray type first, on a run as it was marched, as it is opened, and as xarray opens the file itself."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cf_xarray  # noqa: F401 - registers run.cf
import netCDF4
import numpy as np
import pint_xarray  # noqa: F401 - registers run.pint
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.archive.integrity import edited_variables, without_stale_units
from xdynamics.documenting.manual import manual_text
from xdynamics.record.folding import labelled

ARCHIVES_PAGE = manual_text("archives.md")
WAYS: dict[str, Callable[[xr.Dataset, Path], xr.Dataset]] = {
    "marched": lambda run, _: run,
    "opened": lambda _, path: xd.open_run(path),
    "in chunks": lambda _, path: xd.open_run(path, chunks={}),
    "by the backend": lambda _, path: xr.open_dataset(path, engine="xdynamics"),
    "by xarray": lambda _, path: xr.open_dataset(path),
}
IDIOMS: dict[str, Callable[[xr.Dataset], Any]] = {
    "mean": lambda run: run.mean("step"),
    "std": lambda run: run.std("step"),
    "max": lambda run: run.max("step"),
    "median": lambda run: run.compute().median("step"),
    "sum": lambda run: run.sum(),
    "twice": lambda run: run * 2,
    "difference": lambda run: run - run,
    "where": lambda run: run.where(run.time > 0.5),
    "groupby": lambda run: run.compute().set_coords("row_kind").groupby("row_kind").mean(),
    "rolling": lambda run: run.rolling(step=3).mean(),
    "isel": lambda run: run.isel(step=slice(5), event=[0]),
    "sel": lambda run: run.isel(step=run.time.values > 0.5),
    "concat": lambda run: xr.concat([run, run], "member", coords="different", compat="equals"),
    "merge": lambda run: xr.merge([run[["y"]], run[["v_y"]]]),
    "combine": lambda run: xr.combine_by_coords([run[["y"]], run[["v_y"]]]),
    "astype": lambda run: run.astype("f4"),
    "diff": lambda run: run.diff("step"),
    "shift": lambda run: run.shift(step=1),
    "sortby": lambda run: run.sortby("time"),
    "assign": lambda run: run.assign(speed=abs(run.v_y)),
    "to_dataframe": lambda run: run.y.to_dataframe(),
    "tree": xr.DataTree,
    "pickle": lambda run: pickle.loads(pickle.dumps(run)),
    "copy": lambda run: run.copy(deep=True),
    "interp": lambda run: run.y.swap_dims(step="time").drop_duplicates("time").interp(time=[0.1, 0.2]),
    "polyfit": lambda run: run.y.swap_dims(step="time").polyfit("time", 2),
}


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball that bounces twice."""
    return xd.simulate(xd.Model.from_toml("data/models/bouncing_ball.toml"), until="1.4 s", method="rk4", step="10 ms")


@pytest.fixture(scope="module")
def path(run: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its archive."""
    return Path(xd.save(run, tmp_path_factory.mktemp("idioms") / "ball.nc"))


@pytest.fixture(params=[False, True], ids=["as it was", "new defaults"])
def defaults(request: pytest.FixtureRequest) -> Iterator[None]:
    """Xarray's defaults of joining, and those that are to come."""
    with xr.set_options(use_new_combine_kwarg_defaults=request.param):
        yield


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning", "ignore:invalid value:RuntimeWarning")
@pytest.mark.usefixtures("defaults")
@pytest.mark.parametrize("way", WAYS)
def test_idioms_meet_numbers_alone(run: xr.Dataset, path: Path, way: str) -> None:
    """Assert that no text and no parameter is in the way, and that what comes back still describes the run."""
    given = WAYS[way](run, path)
    for name, idiom in IDIOMS.items():
        result = idiom(given)
        if isinstance(result, xr.Dataset) and name not in ("sum", "concat", "groupby", "merge", "combine", "polyfit"):
            assert float(result.m) == float(run.m), name
            assert result.model_toml.item() == run.model_toml.item(), name
    assert float((given * 2).y[0]) == 2.0 * float(run.y[0])
    assert float(given.mean("step").y) == pytest.approx(float(run.y.mean()))
    assert xr.concat([given, given], "member", coords="different", compat="equals").y.dims == ("member", "step")


@pytest.mark.parametrize("way", WAYS)
def test_what_describes_a_run_are_coordinates(run: xr.Dataset, path: Path, way: str) -> None:
    """Assert that parameters, texts, times and numbers of rows are coordinates, and nothing else is."""
    given = WAYS[way](run, path)
    described = {"m", "g", "e", "model_toml", "force_source", "time", "event_time", "trial_time", "sample_time"}
    described |= {"step_number"} if way == "by xarray" else {"step_number", "end_memory"}
    assert {*given.coords} == described
    assert not given.indexes
    assert given.m.dims == ()
    assert given.model_toml.dims == ("document",)
    assert given.event_time_bounds.attrs == {}
    assert given.event_time.attrs["bounds"] == "event_time_bounds"


@pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning", "ignore:Consolidated metadata")
@pytest.mark.parametrize("way", WAYS)
def test_copies_by_xarray_are_read(run: xr.Dataset, path: Path, way: str, tmp_path: Path) -> None:
    """Assert that netCDF and Zarr that xarray writes of a run have every number, and its verbs take them."""
    given = WAYS[way](run, path)
    given.to_netcdf(tmp_path / "copy.nc")
    given.to_zarr(tmp_path / "copy.zarr")
    for copy in (xr.open_dataset(tmp_path / "copy.nc"), xr.open_zarr(tmp_path / "copy.zarr")):
        for name, variable in run.variables.items():
            assert np.array_equal(copy[name].values, variable.values, equal_nan=variable.dtype.kind == "f"), name
        assert copy.dynamics.events("floor").sizes["event"] == 2


def test_a_dropped_coordinate_is_named_no_more(path: Path, tmp_path: Path) -> None:
    """Assert that what xarray writes of an opened run names no coordinate that was left out."""
    xd.open_run(path).drop_vars("m").to_netcdf(tmp_path / "fewer.nc")
    with netCDF4.Dataset(tmp_path / "fewer.nc") as file:
        named = " ".join(getattr(variable, "coordinates", "") for variable in file.variables.values()).split()
        assert "g" in named
        assert "m" not in named


def test_bounds_have_the_unit_of_what_they_bound(run: xr.Dataset) -> None:
    """Assert units of a table's bracket, and that a time without its bounds beside it names none."""
    units = run.dynamics.frame("event").attrs["units"]
    assert units["event_time_bounds_lower"] == units["event_time_bounds_upper"] == units["event_time"] == "s"
    states = xd.simulate(xd.Model.from_toml("data/models/bouncing_ball.toml"), until="1 s", times=[0.2, 0.8])
    tables = (run.dynamics.events("floor"), run.dynamics.tree()["events"].dataset, states)
    assert all("bounds" not in table.event_time.attrs for table in tables if "event_time" in table)


def rows(run: xr.Dataset, wanted: Any) -> xr.Dataset:
    """Return some rows of a run."""
    return run.isel(step=wanted)


SELECTIONS: dict[str, Callable[[int], Any]] = {
    "all": lambda _: slice(None),
    "late": lambda _: slice(10, None),
    "shuffled": lambda n: np.random.default_rng(1).permutation(n),
    "backwards": lambda _: slice(None, None, -1),
}


@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize("saved", [False, True], ids=["", "saved"])
def test_events_have_their_own_states_in_selections(
    run: xr.Dataset, selection: str, tmp_path: Path, *, saved: bool
) -> None:
    """Assert that rows are found by their numbers: the last bounce has the speeds that it has in the whole run."""
    part = rows(run, SELECTIONS[selection](run.sizes["step"])).isel(event=[-1])
    if saved and selection in ("all", "late"):
        xd.save(part, tmp_path / "part.nc")
        part = xd.open_run(tmp_path / "part.nc")
    found, whole = part.dynamics.events("floor"), run.dynamics.events("floor").isel(event=[-1])
    for name in ("before_v_y", "after_v_y", "before_y", "event_time"):
        assert found[name].values.tolist() == whole[name].values.tolist(), name


def test_what_a_selection_has_not_is_told(run: xr.Dataset) -> None:
    """Assert one line for states of events that were left out, and for steps between rows that were."""
    early = run.isel(step=slice(0, 5))
    for asked in (lambda: early.dynamics.events("floor"), lambda: early.dynamics.solution):
        with pytest.raises(
            xd.InputError, match=r"the row (before|after) event 'floor' at t = 0\.45\d+ s is not in this sel"
        ):
            asked()
    torn = run.isel(step=run.row_kind.values != 4)  # without the states behind the bounces
    bounce = float(run.event_time[0])
    with pytest.raises(xd.InputError, match=r"a row is missing between t = 0\.45\d+ s and"):
        xd.sample(torn, bounce + 1e-3)
    assert xd.sample(torn, bounce / 2).y.values == xd.sample(run, bounce / 2).y.values


def test_a_thinned_run_names_rows_by_number() -> None:
    """Assert that pointers of a run with every seventh row are numbers of the whole march, and find their states."""
    model = xd.Model.from_toml("data/models/bouncing_ball.toml")
    whole = xd.simulate(model, until="1.4 s", method="rk4", step="1 ms")
    thin = xd.simulate(model, until="1.4 s", method="rk4", step="1 ms", keep_every=7)
    for name in ("event_row_before", "event_row_after"):
        assert thin[name].values.tolist() == whole[name].values.tolist()
        assert {*thin[name].values.tolist()} <= {*thin.step_number.values.tolist()}
    assert {*thin.sample_step.values.tolist(), *thin.trial_step.values.tolist()} <= {*thin.step_number.values.tolist()}
    for part in (thin, thin.isel(step=slice(60, None), event=[-1])):
        found, expected = (
            part.dynamics.events("floor"),
            whole.dynamics.events("floor").isel(event=slice(-part.sizes["event"], None)),
        )
        assert found.before_v_y.values.tolist() == expected.before_v_y.values.tolist()
    assert whole.step_number.values.tolist() == list(range(whole.sizes["step"]))


@pytest.mark.parametrize(
    "kept", [{"coords": "different", "compat": "equals"}, {"coords": "minimal", "compat": "override"}]
)
def test_several_runs_are_not_taken_for_one(kept: dict[str, Any]) -> None:
    """Assert one line of each verb for runs that were put together, also where xarray kept the parameters of one."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    heavy = model.replace(parameters={"m": "0.2 kg"})
    runs = [xd.simulate(one, until=1.0, step=0.01, method="rk4") for one in (model, heavy)]
    both = xr.concat(runs, "member", **kept)
    verbs: list[Callable[[], Any]] = [
        lambda: xd.sample(both, [0.5]),
        lambda: both.dynamics.at(0.5),
        both.dynamics.events,
        both.dynamics.tree,
        lambda: xd.compare(both, runs[0]),
        lambda: xd.diagnose(both),
        lambda: xd.plot(both),
        lambda: xd.extend(both, until="2 s"),
    ]
    for verb in verbs:
        with pytest.raises(xd.InputError, match="these are several runs, along 'member'; give one at a time"):
            verb()


REFUSED: dict[str, tuple[Callable[[xr.Dataset], Any], type[Exception], str]] = {
    "max": (lambda run: run.max(), ValueError, "zero-size array to reduction operation maximum which has no identity"),
    "resample": (
        lambda run: run.resample(time="1s").mean(),
        TypeError,
        "Only valid with DatetimeIndex, TimedeltaIndex or PeriodIndex",
    ),
    "merge": (
        lambda run: xr.merge([run, run.isel(step=slice(5))]),
        ValueError,
        "cannot reindex or align along dimension 'step'",
    ),
}


@pytest.mark.parametrize("idiom", REFUSED)
def test_what_xarray_refuses_is_on_the_page(run: xr.Dataset, idiom: str) -> None:
    """Assert the errors of xarray that the page of archives lists, in the words that it has there."""
    ask, kind, text = REFUSED[idiom]
    with pytest.raises(kind) as refusal:
        ask(run)
    assert text in str(refusal.value)
    assert text in " ".join(ARCHIVES_PAGE.split())


def test_neighbours_of_xarray_take_a_run(run: xr.Dataset) -> None:
    """Assert the time axis by cf-xarray, and units that are kept through pint's arithmetic where xarray keeps the old one."""
    assert run.cf.axes["T"] == ["time"]
    assert run.cf["time"].dims == ("step",)
    assert (run.y / 1000).attrs["units"] == "m"
    squared = (run.pint.quantify().v_y ** 2).pint.dequantify()
    assert squared.attrs["units"] == "meter ** 2 / second ** 2"


EDITED = {
    "whole": lambda run: run.assign(y=run.y / 1000),
    "other values": lambda run: run.assign(y=run.y.copy(data=run.y.values * 2)),
    "transposed": lambda run: run.assign(y=run.y.copy(data=run.y.values[::-1])),
    "a selection": lambda run: run.assign(y=run.y / 1000).isel(step=slice(3, None)),
    "shuffled": lambda run: run.assign(y=run.y / 1000).isel(
        step=np.random.default_rng(2).permutation(run.sizes["step"])
    ),
}


@pytest.mark.parametrize("edit", EDITED)
@pytest.mark.parametrize("way", ["marched", "opened"])
def test_no_unit_is_shown_that_an_edit_made_wrong(run: xr.Dataset, path: Path, edit: str, way: str) -> None:
    """Assert an unknown unit in tables, and one line where states between rows would be computed from edited ones."""
    edited = EDITED[edit](WAYS[way](run, path))
    assert edited.y.attrs["units"] == "m"  # as xarray keeps it
    assert edited.dynamics.frame().attrs["units"]["y"] == "unknown unit"
    assert edited.dynamics.frame().attrs["units"]["v_y"] == "m s-1"
    assert edited.dynamics.tree()["steps"].y.attrs["units"] == "unknown unit"
    assert edited.dynamics.events().before_y.attrs["units"] == "unknown unit"
    for verb in (edited.dynamics.plot, edited.dynamics.animate, lambda: edited.dynamics.at(0.1)):
        with pytest.raises(
            xd.InputError, match=r"^y: edited since the run was computed, .* run\.y\.plot\(x=\"time\"\)$"
        ):
            verb()


UNEDITED = {
    "a selection": lambda run: run.isel(step=slice(3, 40), event=[1]),
    "shuffled": lambda run: run.isel(step=np.random.default_rng(2).permutation(run.sizes["step"]), event=[1, 0]),
    "a copy": lambda run: run.copy(deep=True),
    "read": lambda run: run.load(),
    "in chunks and back": lambda run: run.chunk().compute(),
    "with a speed": lambda run: run.assign(speed=abs(run.v_y)),
    "in millimetres": lambda run: run.assign(y=(run.y * 1000).assign_attrs(units="mm")),
    "its mean": lambda run: run.mean("step"),
}


@pytest.mark.parametrize("change", UNEDITED)
@pytest.mark.parametrize("way", ["marched", "opened", "in chunks"])
def test_what_is_not_edited_keeps_its_unit(run: xr.Dataset, path: Path, change: str, way: str) -> None:
    """Assert that rows left out, in another order, copied, read or with a unit stated anew are no edit."""
    changed = UNEDITED[change](WAYS[way](run, path))
    assert edited_variables(changed) == []
    assert without_stale_units(changed) is changed


@pytest.mark.parametrize("name", ["event_time", "step_size"])
def test_an_edit_of_what_every_run_has_is_called_one(run: xr.Dataset, name: str) -> None:
    """Assert that a figure says of a time whose unit is lost that it was edited, not that its unit is another."""
    with pytest.raises(
        xd.InputError, match=f"'{name}' was edited since the run was computed, so that its unit is not known"
    ):
        run.assign({name: run[name] * 1000}).dynamics.plot()


def test_a_parameter_and_an_array_opened_to_writing_are_edited() -> None:
    """Assert that numbers without a dimension are compared, and that what could have been written over is not trusted."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until=0.1)
    assert edited_variables(run.assign_coords(m=run.m / 1000)) == ["m"]
    run.y.values.flags.writeable = True
    run.y.values[:] *= 2.0
    assert edited_variables(run) == ["y"]
    with pytest.raises(xd.InputError, match="y: edited since the run was computed"):
        run.dynamics.at(0.05)


LABELLED = """
name = "two masses"
dimensions.body = ["left", "right"]
coordinates.x = { unit = "m", dims = ["body"] }
parameters = { m = { value = [1, 2], unit = "kg", dims = ["body"] }, k = "3 N m-1" }
mass.x = "m"
forces.spring.x = "-k*x"
initial = { x = { value = [1, 2], unit = "m" }, v_x = "0*metre/second" }
"""


def test_elements_are_found_by_their_labels() -> None:
    """Assert that bodies in another order are no edit, and that values which changed places among them are one."""
    run = xd.simulate(xd.Model.from_text(LABELLED), method="rk4", step="0.1 s", until="1 s")
    assert edited_variables(run.isel(body=[1, 0])) == []
    assert edited_variables(run.transpose("body", ...)) == []
    assert edited_variables(run.isel(body=[1, 0], step=slice(4, 7))) == []
    exchanged = run.assign(x=run.x.copy(data=run.x.values[:, ::-1]))
    assert edited_variables(exchanged) == ["x"]
    assert edited_variables(exchanged.isel(step=slice(4, 7))) == ["x"]


def test_figures_of_edited_numbers_have_no_unit_for_them() -> None:
    """Assert axes of a refinement, of a sweep and of energies, whose other numbers keep theirs."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    study = xd.refine(model, steps=[0.02, 0.01, 0.005], until=0.4)
    axes = xd.plot(study.assign(difference_y=study.difference_y * 1000)).axes[0]
    assert axes.get_ylabel() == "|difference| (unknown unit)"
    assert axes.get_title(loc="left").endswith(" m")
    sweep = xd.sweep(model, {"g": "9:10:3 m s-2"}, until=0.4, keep=["end"]).compute()
    labels = [axes.get_ylabel() for axes in xd.plot(sweep.assign(end_y=sweep.end_y * 1000)).axes]
    assert "end_y (unknown unit)" in labels
    assert "end_v_y (m s⁻¹)" in labels
    run = xd.simulate(model, until=2.0)
    axes = xd.plot(run.assign(kinetic_energy=run.kinetic_energy / 1000), only="energy").axes[0]
    assert axes.get_ylabel() == "energy (J)"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["potential", "total"]


def test_terms_and_parameters_are_found_by_their_names(tmp_path: Path) -> None:
    """Assert that names along a dimension of evidence select, in memory, in a file, and of what is still to be computed."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    budget = xd.error_budget(model, "t", event="ground")
    xd.save(budget, tmp_path / "budget.nc")
    lazy = xd.error_budget(model, "t", event="ground", compute=False)
    opened = (xd.open_run(tmp_path / "budget.nc"), xr.open_dataset(tmp_path / "budget.nc", engine="xdynamics"))
    where = budget.term_name.values.tolist().index("vt")
    for found in (budget, *opened, lazy):
        assert float(found.sel(term="vt").standard_uncertainty) == budget.standard_uncertainty.values[where]
    with netCDF4.Dataset(tmp_path / "budget.nc") as file:
        assert "term" not in file.variables
        assert "term_name" in file.variables
    assert opened[0].dynamics.table().columns[:2].tolist() == ["term_name", "term_kind"]
    assert "term" not in opened[0].dynamics.table().columns
    with pytest.raises(KeyError, match="not all values found in index 'term'"):
        budget.sel(term="g_")


def test_events_are_found_by_their_names(run: xr.Dataset) -> None:
    """Assert that a name gives all events of the detector, and tables have the name."""
    events = run.dynamics.events()
    assert events.sel(event="floor").event_time.values.tolist() == run.event_time.values.tolist()
    assert [*events.dynamics.frame("event").event_name] == ["floor"] * events.sizes["event"]


def test_names_that_are_computed_later_are_no_labels_yet() -> None:
    """Assert that a lazy Dataset, whose names come of its runs, has no index until it is loaded."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    budget = xd.error_budget(model, "t", event="ground", compute=False)
    assert ("term" in budget.indexes) == (budget.term_name.chunks is None)
    events = xd.simulate(model, method="dop853", rtol=1e-9).dynamics.events()
    assert "event" not in labelled(events.drop_vars("event").chunk()).indexes
