"""The command line: lines a person reads, exit codes a script reads."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS, ROOT
from xdynamics.cli import main

BALL = str(MODELS / "ball_drag.toml")
PILE = str(MODELS / "rough_pile.toml")


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archived throw."""
    path = tmp_path_factory.mktemp("cli") / "ball.nc"
    assert call("run", BALL, "-o", path, "--step", "5 ms").exit_code == 0
    return path


def test_run_says_what_a_person_wants_first(tmp_path: Path) -> None:
    """Assert outcome, events, energy and the file, in that order."""
    done = call("run", BALL, "-o", tmp_path / "ball.nc", "--step", "5 ms")
    assert done.exit_code == 0
    words = [line.split()[0] for line in done.output.splitlines() if not line.startswith(" ")]
    assert words[:5] == ["Ball", "outcome", "remark", "method", "log"]
    assert words[5:] == ["end", "energy", "resolved", "event", "event", "archive"]
    assert max(map(len, done.output.splitlines())) <= 140
    assert "outcome   event 'ground' stopped the run at t = " in done.output


def test_settings_reach_the_record(tmp_path: Path) -> None:
    """Assert that method, step, end, changes and samples are what is recorded."""
    path = tmp_path / "ball.nc"
    done = call(
        "run",
        BALL,
        "-o",
        path,
        "--method",
        "forward_euler",
        "--step",
        "0.01 s",
        "--until",
        "1 s",
        "--set",
        "vt=25",
        "--set",
        "v_y=15 m s-1",
        "--force-samples",
        "none",
        "--scale",
        "length=2 m",
    )
    assert done.exit_code == 0, done.output
    run = xd.open_run(path)
    assert run.attrs["solver_method"] == "forward_euler"
    assert (run.attrs["solver_step"], run.attrs["solver_until"], run.attrs["solver_length_scale"]) == (0.01, 1.0, 2.0)
    assert (float(run.vt), float(run.v_y[0])) == (25.0, 15.0)
    assert "sample" not in run.sizes


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nowhere.toml", "-o", "x.nc"], "cannot be read"),
        (["run", BALL, "-o", "."], "is a directory"),
        (["run", BALL, "-o", "x.nc", "--method", "velocity_verlet"], "these fit"),
        (["run", BALL, "-o", "x.nc", "--step", "1 m"], "needs 's'"),
        (["run", BALL, "-o", "x.nc", "--rtol", "1e-20"], "rtol is 1e-20, needs a number from 10 eps"),
        (["run", BALL, "-o", "x.nc", "--atol", "1e-9", "--atol", "1e-8"], "--atol is given 2 times without a name"),
        (["run", BALL, "-o", "x.nc", "--atol", "y=1 s"], "atol of 'y' is '1 s', needs the unit 'm'"),
        (["run", BALL, "-o", "x.nc", "--rtol", "1e-6", "--estimator", "guess"], "there are none, embedded"),
        (["run", BALL, "-o", "x.nc", "--step", "-1 ms"], "needs a positive time"),
        (["run", BALL, "-o", "x.nc", "--set", "mass=3"], "no such parameter"),
        (
            ["run", BALL, "-o", "x.nc", "--set", "until=3"],
            "no such parameter or initial value: give --until; there are",
        ),
        (["run", PILE, "-o", "x.nc", "--set", "nothing=3"], "pitch, move, radius, t, x, v_x and 4 more\n"),
        (["run", PILE, "-o", "x.nc", "--set", "x=3"], "'x' has the elements x[0], x[1], x[2], … x[23]: name one"),
        (["run", BALL, "-o", "x.nc", "--set", "m"], "needs NAME=VALUE"),
        (["run", BALL, "-o", "x.nc", "--set", "m=1 s"], "has units"),
        (["run", BALL, "-o", "x.nc", "--set", "m=nan"], "does not start with a finite number"),
        (["run", BALL, "-o", "x.nc", "--set", "m=1", "--set", "m=2"], "twice"),
        (["run", BALL, "-o", "x.nc", "--scale", "width=1 m"], "scale 'width' is not known"),
        (["show", "nowhere.nc"], "does not exist"),
        (["run", BALL], "It names what is written, like -o run.nc"),
    ],
)
def test_wrong_input_is_one_line_and_two(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert exit code 2, one message, no traceback, nothing written."""
    monkeypatch.chdir(tmp_path)
    done = call(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output
    assert list(tmp_path.iterdir()) == []


def test_tolerances_reach_the_record(tmp_path: Path) -> None:
    """Assert that a bare atol is for every variable, a named one for its own, and that the end says so."""
    path = tmp_path / "ball.nc"
    done = call(
        "run",
        BALL,
        "-o",
        path,
        "--rtol",
        "1e-8",
        "--atol",
        "1e-9",
        "--atol",
        "y=1 um",
        "--max-step",
        "0.1 s",
        "--until",
        "1 s",
    )
    assert done.exit_code == 0, done.output
    assert "adaptive, rtol 1e-08" in done.output
    run = xd.open_run(path)
    assert (run.y.attrs["atol_si"], run.v_y.attrs["atol_si"], run.attrs["solver_rtol"]) == (1e-6, 1e-9, 1e-8)
    assert run.attrs["solver_max_step"] == 0.1
    assert call("reproduce", path).exit_code == 0


def test_a_model_file_reaches_no_further_than_its_folder(tmp_path: Path) -> None:
    """Assert that a table elsewhere is refused without a word of it, and taken where that is asked for."""
    (tmp_path / "model").mkdir()
    path = tmp_path / "model" / "cart.toml"
    path.write_text((MODELS / "cart_spring.toml").read_text().replace("cart_spring.csv", "/etc/passwd"))
    refused = call("run", path, "-o", tmp_path / "x.nc")
    assert refused.exit_code == 2
    assert "table '/etc/passwd' is out of reach" in refused.output
    assert "root" not in refused.output
    (tmp_path / "rows.csv").write_text((MODELS / "cart_spring.csv").read_text())
    path.write_text((MODELS / "cart_spring.toml").read_text().replace("cart_spring.csv", "../rows.csv"))
    assert call("run", path, "-o", tmp_path / "x.nc").exit_code == 2
    assert call("run", path, "-o", tmp_path / "x.nc", "--tables", "anywhere").exit_code == 0


@pytest.mark.filterwarnings("always::xdynamics.faults.StabilityWarning")
def test_an_unstable_step_is_warned_of_in_one_line(tmp_path: Path) -> None:
    """Assert that the warning goes to the error stream and the run is made all the same."""
    model = MODELS / "harmonic_oscillator.toml"
    done = call("run", model, "-o", tmp_path / "x.nc", "--step", "1.2 s")
    assert done.exit_code == 0
    assert done.stderr.startswith("xdynamics: warning: step 1.2 s is beyond the stability limit 1 s")
    assert len(done.stderr.splitlines()) == 1


def test_bad_end_is_one(tmp_path: Path) -> None:
    """Assert that a run that ended badly is archived and exits with 1."""
    done = call(
        "run", MODELS / "cart_spring.toml", "-o", tmp_path / "far.nc", "--set", "x=19 cm", "--set", "v_x=3 m s-1"
    )
    assert done.exit_code == 1
    assert "outside drive table: at t = " in done.output
    xd.verify(tmp_path / "far.nc")


def test_show_names_everything(ball: Path) -> None:
    """Assert parameters with uncertainty, settings and digests."""
    short, shown = call("show", ball).output, call("show", ball, "--all").output
    assert "equations, settings and digests with --all" in short
    assert "vt = 30 ± 1 m s-1   terminal speed" in short
    assert "content_digest" not in short
    for part in (
        "vt = 30 ± 1 m s-1   terminal speed",
        "solver_update_equations = qm = q",
        "content_digest = ",
        "math_functions = xdynamics 2",
    ):
        assert part in shown


def test_verify_reproduce_compare(ball: Path, tmp_path: Path) -> None:
    """Assert exit codes of the checks: 0 for what holds, 1 for what does not."""
    other = tmp_path / "other.nc"
    assert call("run", BALL, "-o", other, "--step", "10 ms").exit_code == 0
    assert call("verify", ball, other).exit_code == 0
    assert "every bit the same" in call("reproduce", ball).output
    assert call("compare", ball, ball).exit_code == 0
    apart = call("compare", ball, other)
    assert apart.exit_code == 1
    assert "setting   solver_step: 0.005 | 0.01" in apart.output
    other.write_bytes(other.read_bytes()[:-5000])
    assert call("verify", ball, other).exit_code == 1


def test_plot_writes_a_figure(ball: Path, tmp_path: Path) -> None:
    """Assert that the figure is there, and another ending refused."""
    assert call("plot", ball, "-o", tmp_path / "ball.png").exit_code == 0
    assert (tmp_path / "ball.png").stat().st_size > 20_000
    assert call("plot", ball, "-o", tmp_path / "ball.gif").exit_code == 2


@pytest.mark.dear
def test_plot_without_a_name_writes_beside_the_archive(ball: Path, tmp_path: Path) -> None:
    """Assert that the figure is called after the archive, beside it, and that the line says where."""
    archive = tmp_path / "ball.of.5ms.nc"
    archive.write_bytes(ball.read_bytes())
    done = call("plot", archive)
    assert (done.exit_code, done.output) == (0, f"figure    {tmp_path / 'ball.of.5ms.png'}\n")
    assert (tmp_path / "ball.of.5ms.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("simulate ball.toml", "xdynamics run ball.toml -o ball.nc"),
        ("simulate ball.toml -o b.nc --step '1 ms'", "xdynamics run ball.toml -o b.nc --step '1 ms'"),
        ("ball.toml", "xdynamics run ball.toml -o ball.nc"),
        ("ball.nc", "xdynamics show ball.nc"),
        ("draw ball.nc", "xdynamics plot ball.nc"),
        ("Plot ball.nc", "xdynamics plot ball.nc"),
        ("plto ball.nc", "xdynamics plot ball.nc"),
        ("convergence ball.toml", "xdynamics refine ball.toml"),
    ],
)
def test_a_verb_that_is_not_there_leads_to_the_one_that_is(typed: str, meant: str) -> None:
    """Assert that the message has the whole command that was meant."""
    refused = call(*shlex.split(typed))
    assert refused.exit_code == 2
    assert f"did you mean `{meant}`?" in refused.output


def test_a_word_like_no_verb_lists_them() -> None:
    """Assert that of a word like none of them all verbs are listed, and none is guessed."""
    refused = call("frobnicate", "ball.toml")
    assert refused.exit_code == 2
    assert "there is no verb 'frobnicate'; there are animate, budget, bundle" in refused.output


def test_help_takes_verbs() -> None:
    """Assert that `help VERB` is the verb's own page, also by another word for it; a section's page names the verb."""
    assert call("help", "plot").output == call("plot", "--help").output
    assert "run [OPTIONS] MODEL.toml" in call("help", "simulate").output
    both = call("help", "fit").output
    assert both.startswith("[fit]\n")
    assert both.endswith("the verb of that name: xdynamics fit --help\n")
    assert "did you mean 'events'?" in call("help", "eventz").output


def test_methods_prints_the_table() -> None:
    """Assert a line for every method between a title and two hints, and of each a page with order, update, and what stands between its steps."""
    table = call("methods").output.splitlines()
    assert len(table) == len(xd.METHODS) + 3
    for line, method in zip(table[1:], xd.METHODS.values(), strict=False):
        assert line.split()[:2] == [method.name, str(method.order)]
        page = call("methods", method.name).output
        assert f"{method.name}: order {method.order}" in page
        assert method.equations() in page
        assert (
            f"between   re-integration, order {method.order}; or {method.interpolant.words}, order {method.interpolant.order}"
            in page
        )
    unknown = call("methods", "rk5")
    assert (unknown.exit_code, "method 'rk5' is not known; did you mean 'dormand_prince'?" in unknown.output) == (
        2,
        True,
    )


def test_every_verb_has_an_example() -> None:
    """Assert that each help ends with an example, whose options the verb has."""
    for name, command in main.commands.items():
        shown = call(name, "--help").output
        example = next(
            (line.strip() for line in shown.splitlines() if line.strip().startswith(f"xdynamics {name} ")), ""
        )
        assert example, name
        options = {opt for parameter in command.params for opt in parameter.opts}
        used = {word for word in example.split() if word.startswith("-") and not word[1:2].isdigit()}
        assert used <= options, name


def test_quiet_and_json(tmp_path: Path) -> None:
    """Assert that nothing is printed, or one object that a script reads; errors stay."""
    path = tmp_path / "ball.nc"
    assert call("run", BALL, "-o", path, "--step", "5 ms", "--quiet").output == ""
    done = call("run", BALL, "-o", path, "--step", "5 ms", "--json")
    told = json.loads(done.output)
    assert (told["outcome"], told["archive"], told["units"]["v_y"]) == ("stopped_by_event", str(path), "m s-1")
    assert [event["name"] for event in told["events"]] == ["apex", "ground"]
    assert {
        key: load for key, load in json.loads(call("show", path, "--json").output).items() if key != "content_digest"
    } == {key: value for key, value in told.items() if key not in ("archive", "content_digest")}
    assert "needs 's'" in call("run", BALL, "-o", path, "--step", "1 m", "--quiet").output


def test_many_events_are_one_line(tmp_path: Path) -> None:
    """Assert that of a hundred bounces the first, how many, and how far apart are told."""
    done = call("run", MODELS / "bouncing_ball.toml", "-o", tmp_path / "b.nc")
    events = [line for line in done.output.splitlines() if line.startswith("event")]
    assert len(events) < 5
    assert "floor (impact): 99 times, the last at t = " in done.output
    assert "floor (rest) at t = " in done.output
    shortened = re.search(
        r"1201 rows, 0 rejected trials, 100 events, 1201 force samples; (\d+) steps shortened to find", done.output
    )
    assert shortened
    assert 100 <= int(shortened[1]) <= 900


def test_start_imports_little() -> None:
    """Assert that the root, the help and a plain run do not import what they do not need."""
    heavy = {"numpy", "xarray", "numba", "pint", "dask", "matplotlib", "sympy", "pandas", "scipy"}
    script = "import sys; import xdynamics; from click.testing import CliRunner; from xdynamics.cli import main; print({0}); print(*sys.modules)"
    for command, absent in (("0", heavy), ("CliRunner().invoke(main, ['--help']).exit_code", heavy)):
        loaded = subprocess.run(
            [sys.executable, "-c", script.format(command)], capture_output=True, text=True, check=True
        ).stdout
        assert not absent & set(loaded.split()), command


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("output", "code", "said"),
    [
        ("/dev/full", 2, "'/dev/full' is a device; name a file"),
        ("/proc/run.nc", 1, "'/proc/run.nc' cannot be written: No such file or directory"),
    ],
)
def test_a_place_for_no_file_ends_a_run_at_once(output: str, code: int, said: str) -> None:
    """Assert exit code and cause, whatever is asked for; of a device before anything that marches is imported."""
    verb = ["run", BALL, "--method", "rk4", "--step", "1 ns", "-o", output]
    script = f"import sys; from xdynamics.cli import main; main({verb!r})"
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", script], capture_output=True, text=True, timeout=100, check=False
    )
    lines = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    assert (done.returncode, said in "\n".join(lines)) == (code, True)
    assert ("llvmlite" in done.stderr) == (code == 1)


LABELLED = """
name = "two beads"
[dimensions]
bead = ["left", "right"]
[coordinates]
x = { unit = "m", dims = ["bead"] }
[mass]
x = "kilogram"
[forces.spring]
x = "-kilogram/second**2*x"
[initial]
x = "metre"
"""


def modules_after(commands: list[list[str]]) -> set[str]:
    """Run commands in one new process, without a fault; return the names of all modules that it has imported."""
    script = (
        "import sys, json; from click.testing import CliRunner; from xdynamics.cli import main; "
        "print(*(CliRunner().invoke(main, run).exit_code for run in json.loads(sys.argv[1]))); print(*sys.modules)"
    )
    new_process = [sys.executable, "-c", script, json.dumps(commands)]
    codes, modules = subprocess.run(
        new_process, capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.splitlines()
    assert codes.split() == ["0"] * len(commands)
    return {*modules.split()}


def test_looking_at_a_run_imports_no_dask(tmp_path: Path) -> None:
    """Assert that xarray is given no reason to import dask, which takes half a second, by verbs that compute nothing lazily."""
    archive, picture = str(tmp_path / "ball.nc"), str(tmp_path / "ball.png")
    assert call("run", BALL, "--until", "1 s", "-o", archive).exit_code == 0
    looks = [["check", str(BALL)], ["show", archive], ["table", archive], ["plot", archive, "-o", picture]]
    asks = [["diagnose", archive], ["reproduce", archive], ["compare", archive, archive]]
    assert "dask.array" not in modules_after(looks + asks)


def test_a_plain_run_imports_none_of_the_dear_libraries(tmp_path: Path) -> None:
    """Assert that runs whose machine code is kept, labels or not, need neither numba, a third of their start, nor others."""
    beads = tmp_path / "beads.toml"
    beads.write_text(LABELLED)
    runs = [["run", str(model), "--method", "rk4", "--step", "5 ms", "--until", "0.1 s"] for model in (BALL, beads)]
    for k, run in enumerate(runs):
        assert call(*run, "-o", tmp_path / f"{k}.nc").exit_code == 0
        run += ["-o", str(tmp_path / f"{k} again.nc")]
    assert not {"numba", "dask", "matplotlib", "sympy", "cf_xarray", "pint"} & modules_after(runs)


def test_second_process_compiles_nothing(tmp_path: Path) -> None:
    """Assert that a second process takes the machine code from the cache, where compilations would be counted."""
    script = (
        "import sys\nimport numba\nfrom numba.core import event\nseen = event.RecordingListener()\n"
        "from click.testing import CliRunner\nfrom xdynamics.cli import main\n"
        "with event.install_listener('numba:compile', seen):\n    CliRunner().invoke(main, sys.argv[1:])\n"
        "    run = len(seen.buffer)\n    numba.njit(lambda x: x + 1.0)(1.0)\n"
        "print(run, len(seen.buffer) > run)"
    )
    command = ["run", BALL, "-o", str(tmp_path / "ball.nc"), "--step", "5 ms"]
    assert call(*command).exit_code == 0
    (tmp_path / "ball.nc").rename(tmp_path / "first.nc")
    second = subprocess.run([sys.executable, "-c", script, *command], capture_output=True, text=True, check=True)
    assert second.stdout.split() == ["0", "True"]
    assert (tmp_path / "ball.nc").exists()


def test_options_take_elements(tmp_path: Path) -> None:
    """Assert that lists of names, parted by commas, have elements whose labels are parted by commas, too."""
    path = tmp_path / "run.nc"
    asked = ("--until", "0.1 s", "--log", "r[0, x],v_r[1, y]", "--set", "r[0, x]=0.96")
    done = call("run", MODELS / "figure_eight.toml", "-o", path, *asked)
    assert done.exit_code == 0, done.output
    with xd.open_run(path) as run:
        assert run.attrs["solver_log_variables"] == "r[0,x] v_r[1,y]"
        assert run.r.values[0, 0, 0] == 0.96
    wrong = call("run", MODELS / "figure_eight.toml", "-o", path, "--set", "r[3, x]=0.96")
    assert "--set 'r[3, x]': dimension 'body' has no element 3; it has the elements 0 to 2" in wrong.output
    drawn = call("plot", path, "--only", "r[0, x], v_r[1, y]", "-o", tmp_path / "run.png")
    assert drawn.exit_code == 0, drawn.output


@pytest.mark.dear
def test_refinements_of_quantities_with_dimensions_are_told(tmp_path: Path) -> None:
    """Assert a line for each of the first six elements, by its name as it is written, and how many more there are."""
    how = ("--method", "rk4", "--step", "20 ms", "--levels", "3", "--at", "0.1 s")
    done = call("refine", MODELS / "figure_eight.toml", *how, "-o", tmp_path / "study.nc")
    assert done.exit_code == 0, done.output
    assert re.search(r"^r\[2, y\] at t = 0.1 s = .*, asymptotic$", done.output, re.MULTILINE)
    long = call("refine", MODELS / "granular_box.toml", *how[:2], "--step", "5 ms", "--until", "0.3 s", *how[4:])
    assert "r, v_r: 14 further elements of each are in the record" in long.output
    told = re.findall(r"^(.*): \d+ further occurrences are in the record$", long.output, re.MULTILINE)
    assert told == ["event_time_walls", "event_time_discs", "event_time_far_walls"]


def test_verdicts_are_a_line_each(ball: Path, tmp_path: Path) -> None:
    """Assert verdict, file and fault in one line of standard output, and what says at which rows a run was edited."""
    edited, damaged = tmp_path / "edited.nc", tmp_path / "damaged.nc"
    run = xd.open_run(ball).load()
    run.assign(y=2.0 * run.y).to_netcdf(edited, engine="netcdf4")
    damaged.write_bytes(ball.read_bytes()[:-3000])
    done = call("verify", ball, edited, damaged)
    lines = done.stdout.splitlines()
    assert (done.exit_code, [line.split()[0] for line in lines]) == (1, ["verified", "edited", "damaged"])
    assert lines[1].startswith(f"edited  {edited}: variable 'y' differs from its digest (xdynamics reproduce")
    assert lines[2].startswith(f"damaged  {damaged}: it cannot be read: ")
