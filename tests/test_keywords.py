"""Settings of a march: the same on the command line, as keywords, in a model file, and back from a record."""

from __future__ import annotations

import inspect
import tomllib
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main
from xdynamics.keywords import IN_FILES, KEYWORDS, RECORD, Keyword, read_log_columns, read_number
from xdynamics.record.arguments import recorded_arguments
from xdynamics.units import parse_unit

MODEL = xd.Model(
    name="swing",
    coordinates={"x": {"unit": "m"}},
    parameters={"m": "1 kg", "k": "4 N m-1"},
    mass={"x": "m"},
    forces={"spring": {"potential": "k*x**2/2"}, "kink": {"x": "-0.1*newton*where(x > 0*metre, 1, 0)"}},
    initial={"x": "1 m", "v_x": "0 m s-1"},
)
# each setting as a keyword, and as the command line has it; what goes together stands in one case
CASES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "chosen": (
        {
            "method": "dop853",
            "until": "2 s",
            "step": "1 ms",
            "rtol": 1e-7,
            "atol": {"x": "1 um"},
            "estimator": "embedded",
            "safety": 0.8,
            "growth_limits": (0.3, 5.0),
            "min_step": "1 ns",
            "max_step": "0.1 s",
            "max_steps": 5000,
            "time_tolerance": "1 ns",
            "switches": "located",
            "scales": {"length": "2 m"},
            "force_samples": "none",
            "nodes": ["0.5 s", "1 s"],
        },
        [
            "--method",
            "dop853",
            "--until",
            "2 s",
            "--step",
            "1 ms",
            "--rtol",
            "1e-7",
            "--atol",
            "x=1 um",
            "--estimator",
            "embedded",
            "--safety",
            "0.8",
            "--growth-limits",
            "0.3,5",
            "--min-step",
            "1 ns",
            "--max-step",
            "0.1 s",
            "--max-steps",
            "5000",
            "--time-tolerance",
            "1 ns",
            "--switches",
            "located",
            "--scale",
            "length=2 m",
            "--force-samples",
            "none",
            "--node",
            "0.5 s",
            "--node",
            "1 s",
        ],
    ),
    "grid": (
        {
            "method": "velocity_verlet",
            "until": "2 s",
            "step": "1 ms",
            "summation": "compensated",
            "keep_every": 10,
            "log": ["x"],
            "compress": True,
            "math_functions": "xdynamics 1",
            "event_root_method": "one by one",
            "event_start": "waiting",
            "sliding": "ends",
        },
        [
            "--method",
            "velocity_verlet",
            "--until",
            "2 s",
            "--step",
            "1 ms",
            "--summation",
            "compensated",
            "--keep-every",
            "10",
            "--log",
            "x",
            "--compress",
            "--math-functions",
            "xdynamics 1",
            "--event-root-method",
            "one by one",
            "--event-start",
            "waiting",
            "--sliding",
            "ends",
        ],
    ),
    "stiff": (
        {"method": "radau_iia", "until": "2 s", "rtol": 1e-6, "jacobian": "differences"},
        ["--method", "radau_iia", "--until", "2 s", "--rtol", "1e-6", "--jacobian", "differences"],
    ),
    "digits": (
        {"method": "taylor", "until": "2 s", "rtol": 1e-20, "precision": "double_double"},
        ["--method", "taylor", "--until", "2 s", "--rtol", "1e-20", "--precision", "double_double"],
    ),
    "series": (
        {"method": "taylor", "until": "2 s", "rtol": 1e-9, "order": 20, "atol_floor": "none"},
        ["--method", "taylor", "--until", "2 s", "--rtol", "1e-9", "--order", "20", "--atol-floor", "none"],
    ),
}


def attributes(run: Any) -> dict[str, str]:
    """What a record says was used."""
    said = ("solver_", "math_functions", "run_outcome", "model_digest")
    told = {key: str(value) for key, value in run.attrs.items() if key.startswith(said)}
    return told | {"content": xd.content_digest(run)}


def test_every_setting_is_in_a_case() -> None:
    """Assert that the cases here have every setting of the table, and with options of the same names."""
    assert {name for asked, _ in CASES.values() for name in asked} == {*KEYWORDS}
    for asked, options in CASES.values():
        assert {KEYWORDS[name].flag for name in asked} == {option for option in options if option.startswith("--")}


@pytest.mark.every(2)
@pytest.mark.parametrize("case", CASES)
def test_options_are_keywords(case: str, tmp_path: Path) -> None:
    """Assert that a run by options is one by keywords, one by a model file's [run], and one by what its record says."""
    asked, options = CASES[case]
    by_keywords = xd.simulate(MODEL, **asked)
    file = tmp_path / "swing.toml"
    file.write_text(MODEL.to_toml())
    done = CliRunner().invoke(main, ["run", str(file), "-o", str(tmp_path / "run.nc"), *options])
    assert done.exit_code == 0, done.output
    assert attributes(xd.open_run(tmp_path / "run.nc")) == attributes(by_keywords)
    assert attributes(xd.simulate(MODEL, **recorded_arguments(by_keywords))) == attributes(by_keywords)
    inside = {name: value for name, value in asked.items() if name in IN_FILES}
    outside = {name: value for name, value in asked.items() if name not in IN_FILES}
    filed = xd.Model(**tomllib.loads(MODEL.to_toml()) | {"run": inside})
    own = {"model_digest", "content"}  # of the file, whose [run] is part of its model
    by_file = attributes(xd.simulate(xd.Model.from_text(filed.to_toml()), **outside))
    assert {key: value for key, value in by_file.items() if key not in own} == {
        key: attribute for key, attribute in attributes(by_keywords).items() if key not in own
    }


@pytest.mark.parametrize("keyword", KEYWORDS.values(), ids=KEYWORDS)
def test_defaults_are_among_the_words(keyword: Keyword) -> None:
    """Assert that where words are listed, what holds without one begins with one of them."""
    words = [word.strip('" ') for word in keyword.takes.split(" | ")] if " | " in keyword.takes else [""]
    assert keyword.default.startswith(tuple(words)) or keyword.name == "estimator"
    assert keyword.value_form == (keyword.takes or keyword.kind)


@pytest.mark.parametrize(
    ("name", "value", "read"),
    [
        ("safety", "0.8", 0.8),
        ("max_steps", 5e3, 5000),
        ("growth_limits", np.array([0.3, 5.0]), (0.3, 5.0)),
        ("growth_limits", ["0.3", 5], (0.3, 5.0)),
        ("compress", True, True),
        ("method", "rk4", "rk4"),
        ("min_step", "2 ms", 2e-3),
        ("atol", "1 um", "1 um"),
    ],
)
def test_values_are_read(name: str, value: Any, read: Any) -> None:
    """Assert what a march is given for a value; what is read with the model is left as it is."""
    found = KEYWORDS[name].read(value, parse_unit("s"))
    assert (found, type(found)) == (read, type(read))


@pytest.mark.parametrize(
    ("given", "read"), [("full", "full"), ("states", "states"), (["x", "v_x", "x"], ("x", "v_x")), (("x",), ("x",))]
)
def test_columns_are_read(given: Any, read: Any) -> None:
    """Assert a word for many columns, or names, each once."""
    assert read_log_columns(given) == read


def test_a_tolerance_for_one_variable_is_a_table() -> None:
    """Assert that an absolute tolerance with a unit is told how to be written, and no other number is."""
    with pytest.raises(
        xd.InputError, match=r"^atol is '1 um', needs a number; for one variable write \{'y': '1 um'\}$"
    ):
        read_number("1 um", "atol")
    with pytest.raises(xd.InputError, match=r"^safety is '1 um', needs a number$"):
        read_number("1 um", "safety")


@pytest.mark.parametrize("given", [[], ["x", 3], {"x": 1}, 7])
def test_wrong_columns(given: Any) -> None:
    """Assert that what is neither a word nor a list of names is refused."""
    with pytest.raises(xd.InputError, match=r"^log is .*, needs 'full', 'states' or a list of variables, like \['x'"):
        read_log_columns(given)


@pytest.mark.parametrize("verb", ["run", "refine", "sweep", "budget", "certify", "fit"])
def test_verbs_that_march_take_them_all(verb: str) -> None:
    """Assert that every verb that marches has every setting as an option; those of records where there is one."""
    known = {option.name for option in main.commands[verb].params if isinstance(option, click.Option)}
    records = {name for name, keyword in KEYWORDS.items() if keyword.group == RECORD}
    assert known >= {*KEYWORDS} - (set() if verb in ("run", "sweep") else records)


def test_simulate_has_the_table_s_order() -> None:
    """Assert that the keywords of `simulate` are those of the table, in its order, and that each is explained."""
    names = [name for name in inspect.signature(xd.simulate).parameters if name in KEYWORDS]
    assert names == [*KEYWORDS]
    told = str(xd.simulate.__doc__).split("Returns\n")[0]
    heads = [line.strip().split(" :")[0] for line in told.splitlines() if line.startswith("    ") and line[4:5].strip()]
    explained = {name.strip() for head in heads for name in head.split(",")}
    assert explained >= {*KEYWORDS}


def test_the_help_gathers_what_belongs_together() -> None:
    """Assert that the help of a verb has a section for each group, with the words that an option takes."""
    told = CliRunner().invoke(main, ["run", "--help"], terminal_width=200).output
    at = [
        told.index(f"\n{name}:\n")
        for name in ("Options", "Integration", "Step control", "Events", "Arithmetic", "Record")
    ]
    assert at == sorted(at)
    assert "--switches located|landed on|stepped over" in told
    assert told.index("--safety") > told.index("\nStep control:\n")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("safety", "brave", "safety is 'brave', needs a number"),
        ("max_steps", 1.5, "max_steps is 1.5, needs a whole number"),
        ("max_steps", True, "max_steps is True, needs a number"),
        ("growth_limits", 3.0, r"growth_limits are 3.0, need two factors, like \(0.2, 10\)"),
        ("growth_limits", "0.2", r"growth_limits are '0.2', need two factors"),
        ("growth_limits", "12", r"growth_limits are '12', need two factors"),
        ("growth_limits", (0.2, 1.5, 10.0), r"growth_limits are \(0.2, 1.5, 10.0\), need two factors"),
        ("growth_limits", {0.2: 1, 10.0: 2}, r"growth_limits are \{0.2: 1, 10.0: 2\}, need two factors"),
        ("compress", "yes", "compress is 'yes', needs true or false"),
        ("estimator", 3, "estimator is 3, needs a word"),
        ("min_step", "1 m", "min_step '1 m' has units 'm', needs 's'"),
        ("rtol", "small", "rtol is 'small', needs a number$"),
        ("log", 7, r"log is 7, needs 'full', 'states' or a list of variables"),
    ],
)
def test_wrong_values_are_told_alike(name: str, value: Any, message: str) -> None:
    """Assert that a wrong value is refused in the same words as a keyword and in a model file."""
    with pytest.raises(xd.InputError, match=message):
        xd.simulate(MODEL, **{"method": "dop853", "until": "1 s", "rtol": 1e-6, name: value})
    if name != "rtol":
        with pytest.raises(xd.ModelError, match=message):
            xd.Model(**tomllib.loads(MODEL.to_toml()) | {"run": {name: value}})
