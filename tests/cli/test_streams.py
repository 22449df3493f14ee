"""Standard output and error that are closed, full or cut off: what was marched is kept, and the exit code is the archive's.

What a message names as the remedy is taken at the next try.
"""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.cli import main
from xdynamics.cli.command import Stream, surviving_streams

KEPLER = MODELS / "kepler.toml"
LONG = f"run {KEPLER} -o run.nc --method dop853 --rtol 1e-12 --force-samples none --until 3000s"  # over a second
SHORT = f"run {KEPLER} -o run.nc --method dop853 --rtol 1e-6 --until 1s"
COMMAND = f"{sys.executable} -m xdynamics"


def shell(folder: Path, line: str) -> tuple[int, str, str]:
    """Run a line of bash; what its first command ended with, and what came of both streams."""
    done = subprocess.run(
        ["bash", "-c", f"{line}; exit ${{PIPESTATUS[0]}}"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.every(4)
@pytest.mark.parametrize(
    ("verb", "redirected", "code", "message"),
    [
        (LONG, "<&- >&- 2>&-", 0, ""),
        (LONG, "2>&-", 0, ""),
        (SHORT, "> /dev/full", 0, "could not be written to standard output (No space left on device)"),
        (SHORT, "> /dev/full 2> /dev/full", 0, ""),
        (SHORT, ">&-", 0, "could not be written to standard output (it is closed)"),
        (SHORT, "--quiet >&-", 0, ""),
        (SHORT, "| head -c 5", 0, ""),
    ],
)
def test_a_run_outlives_its_streams(verb: str, redirected: str, code: int, message: str, tmp_path: Path) -> None:
    """Assert that the archive is whole, that the loss is said in one line where it can be, and no traceback is."""
    ended, _, said = shell(tmp_path, f"{COMMAND} {verb} {redirected}")
    assert (ended, len(said.splitlines())) == (code, bool(message))
    assert message in said
    assert len(verified(tmp_path / "run.nc")) == 64
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"]


@pytest.mark.dear
@pytest.mark.parametrize(("redirected", "code"), [("> /dev/full", 1), (">&-", 1), ("| head -1", 0), ("--quiet >&-", 0)])
def test_a_lost_report_ends_a_verb_that_only_reports(redirected: str, code: int, tmp_path: Path) -> None:
    """Assert that `methods` fails where its table is lost, and does not where a reader has seen enough."""
    assert shell(tmp_path, f"{COMMAND} methods {redirected}")[0] == code


@pytest.mark.dear
@pytest.mark.parametrize(("written", "code"), [("", 1), ("-o refinement.nc", 0)])
def test_a_lost_number_is_a_failure_unless_it_is_kept(written: str, code: int, tmp_path: Path) -> None:
    """Assert that a refinement whose JSON is lost fails, and does not where an archive has it."""
    line = f"refine {KEPLER} --step 40ms --step 20ms --until 1s --json {written}"
    ended, _, said = shell(tmp_path, f"{COMMAND} {line} >&-")
    assert (ended, said.splitlines()[-1]) == (
        code,
        "xdynamics: the report could not be written to standard output (it is closed)",
    )


@pytest.mark.dear
def test_a_sweep_that_is_terminated_goes_on_later(tmp_path: Path) -> None:
    """Assert exit code 143 and what to do in words; the same command then ends the sweep, without marching anew."""
    line = f"sweep {MODELS / 'ball_drag.toml'} --axis vt='20:60:60000 m s-1' -o found"
    wait = "while ! ls found/* > /dev/null 2>&1; do sleep 0.1; done; kill -TERM $!; wait $!; exit $?"
    ended, _, said = shell(tmp_path, f"{COMMAND} {line} & {wait}")
    assert ended == 143
    assert said.splitlines()[-2:] == [
        "xdynamics: interrupted; what is done is kept in 'found', and the same command goes on with it",
        "xdynamics: terminated",
    ]
    assert shell(tmp_path, f"{COMMAND} {line}")[0] == 0
    assert xd.open_sweep(tmp_path / "found").sizes["vt"] == 60000


@pytest.mark.parametrize(
    ("verb", "line", "said"),
    [
        ("sweeping.sweep", "sweep {} --axis k=1,2 -o found", "; what is done is kept in 'found', and the same command"),
        (
            "evidence.refining.refinement",
            "refine {} --step 1s --keep found -o r.nc",
            "; what is done is kept in 'found', and",
        ),
        ("evidence.refining.refinement", "refine {} --step 1s -o r.nc", ""),
    ],
)
def test_ctrl_c_is_said_in_one_line(
    verb: str, line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert exit code 1 and a line of our own alone: what is kept, where something is."""

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"xdynamics.{verb}.{line.split(maxsplit=1)[0]}", interrupted)
    ended = CliRunner().invoke(main, line.format(MODELS / "harmonic_oscillator.toml").split())
    assert (ended.exit_code, ended.stdout, len(ended.stderr.splitlines())) == (1, "", 1)
    assert ended.stderr.startswith(f"xdynamics: interrupted{said}")


@pytest.mark.parametrize("verb", ["new model.toml", "sign --new-key key.pem"])
def test_a_lost_report_does_not_end_a_verb_that_makes_a_file(verb: str, tmp_path: Path) -> None:
    """Assert exit code 0 and one line, though no option names the file."""
    code, _, said = shell(tmp_path, f"{COMMAND} {verb} >&-")
    assert (code, len(said.splitlines())) == (0, 1)
    assert list(tmp_path.iterdir())


@pytest.mark.parametrize("megabytes", [300, 512, 600])
def test_too_little_memory_is_said_at_once(megabytes: int, tmp_path: Path) -> None:
    """Assert one line that says how much is needed, exit code 1, within seconds; verbs that need little still work."""
    begun = time.monotonic()
    code, _, said = shell(tmp_path, f"ulimit -v {megabytes}000; {COMMAND} {SHORT}")
    assert (code, len(said.splitlines())) == (1, 1)
    assert said.endswith(
        f"about 700 MB of address space are needed, and room for the record; the limit (ulimit -v) is {megabytes * 1024 // 1000} MB\n"
    )
    assert time.monotonic() - begun < 10.0
    assert shell(tmp_path, f"ulimit -v {megabytes}000; {COMMAND} help events")[0] == 0


@pytest.mark.dear
def test_a_hangup_keeps_what_was_marched(tmp_path: Path) -> None:
    """Assert that SIGHUP, as SIGTERM, ends a march as an outcome, whose rows are kept."""
    line = f"run {KEPLER} -o run.nc --method dop853 --rtol 1e-9 --until 1e9s --max-steps 1e9".split()
    marching = subprocess.Popen(
        [sys.executable, "-m", "xdynamics", *line], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120.0
    while not [*tmp_path.iterdir()] and time.monotonic() < deadline:  # until its file is begun
        time.sleep(0.1)
    time.sleep(2.0)  # and some rows are there
    marching.send_signal(signal.SIGHUP)
    assert (marching.communicate(timeout=120)[1], marching.returncode) == ("xdynamics: terminated\n", 129)
    assert xd.open_run(tmp_path / "run.nc").attrs["run_outcome"] == "interrupted"


@pytest.mark.dear
def test_a_hangup_that_is_ignored_stays_so(tmp_path: Path) -> None:
    """Assert that what `nohup` started goes on."""
    script = f"trap '' HUP; {COMMAND} {LONG} & sleep 1; kill -HUP $!; wait $!"
    assert shell(tmp_path, script)[0] == 0
    assert xd.open_run(tmp_path / "run.nc").attrs["run_outcome"] == "completed"


class Broken:
    """A stream that takes some writes, and then fails."""

    def __init__(self, most: int, error: OSError) -> None:
        self.most, self.error, self.taken = most, error, ""

    def write(self, text: str) -> int:
        """Take a text, or fail."""
        if len(self.taken) + len(text) > self.most:
            raise self.error
        self.taken += text
        return len(text)

    def flush(self) -> None:
        """Do nothing."""

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return True

    def fileno(self) -> int:
        """Have none."""
        raise OSError(errno.EBADF, "no descriptor")


@pytest.mark.parametrize(("number", "cut_off"), [(errno.ENOSPC, False), (errno.EPIPE, True), (errno.EIO, False)])
def test_the_first_failure_is_kept(number: int, cut_off: bool) -> None:
    """Assert that nothing is written after a failure, whose reason stays."""
    inner = Broken(10, OSError(number, os.strerror(number)))
    stream = Stream(inner)  # type: ignore[arg-type]
    assert stream.isatty()
    assert [stream.write(text) for text in ("12345", "678901", "1")] == [5, 6, 1]
    assert (inner.taken, stream.lost, stream.cut_off, stream.isatty()) == ("12345", os.strerror(number), cut_off, False)


def test_streams_are_put_back(capsys: pytest.CaptureFixture[str]) -> None:
    """Assert that streams are exchanged for as long as a command lasts."""
    before = sys.stdout, sys.stderr
    with surviving_streams():
        print("seen")
    assert (sys.stdout, sys.stderr) == before
    assert capsys.readouterr().out == "seen\n"


def test_the_version_is_the_installed_one() -> None:
    """Assert that the package tells its version, as the command does."""
    done = subprocess.run([*COMMAND.split(), "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"xdynamics {xd.__version__}\n"


BALL = MODELS / "ball_drag.toml"
CRATE = """\
name = "Crate"
coordinates.x = "m"
parameters.m = "40 kg"
mass.x = "m"
initial = {{ x = "0 m", v_x = "1 m s-1" }}
run = {{ method = "dop853", until = "9 s" }}
{wall}
"""
QUICK = {"method": "rk4", "step": "20 ms"}


def crate(wall: str) -> xd.Model:
    """A crate that slides from wall to wall."""
    return xd.Model.from_text(CRATE.format(wall=wall))


def test_a_gap_with_a_kink() -> None:
    """Assert that both remedies that the message names give the motion between two walls."""
    with pytest.raises(xd.ModelError, match=r"gap has a kink or a jump, abs; .* a contact for each") as refused:
        crate('contacts.wall = { gap = "1*metre - abs(x)", restitution = 0.4 }')
    left, right = re.findall(r"as '([^']+)' and '([^']+)' for", str(refused.value))[0]
    two = crate(
        "".join(
            f'contacts.{n} = {{ gap = "{gap}", restitution = 0.4 }}\n'
            for n, gap in zip("ab", (left, right), strict=True)
        )
    )
    assert "action = 'reset' and set" in str(refused.value)
    wall = 'events.w = { function = "1*metre - abs(x)", direction = "falling", action = "reset", set.v_x = "-0.4*v_x" }'
    ends = [float(xd.simulate(model).x[-1]) for model in (two, crate(wall))]
    assert ends == pytest.approx([-0.52, -0.52], abs=1e-12)


@pytest.mark.parametrize(("text", "remedy"), [("12 rad", "needs 's'"), ("2 fortnights", "min, h, day, month and year")])
def test_an_end_without_a_unit_of_time(text: str, remedy: str, tmp_path: Path) -> None:
    """Assert that the units of time are named; and of a pure number, too."""
    refused = call("run", BALL, "-o", tmp_path / "b.nc", "--until", text)
    assert (refused.exit_code, remedy in refused.output) == (2, True)


def test_a_budget_of_an_extreme_at_a_time() -> None:
    """Assert that an extreme with a time or event is refused with the remedy, which is then taken."""
    with pytest.raises(
        xd.InputError, match="'maximum_y', over the whole run, and at is '1 s': leave that out; .* until = '1 s'"
    ):
        xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", at="1 s", **QUICK)
    with pytest.raises(
        xd.InputError, match="and event is 'apex': leave that out; .* action = 'stop' of the event 'apex'"
    ):
        xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", event="apex", **QUICK)
    budget = xd.error_budget(xd.Model.from_toml(BALL), "maximum_y", until="1 s", **QUICK)
    assert budget.attrs["quantity"] == "maximum_y"


def test_a_quantity_that_is_none_names_extremes_too() -> None:
    """Assert that the list of quantities goes on with extremes."""
    with pytest.raises(xd.InputError, match="maximum_… and minimum_… of these and of forces, like 'maximum_y'"):
        xd.error_budget(xd.Model.from_toml(BALL), "height", at="1 s", **QUICK)


def test_a_file_of_numbers_alone(tmp_path: Path) -> None:
    """Assert that a file without titles is refused with titles of as many columns, which are then taken."""
    run, table = tmp_path / "b.nc", tmp_path / "scope.csv"
    call("run", BALL, "-o", run, "--step", "20 ms")
    table.write_text("0.0,0.0\n0.1,1.9\n0.2,3.6\n")
    refused = call("compare", run, table)
    assert refused.exit_code == 2
    header = re.findall(r"--header '([^']+)'", refused.output)[0]
    assert header == "t [s],y [unit]"
    assert call("compare", run, table, "--header", header.replace("unit", "m")).exit_code == 0


def test_a_drive_of_numbers_alone(tmp_path: Path) -> None:
    """Assert the same of a drive's table, whose message has the key of the model file."""
    (tmp_path / "scope.csv").write_text("0.0,0.0\n0.1,1.9\n9.0,3.6\n")
    drive = 'forces.push.x = "push"\ndrives.push = {{ table = "scope.csv"{header} }}'
    path = tmp_path / "crate.toml"
    path.write_text(CRATE.format(wall=drive.format(header="")))
    titles = re.escape(
        """numbers alone, '0.0,0.0'; give one for each of its 2 columns, like header = ["t [s]", "x [m]"]"""
    )
    with pytest.raises(xd.ModelError, match=titles):
        xd.Model.from_toml(path)
    path.write_text(CRATE.format(wall=drive.format(header=', header = ["t [s]", "push [N]"]')))
    assert xd.Model.from_toml(path).drives["push"].table.value_unit.text == "N"
