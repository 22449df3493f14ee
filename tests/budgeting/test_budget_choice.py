"""Terms of a budget computed alone and left out: the same terms, other totals, and the record that says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches, no_march
from xdynamics.cli import main
from xdynamics.documenting.summary import summary

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ROCKET = xd.Model.from_toml(MODELS / "rocket_c6.toml")
ASKED: dict[str, Any] = {"event": "apex", "method": "rk4", "step": "20 ms", "until": "5 s"}


def rows(budget: xr.Dataset) -> dict[str, list[str]]:
    """All that a budget says of each term by itself, by its name."""
    along = [name for name in budget.data_vars if budget[name].dims == ("term",) and name not in ("share", "term_name")]
    names = budget.term_name.values.tolist()
    return {name: sorted(f"{row}: {budget[row].values[i]}" for row in along) for i, name in enumerate(names)}


@pytest.mark.dear
@pytest.mark.parametrize("compute", [True, False])
def test_a_term_is_the_same_alone_and_with_others(compute: bool) -> None:
    """Assert every term of a budget against the one computed alone, and against one that is left out."""
    whole = rows(xd.error_budget(BALL, "y", **ASKED))
    assert [*whole] == ["truncation", "roundoff", "interpolation", "event_location", "vt"]
    for name, row in whole.items():
        alone = xd.error_budget(BALL, "y", only=name, compute=compute, **ASKED).compute()
        assert rows(alone) == {name: row}
        rest = rows(xd.error_budget(BALL, "y", without=[name], compute=compute, **ASKED).compute())
        assert rest == {key: entry for key, entry in whole.items() if key != name}


@pytest.mark.dear
def test_totals_are_of_what_is_left_and_the_record_says_so() -> None:
    """Assert totals, draws and shares without an input, and what attributes, result and summary say."""
    whole = xd.error_budget(ROCKET, "y", event="apogee", step="5 ms", draws=400)
    part = xd.error_budget(
        ROCKET, "y", event="apogee", step="5 ms", draws=400, without=["drag_coefficient", "roundoff"]
    )
    assert part.attrs["left_out"] == "roundoff, drag_coefficient"
    assert "left_out" not in whole.attrs
    standard = float(whole.standard_uncertainty[whole.term_name.values.tolist().index("airframe")])
    assert float(part.physical_rss) == standard
    assert float(part.monte_carlo_standard_uncertainty) == pytest.approx(standard, rel=0.2)
    assert float(whole.monte_carlo_standard_uncertainty) > 5.0 * standard
    assert float(part.share.sum()) == pytest.approx(1.0)
    assert "(k = 2, without roundoff and drag_coefficient, numerical part" in part.attrs["result"]
    alone = xd.error_budget(ROCKET, "y", event="apogee", step="5 ms", only=["airframe"])
    assert "(k = 2, airframe alone, numerical part 0 m)" in alone.attrs["result"]
    assert any(line.split()[:2] == ["airframe", "physical"] for line in summary(alone))


def test_without_truncation_no_finer_run_is_marched() -> None:
    """Assert one run where interpolation alone is wanted, steps that cannot be finer, and no levels in the record."""
    with marches() as begun:
        budget = xd.error_budget(BALL, "y", at="1 s", only="interpolation", method="rk4", step="20 ms", until="2 s")
    assert len(begun) == 1
    assert "level" not in budget.sizes
    steps: dict[str, Any] = {"at": "1 s", "method": "rk4", "step": [0.25, 0.5, 0.25, 0.5, 0.5], "until": "2 s"}
    with pytest.raises(xd.InputError, match="a step or a tolerance that can be made finer"):
        xd.error_budget(BALL, "y", **steps)
    assert xd.error_budget(BALL, "y", without="truncation", **steps).attrs["left_out"] == "truncation"


@pytest.mark.dear
def test_a_lazy_budget_of_a_part_has_the_bits_of_the_eager_one() -> None:
    """Assert the description while every march fails, and the bits, with draws of the inputs that are left."""
    left_out = ["truncation", "drag_coefficient"]
    asked: dict[str, Any] = {"event": "apogee", "method": "rk4", "step": "20 ms", "draws": 200, "without": left_out}
    with no_march():
        stage = xd.error_budget(ROCKET, "y", compute=False, **asked)
    eager = xd.error_budget(ROCKET, "y", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (
            {"without": ["rounding"]},
            "without names 'rounding', which is no term of this budget; there are truncation, roundoff",
        ),
        ({"only": "wind"}, "only names 'wind', which is no term"),
        ({"only": ["vt"], "without": ["roundoff"]}, "only and without are both given"),
        ({"only": 3}, r"only is '3', needs names of terms, like \['roundoff'\]"),
        ({"without": [1]}, "without is .*, needs names of terms"),
    ],
)
def test_a_choice_that_cannot_be_is_named(choice: dict[str, Any], said: str) -> None:
    """Assert what is said of unknown names, of both choices at once and of what is no name, before a march."""
    with no_march(), pytest.raises(xd.InputError, match=said):
        xd.error_budget(BALL, "y", **choice, **ASKED)


def test_one_term_is_left_at_least() -> None:
    """Assert that a budget of nothing is refused, before a march."""
    names = ["truncation", "roundoff", "interpolation", "event_location", "vt"]
    with no_march(), pytest.raises(xd.InputError, match="no term is left of the budget; there are truncation"):
        xd.error_budget(BALL, "y", without=names, **ASKED)
    with no_march(), pytest.raises(xd.InputError, match="no term is left of the budget"):
        xd.error_budget(BALL, "y", only=[], **ASKED)


def test_a_certificate_has_every_term() -> None:
    """Assert that none can be left out of a certificate."""
    with pytest.raises(xd.InputError, match="a certificate has every term of its number, and without is given"):
        xd.certify(BALL, "y", without=["roundoff"], **ASKED)


def test_the_command_line_leaves_out_and_computes_alone(tmp_path: Path) -> None:
    """Assert options against keywords, and the one line of an unknown name."""
    command = [
        "budget",
        str(MODELS / "ball_drag.toml"),
        "--quantity",
        "y",
        "--event",
        "apex",
        "--method",
        "rk4",
        "--step",
        "20 ms",
    ]
    result = CliRunner().invoke(
        main, [*command, "--without", "roundoff", "--without", "vt", "-o", str(tmp_path / "b.nc")]
    )
    assert result.exit_code == 0, result.output
    kept = xd.open_run(tmp_path / "b.nc")
    asked = {name: entry for name, entry in ASKED.items() if name != "until"}
    assert rows(kept) == rows(xd.error_budget(BALL, "y", without=["roundoff", "vt"], **asked))
    alone = CliRunner().invoke(main, [*command, "--only", "vt"])
    assert (alone.exit_code, "vt alone" in alone.output) == (0, True)
    wrong = CliRunner().invoke(main, [*command, "--without", "rounding"])
    assert wrong.exit_code == 2
    assert "without names 'rounding', which is no term of this budget" in wrong.output
