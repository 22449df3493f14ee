"""Sweeps on a cluster of processes, and sweeps whose processes are killed: the same bits, nothing lost, nothing twice."""

from __future__ import annotations

import io
import os
import pickle
import pty
import re
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import dask
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.archive import integrity
from xdynamics.evidence import cluster
from xdynamics.evidence.cluster import check_workers, cluster_of, connected
from xdynamics.evidence.stages import STAGE, compute_datasets

AXES: dict[str, Any] = {"v_y": "10:30:40 m s-1", "vt": "20:60:5 m s-1", "method": ["heun", "dop853"]}
ASKED: dict[str, Any] = {"keep": ["end", "event_time_ground", "y"], "times": [0.5, 1.0], "rtol": 1e-6, "until": "6 s"}


@pytest.fixture(scope="module")
def here() -> xr.Dataset:
    """The sweep in this process."""
    return xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, **ASKED).compute(scheduler="synchronous")


def assert_same(found: xr.Dataset, expected: xr.Dataset) -> None:
    """Assert every variable that was kept, bit for bit; texts by their letters."""
    for name, variable in expected.data_vars.items():
        mine = found[name].values
        if variable.dtype.kind in "UO":
            assert mine.astype(str).tolist() == variable.values.astype(str).tolist(), name
        else:
            assert mine.tobytes() == variable.values.tobytes(), name


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Two processes of one thread."""
    pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what the library leaves open
        with cluster_of(None, 2) as client:
            yield client


def test_a_scheduler_of_no_kind_leaves_nothing_behind() -> None:
    """Assert, before any cluster is there, that dask computes in this process again after an address that is none."""
    pytest.importorskip("distributed")
    with pytest.raises(xd.InputError, match="'nowhere://x' cannot be reached"), cluster_of("nowhere://x", None):
        raise AssertionError("connected to nowhere")
    assert connected() is None
    assert dask.config.get("scheduler", None) is None


def test_where_a_cluster_may_be() -> None:
    """Assert that by default there is none, and one line for what is neither an address nor a number of processes."""
    with xd.cluster() as none:
        assert none is None
        assert connected() is None
    for wrong in (0, -1, "0", True, 1.5, "", [4], b"tcp://x"):
        with pytest.raises(xd.InputError, match=r"a cluster is .*, needs the address of a scheduler, like 'tcp:"):
            xd.cluster(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("guard", ["", "if 1 == 1:\n "])
def test_a_script_without_a_main_guard_is_told(tmp_path: Path, guard: str) -> None:
    """Assert one error, with the line and the remedy, where each process would run the script again: it hung before."""
    pytest.importorskip("distributed")
    script = tmp_path / "study.py"
    script.write_text(f"import xdynamics as xd\n{guard}xd.cluster(2).__enter__()\n")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False)
    line = 2 + bool(guard)
    assert f"'study.py' starts the processes of a cluster in line {line}, and each" in done.stderr
    assert done.stderr.rstrip().endswith('below the line if __name__ == "__main__":')


@pytest.mark.parametrize(
    "script", ['if __name__ == "__main__":\n check()', 'if __name__ != "__main__":\n raise SystemExit\ncheck()']
)
def test_a_main_guard_is_known(tmp_path: Path, script: str) -> None:
    """Assert that a script which its processes do not run again may start them."""
    path = tmp_path / "study.py"
    path.write_text(f"from xdynamics.evidence.cluster import check_main_guard as check\n{script}\n")
    assert subprocess.run([sys.executable, path], capture_output=True, timeout=60, check=False).returncode == 0


def test_a_client_that_is_closed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the remedies where dask's setting still names a cluster, of a stage and of a sweep into a folder."""
    distributed = pytest.importorskip("distributed")
    said = r"its client is closed; open another, distributed.Client\('tcp://…'\), or compute here"
    with dask.config.set(scheduler="dask.distributed"):
        with pytest.raises(xd.InputError, match=said):
            compute_datasets(studied())
        monkeypatch.setattr(distributed, "default_client", lambda: type("Client", (), {"status": "closed"}))
        with pytest.raises(xd.InputError, match=said):
            connected()
    monkeypatch.undo()
    assert connected() is None


SCHEDULER = """
import time, distributed
asked = {"processes": False, "dashboard_address": None, "silence_logs": "CRITICAL", "protocol": "tcp://"}
asked["scheduler_kwargs"] = {"dashboard_address": "127.0.0.1:0"}
print(distributed.LocalCluster(n_workers=1, threads_per_worker=1, **asked).scheduler_address, flush=True)
time.sleep(600)
"""


def lost(address: str, process: subprocess.Popen[str], when: str) -> None:
    """Compute a study on a cluster whose process is killed before it or in the middle."""
    with cluster_of(address, None) as client, dask.config.set({"distributed.comm.timeouts.connect": "2s"}):
        assert connected() is client
        killer = threading.Timer(0.0 if when == "before" else 1.5, process.kill)
        killer.start()
        if when == "before":
            process.wait()
        compute_datasets(studied(until=100_000.0))


@pytest.mark.parametrize("when", ["before", "in the middle"])
def test_a_cluster_that_is_gone_is_told(
    when: str, request: pytest.FixtureRequest, capfd: pytest.CaptureFixture[str]
) -> None:
    """Assert one line and nothing else of a cluster whose process is killed, and that stages are computed here again."""
    if not request.config.getoption("--whole"):
        pytest.skip("a cluster of its own, and the wait for one that is gone; --whole")
    process = subprocess.Popen([sys.executable, "-c", SCHEDULER], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process, process.stdout as output:
        address = output.readline().strip()
        with pytest.raises(xd.InputError, match=f"the cluster at {address} is gone .*; start it again"):
            lost(address, process, when)
    assert capfd.readouterr().err == ""
    assert compute_datasets(studied())[0].order_x.values[2, 0] == pytest.approx(4.0, abs=0.1)


def test_two_clusters_of_this_machine_do_not_meet(client: Any) -> None:
    """Assert that the pages of one are at a free port, not at dask's own, and for this machine alone."""
    server = client.cluster.scheduler.http_server
    address, port = server.address, server.port
    assert address == "127.0.0.1"
    assert port != 8787


@pytest.mark.dear
def test_a_cluster_is_where_stages_are_computed(client: Any) -> None:
    """Assert a client of its own by an address, with the bits of this process, and that the one before is back then."""
    study = studied()
    with xd.cluster(client.scheduler.address) as mine:
        assert connected() is mine
        assert mine is not client
        there = study.compute()
    assert connected() is client
    assert_same(there, study.compute(scheduler="synchronous"))


@pytest.mark.dear
def test_a_report_on_a_cluster_has_its_bar(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a terminal is told how many tasks of a report's graph are done, and that the line is empty in the end."""
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(cluster, "OFTEN", 0.01)
    assert connected() is client
    xd.report(tmp_path, study=studied(until=200.0))
    assert re.search(r"\[#* *\] \| \d+% \| \d+ tasks done", terminal.getvalue())
    assert terminal.getvalue().endswith("\r\x1b[K")


@pytest.mark.dear
def test_two_processes_give_the_same_bits(client: Any, here: xr.Dataset, tmp_path: Path) -> None:
    """Assert a lazy sweep, and one into a folder, on a cluster of two workers."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    assert connected() is client
    assert_same(xd.sweep(model, AXES, members_per_task=20, **ASKED).compute(), here)
    assert_same(xd.sweep(model, AXES, members_per_task=20, path=tmp_path / "s", **ASKED), here)
    assert_same(compute_datasets(xd.sweep(model, AXES, **ASKED))[0], here)


@pytest.mark.dear
def test_what_came_back_from_a_cluster_is_saved_without_a_march(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a sweep computed by xarray, by the client or by a report is known to be what was marched; an edit, too."""
    client.wait_for_workers(2, timeout=60)
    grid = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, members_per_task=20, **ASKED)
    ways: tuple[Callable[[], xr.Dataset], ...] = (
        lambda: client.compute(grid).result(),
        grid.compute,
        lambda: compute_datasets(grid)[0],
    )
    digest_of = integrity.variable_digest

    def unless_lazy(name: str, variable: xr.Variable) -> str:
        assert variable.chunks is None, f"{name} is computed again"
        return digest_of(name, variable)

    for way in ways:
        found = way()
        with monkeypatch.context() as patch:
            patch.setattr(integrity, "variable_digest", unless_lazy)
            xd.archive.check_unchanged(found)
        with pytest.raises(xd.InputError, match="variable 'end_y'"):
            xd.archive.check_unchanged(found.assign(end_y=found.end_y.copy(data=found.end_y.values + 1e-9)))


def studied(**more: Any) -> xr.Dataset:
    """A refinement of an oscillator, not computed yet."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    asked = {"method": "rk4", "steps": [0.04, 0.02, 0.01, 0.005], "at": [1.0], "until": 20.0}
    return xd.refine(oscillator, compute=False, **asked | more)


STAGES: dict[str, Callable[[], xr.Dataset]] = {
    "refinement": studied,
    "ledger": lambda: xd.validate(["rk4", "velocity_verlet"], compute=False),
    "budget": lambda: xd.error_budget(
        xd.Model.from_toml(MODELS / "ball_drag.toml"), "y", at="1 s", draws=10_000, compute=False
    ),
    "certificate": lambda: xd.certify(
        xd.Model.from_toml(MODELS / "ball_drag.toml"), "y", at="1 s", draws=1000, compute=False
    ),
}


def test_stages_on_a_cluster_have_the_bits_of_threads(client: Any, request: pytest.FixtureRequest) -> None:
    """Assert every stage, with a worker killed while it is computed; results of tasks that pass the scheduler are small."""
    told: list[float] = []
    for name in STAGES if request.config.getoption("--whole") else ["refinement"]:
        with dask.config.set(scheduler="threads"):
            whole = compute_datasets(STAGES[name]())[0]
        victim = min(client.run(os.getpid).values())
        killer = threading.Timer(0.3, os.kill, (victim, signal.SIGKILL))
        killer.start()
        found = compute_datasets(STAGES[name](), tell=lambda done, *_: told.append(done))[0]
        killer.join()
        assert_same(found, whole)
        assert len(pickle.dumps(found)) < 200_000
        client.wait_for_workers(2, timeout=60)
    assert all(0.0 <= done <= 1.0 for done in told)


@pytest.mark.dear
def test_the_finest_level_begins_first_and_each_study_ends_before_the_next(client: Any) -> None:
    """Assert the order that priorities give: a longer study first, its finest level, its others; what reads is never behind."""
    client.wait_for_workers(2, timeout=60)
    asked = {"short": ("rk4", 20.0), "one": ("rk4", 40.0), "other": ("heun", 40.0)}
    ranks = {}
    for name, (method, until) in asked.items():
        study = studied(method=method, until=until)
        layers = study.encoding[STAGE].delayed(study).__dask_graph__().layers
        begun = [layer.annotations["priority"] for key, layer in layers.items() if key.startswith("march-")]
        ranks[name] = sorted(begun, reverse=True)
        read = {key: layer.annotations["priority"] for key, layer in layers.items() if key.startswith(("acc", "subj"))}
        assert len(read) == 5
        assert min(read.values()) > max(begun)
    first, second = sorted([ranks["one"], ranks["other"]], reverse=True)
    assert first[-1] > second[0] > second[-1] > ranks["short"][0] > ranks["short"][-1]
    steps = [str(study.encoding[STAGE].task.needs[1 + k].needs[0].steps) for k in range(4)]
    assert steps == [*map(str, reversed(ranks["other"]))]  # from coarse to fine


@pytest.mark.dear
def test_workers_with_another_environment_are_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the worker, what it has and what is here; a scheduler that is not there; and one line of the command."""
    client.wait_for_workers(2, timeout=60)
    check_workers(client)
    mine = cluster.environment()
    monkeypatch.setattr(cluster, "OFTEN", 0.01)
    monkeypatch.setattr(
        client,
        "run",
        lambda *_, **__: {
            "tcp://10.0.0.1:2": {**mine, "xdynamics": "0.1"},
            "tcp://10.0.0.2:2": OSError("no such module"),
        },
    )
    with pytest.raises(xd.InputError, match="worker tcp://10.0.0.1:2 has xdynamics 0.1, and this process") as told:
        check_workers(client)
    assert "worker tcp://10.0.0.2:2 cannot be asked: no such module" in str(told.value)
    answers = [{"tcp://10.0.0.1:2": OSError("Connection reset by peer")}, {"tcp://10.0.0.3:2": mine}]
    monkeypatch.setattr(client, "run", lambda *_, **__: answers.pop(0))
    check_workers(client)  # one was lost while it was asked, and another is there in its place
    assert answers == []
    monkeypatch.setattr(client, "run", lambda *_, **__: {})
    with pytest.raises(xd.InputError, match="has no workers; start one with: dask worker tcp://"):
        check_workers(client)
    monkeypatch.undo()
    monkeypatch.setattr(cluster, "PATIENCE", "1s")
    for wrong in ("tcp://127.0.0.1:9", "nowhere://x"):
        done = call("refine", MODELS / "harmonic_oscillator.toml", "--step", "0.1 s", "--scheduler", wrong)
        assert done.exit_code == 2
        assert f"the scheduler '{wrong}' cannot be reached" in done.output
    done = call("validate", "--scheduler", "tcp://127.0.0.1:9", "--workers", "2")
    assert (done.exit_code, "a cluster has its own workers, give one" in done.output) == (2, True)


@pytest.mark.dear
def test_a_verb_on_a_cluster_says_what_it_says_here(client: Any, tmp_path: Path) -> None:
    """Assert that a refinement by the command, on a scheduler that is running, prints what it prints without."""
    client.wait_for_workers(2, timeout=60)
    asked = ("refine", MODELS / "harmonic_oscillator.toml", "--step", "0.1 s", "--levels", "3", "--until", "1 s")
    with dask.config.set(scheduler="threads"):
        here = call(*asked)
    there = call(*asked, "--scheduler", client.scheduler.address, "-o", tmp_path / "r.nc")
    assert (here.exit_code, there.exit_code) == (0, 0)
    assert there.output.startswith(here.output)


def in_terminal(*words: Any, until: bytes) -> tuple[int, str]:
    """Run the command in a terminal, press Ctrl-C half a second after it showed a text; return its exit code and all it showed."""
    number, terminal = pty.fork()
    if not number:
        os.execv(sys.executable, [sys.executable, "-m", "xdynamics", *map(str, words)])
    shown, pressed = b"", False
    with suppress(OSError):  # its other end is closed
        while piece := os.read(terminal, 4096):
            shown += piece
            if until in shown and not pressed:
                time.sleep(0.5)
                os.write(terminal, b"\x03")
                pressed = True
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]), shown.decode()


@pytest.mark.dear
def test_control_c_in_a_terminal_ends_a_study_on_a_cluster(client: Any, request: pytest.FixtureRequest) -> None:
    """Assert one line and no traceback, and that nothing that was asked is left on the cluster, which works on."""
    if not request.config.getoption("--whole"):
        pytest.skip("a command of its own on a cluster takes ten seconds; --whole")
    client.wait_for_workers(2, timeout=60)
    model = MODELS / "harmonic_oscillator.toml"
    steps = ("--step", "1 ms", "--levels", "3", "--until", "5000 s")
    code, shown = in_terminal("refine", model, *steps, "--scheduler", client.scheduler.address, until=b"tasks done")
    assert code == 1
    assert "xdynamics: interrupted; the cluster was told to drop what was asked of it" in shown
    assert "Traceback" not in shown
    for _ in range(600):
        if not client.run_on_scheduler(cluster._unfinished):
            break
        time.sleep(0.1)
    else:
        pytest.fail("tasks are left on the cluster")
    assert compute_datasets(studied())[0].order_x.values[2, 0] == pytest.approx(4.0, abs=0.1)
