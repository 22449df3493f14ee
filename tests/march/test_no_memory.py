"""A march whose programs ask for memory that the system does not give."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from xdynamics.kernels.shared_storage import forget_refusal, note_refusal, was_refused

pytest.importorskip("resource")

# arrays of a program beyond 10,000 numbers are asked for at every evaluation, of rk4 those of its stages
MARCH = """
import resource, sys
from xdynamics import Model
from xdynamics.march import March, ensemble, log, runner, simd_ensemble
from xdynamics.march.configuration import settings_for

where, many = sys.argv[1:]
model = Model(
    name="chain",
    dimensions={"site": 16_000 if many == "many" else 400_000},
    definitions={"bend": "u**3"},
    coordinates={"u": {"unit": "1", "dims": ["site"]}},
    parameters={"k": "1 s-2"},
    mass={"u": "1"},
    forces={"spring": {"u": "k*(shift(bend, site, 1, 0) - 2*bend + shift(bend, site, -1, 0))"}},
    initial={"u": "sin(index(site)/1000)"},
)
settings = settings_for(model, method="rk4", step=1e-3, until=0.1, force_samples="none")
engine, lanes = runner.engine(), simd_ensemble.side_by_side()


def poorly(call):
    def called(*given):
        limits = resource.getrlimit(resource.RLIMIT_AS)
        used = 4096 * int(open("/proc/self/statm").read().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (used, limits[1]))
        try:
            return call(*given)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, limits)

    return called


def allocate(*given, **more):
    raise MemoryError


if where == "program":
    poor = engine._replace(march=poorly(engine.march), march_many=poorly(engine.march_many))
    poor_lanes = lanes._replace(march=poorly(lanes.march))
    runner.engine = ensemble.engine = lambda: poor
    simd_ensemble.side_by_side = lambda: poor_lanes
elif where == "log":
    log.allocate = ensemble.allocate = allocate
if many == "many":
    for abreast in (1, 4):
        try:
            ensemble.march_many(model, settings, parameters={"k": [1.0, 2.0, 3.0, 4.0]}, lanes=abreast)
        except Exception as error:
            print(abreast, type(error).__mro__[1].__name__, error)
else:
    next(March(model, settings).blocks(4))
"""


# glibc would serve large arrays from what was freed before
ENVIRONMENT = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
only_on_linux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="limits of memory are as Linux keeps them"
)


def marched(where: str, many: str) -> subprocess.CompletedProcess[str]:
    """March in a process that has its machine code already: what compiling leaves free would serve, too."""
    command = [sys.executable, "-c", MARCH]
    subprocess.run([*command, "compile", many], capture_output=True, check=True)
    return subprocess.run([*command, where, many], capture_output=True, text=True, check=False, env=ENVIRONMENT)


@pytest.mark.every(2)
@only_on_linux
@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("program", "what one evaluation of the model 'chain' needs, at t = 0 s: nothing of it is kept"),
        ("log", "the log of the model 'chain', or for what is read from it: keep less, by log = 'states'"),
    ],
)
def test_a_march_without_memory_ends_in_words(where: str, said: str) -> None:
    """Assert that an evaluation, or a log, which is given no memory ends in one error, not with a signal."""
    ended = marched(where, "one")
    assert ended.returncode == 1
    assert f"Error: the system gave no memory for {said}" in ended.stderr


@only_on_linux
@pytest.mark.dear
def test_many_runs_without_memory_end_in_words() -> None:
    """Assert the same of runs one after the other and of runs side by side."""
    ended = marched("program", "many")
    said = (
        "the system gave no memory for what one evaluation of the model 'chain' needs, in one of 4 runs: nothing of it"
    )
    assert [line.partition(" is kept")[0] for line in ended.stdout.splitlines()] == [
        f"{abreast} InputError {said}" for abreast in (1, 4)
    ]


def test_a_refusal_belongs_to_the_thread_that_marches() -> None:
    """Assert that memory which one march lacked is not held against another one at the same time."""
    forget_refusal()
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(lambda: (note_refusal(), was_refused())).result() == (None, True)
    assert not was_refused()
    note_refusal()
    assert was_refused()
