"""What a notebook shows of the last line of a cell."""

from __future__ import annotations

import warnings

import nbformat
import pytest

from cases.problems import ROOT

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from nbclient import NotebookClient

CELLS = {
    "run": "import xdynamics as xd\nrun = xd.simulate(xd.Model.from_toml('data/models/ball_drag.toml'))\nrun",
    "plot": "xd.plot(run)",
    "accessor": "run.dynamics.plot(only='y')",
    "page": "box = xd.simulate(xd.Model.from_toml('data/models/ball_in_box.toml'), until='1 s')\nxd.animate(box, seconds=0.2)",
    "film": "import tempfile, pathlib\nxd.animate(box, pathlib.Path(tempfile.mkdtemp()) / 'box.gif', seconds=0.2)",
    "interactive": "run.dynamics.plot(only='y').interactive()",
    "methods": "xd.METHODS",
    "other": "import xarray as xr\nxr.Dataset({'a': 1})",
}


@pytest.fixture(scope="module")
def shown() -> dict[str, dict[str, str]]:
    """What each cell of one notebook shows, by its kind."""
    book = nbformat.v4.new_notebook()
    book.cells = [nbformat.v4.new_code_cell(source) for source in CELLS.values()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        NotebookClient(book, timeout=300, kernel_name="python3", resources={"metadata": {"path": ROOT}}).execute()
    return {
        name: {kind: text for out in cell.outputs for kind, text in out.get("data", {}).items()}
        for name, cell in zip(CELLS, book.cells, strict=True)
    }


@pytest.mark.dear
def test_a_run_is_a_small_page(shown: dict[str, dict[str, str]]) -> None:
    """Assert a page under 20 kB with outcome, end, events and the names of variables; other Datasets are xarray's."""
    page = shown["run"]["text/html"]
    assert len(page.encode()) <= 20_000
    for said in (
        "Ball thrown upward",
        "&#x27;ground&#x27; stopped the run",
        "apex at t = 1.799 s",
        "v_y",
        "force_drag_y",
        "total_energy",
    ):
        assert said in page
    assert "xr-wrap" in shown["other"]["text/html"]


def test_pictures_and_films_are_shown(shown: dict[str, dict[str, str]]) -> None:
    """Assert a PNG of plots, a slider over the frames of a film without a file, and the GIF that was written."""
    assert all(shown[cell]["image/png"].startswith("iVBORw0KGgo") for cell in ("plot", "accessor"))
    page, film = (shown[cell]["text/html"] for cell in ("page", "film"))
    assert 'type="range" min="0" max="4"' in page
    assert page.count("iVBORw0KGgo") == 5
    assert film.startswith('<img src="data:image/gif;base64,R0lGOD')


@pytest.mark.dear
def test_an_interactive_figure_is_in_its_cell(shown: dict[str, dict[str, str]]) -> None:
    """Assert the figure's data and all that draws it in the output of the cell, and no address to be fetched from."""
    page = shown["interactive"]["text/html"]
    assert "plotly.js v" in page
    assert "Plotly.newPlot(" in page
    assert "src=" not in page.partition("<script")[0] + page.partition("Plotly.newPlot(")[2]


def test_methods_are_a_table(shown: dict[str, dict[str, str]]) -> None:
    """Assert a row for each method, with its order."""
    page = shown["methods"]["text/html"]
    assert "<td>velocity_verlet</td><td>2</td><td>symplectic, symmetric</td>" in page
    assert page.count("<tr>") > 20
