"""Runs that are killed at random moments, process by process, and resumed to the bits of the whole run.

By hand, with new processes and segments every 5 ms: `python tests/killing.py 200`. The ordinary tests fork a few. With
`python tests/killing.py aimed 100` every run is killed in places: first when it has two segments or more, then up to three
times more, while it is resumed, while the archive is made of the segments, while these are removed.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import xdynamics as xd
from cases.verdicts import verified
from xdynamics.archive import segments, writing
from xdynamics.archive.writing import Writer
from xdynamics.march import March

MODELS = Path(__file__).parents[2] / "data" / "models"
EVERY = 0.005  # s between segments

# what is marched: model and settings; each takes some tenths of a second
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "fixed steps with events": ("pendulum", {"method": "rk4", "step": 1e-4, "until": 15.0, "force_samples": "none"}),
    "chosen steps, rejected trials": (
        "kepler",
        {"method": "dop853", "rtol": 1e-11, "until": 7_000.0, "force_samples": "none"},
    ),
    "force samples, drives, nodes": ("rocket_c6", {"method": "midpoint", "step": 8e-5}),
    "chosen steps with events": ("pendulum", {"method": "dormand_prince", "rtol": 1e-9, "until": 1_200.0}),
    "an implicit method that keeps factors": ("pendulum", {"method": "radau_iia", "rtol": 1e-8, "until": 500.0}),
    "an implicit method by Newton": ("pendulum", {"method": "implicit_midpoint", "step": 1e-3, "until": 75.0}),
    "step doubling": ("kepler", {"method": "velocity_verlet", "rtol": 1e-5, "until": 200.0, "force_samples": "none"}),
    "first-order states alone": ("", {"method": "dormand_prince", "rtol": 1e-9, "until": 350.0}),
}

# where a run is killed, by the function in which it is: (where it is looked up, its name, times it may be called before)
PLACES: dict[str, tuple[Any, str, int]] = {
    "a segment is written": (segments, "write_segment", 3),
    "segments are compared": (segments.Segment, "check", 3),
    "rows are taken over": (segments.Segments, "rows", 0),
    "the march is put behind them": (March, "go_on_from", 0),
    "the archive is finished": (Writer, "finish", 0),
    "it is sealed and read back": (writing, "_seal_new_file", 0),
    "segments are removed": (segments, "_remove_segments", 0),
}


def case(name: str) -> tuple[xd.Model, dict[str, Any]]:
    """Return a model and what is asked of its march."""
    model, asked = CASES[name]
    if model:
        return xd.Model.from_toml(MODELS / f"{model}.toml"), asked
    rates = {"x": "s*(y - x)", "y": "k*x*(r - z) - k*y", "z": "k*x*y - b*z"}
    states = {name: {"unit": "1", "rate": rate} for name, rate in rates.items()}
    parameters = {"s": "10 s-1", "k": "1 s-1", "r": "28", "b": "2.6 s-1"}
    initial = {"x": "1", "y": "1", "z": "1"}
    return xd.Model(name="Lorenz", states=states, parameters=parameters, initial=initial), asked


def march(name: str, path: Path, ready: Callable[[], None] = lambda: None) -> None:
    """March a case into a file, from where it was left."""
    segments.EVERY = EVERY
    warnings.simplefilter("ignore", xd.ResumeWarning)  # nothing is there yet, or nothing any more
    model, asked = case(name)
    ready()
    xd.simulate(model, **asked, path=path, resume=True)


def new_process(name: str, path: Path) -> int:
    """March in a new process; return its number once it is about to."""
    command = [sys.executable, __file__, "march", name, str(path)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    child.stdout.close()
    return child.pid


def forked(name: str, path: Path) -> int:
    """March in a copy of this process."""
    if number := os.fork():
        return number
    status = 1
    try:
        march(name, path)
        status = 0
    except Exception:  # noqa: BLE001 - this process shall end here, whatever happens
        traceback.print_exc()
    finally:
        os._exit(status)


def wounded(place: str, calls: int, delay: float) -> Callable[[str, Path], int]:
    """Return a start of a process that the system kills a while after it came to a place, whatever it does then."""
    where, name, _ = PLACES[place]
    function, left = getattr(where, name), [calls]

    def called(*arguments: Any, **named: Any) -> Any:
        left[0] -= 1
        if left[0] == -1:
            signal.setitimer(signal.ITIMER_REAL, delay)  # nobody waits for its signal: it ends the process at once
        return function(*arguments, **named)

    def start(case_name: str, path: Path) -> int:
        setattr(where, name, called)
        try:
            return forked(case_name, path)
        finally:
            setattr(where, name, function)

    return start


def ended(number: int) -> int:
    """Wait for a process; return how it ended."""
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def attempt(name: str, moments: random.Random, start: Callable[[str, Path], int], whole: float) -> tuple[str, int, int]:
    """Kill a run once or twice, then let it end; return its digest, kills that met it, segments at the last one."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        path, kills, left = Path(folder) / "run.nc", 0, 0
        for _ in range(moments.randint(1, 2)):
            number = start(name, path)
            time.sleep(moments.uniform(0.0, whole))
            os.kill(number, signal.SIGKILL)
            kills += ended(number) == -signal.SIGKILL
            left = len(list(segments.segments_folder(path).glob("*.segment")))
        if ended(start(name, path)) != 0:
            return "did not end", kills, left
        if segments.has_segments(path):
            return "left segments behind", kills, left
        return verified(path), kills, left


def aimed(name: str, moments: random.Random, expected: str) -> tuple[str, list[tuple[str, int]]]:
    """Kill a run in places and let it end; return what is wrong in the end, and where it was killed with how many segments."""
    plan = [("a segment is written", moments.randint(2, 4))]
    places = moments.choices(list(PLACES), k=moments.randint(1, 3))
    plan += [(place, moments.randint(0, PLACES[place][2])) for place in places]
    kills, wrong = [], ""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        path = Path(folder) / "run.nc"
        for place, calls in plan:
            killed = ended(wounded(place, calls, 10.0 ** moments.uniform(-6.0, -1.5))(name, path)) == -signal.SIGALRM
            if killed:
                kills.append((place, len(list(segments.segments_folder(path).glob("*.segment")))))
            if path.exists() and verified(path) != expected:
                wrong = f"another digest after '{place}'"
        if ended(forked(name, path)) != 0:
            return "did not end", kills
        if left := [entry.name for entry in Path(folder).iterdir() if entry != path]:
            return f"left {left}", kills
        return wrong or ("" if verified(path) == expected else "another digest"), kills


def all_aimed(count: int, seed: int) -> int:
    """Kill cases in turn in places; print a line each and where the kills were, and return how many came out equal."""
    moments, equal, expected, met = random.Random(seed), 0, {}, Counter[tuple[str, int]]()
    for i in range(count):
        name = list(CASES)[i % len(CASES)]
        if name not in expected:
            model, asked = case(name)
            expected[name] = xd.content_digest(xd.simulate(model, **asked))
        wrong, kills = aimed(name, moments, expected[name])
        equal += not wrong
        met.update(kills)
        print(f"{name}: {wrong or 'equal'}, {'; '.join(f'{place} ({n} segments)' for place, n in kills)}", flush=True)
    for place in PLACES:
        print(f"{place}: {dict(sorted((n, k) for (where, n), k in met.items() if where == place))}")
    many = sum(k for (_, n), k in met.items() if n > 1)
    print(f"{equal} of {count} digests equal, {met.total()} kills, {many} with two segments or more", flush=True)
    return equal


def digests_equal(count: int, start: Callable[[str, Path], int], seed: int) -> tuple[int, int]:
    """Try all cases in turn; print a line each, and return how many of how many digests are equal."""
    moments, equal, times, expected = random.Random(seed), 0, {}, {}
    for i in range(count):
        name = list(CASES)[i % len(CASES)]
        if name not in expected:
            model, asked = case(name)
            expected[name] = xd.content_digest(xd.simulate(model, **asked))
            with tempfile.TemporaryDirectory() as folder:
                number, began = start(name, Path(folder) / "run.nc"), time.monotonic()
                assert ended(number) == 0
                times[name] = time.monotonic() - began
        digest, kills, left = attempt(name, moments, start, times[name])
        equal += digest == expected[name]
        print(f"{name}: {'equal' if digest == expected[name] else digest}, {kills} kills, {left} segments", flush=True)
    print(f"{equal} of {count} digests equal", flush=True)
    return equal, count


if __name__ == "__main__":
    if sys.argv[1] == "march":
        march(sys.argv[2], Path(sys.argv[3]), lambda: print("ready", flush=True))
    elif sys.argv[1] == "fork":
        digests_equal(int(sys.argv[2]), forked, int(sys.argv[3]))
    elif sys.argv[1] == "aimed":
        sys.exit(all_aimed(int(sys.argv[2]), seed=23) != int(sys.argv[2]))
    else:
        done, asked_for = digests_equal(int(sys.argv[1]), new_process, seed=17)
        sys.exit(done != asked_for)
