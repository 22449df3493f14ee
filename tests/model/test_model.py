"""Models: TOML without loss, faults gathered, drives, Python forces."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import CubicSpline, PchipInterpolator

import xdynamics as xd
from cases.problems import MODELS, particle
from cases.python_forces import stiff_push
from xdynamics.model import Table, Trait, traits_of
from xdynamics.model.drives import piece_coefficients

FILES = sorted(MODELS.glob("*.toml"))
GOOD = (MODELS / "ball_drag.toml").read_text()


@pytest.mark.parametrize("path", FILES, ids=lambda one: one.stem)
def test_toml_round_trip_loses_nothing(path: Path) -> None:
    """Assert that a model written and read again says the same, tables included."""
    model = xd.Model.from_toml(path)
    again = xd.Model.from_text(model.to_toml())
    assert again == model
    assert again.digest == model.digest
    assert all(again.drives[name].table.text == drive.table.text for name, drive in model.drives.items())


def test_python_statement_equals_file() -> None:
    """Assert that the same sections in Python give the same model."""
    assert xd.Model(**tomllib.loads(GOOD)) == xd.Model.from_text(GOOD)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"-c*v_y*abs(v_y)"',
            '"-c*v_y"',
            r"force 'drag' of 'y' has units 'kg s-1', needs 'kg m s-2 \(N\)' \(column 1: -c\*v_y\)",
        ),
        ('unit = "m s-1", uncertainty', 'unit = "m # s", uncertainty', "parameter 'vt': unit 'm # s' cannot be read"),
        ("value = 0.145", "value = nan", "parameter 'm': quantity nan is not finite"),
        ('"-c*v_y*abs(v_y)"', '"-c*v_z*abs(v_y)"', "name 'v_z' .* is not declared; did you mean 'v_y'"),
        (
            'direction = "falling"\naction = "record"',
            'direction = "down"',
            "direction 'down' is not known; there are rising, falling",
        ),
        ('y = "0 m"', "", "initial value of 'y' is missing; write .initial. y = .0 m., or what it is"),
        ('v_y = "20 m s-1"', 'v_y = "20 m"', "initial value 'v_y = 20.0 m' has units 'm', needs 'm s-1'"),
        ('action = "stop"', 'action = "impact"', "event 'ground': key 'restitution' is missing"),
        ('[mass]\ny = "m"', "[mass]", "mass: of coordinate 'y' is missing"),
        ('time_tolerance = "1e-12 s"', 'time_tolerance = "-1 s"', "time_tolerance is '-1.0 s', needs a positive time"),
        ("[run]", '[contacts.floor]\ngap = "y"\n[run]', "contact 'floor': key 'restitution' is missing"),
        ("[run]", '[forcess.x]\ny = "0"\n[run]', r"\[forcess\] is no section; did you mean 'forces'"),
        (
            'c = "m*g/vt**2"',
            'c = "m*g/vt**2"\nspeed = "v_y*other"\nother = "speed"',
            "definitions speed, other are defined by one another",
        ),
        ('potential = "m*g*y"', 'potential = "m*g*y*v_y"', "potential of 'gravity' depends on a velocity"),
        ('step = "1 ms"', 'stepp = "1 ms"', r"\[run\] has no setting 'stepp'; did you mean 'step'"),
        ("g = {", "time = {", "parameter 'time' and the record both claim the name 'time'"),
        ("g = {", "second = {", "the name 'second' is a word of the expression language"),
        ("uncertainty = 1,", "uncertainty = -1,", "needs to be non-negative"),
    ],
)
def test_fault_is_named(old: str, new: str, message: str) -> None:
    """Assert that a fault is named with its value and what was needed."""
    assert old in GOOD
    with pytest.raises(xd.ModelError, match=message):
        xd.Model.from_text(GOOD.replace(old, new, 1))


def test_duplicate_key_is_refused() -> None:
    """Assert that TOML's refusal of duplicate keys is ours, with the line."""
    with pytest.raises(xd.ModelError, match="no TOML"):
        xd.Model.from_text(GOOD.replace("[mass]\n", '[mass]\ny = "m"\n'))


def test_all_faults_come_at_once() -> None:
    """Assert that the faults of one file are one error."""
    broken = GOOD.replace('"m*g*y"', '"m*g"').replace("-c*v_y", "-c").replace('y = "0 m"', 'y = "0 s"')
    with pytest.raises(xd.ModelError, match="has 3 faults") as caught:
        xd.Model.from_text(broken)
    assert len(caught.value.faults) == 3


@pytest.mark.parametrize("path", [Path("nowhere.toml"), MODELS])
def test_unreadable_file(path: Path) -> None:
    """Assert that a missing file and a directory are named."""
    with pytest.raises(xd.ModelError, match="cannot be read|is a directory"):
        xd.Model.from_toml(path)


def test_replace_keeps_the_unit_of_a_bare_number() -> None:
    """Assert that parameters and initial values can be changed, and nothing unknown."""
    model = xd.Model.from_text(GOOD).replace(parameters={"m": 0.2, "vt": "100 km/h"}, initial={"v_y": 10})
    assert str(model.parameters["m"].quantity) == "0.2 kg"
    assert model.parameters["vt"].quantity.si == pytest.approx(27.7777777777777)
    assert model.initial["v_y"].si == 10.0
    with pytest.raises(xd.ModelError, match="parameters has no entry 'mass'; there are: m, g, vt"):
        model.replace(parameters={"mass": 1})


@pytest.mark.parametrize(
    "number", [np.float64(0.2), np.array(0.2), xr.DataArray(0.2)], ids=lambda one: type(one).__name__
)
def test_replace_takes_numbers_of_numpy_and_xarray(number: object) -> None:
    """Assert that one number is one number, whatever library it comes from."""
    model = xd.Model.from_text(GOOD)
    for section, name in (("parameters", "m"), ("initial", "v_y")):
        assert model.replace(**{section: {name: number}}).digest == model.replace(**{section: {name: 0.2}}).digest


def test_traits_name_the_culprit() -> None:
    """Assert that a drive of a coordinate counts as that coordinate."""
    assert Trait.VELOCITY_DEPENDENT not in traits_of(xd.Model.from_toml(MODELS / "cart_spring.toml"))
    assert traits_of(xd.Model.from_text(GOOD)) == {Trait.VELOCITY_DEPENDENT: "force 'drag' of 'y' depends on v_y"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("time [s],thrust [N]\n", "has 0 rows, needs 2"),
        (
            "time,thrust\n0,1\n1,2",
            r"line 1 \(separated by commas(?s:.*)column 'time': it has no unit; write it like 'time .s.'",
        ),
        ("time [s],thrust [N]\n0,1\n0,2", "line 3: argument 0.0 does not increase after 0.0"),
        (
            "# a note\ntime [s],thrust [N]\n0,1\n1,nan",
            "line 4: column 'thrust .N.' has a gap; fill it, or leave such lines out with gaps = \"skip\"",
        ),
        ("time [s],thrust [N]\n0,1\n1;2", "line 3, '1;2' …, has 1 cells, the header 2"),
        ("time [s],thrust [N]\n0,1\n1,two", "line 3: 'two' is no number"),
        ("time [s],thrust [N]\n0,1\n1,2,3", "line 3, '1' …, has 3 cells, the header 2"),
        ("time [s],thrust [N]\n0,1\n" + "secret" * 9 + ",2", "line 3: 'secretsecretsecretsecret…' is no number"),
        ("time [s],thrust [bananas]\n0,1\n1,2", "unit 'bananas' is not known"),
        (
            "time [s],thrust [N],more [1]\n0,1,2\n1,2,3",
            "has 2 columns of values: say which with column = .thrust.; it is separated by commas, columns",
        ),
    ],
)
def test_faulty_table_is_refused_by_line(text: str, message: str) -> None:
    """Assert that a table's fault is named with its line."""
    with pytest.raises(xd.InputError, match=message):
        Table.parse("thrust.csv", text)


ARGUMENT, VALUE = np.array([0.0, 1.0, 2.5, 3.0, 4.0]), np.array([1.0, 3.0, 2.0, 2.0, 5.0])


@pytest.mark.parametrize(
    ("rule", "reference"),
    [
        ("linear", lambda x: np.interp(x, ARGUMENT, VALUE)),
        ("pchip", PchipInterpolator(ARGUMENT, VALUE)),
        ("cubic", CubicSpline(ARGUMENT, VALUE)),
        ("previous", lambda x: VALUE[np.searchsorted(ARGUMENT, x, side="right") - 1]),
    ],
)
def test_compiled_table_agrees_with_scipy(rule: str, reference: object) -> None:
    """Assert that the pieces, as compiled code evaluates them, are scipy's interpolant."""
    from xdynamics.kernels import drive_tables

    flat, places = drive_tables.concatenated_tables([piece_coefficients(ARGUMENT, VALUE, rule, "zero")])
    points = np.linspace(0.0, 3.999, 97)

    def piece(x: float) -> int:
        return drive_tables.PYTHON_TABLES["_find_piece"](flat, places, x, 0)

    def value(x: float, number: int) -> float:
        return drive_tables.PYTHON_TABLES["_value_at"](flat, places, x, number, 0)

    mine = [value(x, piece(x)) for x in points]
    assert np.allclose(mine, reference(points), rtol=1e-14, atol=1e-14)
    assert [piece(x) for x in (-0.1, 4.1, 4.0)] == [0, 5, 4]
    assert value(-0.1, 0) == value(9.0, 5) == 0.0


def test_drive_of_the_wrong_argument_unit() -> None:
    """Assert that a table in seconds cannot be a drive of a position."""
    table = {"table": "r.csv", "csv": "time [s],force [N]\n0,1\n1,2\n", "argument": "x"}
    with pytest.raises(xd.ModelError, match="first column of 'r.csv' is in 's', its argument 'x' in 'm'"):
        particle("pull", drives={"pull": table})


def other_push(x: float, F: float) -> float:  # noqa: ARG001
    """Another force under the same arguments."""
    return F


def test_python_force_is_recorded_and_compared() -> None:
    """Assert that a Python force runs like its expression, keeps its source, and comes back only with its digest."""
    by_function = particle(stiff_push)
    by_text = particle("F - 40*newton/metre**3*x*x*x")
    runs = [xd.simulate(one, method="velocity_verlet", step=0.01, until=1.0) for one in (by_function, by_text)]
    assert (runs[0].x.values == runs[1].x.values).all()
    assert "return F - 40.0 * x * x * x" in str(runs[0].force_source.values)
    text = by_function.to_toml()
    assert xd.Model.from_text(text, functions={"stiff_push": stiff_push}) == by_function
    with pytest.raises(xd.ModelError, match="hand them over"):
        xd.simulate(xd.Model.from_text(text), method="velocity_verlet", step=0.01, until=1.0)
    with pytest.raises(xd.ModelError, match="has digest"):
        xd.Model.from_text(text, functions={"stiff_push": other_push})


def test_python_force_that_asks_for_the_unknown() -> None:
    """Assert that an undeclared argument is named."""

    def pull(z: float) -> float:
        return z

    with pytest.raises(xd.ModelError, match="function 'pull' asks for 'z', which is not declared"):
        particle(pull)


HOSTILE_NAMES = [
    '"""+str(open("pwned", "w"))+"""',
    "'''\"\"\"\nopen('pwned', 'w')\n",
    "{open('pwned','w')}",
    "\\",
    "%s",
]


@pytest.mark.parametrize("text", HOSTILE_NAMES)
def test_no_text_of_a_model_reaches_the_generated_code(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that name and descriptions are never part of what is compiled."""
    monkeypatch.chdir(tmp_path)
    plain = xd.simulate(particle(), method="midpoint", step=0.5, until=1.0)
    described = {"name": text, "description": text, "coordinates": {"x": {"unit": "m", "description": text}}}
    run = xd.simulate(particle(**described), method="midpoint", step=0.5, until=1.0)
    assert run.force_source.values == plain.force_source.values
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        (
            {"parameters": {"m": {"value": "2 kg", "unit": "g"}, "F": "5 N"}},
            "'2 kg' has a unit already, and 'g' stands beside it",
        ),
        ({"parameters": {"m": "1e308 km", "F": "5 N"}}, "is not finite in SI units|needs"),
        ({"parameters": {"m": 10**400, "F": "5 N"}}, "is no number with a unit"),
        ({"parameters": {"lambda": "1 kg"}}, "'lambda' is a word of Python"),
        (
            {"coordinates": {"description": "m"}, "mass": {"description": "m"}, "forces": {}},
            "'description' is a key of the model file",
        ),
        ({"forces": {"push": {"description": "nothing"}}}, "needs a potential or a component"),
        ({"forces": {"push": {"x": {"function": [1], "digest": "0"}}}}, "needs texts"),
        ({"mass": {"matrix": [1]}}, "matrix needs 1 rows"),
        ({"run": {"step": "foo"}}, r"\[run\]: step: quantity 'foo'"),
        ({"run": {"scales": "1 m"}}, "scales are '1 m', need a table"),
        ({"events": {f"e{n}": {"function": "x"} for n in range(101)}}, "has 101 events, 100 at most"),
        ({"definitions": {f"d{n}": f"d{n + 1} + 1" for n in range(900)} | {"d900": "1"}}, "nested too deeply"),
        (
            {"definitions": {"d": "m*v_x**2"}, "forces": {"push": {"potential": "d"}}},
            "potential of 'push' depends on a velocity",
        ),
        ({"initial": {"x": 0, "v_x": "1 m s-1"}}, "write the unit after the number"),
        ({"name": "a\0b"}, "not printable"),
    ],
)
def test_statement_that_cannot_be_marched(sections: dict[str, object], message: str) -> None:
    """Assert that every wrong section ends in one model error, and no other."""
    with pytest.raises(xd.ModelError, match=message):
        particle(**sections)


def test_mass_matrix_must_be_symmetric() -> None:
    """Assert that entries that differ across the diagonal are shown."""
    with pytest.raises(xd.ModelError, match=r"entry \(1, 2\) is 'm', \(2, 1\) is '0\*m'"):
        xd.Model(
            name="skew",
            coordinates={"x": "m", "z": "m"},
            parameters={"m": "1 kg"},
            mass={"matrix": [["2*m", "m"], ["0*m", "m"]]},
            initial={"x": "0 m", "v_x": "0 m s-1", "z": "0 m", "v_z": "0 m s-1"},
        )


def test_replacing_a_unit_keeps_the_uncertainty() -> None:
    """Assert that an uncertainty keeps its own unit when the value gets another."""
    statement = GOOD.replace('value = 0.145, unit = "kg"', 'value = 0.145, unit = "kg", uncertainty = 0.001')
    model = xd.Model.from_text(statement).replace(parameters={"m": "150 g"})
    part = model.parameters["m"]
    assert part.quantity.si == 0.15
    assert part.spread is not None
    assert part.spread.standard.si == 0.001
    assert xd.Model.from_text(model.to_toml()) == model


def test_python_force_with_a_closure_is_refused() -> None:
    """Assert that a function whose source does not tell all it uses is refused, as are two of one name."""
    k = 3.0

    def pull(x: float) -> float:
        return -k * x

    with pytest.raises(xd.ModelError, match="function 'pull' takes k from around it"):
        particle(pull)


TABLED = """
name = "driven"
[coordinates]
x = { unit = "m" }
[parameters]
m = "1 kg"
[mass]
x = "m"
[drives.pull]
table = "TABLE"
[forces.pull]
x = "pull"
[initial]
x = "0 m"
v_x = "0 m s-1"
"""
ROWS = "time [s],pull [N]\n0,0\n1,2\n"


def tabled(folder: Path, table: str) -> Path:
    """Write a model file with a table into a folder of its own, a table beside that, and links."""
    (folder / "model" / "below").mkdir(parents=True)
    for path in (folder / "out.csv", folder / "model" / "in.csv", folder / "model" / "below" / "in.csv"):
        path.write_text(ROWS)
    (folder / "model" / "inward.csv").symlink_to(folder / "model" / "below" / "in.csv")
    (folder / "model" / "outward.csv").symlink_to(folder / "out.csv")
    (folder / "model" / "away").symlink_to(folder)
    path = folder / "model" / "driven.toml"
    path.write_text(TABLED.replace("TABLE", table.replace("HERE", str(folder))))
    return path


@pytest.mark.parametrize("table", ["in.csv", "below/in.csv", "./in.csv", "inward.csv"])
def test_a_model_file_takes_tables_from_below_it(tmp_path: Path, table: str) -> None:
    """Assert that a table in the file's folder and below is read, links within it included."""
    assert xd.Model.from_toml(tabled(tmp_path, table)).drives["pull"].table.value.tolist() == [0.0, 2.0]


@pytest.mark.parametrize(
    "table", ["HERE/out.csv", "HERE/model/in.csv", "../out.csv", "below/../in.csv", "outward.csv", "away/out.csv"]
)
def test_no_table_out_of_reach_is_opened(tmp_path: Path, table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what lies elsewhere is refused unopened, and is read where everything is allowed."""
    path = tabled(tmp_path, table)
    with monkeypatch.context() as patch:
        opened = os.open
        patch.setattr(os, "open", lambda name, *how: opened(name, *how) if name == path else pytest.fail("opened"))
        with pytest.raises(xd.ModelError, match="out of reach") as caught:
            xd.Model.from_toml(path)
    assert "--tables anywhere" in str(caught.value)
    assert xd.Model.from_toml(path, tables="anywhere").drives["pull"].table.value.tolist() == [0.0, 2.0]


def test_a_text_takes_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an archive's model has its tables in it or none, and that Python may name any file."""
    path = tabled(tmp_path, "in.csv")
    monkeypatch.chdir(path.parent)
    with pytest.raises(xd.ModelError, match="table 'in.csv' is not in the text"):
        xd.Model.from_text(path.read_text())
    named = xd.Model(**tomllib.loads(path.read_text().replace("in.csv", str(tmp_path / "out.csv"))))
    assert xd.Model.from_text(named.to_toml()) == named


@pytest.mark.parametrize("what", ["pipe", "folder", "missing", "bytes", "large"])
def test_a_table_that_is_no_file(tmp_path: Path, what: str) -> None:
    """Assert that each is one error at once, without a word of what it holds."""
    path, table = tabled(tmp_path, "it.csv"), tmp_path / "model" / "it.csv"
    act = {
        "pipe": lambda: os.mkfifo(table),
        "folder": table.mkdir,
        "missing": lambda: None,
        "bytes": lambda: table.write_bytes(b"secret\x00\xff"),
        "large": lambda: os.truncate(table, 1 << 40),
    }
    if what == "large":
        table.touch()
    act[what]()
    with pytest.raises(xd.ModelError, match="no regular file|cannot be read|is not in|has over") as caught:
        xd.Model.from_toml(path)
    assert "secret" not in str(caught.value)
    why = {
        "pipe": "a pipe",
        "folder": "directory",
        "missing": "is not in",
        "bytes": "no UTF-8 text",
        "large": "limit",
    }
    assert why[what] in str(caught.value)


def test_what_tables_may_be(tmp_path: Path) -> None:
    """Assert that a word that is none is refused."""
    with pytest.raises(xd.InputError, match="tables is 'all'; there are below, anywhere"):
        xd.Model.from_toml(tabled(tmp_path, "in.csv"), tables="all")
