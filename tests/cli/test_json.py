"""With --json every verb that yields a number prints one object of one form, and nothing else, on standard output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from cases.smooth_models import oscillator
from xdynamics.cli import main
from xdynamics.documenting.guide import guide
from xdynamics.documenting.json_data import json_text

BALL = """\
name = "Ball"
coordinates.y = "m"
parameters = { m = "1 kg", g = { value = "9.81 m s-2", uncertainty = "0.01 m s-2" } }
mass.y = "m"
forces.weight.y = "-m*g"
events.ground = { function = "y", direction = "falling" }
initial = { y = "10 m", v_y = "0 m s-1" }
run = { method = "rk4", step = "50 ms", until = "2 s" }
"""
# verb -> what follows it, and the kind of what it yields
VERBS = {
    "run": ("ball.toml -o other.nc", "run"),
    "extend": ("run.nc --until '3 s' -o longer.nc", "run"),
    "complete": ("states.nc -o whole.nc", "run"),
    "show": ("run.nc", "run"),
    "check": ("ball.toml", "model"),
    "sweep": ("ball.toml --axis 'g=9:10:3 m s-2' -o grid", "sweep"),
    "fit": ("ball.toml bench.csv --parameter g -o fit.nc", "fit"),
    "budget": ("ball.toml --quantity y --event ground -o budget.nc", "budget"),
    "certify": ("ball.toml --quantity t --event ground --draws 0 -o certificate.nc", "certificate"),
    "refine": ("ball.toml --levels 3 -o study.nc", "refinement"),
    "compare": ("run.nc run.nc -o comparison.nc", "comparison"),
    "diagnose": ("run.nc --no-companion -o diagnosis.nc", "diagnosis"),
    "validate": ("--method heun -o ledger.nc", "ledger"),
    "recheck": ("certificate.nc", "certificate"),
    "verify": ("run.nc", "verification"),
    "reproduce": ("run.nc", "reproduction"),
    "table": ("run.nc --of events -o events.csv", "table"),
    "sample": ("run.nc --times '0.1 s, 0.2 s' -o table.csv", "states"),
    "enclose": ("spring.toml --until '0.1 s' --order 8 -o tube.nc", "enclosure"),
    "methods": ("", "methods"),
    "modes": ("ball.toml -o modes.nc", "modes"),
}
# verbs that write files or words, and yield no number
NUMBERLESS = {"animate", "bundle", "discard", "help", "new", "plot", "report", "sign"}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what every verb prints, and where its files are."""
    import os
    import shlex

    folder, before = tmp_path_factory.mktemp("json"), Path.cwd()
    os.chdir(folder)
    try:
        Path("ball.toml").write_text(BALL)
        Path("spring.toml").write_text(oscillator().to_toml())
        rows = [f"{t},{10 - 9.7 / 2 * t**2},2" for t in np.linspace(0.0, 1.2, 13).tolist()]
        Path("bench.csv").write_text("\n".join(["time [s],y [m],u(y) [mm]", *rows]))
        for output, more in (("run.nc", ()), ("states.nc", ("--log", "states"))):
            assert call("run", "ball.toml", "-o", output, *more).exit_code == 0
        outputs = {verb: call(verb, *shlex.split(words), "--json") for verb, (words, _) in VERBS.items()}
    finally:
        os.chdir(before)
    return outputs | {"folder": folder}


def refuse(word: str) -> None:
    """Refuse numbers that JSON does not have."""
    raise AssertionError(word)


@pytest.mark.every(2)
@pytest.mark.parametrize("verb", VERBS)
def test_one_object_alone(verb: str, told: dict[str, Any]) -> None:
    """Assert that standard output is one line of strict JSON, of the kind that the verb yields, with its file."""
    assert told[verb].exit_code in (0, 1)
    assert told[verb].stdout.count("\n") == 1
    data = json.loads(told[verb].stdout, parse_constant=refuse)
    words, kind = VERBS[verb]
    assert data["kind"] == kind
    if " -o " in words:
        assert Path(data["archive"]).name == words.split(" -o ")[1]


def test_every_verb_that_has_it_is_on_the_page() -> None:
    """Assert that the verbs of the page are those with the option, and are all tried here."""
    having = {name for name, verb in main.commands.items() if any("--json" in option.opts for option in verb.params)}
    page = " ".join(guide("json"))
    listed = page.split("These verbs have it: ")[1].split(".")[0]
    assert {*listed.replace(",", " ").split()} == having == {*VERBS}
    assert {*main.commands} - having == NUMBERLESS


@pytest.mark.parametrize("verb", ["fit", "budget", "certify", "refine", "compare", "diagnose", "validate", "sweep"])
def test_show_has_what_the_verb_had(verb: str, told: dict[str, Any]) -> None:
    """Assert that `show --json` of the archive holds the same numbers, units and words, to the last digit."""
    data = json.loads(told[verb].stdout)
    archive = told["folder"] / VERBS[verb][0].split(" -o ")[1]
    shown = json.loads(call("show", archive, "--json").stdout)
    assert shown["variables"] == data["variables"]
    assert (shown["kind"], shown["title"], shown["sizes"]) == (data["kind"], data["title"], data["sizes"])


def test_evidence_is_as_in_its_archive(told: dict[str, Any]) -> None:
    """Assert values to the last bit, units, dimensions, flags by their words, and every attribute but memory's own."""
    data = json.loads(told["refine"].stdout)
    with xd.open_run(told["folder"] / "study.nc") as study:
        for name in ("y", "order_y", "uncertainty_y"):
            held = data["variables"][name]
            values = np.array(held["values"], float)
            assert values.tobytes() == np.asarray(study[name].values, float).tobytes()
            assert (held["dims"], held["units"]) == ([*study[name].dims], study[name].attrs["units"])
        assert data["variables"]["verdict_y"]["values"][0] in study.verdict_y.attrs["flag_meanings"].split()
        assert {*study.attrs} - {*data["attributes"]} <= {
            "title",
            "evidence",
            "origin",
            "content_digest",
            "volatile_digest",
            "variable_digests",
        }


def test_a_run_and_a_fit_say_what_one_asks_for(told: dict[str, Any]) -> None:
    """Assert the estimate and its unit, a parameter with its uncertainty, and the events of a run."""
    fitted, run = (json.loads(told[verb].stdout) for verb in ("fit", "show"))
    estimate = fitted["variables"]["estimate"]["values"]
    assert dict(zip(fitted["variables"]["parameter_name"]["values"], estimate, strict=True))["g"] == pytest.approx(9.7)
    assert fitted["variables"]["parameter_units"]["values"] == ["m s-2"]
    assert run["parameters"]["g"]["uncertainty"] == 0.01
    assert [(event["name"], round(event["time"], 6)) for event in run["events"]] == [("ground", 1.427843)]


def test_check_says_what_a_script_asks_for(told: dict[str, Any]) -> None:
    """Assert equations, reasons why a method refuses, and the time scales."""
    data = json.loads(told["check"].stdout)
    assert data["equations"][:2] == ["motion m*a_y = weight", "force weight of y = -m*g"]
    assert data["parameters"]["g"] == {"value": 9.81, "units": "m s-2", "uncertainty": 0.01}
    assert data["methods"]["rk4"] == {"order": 4, "chooses_steps": False, "refuses": []}
    fastest = data["scales"]["variables"]["fastest_time_scale"]
    assert (fastest["dims"], fastest["units"], fastest["values"]) == ([], "s", "inf")


def test_numbers_that_are_not_finite_have_a_form() -> None:
    """Assert null, "inf" and "-inf", in arrays too, and that finite ones lose no digit."""
    data = {"a": np.array([np.nan, np.inf, -np.inf, 0.1]), "b": np.float64(np.nan), "c": 1e-300}
    assert json_text(data) == '{"a": [null, "inf", "-inf", 0.1], "b": null, "c": 1e-300}'


def test_damage_is_a_verdict(told: dict[str, Any], tmp_path: Path) -> None:
    """Assert that `verify --json` has a verdict for each archive and the exit code of the worst: damage is an answer."""
    bad = tmp_path / "bad.nc"
    bad.write_bytes((told["folder"] / "run.nc").read_bytes()[:-3000])
    done = call("verify", told["folder"] / "run.nc", told["folder"] / "grid", bad, "--json")
    archives = json.loads(done.stdout)["archives"]
    assert (done.exit_code, [entry["verdict"] for entry in archives]) == (1, ["verified", "verified", "damaged"])
    assert "digest" not in archives[2]
    assert archives[2]["text"].startswith(f"damaged  {bad}: ")


def test_errors_leave_standard_output_empty() -> None:
    """Assert that where nothing is made nothing is printed there."""
    done = call("check", MODELS / "nowhere.toml", "--json")
    assert (done.exit_code, done.stdout) == (2, "")


def test_states_and_methods(told: dict[str, Any]) -> None:
    """Assert `sample` to the last bit beside its table, a method alone as in the table of all, and limits of known methods."""
    states = json.loads(told["sample"].stdout)["variables"]
    rows = (told["folder"] / "table.csv").read_text().splitlines()[1:]
    assert [
        f"{t!r},{y!r},{v!r}" for t, y, v in zip(*(states[n]["values"] for n in ("at_time", "y", "v_y")), strict=True)
    ] == rows
    methods = json.loads(told["methods"].stdout)["methods"]
    assert {*methods} == {*xd.METHODS}
    alone = json.loads(call("methods", "velocity_verlet", "--json").stdout)
    assert methods["velocity_verlet"].items() <= alone.items()
    assert (alone["order"], alone["is"], round(alone["oscillation_limit"], 9)) == (2, ["symplectic", "symmetric"], 2.0)
    assert methods["implicit_midpoint"]["oscillation_limit"] == "inf"
    assert json.loads(told["reproduce"].stdout)["attributes"]["identical"] == 1
