"""What whoever writes a model meets: the guide, the starter, and `check`."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS, ROOT
from xdynamics.documenting.guide import MEANINGS_ALONG, PAGES, SAID, SHAPED_MODEL, STARTER, guide
from xdynamics.documenting.markdown import WIDTH
from xdynamics.expressions.element_folding import MOST_FAMILIES
from xdynamics.expressions.parser import FORMS
from xdynamics.expressions.traced_arrays import LARGEST_SOLVED, MOST_KINKS
from xdynamics.expressions.tracing import MOST_NODES
from xdynamics.expressions.tree import ALONG, FUNCTIONS
from xdynamics.model.grammar import SECTIONS
from xdynamics.simulation.array_models import MOST_TRACED, MOST_WRITTEN_OUT
from xdynamics.simulation.scipy_interface import MOST_NAMED


@pytest.mark.parametrize(
    "topic",
    [
        "model",
        "language",
        "shapes",
        "units",
        "record",
        "cluster",
        "archives",
        "files",
        "json",
        "words",
        "solve",
        "stores",
        *SECTIONS,
    ],
)
def test_topics(topic: str) -> None:
    """Assert that every topic has lines, and each section all its keys with what they take."""
    done = call("help", topic)
    assert done.exit_code == 0
    for key in SECTIONS[topic].keys if topic in SECTIONS else ():
        assert f"  {key.name}" in done.output
        assert key.takes in " ".join(done.output.split())


def test_the_guide_knows_the_language() -> None:
    """Assert that every function stands in it, and a topic that is none is named with those there are."""
    text = "\n".join(guide("language"))
    assert all(name in text for name in FUNCTIONS)
    assert set(SAID) <= set(FUNCTIONS)
    assert all(f"  {name} " in call("help").output for names in PAGES.values() for name in names)
    assert call("help", "drive").output == call("help", "drives").output
    done = call("help", "drvies")
    assert (done.exit_code, "did you mean 'drives'?" in done.output) == (2, True)


def test_the_page_on_records_has_what_models_and_logs_name() -> None:
    """Assert the dimension of logged elements, the labels and ends of links, and what goes on from closed links."""
    lines = [*guide("record")]
    for start in (
        "  logged_<dimension>  ",
        "  <dimension>_label, logged_<dimension>_label",
        "  <relation>_first, <rel",
    ):
        assert sum(line.startswith(start) for line in lines) == 1
    assert any(line.startswith("  closed_friction_state ") and "(closed) " in line for line in lines)
    assert max(map(len, lines)) <= WIDTH


def test_the_page_on_solve_has_its_limits() -> None:
    """Assert that the numbers that the page names are those that are kept to."""
    limits = (MOST_NODES, MOST_TRACED, MOST_WRITTEN_OUT, MOST_FAMILIES, MOST_NAMED, MOST_KINKS, LARGEST_SOLVED)
    named = [line.split()[0] for line in guide("scipy") if line.split()[:1] and line.split()[0].isdigit()]
    assert named == [*map(str, limits)]


def test_the_page_on_shapes_is_true() -> None:
    """Assert that every function along dimensions is explained, and that the model on the page marches: near circles."""
    assert {*MEANINGS_ALONG} == {*ALONG} == {*FORMS}
    model = xd.Model.from_text("\n".join(SHAPED_MODEL))
    assert [*model.elements.force_components["gravity"]] == [*model.elements.statement.coordinates]
    run = xd.simulate(model)
    assert run.attrs["run_outcome"] == "completed"
    far = np.linalg.norm(run.r.sel(body=["Jupiter", "Saturn"]) - run.r.sel(body="Sun"), axis=-1) / 149597870700.0
    assert (np.ptp(far, axis=0) < 0.1).all()  # astronomical units: near circles of 5.2 and 9.58
    energy = run.total_energy.values
    assert np.ptp(energy) < 1e-6 * abs(energy[0])


def test_the_starter_marches(tmp_path: Path) -> None:
    """Assert that what `new` writes is checked, marched, and not written over."""
    path = tmp_path / "pendulum.toml"
    assert call("new", path).exit_code == 0
    assert path.read_text() == STARTER
    path.write_text(STARTER + "# mine\n")
    again = call("new", path)
    assert (again.exit_code, "is there already, and is not written over" in again.output) == (2, True)
    assert path.read_text().endswith("# mine\n")
    assert call("check", path).exit_code == 0
    assert xd.simulate(xd.Model.from_toml(path), until="1 s").attrs["run_outcome"] == "completed"
    commented = STARTER.replace("# [drives", "[drives").replace(
        '# table = "push.csv"', 'csv = "t [s],push [N m]\\n0,0\\n1,0\\n"'
    )
    assert {*tomllib.loads(commented)} >= {"name", "coordinates", "mass", "drives", "run"}


@pytest.mark.parametrize(
    ("path", "said"),
    [("pendulum.txt", "needs one like pendulum.toml"), ("no/p.toml", "No such file"), (".", "is not a name for")],
)
def test_names_that_are_none(path: str, said: str, tmp_path: Path) -> None:
    """Assert that a name of another kind or place is refused in one line."""
    done = call("new", tmp_path / path)
    assert (done.exit_code, said in done.output) == (2, True), done.output


@pytest.mark.every(13)
@pytest.mark.parametrize("path", sorted(MODELS.glob("*.toml")), ids=lambda one: one.stem)
def test_check_reads_every_model(path: Path) -> None:
    """Assert that each model is told, with all methods, and nothing is marched."""
    done = call("check", path)
    assert done.exit_code == 0, done.output
    words = [line.split()[0] for line in done.output.splitlines()[1:]]
    assert words.count("scales") == 1
    assert all(name in done.output for name in xd.METHODS)


def test_check_says_equations_and_faults(tmp_path: Path) -> None:
    """Assert the equations of a double pendulum, and that a fault ends with 2 and its column."""
    lines = call("check", MODELS / "double_pendulum.toml").output.splitlines()
    assert any(line.startswith("motion    ") and "*a_th1 + " in line for line in lines)
    path = tmp_path / "wrong.toml"
    path.write_text((ROOT / "data/models/ball_drag.toml").read_text().replace('"m*g*y"', '"m*g*y^2"'))
    done = call("check", path)
    assert (done.exit_code, "has the character '^' at column 6; a power is written **" in done.output) == (2, True)
    path.write_text((ROOT / "data/models/ball_drag.toml").read_text().replace('"m*g*y"', '"m*g"'))
    assert "needs 'kg m2 s-2 (J)'" in call("check", path).output


def test_what_show_prints_can_be_written() -> None:
    """Assert that a value with its uncertainty is read, changed and written."""
    model = xd.Model(
        name="x",
        states={"q": {"unit": "g", "rate": "m/second"}},
        parameters={"m": "50 ± 0.5 g"},
        initial={"q": "1 +/- 0.1 g"},
    )
    assert (model.parameters["m"].quantity.value, model.parameters["m"].uncertainty) == (50.0, 0.5)
    assert model.elements.starts["q"].uncertainty == 0.1
    assert xd.Model.from_text(model.to_toml()) == model
    other = model.replace(parameters={"m": "60 ± 2 g"})
    assert (other.parameters["m"].quantity.value, other.parameters["m"].uncertainty) == (60.0, 2.0)
    for text, size in {"50.0(5) g": 0.5, "50(2)g": 2.0, "(5 ± 0.4)e1 g": 4.0, "50 g ± 300 mg": 0.3}.items():
        other = model.replace(parameters={"m": text})
        assert other.parameters["m"].quantity.value == pytest.approx(50.0, rel=1e-15)
        assert other.parameters["m"].uncertainty == pytest.approx(size, rel=1e-15)
    for text in ("60 ± about 2 g", "60(two) g", "(60 ± two) g"):
        with pytest.raises(xd.InputError, match="cannot be read|does not start with a finite number|after its number"):
            model.replace(parameters={"m": text})
