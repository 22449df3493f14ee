"""Tables of records: what a row is of, headers with units, files that other programs read, and lines for a terminal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.interchange import tables
from xdynamics.interchange.tables import board_of, kinds_of, table, table_lines

BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball that bounces twice."""
    return xd.simulate(BALL, until="1.4 s")


@pytest.fixture(scope="module")
def study() -> xr.Dataset:
    """A refinement whose order is known: that of the forward Euler method is one."""
    return xd.refine(BALL, steps=[0.02, 0.01, 0.005], until=1.0, at=[0.5, 1.0], method="forward_euler", defects=True)


def test_events_have_both_sides_in_their_row(run: xr.Dataset) -> None:
    """Assert detector, kind, direction, time, bracket, uncertainty and residual first, then each quantity before and after."""
    events = run.dynamics.table("events")
    assert events.columns[:8].tolist() == [
        "event_detector",
        "event_kind",
        "event_direction",
        "event_time [s]",
        "event_time_bounds_lower [s]",
        "event_time_bounds_upper [s]",
        "event_time_uncertainty [s]",
        "event_residual",
    ]
    assert events["event_detector"].tolist() == ["floor", "floor"]
    assert events["before_v_y [m s-1]"].tolist() == run.v_y.values[run.event_row_before.values].tolist()
    assert events["after_v_y [m s-1]"].tolist() == run.v_y.values[run.event_row_after.values].tolist()
    restitution = -events["after_v_y [m s-1]"] / events["before_v_y [m s-1]"]
    assert restitution.tolist() == pytest.approx([0.9, 0.9], rel=1e-12)
    assert events.attrs["units"]["before_v_y [m s-1]"] == "m s-1"


def test_steps_have_every_number_of_their_row(run: xr.Dataset) -> None:
    """Assert that no bit of a state is lost, of a part of a run too, and that a frame has the same without units in its names."""
    steps = run.dynamics.table()
    assert steps["y [m]"].tolist() == run.y.values.tolist()
    assert steps["row_kind"].iloc[0] == "initial"
    assert steps["step_number"].dtype.kind == "i"
    part = run.isel(step=slice(3, 6)).dynamics.table("step")
    assert part["time [s]"].tolist() == run.time.values[3:6].tolist()
    assert run.dynamics.frame("step")["y"].tolist() == steps["y [m]"].tolist()


def test_levels_have_value_difference_order_and_verdict(study: xr.Dataset) -> None:
    """Assert a row a level and every observable at every place; the observed order of forward Euler is about one."""
    levels = study.dynamics.table("levels")
    assert levels["step_size [s]"].tolist() == [0.02, 0.01, 0.005]
    assert levels["y at t = 1.0 s [m]"].tolist() == study.y.values[:, 1].tolist()
    assert levels["difference_y at t = 1.0 s [m]"].tolist()[:2] == study.difference_y.values[:2, 1].tolist()
    assert levels["order_v_y at t = 1.0 s"][1] == pytest.approx(1.0, abs=0.1)
    assert {"event_time_floor[1] [s]", "verdict_y at t = 0.5 s", "event_count_floor", "step_defect_y [m]"} <= {
        *levels.columns
    }
    assert {"y at t = 0.5 s", "v_y at t = 1.0 s"} <= {*study.dynamics.frame("level").columns}


def test_members_cases_terms_times_and_parameters(run: xr.Dataset) -> None:
    """Assert a row for each of these, with the axes of a sweep first."""
    sweep = xd.sweep(
        BALL, {"e": [0.8, 0.9], "method": ["velocity_verlet", "rk4"]}, until=0.4, step=0.01, times=[0.1, 0.2]
    )
    members = table(sweep)
    assert members.columns[:2].tolist() == ["e", "solver_method"]
    assert members["e"].tolist() == [0.8, 0.8, 0.9, 0.9]
    assert members["y at t = 0.2 s [m]"].tolist() == sweep.y.values[:, :, 1].ravel().tolist()
    ledger = xd.validate(BALL)
    assert table(ledger)["verdict"].tolist() == ["passed"] * ledger.sizes["case"]
    budget = xd.error_budget(BALL, "y", at="0.3 s", step=0.01)
    assert kinds_of(budget)[0] == "terms"
    assert "standard_uncertainty [m]" in table(budget).columns
    states = table(run.dynamics.at([0.1, 0.2]))
    assert states["at_time [s]"].tolist() == [0.1, 0.2]
    parameters = table(run, "parameters").set_index("parameter")
    assert parameters.loc["g", "value"] == 9.81
    assert parameters.loc["g", "units"] == "m s-2"


def test_elements_are_columns_by_their_labels() -> None:
    """Assert a column for each element of a quantity with dimensions, and a row for each element of a parameter."""
    model = xd.Model.from_toml(MODELS / "outer_solar_system.toml")
    run = xd.simulate(model, until="100 d", method="dop853", rtol=1e-6)
    steps = table(run)
    assert steps["r[Jupiter, x] [astronomical_unit]"].tolist() == run.r.sel(body="Jupiter", axis="x").values.tolist()
    assert "mu[Saturn]" in table(run, "parameters")["parameter"].tolist()


def test_numbers_are_rounded_only_where_it_is_asked(study: xr.Dataset) -> None:
    """Assert that a number keeps the digits that its uncertainty supports, and moves by less than this."""
    whole, rounded = (
        table(study, "levels", rounded=asked)["event_time_floor[1] [s]"].values for asked in (False, True)
    )
    doubt = float(study.uncertainty_event_time_floor[0])
    assert (np.abs(whole - rounded) <= doubt / 2).all()
    assert all(len(repr(float(number))) < 9 for number in rounded)


@pytest.mark.parametrize("ending", ["csv", "xlsx", "parquet"])
def test_files_are_read_by_pandas(run: xr.Dataset, tmp_path: Path, ending: str) -> None:
    """Assert that text and Parquet give the same bits again, by the command, and a workbook the 16 digits that it keeps."""
    xd.save(run, tmp_path / "ball.nc")
    path = tmp_path / f"events.{ending}"
    done = CliRunner().invoke(main, ["table", str(tmp_path / "ball.nc"), "--of", "events", "-o", str(path)])
    assert done.exit_code == 0, done.output
    read = {"csv": pd.read_csv, "xlsx": pd.read_excel, "parquet": pd.read_parquet}[ending](path)
    made = run.dynamics.table("events")
    assert read.columns.tolist() == made.columns.tolist()
    precise = 1e-15 if ending == "xlsx" else 0.0
    assert read["before_v_y [m s-1]"].tolist() == pytest.approx(
        made["before_v_y [m s-1]"].tolist(), rel=precise, abs=0.0
    )


def test_markdown_and_latex_need_nothing(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert rows of cells whose signs the language would take for its own are escaped."""
    parameters = table(run, "parameters")
    parameters.loc[2, "description"] = "ratio |v'/v|"
    tables.write_table(parameters, tmp_path / "p.md")
    rows = (tmp_path / "p.md").read_text().splitlines()
    assert rows[0] == "| parameter | value | units | description |"
    assert rows[3] == "| g | 9.81 | m s-2 | parameter g |"
    assert rows[4] == "| e | 0.9 | 1 | ratio \\|v'/v\\| |"
    tables.write_table(run.dynamics.table("events"), tmp_path / "e.tex")
    text = (tmp_path / "e.tex").read_text()
    assert text.startswith("\\begin{tabular}{lllrr")
    assert "event\\_detector & event\\_kind" in text
    assert text.count("\\\\\n") == 3


def test_a_text_is_no_formula(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that a workbook shows a text that begins with =, and computes nothing."""
    openpyxl = pytest.importorskip("openpyxl")
    made = table(run, "parameters")
    made.loc[0, "description"] = '=HYPERLINK("http://example.org")'
    tables.write_table(made, tmp_path / "p.xlsx")
    cell = openpyxl.load_workbook(tmp_path / "p.xlsx").active["D2"]
    assert (cell.data_type, cell.value) == ("s", '=HYPERLINK("http://example.org")')


@pytest.mark.parametrize("width", [80, 160])
def test_the_board_fits_a_terminal(study: xr.Dataset, width: int) -> None:
    """Assert a convergence record with value, difference and order of each observable, in the width of the terminal."""
    board = board_of(study, width)
    assert max(map(len, board)) <= width
    assert board[0].split()[:2] == ["step_size", "[s]"]
    assert board[0].count("order") == (1 if width == 80 else 3)
    assert any("local error of y [m]" in line for line in board)


def test_a_name_of_a_model_keeps_its_digits() -> None:
    """Assert ten digits of what a model may call as evidence calls its own, all of a time, three of an uncertainty."""
    headers = [
        "border",
        "order_parameter",
        "event_time [s]",
        "time [s]",
        "event_time_uncertainty [s]",
        "residual",
        "rebound",
    ]
    made = pd.DataFrame({header: [1 / 3] for header in headers})
    cells = [*table_lines(made, 1000)][1].split()
    assert cells == [
        *("0.3333333333", "0.3333333333", "0.333333333333333", "0.333333333333333"),
        *("0.333", "0.333", "0.3333333333"),
    ]


@pytest.mark.parametrize("of", ["trials", "events"])
def test_a_table_without_rows_has_its_headers(of: str, tmp_path: Path) -> None:
    """Assert the columns of a run in which nothing was rejected, or nothing happened, on a terminal and in files too."""
    run = xd.simulate(BALL, until=0.1)
    made = table(run, of)
    assert (len(made), len(made.columns) > 3) == (0, True)
    assert len({*table_lines(made, 10_000)}) == 1
    for ending in ("csv", "xlsx", "parquet", "md", "tex"):
        assert "0 rows" in tables.write_table(made, tmp_path / f"{of}.{ending}")


def test_one_member_and_a_lazy_sweep() -> None:
    """Assert one row of a member that was chosen, and the rows of a sweep that is marched when its table is asked for."""
    lazy = xd.sweep(BALL, {"e": [0.8, 0.9]}, until=0.4, step=0.01)
    sweep = lazy.compute()
    assert table(sweep.isel(e=1))["end_y [m]"].tolist() == [float(sweep.end_y[1])]
    assert table(lazy)["end_y [m]"].tolist() == sweep.end_y.values.tolist()

    marches = []

    def counted(graph: Any, keys: Any, **how: Any) -> Any:
        marches.append(len(keys))
        return dask.get(graph, keys, **how)

    with dask.config.set(scheduler=counted):
        table(lazy)
    assert len(marches) == 1


def test_a_long_table_is_cut_on_a_terminal(run: xr.Dataset) -> None:
    """Assert the first rows, the last ones, and how many are between."""
    steps = table(run)
    lines = [*table_lines(steps, 10_000)]
    assert lines[13] == f"… {len(steps) - 24} rows more"
    assert len(lines) == 26


WRONG: dict[str, tuple[list[str], str]] = {
    "unknown": (
        ["ball.nc", "--of", "foo"],
        "there is no table of 'foo' here; there are steps, trials, events, samples, param",
    ),
    "another kind": (["ball.nc", "--of", "levels"], "there is no table of 'levels' here"),
    "ending": (["ball.nc", "-o", "t.doc"], "has the ending '.doc'; there are .csv, .xlsx, .parquet, .md, .tex"),
    "folder": (["ball.nc", "-o", "."], "is a directory; name a file"),
    "no folder": (["ball.nc", "-o", "none/t.csv"], "cannot be written: there is no folder 'none'"),
    "missing": (["none.nc"], "'none.nc' does not exist"),
    "several": (["ball.nc", "ball.nc", "--of", "steps"], "of 2 files each has a row; give one for --of"),
    "evidence among several": (
        ["ball.nc", "ledger.nc"],
        "'ledger.nc' is evidence, no run: a ledger from 1 run; an index is of runs",
    ),
    "text": (["text.nc"], "is damaged or no run archive"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run: xr.Dataset) -> Path:
    """A run, a ledger and a text in a folder."""
    path = tmp_path_factory.mktemp("tables")
    xd.save(run, path / "ball.nc")
    xd.save(xd.validate(BALL), path / "ledger.nc")
    (path / "text.nc").write_text("no archive")
    return path


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line(case: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert an exit code that is not 0 and what was needed; nothing is written."""
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    arguments, words = WRONG[case]
    done = CliRunner().invoke(main, ["table", *arguments])
    assert done.exit_code == (1 if case == "text" else 2)
    assert words in done.output
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert one line with the command that installs it."""
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(xd.InputError, match=r"\.parquet needs pyarrow, .* pip install 'xdynamics\[tables\]'"):
        tables.check_table_target(tmp_path / "t.parquet")


def test_refine_and_show_print_the_board(folder: Path, study: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the table stands above the summary, and that JSON and --quiet have none."""
    monkeypatch.chdir(folder)
    xd.save(study, "study.nc")
    ask: Any = CliRunner().invoke
    shown = ask(main, ["show", "study.nc"]).output
    assert "difference  order" in shown
    assert "difference  order" not in ask(main, ["show", "study.nc", "--json"]).output
    judged = ask(main, ["validate", str(MODELS / "bouncing_ball.toml")]).output.splitlines()
    assert judged[2].split() == ["case", "verdict", "residual", "bound", "unit"]
    assert judged[3].split()[:2] == ["impacts.impulse_y", "passed"]


def test_show_takes_several_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one after another, and with JSON a line each; a file that is missing is named after those before it."""
    monkeypatch.chdir(folder)
    ask: Any = CliRunner().invoke
    both = ask(main, ["show", "ball.nc", "ledger.nc"]).output
    assert both.count("Bouncing ball, by velocity_verlet") == 1
    assert "validation of Bouncing ball" in both
    lines = ask(main, ["show", "ball.nc", "ledger.nc", "--json"]).output.splitlines()
    assert [json.loads(line)["kind"] for line in lines] == ["run", "ledger"]
    missing = ask(main, ["show", "ball.nc", "none.nc"])
    assert missing.exit_code == 2
    assert missing.output.endswith("xdynamics: 'none.nc' does not exist\n")
