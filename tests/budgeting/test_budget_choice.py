"""Terms of a budget computed alone and left out: the same terms, other totals, and the record that says so.

Budgets and certificates described before they are marched: a task for each level, term and block of draws.
Budgets of models with contacts of many links: after an impact, and what is refused.
Budgets over a grid: each member's own, bit for bit, lazily, with a figure and a table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches, no_march
from xdynamics.budgeting.budget_summary import budget_lines
from xdynamics.budgeting.numerical import MetEvents
from xdynamics.cli import main
from xdynamics.documenting.summary import summary
from xdynamics.faults import InputError

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


RK4: dict[str, Any] = {"method": "rk4", "step": "10 ms"}
BUDGETS: dict[str, tuple[xd.Model, str, dict[str, Any]]] = {
    "time": (BALL, "y", {"at": "1 s", **RK4}),
    "event": (BALL, "t", {"event": "apex", "draws": 600}),
    "extreme": (BALL, "maximum_y", {"draws": 100, "terms": xd.Declared("wind", "maximum_y", "1 mm")}),
    "table": (ROCKET, "y", {"event": "apogee", **RK4}),
}


@pytest.mark.every(5)
@pytest.mark.parametrize("case", BUDGETS)
def test_a_lazy_budget_has_the_bits_of_the_eager_one(case: str) -> None:
    """Assert the description while every march fails, one graph, and the bits of the eager budget."""
    model, quantity, asked = BUDGETS[case]
    with no_march():
        stage = xd.error_budget(model, quantity, compute=False, **asked)
    eager = xd.error_budget(model, quantity, **asked)
    assert_described(stage, eager)
    with marches() as begun:
        assert float(stage.value) == float(eager.value)
        marched = len(begun)
        assert_same_bits(stage, eager)
    assert len(begun) == marched
    assert eager.attrs["result"] == str(eager.result.values)
    assert summary(stage.compute())[2:] == summary(eager)[2:]  # the lines before count runs


def test_a_level_is_shared_with_a_refinement_and_draws_are_blocks() -> None:
    """Assert that levels of a budget and of a study are marched once, and that more draws are more tasks."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    study = xd.refine(oscillator, method="rk4", steps=["10 ms", "5 ms"], at=["1 s"], compute=False)
    budget = xd.error_budget(oscillator, "x", at="1 s", compute=False, **RK4)
    with marches() as begun:
        dask.compute(study, budget)
    with marches() as alone:
        budget.value.compute()
    assert len(begun) == len(alone)
    sizes = [
        len(xd.error_budget(BALL, "y", at="1 s", draws=512 * n, compute=False, **RK4).value.__dask_graph__())
        for n in (1, 2, 3)
    ]
    assert sizes[1] - sizes[0] == sizes[2] - sizes[1] < 8


@pytest.mark.parametrize("compute", [True, False])
def test_what_stages_need_is_marched_once(compute: bool) -> None:
    """Assert one march of each step for a run, a study and a budget, one after the other or in one graph."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    asked: dict[str, Any] = {"method": "rk4", "until": "1 s"}
    with marches() as begun:
        run = xd.simulate(oscillator, step=0.02, force_samples="none", compute=False, **asked)
        study = xd.refine(oscillator, steps=[0.02, 0.01], at=["1 s"], compute=compute, **asked)
        budget = xd.error_budget(oscillator, "x", at="1 s", step=0.02, only="truncation", compute=compute, **asked)
        dask.compute(run, study, budget)
    assert sorted(begun) == [f"Harmonic oscillator rk4 {step}" for step in (0.0025, 0.005, 0.01, 0.02)]


def test_draws_that_end_by_themselves_are_refused() -> None:
    """Assert the remedy where the number of draws is known only after drawing."""
    with pytest.raises(xd.InputError, match="give draws=10000, or compute=True"):
        xd.error_budget(BALL, "y", at="1 s", until_uncertainty="1 m", compute=False)


@pytest.mark.dear
def test_a_lazy_certificate_has_the_bits_of_the_eager_one() -> None:
    """Assert a whole certificate: budget, gates and ledger."""
    asked = {"event": "apex", "draws": 200, **RK4}
    with no_march():
        stage = xd.certify(BALL, "t", compute=False, **asked)
    eager = xd.certify(BALL, "t", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)
    assert xd.recheck(eager).attrs["result"] == eager.attrs["result"]


BALLS = xd.Model.from_text("""
name = "bouncing balls"
[dimensions]
ball = 26
[coordinates.y]
unit = "m"
dims = ["ball"]
[parameters]
g = { value = 9.81, unit = "m s-2", uncertainty = 0.01 }
[mass]
y = "1*kilogram"
[forces.weight]
y = "-g*kilogram"
[contacts.floor]
gap = "y"
restitution = 0.8
[initial]
y = "(1 + 0.01*index(ball))*metre"
[run]
method = "dop853"
rtol = 1e-9
until = "0.8 s"
""")


def height(g: float, t: float = 0.7) -> float:
    """Height after the first of its impacts, of a ball let go at 1 m."""
    met = np.sqrt(2.0 / g)
    return float(0.8 * g * met * (t - met) - g * (t - met) ** 2 / 2.0)


@pytest.mark.dear
def test_budget_after_an_impact() -> None:
    """Assert value and share of a parameter's uncertainty against the closed form."""
    budget = xd.error_budget(BALLS, "y[0]", at="0.7 s")
    assert float(budget.value) == pytest.approx(height(9.81), abs=1e-9)
    slope = (height(9.82) - height(9.80)) / 0.02
    assert float(budget.physical_rss) == pytest.approx(abs(slope) * 0.01, rel=1e-5)


@pytest.mark.parametrize("verb", [xd.error_budget, xd.certify])
def test_an_impact_of_many_links_is_no_event_of_a_budget(verb: object) -> None:
    """Assert one sentence with the remedy."""
    with pytest.raises(InputError, match=r"'floor', a contact of many links.*at='1 s'"):
        verb(BALLS, "y[0]", event="floor")  # type: ignore[operator]


def test_contacts_of_many_links_have_no_31_digits() -> None:
    """Assert that a run with sums of two floats is refused, as with contacts that are written out, and so is no twin."""
    with pytest.raises(InputError, match="contacts and frictions, whose impacts and forces are solved in float64"):
        xd.simulate(BALLS, precision="double_double")


BEADS = xd.Model(
    name="beads of unequal masses that strike each other",
    dimensions={"ball": 8},
    relations={"pair": {"of": "ball"}},
    coordinates={"x": {"unit": "m", "dims": ["ball"]}},
    parameters={"m": {"dims": ["ball"], "value": [1.0, 4.0, 2.0, 5.0, 3.0, 1.0, 4.0, 2.0], "unit": "kg"}},
    mass={"x": "m"},
    forces={"springs": {"potential": "50*newton/metre*x**2"}},
    initial={"x": "(0.15*index(ball) - 0.6)*metre", "v_x": "0.1*index(ball)*metre/second"},
    contacts={"balls": {"gap": "second(x, pair) - first(x, pair) - 0.1*metre", "restitution": 1}},
    run={"method": "velocity_verlet", "step": "20 ms"},
)


def test_runs_that_met_other_events_leave_a_number_of_unknown_uncertainty() -> None:
    """Assert infinite terms and totals, no shares, words and a picture that name the events, against numbers of runs."""
    budget = xd.error_budget(BEADS, "x[0]", at=3.0, until=3.0)
    counts = [xd.simulate(BEADS, step=step, until=3.0).sizes["event"] for step in (0.005, 0.0025)]
    assert counts[0] != counts[1]
    assert budget.term_name.values[np.isinf(budget.standard_uncertainty.values)].tolist() == ["truncation"]
    assert np.isnan(budget.share).all()
    assert [float(budget[name]) for name in ("numerical_bound", "numerical_rss", "total_rss")] == [np.inf] * 3
    assert budget.result.item() == f"{budget.value.item():.6g} m, of unknown uncertainty"
    lines = list(budget_lines(budget))
    assert any(line.split()[:3] == ["truncation", "numerical", "unknown"] for line in lines)
    (why,) = (line for line in lines if "did not meet the same events" in line)
    assert f"step_size 0.005 and 0.0025 did not meet the same events (balls {counts[0]} and {counts[1]} times)" in why
    assert any(line.startswith("totals    numerical unknown, at most unknown; physical 0 m;") for line in lines)
    (axes,) = xd.plot(budget).axes
    assert "unknown" in [label.get_text() for label in axes.texts]


def test_runs_that_met_the_same_events_keep_their_uncertainty() -> None:
    """Assert a bound, and that it holds beside a run with a step a hundred times as small."""
    budget = xd.error_budget(BEADS, "x[0]", at=0.3, until=0.3)
    fine = xd.simulate(BEADS, step=0.0002, until=0.3)
    assert 0.0 < abs(float(budget.value - fine.x[-1, 0])) < float(budget.numerical_bound) < 1e-3


def test_an_extreme_after_other_events_is_of_unknown_uncertainty() -> None:
    """Assert it of a largest velocity, which comes after other numbers of impacts in finer runs."""
    assert np.isinf(xd.error_budget(BEADS, "maximum_v_x[1]", until=4.0).total_rss)


@pytest.mark.parametrize(
    ("before", "compared", "expected"),
    [((3, 4), (9, 9), False), ((3, 3), (9, 8), False), ((3, 4), (9, 8), True)],
)
def test_equal_extremes_at_other_times_are_not_apart(
    before: tuple[int, int], compared: tuple[int, int], expected: bool
) -> None:
    """Assert that both the events before the number and those of the runs have to differ in number."""
    one, other = (MetEvents({"floor": count}, whole) for count, whole in zip(before, compared, strict=True))
    assert one.are_apart(other) is expected


GRID_ASKED: dict[str, Any] = {"rtol": 1e-8, "method": "dormand_prince"}
WANTED: dict[str, Any] = {"quantity": "t", "event": "ground", "without": "roundoff"}


@pytest.fixture(scope="module")
def sweep() -> xr.Dataset:
    """Balls thrown at two speeds, with two terminal speeds that are uncertain."""
    return xd.sweep(BALL, {"v_y": "10:20:2 m s-1", "vt": "20:40:2 m s-1"}, **GRID_ASKED)


def test_each_is_the_budget_of_its_member(sweep: xr.Dataset) -> None:
    """Assert every number of a member's budget against the budget of its model, bit for bit."""
    found = xd.error_budget(sweep, **WANTED)
    assert found.value.dims == ("v_y", "vt")
    assert found.standard_uncertainty.dims == ("v_y", "vt", "term")
    assert found.vt.attrs["units"] == "m s-1"
    for i, j in ((0, 1), (1, 0)):
        model = BALL.replace(initial={"v_y": float(sweep.v_y[i])}, parameters={"vt": float(sweep.vt[j])})
        alone, member = xd.error_budget(model, **WANTED, **GRID_ASKED), found.isel(v_y=i, vt=j)
        for name, one in alone.data_vars.items():
            if name in member and one.dtype.kind in "fi":
                np.testing.assert_array_equal(member[name].values, one.values, err_msg=str(name))
        assert str(member.result.values) == alone.attrs["result"]
    assert (found.physical_rss.diff("v_y") > 0.0).all()


def test_it_is_lazy_and_computed_part_by_part(sweep: xr.Dataset) -> None:
    """Assert dask arrays of all names and units before anything is marched, and one budget's tasks for one member."""
    lazy = xd.error_budget(sweep, compute=False, **WANTED)
    assert lazy.total_rss.chunks is not None
    assert lazy.term_name.values.tolist() == ["truncation", "interpolation", "event_location", "vt"]
    assert lazy.value.attrs["units"] == "s"
    one = float(lazy.total_rss.isel(v_y=1, vt=0))
    assert one == float(xd.error_budget(sweep, **WANTED).total_rss[1, 0])


def test_it_has_lines_a_table_and_figures(sweep: xr.Dataset) -> None:
    """Assert a row a member with the terms by name, a map of each total, and a band over one axis."""
    found = xd.error_budget(sweep, **WANTED)
    table = found.dynamics.table()
    assert len(table) == 4
    assert "standard_uncertainty[vt] [s]" in table.columns
    assert "physical vt" in repr(found.dynamics)
    titles = [axis.get_title(loc="left") for axis in xd.plot(found).axes if axis.get_title(loc="left")]
    assert titles == [
        "time of ground",
        *(f"{word} standard uncertainty" for word in ("numerical", "physical", "total")),
    ]
    band = xd.plot(found.isel(vt=0))
    assert [axis.get_title(loc="left") for axis in band.axes] == [
        "time of ground, vt = 20 m s-1",
        "terms; dashed: numerical",
    ]
    words = xd.sweep(BALL, {"method": ["heun", "rk4"]}, step="20 ms")
    points = xd.plot(xd.error_budget(words, **WANTED))
    assert [label.get_text() for label in points.axes[0].get_yticklabels()] == ["heun", "rk4"]


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown number": ({"quantity": "z"}, "quantity is 'z'; there are y, v_y"),
    "a setting": ({"step": 0.1}, "step cannot be given for a sweep, whose members have their settings"),
    "doubled draws": ({"until_uncertainty": "1 s at 95 %"}, "until_uncertainty cannot be given for a sweep"),
    "no such event": ({"event": "wall"}, "wall"),
    "an unknown term": ({"without": "noise"}, "noise"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_named(case: str, sweep: xr.Dataset) -> None:
    """Assert one clear error, before anything is marched."""
    more, words = WRONG[case]
    with pytest.raises(xd.InputError) as caught:
        xd.error_budget(sweep, **(WANTED | more))
    assert words in str(caught.value)
