"""The lessons: what they compute is what their words say, and their notebooks are made by one command."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cases.problems import ROOT

HOME = ROOT / "pipelines" / "lessons"
SHORT = ("methods", "contacts", "tables")  # the others with --whole


def maker() -> Any:
    """The module that makes notebooks."""
    spec = importlib.util.spec_from_file_location("notebooks", HOME / "notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def of_methods(names: dict[str, Any]) -> None:
    """The discrete laws: Euler's growth, the period of Euler-Cromer, the orders."""
    assert names["growth"] == pytest.approx(names["predicted_growth"], rel=1e-11)
    assert names["period"] == pytest.approx(names["numerical_period"], rel=2e-5)
    assert [round(order, 1) for order in names["orders"].values()] == [1.1, 1.0, 2.0]


def of_contacts(names: dict[str, Any]) -> None:
    """The closed forms of impacts and of their end, and the weight."""
    assert np.abs(names["errors"]).max() < 1e-12
    assert names["rest"] == pytest.approx(names["accumulation"], abs=1e-9)
    assert float(names["run"].contact_force_floor[-1]) == pytest.approx(0.2 * 9.81, rel=1e-12)


def of_bodies(names: dict[str, Any]) -> None:
    """Momentum is kept to rounding."""
    assert max(names["momentum"].values()) < 1e-12


def of_chaos(names: dict[str, Any]) -> None:
    """The trace of the Jacobian, and a slope near the largest exponent, 0.9056."""
    assert names["exponents"].sum() == pytest.approx(-(11 + 8 / 3), abs=1e-3)
    assert names["slope"] == pytest.approx(0.9056, abs=0.15)


def of_uncertainty(names: dict[str, Any]) -> None:
    """Derivatives of (vt^2/2g) ln(1 + v^2/vt^2)."""
    g, vt, v = 9.80665, 30.0, 20.0
    ratio = v**2 / vt**2
    assert names["height"] == pytest.approx(vt**2 / (2 * g) * np.log1p(ratio), rel=1e-5)
    assert names["slopes"]["vt"] == pytest.approx(vt / g * (np.log1p(ratio) - ratio / (1 + ratio)), rel=1e-4)
    assert names["slopes"]["v_y"] == pytest.approx(v / g / (1 + ratio), rel=1e-4)


def of_fitting(names: dict[str, Any]) -> None:
    """The truth is within three standard uncertainties."""
    assert (np.abs(names["estimates"] - (20.0, 0.12)) < 3.0 * names["doubts"]).all()


def of_tables(names: dict[str, Any]) -> None:
    """The closed form at the floor and in the states, the order of the method, and a ledger that passed."""
    assert names["fallen"] == pytest.approx(0.5, abs=1e-6)
    times, states = (names["states"][name].to_numpy() for name in ("time [s]", "y [m]"))
    assert np.abs(states - 0.981 * (times - 0.1 * (1.0 - np.exp(-10.0 * times)))).max() < 1e-6
    orders = [column for column in names["levels"].columns if column.startswith("order_y")]
    assert names["levels"][orders[0]].dropna().iloc[-1] == pytest.approx(4.0, abs=0.2)
    assert names["cases"]["verdict"].tolist() == ["passed"] * len(names["cases"])


CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "methods": of_methods,
    "contacts": of_contacts,
    "bodies": of_bodies,
    "chaos": of_chaos,
    "uncertainty": of_uncertainty,
    "fitting": of_fitting,
    "tables": of_tables,
}


@pytest.mark.every(3)
@pytest.mark.filterwarnings("ignore:no step of 'forward_euler' is stable")  # which the lesson is about
@pytest.mark.parametrize("name", CHECKS)
def test_a_lesson_computes_what_it_says(name: str, request: pytest.FixtureRequest, monkeypatch: Any) -> None:
    """Assert the closed forms and laws that a lesson speaks of."""
    if name not in SHORT and not request.config.getoption("--whole"):
        pytest.skip("with --whole")
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {"__name__": name}
    exec(compile((HOME / f"{name}.py").read_text(), name, "exec"), names)
    CHECKS[name](names)


@pytest.mark.dear
def test_notebooks_are_made_by_one_command(tmp_path: Path) -> None:
    """Assert text, numbers and pictures of an executed lesson, all lessons by default, and a refused name."""
    import nbformat

    made = maker()
    assert {*made.LESSONS} == {path.stem for path in HOME.glob("*.py")} - {"notebooks"} == {*CHECKS}
    (file,) = made.main(str(tmp_path / "books"), "contacts")
    book = nbformat.read(file, as_version=4)
    assert book.cells[0].source.startswith("# Where the ground is\n\nA smooth update rule")
    shown = [
        kind for cell in book.cells if cell.cell_type == "code" for out in cell.outputs for kind in out.get("data", {})
    ]
    assert shown.count("image/png") == 2
    assert "text/html" in shown
    with pytest.raises(SystemExit, match="there is no lesson magic; there are methods, contacts"):
        made.main(str(tmp_path), "magic")
