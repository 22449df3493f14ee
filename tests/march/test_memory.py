"""The bytes of a run are all that a march needs to go on, in another process too."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.engine import engine
from xdynamics.march.log import LOG_COUNTS, allocate
from xdynamics.march.memory import changing_arrays, put_back

KINDS: dict[str, dict[str, Any]] = {
    "fixed": {"step": 0.02},
    "adaptive": {"rtol": 1e-3, "atol": 1e-4},
    "doubled": {"rtol": 2e-3, "atol": 2e-3, "estimator": "step_doubling"},
    "extrapolated": {"step": 0.05, "estimator": "step_doubling_extrapolated"},
    "given": {"step": [0.01, 0.02, 0.03] * 40},
}
CASES = [(name, kind) for name in xd.METHODS for kind in KINDS]


def march_of(method: str, kind: str) -> March:
    """A march with events, drives and nodes where the method takes them."""
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    name = "pendulum" if xd.METHODS[method].solves or xd.METHODS[method].refusals(rocket) else "rocket_c6"
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    return March(model, settings_for(model, method=method, until=2.2, **KINDS[kind]))


def marched(march: March, first: int = 1 << 40) -> bytes:
    """March into a log that holds all; return the bytes of the log from a row on, and of the end."""
    log = allocate(march.layout, 20_000, sampled=int(march.run.plan[0].samples))
    log.follow(*(int(march.now[name]) for name in LOG_COUNTS))
    log.lend(march.run)
    engine().march(march.run, first)
    return logged(march, log) + bytes_of(march)


def bytes_of(march: March) -> bytes:
    """Return all that a march changes but its log."""
    return b"".join(one.tobytes() for one in changing_arrays(march.run).values())


def logged(march: March, log: Any) -> bytes:
    """Return the bytes of the log's rows."""
    counts = [int(march.now[name] - log.base[0][name]) for name in LOG_COUNTS]
    parts = (log.rows[:, : counts[0]], log.trials[: counts[1]], log.events[: counts[2]], log.samples[:, : counts[3]])
    return b"".join(np.ascontiguousarray(part.T).tobytes() for part in parts)


@pytest.mark.every(37)
@pytest.mark.parametrize(("method", "kind"), CASES)
def test_a_march_goes_on_from_its_bytes(method: str, kind: str) -> None:
    """Assert that a march that is stopped at a random row and put into another run ends with the same bytes."""
    whole = march_of(method, kind)
    marched(whole)
    rows = int(whole.now.rows)
    assert rows > 5
    row = int(np.random.default_rng(rows + len(method)).integers(1, rows - 1))
    first, second = march_of(method, kind), march_of(method, kind)
    marched(first, row)
    put_back(second.run, changing_arrays(first.run))
    marched(second)
    assert bytes_of(second) == bytes_of(whole)


OTHER = """
import hashlib, pickle, sys
from test_memory import march_of, marched, put_back
for method, kind, memory in pickle.load(sys.stdin.buffer):
    march = march_of(method, kind)
    put_back(march.run, memory)
    print(hashlib.sha256(marched(march)).hexdigest())
"""


@pytest.mark.dear
def test_in_another_process_too() -> None:
    """Assert the same of 20 methods and kinds of step whose second half is marched by a process of its own."""
    import pickle

    given, expected = [], []
    for method, kind in CASES[:: len(CASES) // 20]:
        whole, half = march_of(method, kind), march_of(method, kind)
        marched(whole)
        marched(half, int(whole.now.rows) // 2)
        given.append((method, kind, changing_arrays(half.run)))
        expected.append(hashlib.sha256(marched(half)).hexdigest())
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path += [{str(Path(__file__).parent)!r}, {str(Path(__file__).parents[1])!r}]\n{OTHER}",
    ]
    told = subprocess.run(command, input=pickle.dumps(given), capture_output=True, check=True).stdout.decode().split()
    assert told == expected


def test_a_memory_goes_back_into_a_march_that_went_on() -> None:
    """Assert that a run whose log is half full takes an earlier memory, and goes on from there to the same bytes."""
    march = march_of("midpoint", "fixed")
    blocks = march.blocks(20)
    next(blocks)
    early = changing_arrays(march.run)
    for _ in range(3):
        next(blocks)
    put_back(march.run, early)
    marched(march)
    whole = march_of("midpoint", "fixed")
    marched(whole)
    assert bytes_of(march) == bytes_of(whole)


def test_a_memory_of_another_form_is_refused() -> None:
    """Assert that the first array that has another form is named, and nothing is changed."""
    march, other = march_of("midpoint", "fixed"), march_of("rk4", "fixed")
    before = bytes_of(march)
    with pytest.raises(xd.InputError, match=r"the march's '\w+' has another form than here"):
        put_back(march.run, changing_arrays(other.run))
    assert bytes_of(march) == before


@pytest.mark.parametrize(
    ("name", "until"), [("woodpecker", 0.3), ("block_on_incline", 2.0), ("granular_box", 0.2), ("rocket_c6", 1.0)]
)
def test_every_number_of_the_log_is_written(name: str, until: float) -> None:
    """Assert that rows, trials and events have the same bytes, whatever was in the memory that they are written to."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings = settings_for(model, until=until)
    logs = []
    for filling in (0x00, 0xA5):
        march = March(model, settings)
        log = allocate(march.layout, 5_000, sampled=int(march.run.plan[0].samples))
        for part in ("rows", "trials", "events", "samples"):
            getattr(log, part).view(np.uint8)[...] = filling
        log.lend(march.run)
        engine().march(march.run, 1 << 40)
        assert march.now.events > log.base[0]["events"]
        logs.append(logged(march, log))
    assert logs[0] == logs[1]
