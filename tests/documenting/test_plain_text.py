"""What a checked model says of itself in lines of text.

Limits that pages of help name are those of the code.
The line of a summary about forces of velocities that drive a motion.
The summary of a run with many numbers shows some of them, and says how many more there are.
The glossary names what records and evidence hold, and says what a verdict on convergence means wherever one is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import pandas as pd
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.documenting.guide import guide
from xdynamics.documenting.manual import manual_text
from xdynamics.documenting.plain_text import model_lines
from xdynamics.documenting.summary import summary
from xdynamics.evidence.refining.convergence import MEANINGS, VERDICTS
from xdynamics.march.configuration import settings_for
from xdynamics.march.simd_ensemble import LARGEST_ROW
from xdynamics.methods import METHODS
from xdynamics.model.file_access import LARGEST, LARGEST_RECORDED, LARGEST_TABLE, MOST_RECORDED, MOST_VALUES
from xdynamics.model.model import LARGEST_FILE
from xdynamics.record import unfolding

ROAD = """name = "Wheel on a road"
coordinates = {{ x = {{ unit = "m" }}, z = {{ unit = "m" }} }}
parameters = {{ m = "45 kg", k = "200 kN m-1" }}
mass = {{ x = "m", z = "m" }}
forces.tyre.z = "k*(road - z)"
drives.road = {{ table = "road.csv", argument = "x", outside = "hold", csv = '''x [m],road [m]
{rows}''' }}
initial = {{ x = "0 m", v_x = "15 m s-1", z = "0 m" }}
"""
LINKS = """name = "Two links"
[bodies.upper]
mass = "1 kg"
inertia = ["1 g m2", "80 g m2", "80 g m2"]
points = { end = ["0.5 m", "0 m", "0 m"] }
initial.position = ["0.5 m", "0 m", "0.1 m"]
[bodies.lower]
mass = "1 kg"
inertia = ["1 g m2", "80 g m2", "80 g m2"]
initial.position = ["1.5 m", "0 m", "0 m"]
[joints.hip]
hinge = ["space", "upper"]
at = [["0 m", "0 m", "0 m"], ["-0.5 m", "0 m", "0 m"]]
axis = [0, 0, 1]
[joints.knee]
ball = ["upper", "lower"]
at = ["end", ["-0.5 m", "0 m", "0 m"]]
[constraints.plane]
holds = "lower_r[z]"
[initial]
consistent = true
"""
LATE = """name = "Late spring"
coordinates.x.unit = "m"
parameters = { m = "1 kg", k = "4 N m-1" }
mass.x = "m"
forces.spring.x = "-k*delayed(x, '0.2 s')"
initial.x = "1 m"
"""

ROW = """name = "Row of springs"
dimensions.site = 3
coordinates.x = {{ unit = "cm", dims = ["site"] }}
coordinates.z = {{ unit = "m", dims = ["site"] }}
coordinates.y.unit = "m"
states.s = {{ unit = "1", rate = "1/second" }}
parameters = {{ m = "1 kg", k = "4 N m-1", l = "0.1 m" }}
mass = {{ x = "m", y = "m", z = "m" }}
forces.spring.x = "-k*x"
[initial]
x = "{x}"
y = "{y}"
v_y = "0.30000000000000004 m s-1"
s = "l/metre*3"
z = {{ unit = "m", value = [1, 2, 0.30000000000000004] }}
"""


@pytest.mark.parametrize(("points", "fate"), [(20, "located"), (150, "landed on")])
def test_fate_of_switches_is_that_of_a_run(points: int, fate: str) -> None:
    """Assert that kinks of short tables are said to be located, and those of long ones landed on, as a run does by default."""
    rows = "".join(f"{0.1 * row!r},{0.01 * (row % 3)!r}\n" for row in range(points))
    model = xd.Model.from_text(ROAD.format(rows=rows))
    said = [line for line in model_lines(model) if line.startswith("switches")]
    assert len(said) == 1
    assert f"tyre.road: kinks and jumps inside forces, which are {fate}" in said[0]
    assert settings_for(model, method="dop853", until="1 s").switches == fate


def _listed_methods(lines: Iterable[str]) -> set[str]:
    listed = [line.partition(": ")[2] for line in lines if line.startswith("methods ")]
    return {item.split()[0] for line in listed for item in line.split(", ")}


def test_methods_that_take_delays_are_those_that_march_them() -> None:
    """Assert that a method is offered for delayed values just where settings with it are accepted."""
    model = xd.Model.from_text(LATE)
    offered = _listed_methods(model_lines(model))
    accepted = set()
    for name in METHODS:
        try:
            settings_for(model, method=name, step="10 ms", until="1 s").check(model)
        except xd.InputError:
            continue
        accepted.add(name)
    assert offered == accepted
    assert {"dop853", "rk4", "velocity_verlet"} <= accepted
    assert not {"taylor", "radau_iia", "yoshida6"} & accepted


KINDS = {
    "contacts of many links": "granular_box",
    "another law of impacts": "newtons_cradle_sequential",
    "Poisson's law with friction": "woodpecker",
    "dry friction": "stick_slip_belt",
    "a controller": "cart_pid",
    "states alone": "heat",
    "constraints": "four_bar",
    "links in a row": "links_pendulum",
    "forces alone": "kepler",
}


@pytest.mark.parametrize("name", KINDS.values(), ids=KINDS)
def test_methods_that_take_a_model_are_those_that_begin(name: str) -> None:
    """Assert that a method is listed where a march by it begins, and refused with the same reason where none does."""
    model = xd.Model.from_toml(f"data/models/{name}.toml")
    lines = [*model_lines(model)]
    listed = _listed_methods(lines)
    reasons = {
        one: reason
        for line in lines
        if line.startswith("not by ")
        for names, _, reason in [line.removeprefix("not by").strip().partition(": ")]
        for one in names.split(", ")
    }
    assert listed | reasons.keys() == METHODS.keys()
    for method in METHODS:
        settings = {"method": method, "step": model.run.get("step", "1 ms"), "until": model.run["until"]}
        if method in listed:
            assert settings_for(model, **settings).method.name == method
        else:
            with pytest.raises(xd.InputError, match=re.escape(reasons[method])):
                settings_for(model, **settings)


def test_joints_are_named_in_the_motion() -> None:
    """Assert that what joints and bodies stand for is named, not written out, what a user wrote is, and that starts move."""
    lines = list(model_lines(xd.Model.from_text(LINKS)))
    assert "motion    upper_mass*a_upper_r[x] = joint hip + joint knee" in lines
    assert "motion    lower_mass*a_lower_r[z] = (1)*constraint_force_plane + joint knee" in lines
    assert "constraint plane holds: lower_r[z] = 0" in lines
    assert "joint     hip: hinge of space and upper, about [0, 0, 1] in space; has hip_angle, v_hip_angle" in lines
    assert "body      upper: turns, with the attitude upper_q0, upper_q; points upper_end" in lines
    assert not [line for line in lines if line.startswith(("with ", "rate "))]
    assert next(line for line in lines if line.startswith("start ")).endswith(
        "; moved from there to where constraints hold"
    )


ROUGH = """
name = "rough balls"
[dimensions]
ball = 50
[relations.pair]
of = "ball"
neighbours = 1
[coordinates]
x = { unit = "m", dims = ["ball"] }
y = { unit = "m", dims = ["ball"] }
[parameters]
m = "1 kg"
[mass]
x = "m"
y = "m"
[contacts.balls]
gap = "second(y, pair) - first(y, pair)"
restitution = 0
tangential = "coulomb"
slip = "second(v_x, pair) - first(v_x, pair)"
friction = 0.3
[initial]
x = "0*metre"
y = "index(ball)*metre"
"""


@pytest.mark.parametrize(
    ("old", "new", "count"),
    [
        ("", "", 1),
        ("ball = 50", "ball = 49", 0),
        ('tangential = "coulomb"', 'tangential = "coulomb"\nlaw = "poisson"', 0),
    ],
)
def test_heaps_are_advised_to_step_over_impacts(old: str, new: str, count: int) -> None:
    """Assert that of fifty bodies that rub, and no fewer, Moreau's method is named before the march, if it takes them."""
    lines = [one for one in model_lines(xd.Model.from_text(ROUGH.replace(old, new))) if one.startswith("heap ")]
    assert len(lines) == count
    assert all("50 bodies may rub against each other by contact 'balls'" in one for one in lines)
    assert all(one.endswith("method = moreau_jean steps over them") for one in lines)


@pytest.mark.parametrize(
    ("y", "said"),
    [
        ("3*l", "0.3 m"),
        ("l/3", "0.0333333333333 m"),
        ("3e-20*l", "3e-21 m"),
        ("0.30000000000000004 m", "0.30000000000000004 m"),
        ("0.12345678901234567890123 m", "0.12345678901234567890123 m"),
    ],
)
def test_starts_are_as_written_or_without_what_rounding_leaves(y: str, said: str) -> None:
    """Assert all digits of starts that are written, and 12 of those that expressions give, also to each element."""
    model = xd.Model.from_text(ROW.format(x="l*(1 + index(site))", y=y))
    assert repr(model.initial["x·2"].value) == "30.000000000000004"
    (start,) = [line for line in model_lines(model) if line.startswith("start")]
    parts = dict(part.split(" = ") for part in start.removeprefix("start").strip().split(", "))
    assert [parts[f"x[{i}]"] for i in range(3)] == ["10.0 cm", "20.0 cm", "30.0 cm"]
    assert parts["y"] == said
    assert parts["s"] == "0.3"
    assert (parts["v_y"], parts["z[2]"]) == ("0.30000000000000004 m s-1", "0.30000000000000004 m")


def test_limits_of_tables_and_model_files() -> None:
    """Assert the sizes in `xdynamics help files`."""
    table, file, text = (f"{limit / 1e6:g} MB" for limit in (LARGEST_TABLE, LARGEST_FILE, LARGEST_RECORDED))
    page = " ".join(manual_text("files.md").split())
    assert LARGEST == LARGEST_FILE
    assert f"A table may have {table}" in page
    assert f"A model file may have {file} and {MOST_VALUES:,} numbers" in page
    assert f"may have {text} and {MOST_RECORDED:,} numbers" in page


def test_limits_of_runs_side_by_side() -> None:
    """Assert the width in `xdynamics help grids`."""
    assert f"over {LARGEST_ROW:,} numbers a row" in " ".join(manual_text("sweeps.md").split())


def lines(drag: str) -> list[str]:
    """What a summary says of the work of drag on a ball thrown up, that falls down again."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2", "c": "0.05 kg m-1"},
        mass={"y": "m"},
        forces={"weight": {"potential": "m*g*y"}, "drag": {"y": drag}},
        initial={"y": "0 m", "v_y": "20 m s-1"},
    )
    run = xd.simulate(ball, method="dop853", rtol=1e-9, until="3 s")
    return [line for line in summary(run) if line.startswith("work")]


@pytest.mark.parametrize(("drag", "where"), [("-c*v_y**2", " where v_y < 0"), ("c*v_y*metre/second", "")])
def test_drag_with_a_wrong_sign_is_said(drag: str, where: str) -> None:
    """Assert that drag of one sign is said to drive a falling ball, and one of the other sign to drive it always."""
    (line,) = lines(drag)
    assert line.startswith("work      drag did +")
    assert f"J of work on the motion{where}: drag would take it" in line


def test_drag_that_brakes_is_no_remark() -> None:
    """Assert no line for drag against the velocity, in either direction."""
    assert not lines("-c*v_y*abs(v_y)")


BALLS = """
name = "balls"
[dimensions]
ball = {balls}
axis = ["across", "up"]
[relations.pair]
of = "ball"
neighbours = 1
[coordinates]
r = {{ unit = "m", dims = ["ball", "axis"] }}
[mass]
r = "1*kilogram"
[events.floor]
function = "r[2, up]"
[events.balls]
function = "norm(second(r, pair) - first(r, pair), axis) - 2*metre"
[initial]
r = "3*metre*(index(ball) + 1)*(1 - index(axis)) + 1*metre*index(axis)"
v_r = "where(index(ball) < 1, 1, 0)*(1 - index(axis))*metre/second - where(index(ball) > 1, 1, 0)*index(axis)*metre/second"
[run]
method = "velocity_verlet"
step = "250 ms"
until = "1.5 s"
"""


@lru_cache
def run(balls: int) -> xr.Dataset:
    """Return a run in which ball 0 comes near ball 1, and ball 2 and those beyond fall."""
    return xd.simulate(xd.Model.from_text(BALLS.format(balls=balls)))


def line_of(lines: list[str], begin: str) -> str:
    """Return the line that begins so."""
    return next(line for line in lines if line.startswith(begin))


def test_an_event_shows_what_met() -> None:
    """Assert that of 20 numbers an event shows those of its two balls, and the end twelve of them."""
    lines = summary(run(5))
    met = line_of(lines, "event     balls")
    assert [name in met for name in ("r[0, across]", "v_r[1, up]", "r[2,", "r[4,")] == [True, True, False, False]
    assert met.endswith(", and 12 numbers more in the record")
    end = line_of(lines, "end")
    assert end.count("[") == 12
    assert end.endswith(", and 8 numbers more in the record")


@pytest.mark.parametrize(("balls", "numbers"), [(3, 12), (4, 12)])
def test_a_short_state_is_whole(balls: int, numbers: int) -> None:
    """Assert that twelve numbers are all shown, and of an event that names no element the first twelve."""
    floor = line_of(summary(run(balls)), "event     floor")
    assert floor.count("[") == numbers
    assert (" more in the record" in floor) == (balls > 3)


CHAIN = """
name = "chain"
[dimensions]
site = 40
axis = ["x", "y"]
[coordinates]
w = { unit = "m" }
u = { unit = "m", dims = ["site", "axis"] }
[mass]
w = "kilogram"
u = "kilogram"
[forces.springs]
w = "-kilogram/second**2*w"
u = "-kilogram/second**2*u"
[initial]
w = "2 m"
u = "metre*index(site)"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "0.5 s"
"""


def test_numbers_that_are_not_shown_are_not_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run of very many numbers has the lines of any other, of as many variables as are shown."""
    chain, parted = xd.simulate(xd.Model.from_text(CHAIN)), list[int]()
    usual = summary(chain)
    unfold = unfolding.unfold

    def counted(run: xr.Dataset) -> xr.Dataset:
        unfolded = unfold(run)
        parted.append(len(unfolded.variables))
        return unfolded

    monkeypatch.setattr(unfolding, "unfold", counted)
    monkeypatch.setattr("xdynamics.documenting.summary.MOST_PARTED", 100)
    assert summary(chain) == usual
    assert line_of(usual, "end").endswith(", and 150 numbers more in the record")
    assert len(unfold(chain).variables) > 300
    assert [number < 150 for number in parted] == [True]


def test_columns_that_no_line_shows_are_not_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of forces and accelerations of elements no variables are made for a description."""
    chain, names = xd.simulate(xd.Model.from_text(CHAIN)), set[str]()
    unfold = unfolding.unfold

    def noted(run: xr.Dataset) -> xr.Dataset:
        unfolded = unfold(run)
        names.update(map(str, unfolded.variables))
        return unfolded

    monkeypatch.setattr(unfolding, "unfold", noted)
    summary(chain)
    assert {"u·39·y", "v_u·39·y", "a_w"} <= names
    assert not any(name.startswith(("a_u", "force_springs_u")) for name in names)


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
    staged = xd.Model.from_toml(MODELS / "staged_rocket.toml")  # with a reset
    every += [xd.sweep(model, {"g": "9:10:2 m s-2"}) for model in (ball(), staged)]
    every += [xd.validate(["midpoint"])]
    found: set[str] = set()
    for record in every:
        found |= {*map(str, record.variables), *map(str, record.dims), *map(str, record.attrs)}
        found |= {word for v in record.variables.values() for word in str(v.attrs.get("flag_meanings", "")).split()}
    return found


def glossary_words(title: str) -> dict[str, str]:
    """Return the words of a part of the glossary, each with its meaning."""
    part = manual_text("glossary.md").partition(f"## {title}\n")[2].partition("\n## ")[0]
    return dict(re.findall(r"^\| `([^`]+)` \| (.+) \|$", part, re.MULTILINE))


@pytest.mark.parametrize("title", ["Of records", "Of accuracy"])
def test_what_is_explained_is_there(title: str, names: set[str]) -> None:
    """Assert that each word is a name of a record, a piece of evidence or a flag; … is the quantity y, v_y or kinetic_energy."""
    words = glossary_words(title)
    assert len(words) > 20
    for word in words.keys() - THINGS:
        spelled = {word.replace("…", quantity) for quantity in ("y", "v_y", "kinetic_energy")}
        assert spelled & names, word


def test_verbs_of_files_are_verbs() -> None:
    """Assert that what is explained by verbs names those there are."""
    assert {"reproduce", "certify", "recheck", "discard"} <= {*main.commands}
    assert {"reproduce", "seal", "segments"} <= {*glossary_words("Of files and verbs")}


def test_every_verdict_has_its_words_on_the_page() -> None:
    """Assert one line or two for each, and that `passed` is explained beside pre_asymptotic."""
    assert (*MEANINGS,) == VERDICTS
    page = [*guide("glossary")]
    assert all(any(line.startswith(f"  {verdict} ") for line in page) for verdict in VERDICTS)
    assert "pre_asymptotic" in glossary_words("Of accuracy")["passed"]


def test_a_certificate_says_what_its_verdict_means(certificate: Any) -> None:
    """Assert that beside the gate that passed stands what the verdict on its levels means."""
    lines = summary(certificate)
    verdict = VERDICTS[int(certificate["level_verdict"])]
    assert f"levels    {verdict.replace('pre_', 'pre-').replace('_', ' ')}: {MEANINGS[verdict]}" in lines
    assert any(line.startswith("passed    convergence: ") for line in lines)
