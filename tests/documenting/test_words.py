"""The glossary names what records and evidence hold, and says what a verdict on convergence means wherever one is."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest

import xdynamics as xd
from xdynamics.cli import main
from xdynamics.documenting.manual_pages import OF_EVIDENCE, OF_FILES, OF_RECORDS, words_page
from xdynamics.documenting.model_pages import WIDTH
from xdynamics.documenting.summary import summary
from xdynamics.evidence.refining.convergence import MEANINGS, VERDICTS

# words for things, which are no names in a Dataset
THINGS = {
    "row",
    "trial",
    "sample",
    "switch",
    "selection",
    "evidence",
    "origin",
    "regime",
    "term",
    "level",
    "at",
    "companion",
}


def ball() -> xd.Model:
    """A ball with an uncertain weight that falls past a mark."""
    return xd.Model(
        name="Ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": {"value": "9.81 m s-2", "uncertainty": "0.01 m s-2"}},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}, "drag": {"y": "-1e-3*kilogram/metre*v_y*abs(v_y)"}},
        events={"mark": {"function": "y", "direction": "falling"}},
        initial={"y": "10 m", "v_y": "0 m s-1"},
        run={"method": "dormand_prince", "rtol": 1e-6, "until": "2 s"},
    )


@pytest.fixture(scope="module")
def certificate() -> Any:
    """A certificate of a number whose levels have no order to rely on."""
    return xd.certify(ball(), "t", event="mark", draws=200)


@pytest.fixture(scope="module")
def names(certificate: Any, tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of variables, dimensions and attributes, and words of flags, of every kind of record, with … for quantities."""
    path = tmp_path_factory.mktemp("words") / "run.nc"
    xd.simulate(ball(), path=path)
    run = xd.open_run(path)
    table = {"time [s]": [0.5, 1.0, 1.2], "y [m]": [8.77, 5.09, 2.94], "u(y) [m]": [0.01, 0.01, 0.01]}
    fitted = xd.fit(ball(), pd.DataFrame(table), ["g"])
    every = [
        run,
        certificate,
        fitted,
        xd.refine(ball(), rtols=[1e-4, 1e-5, 1e-6]),
        xd.diagnose(run),
        xd.compare(run, run),
    ]
    every += [xd.sweep(ball(), {"g": "9:10:2 m s-2"}), xd.validate(["midpoint"])]
    found: set[str] = set()
    for record in every:
        found |= {*map(str, record.variables), *map(str, record.dims), *map(str, record.attrs)}
        found |= {word for v in record.variables.values() for word in str(v.attrs.get("flag_meanings", "")).split()}
    return found


@pytest.mark.parametrize("words", [OF_RECORDS, OF_EVIDENCE], ids=["records", "evidence"])
def test_what_is_explained_is_there(words: dict[str, str], names: set[str]) -> None:
    """Assert that each word is a name of a record, a piece of evidence or a flag; … is the quantity y, v_y or kinetic_energy."""
    for word in words.keys() - THINGS:
        spelled = {word.replace("…", quantity) for quantity in ("y", "v_y", "kinetic_energy")}
        assert spelled & names, word


def test_verbs_of_files_are_verbs() -> None:
    """Assert that what is explained by verbs names those there are."""
    assert {"reproduce", "certify", "recheck", "discard"} <= {*main.commands}
    assert {"reproduce", "seal", "segments"} <= {*OF_FILES}


def test_every_verdict_has_its_words_on_the_page() -> None:
    """Assert one line or two for each, within the width, and that `passed` is explained beside pre_asymptotic."""
    assert (*MEANINGS,) == VERDICTS
    page = [*words_page()]
    assert all(any(line.startswith(f"  {verdict} ") for line in page) for verdict in VERDICTS)
    assert max(map(len, page)) <= WIDTH
    assert "pre_asymptotic" in OF_EVIDENCE["passed"]


def test_a_certificate_says_what_its_verdict_means(certificate: Any) -> None:
    """Assert that beside the gate that passed stands what the verdict on its levels means."""
    lines = summary(certificate)
    verdict = VERDICTS[int(certificate["level_verdict"])]
    assert f"levels    {verdict.replace('pre_', 'pre-').replace('_', ' ')}: {MEANINGS[verdict]}" in lines
    assert any(line.startswith("passed    convergence: ") for line in lines)
