"""A march whose programs ask for memory that the system does not give."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip("resource")

# arrays of a program beyond 10,000 numbers are asked for at every evaluation
MARCH = """
import resource, sys
from xdynamics import Model
from xdynamics.march import March, runner
from xdynamics.march.configuration import settings_for

model = Model(
    name="chain",
    dimensions={"site": 400_000},
    definitions={"bend": "u**3"},
    coordinates={"u": {"unit": "1", "dims": ["site"]}},
    parameters={"k": "1 s-2"},
    mass={"u": "1"},
    forces={"spring": {"u": "k*(shift(bend, site, 1, 0) - 2*bend + shift(bend, site, -1, 0))"}},
    initial={"u": "sin(index(site)/1000)"},
)
settings = settings_for(model, method="velocity_verlet", step=1e-3, until=0.1, force_samples="none")
march = March(model, settings)
engine = runner.engine()


class Poor:
    def march(self, run, rows):
        limits = resource.getrlimit(resource.RLIMIT_AS)
        used = 4096 * int(open("/proc/self/statm").read().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (used, limits[1]))
        try:
            return engine.march(run, rows)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, limits)


def allocate(*given, **more):
    raise MemoryError


if sys.argv[1] == "program":
    runner.engine = Poor
elif sys.argv[1] == "log":
    runner.allocate = allocate
next(march.blocks(4))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of memory are as Linux keeps them")
@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("program", "what one evaluation of the model 'chain' needs, at t = 0 s: nothing of the run is kept"),
        ("log", "the log of the model 'chain', or for what is read from it: keep less, by log = 'states'"),
    ],
)
def test_a_march_without_memory_ends_in_words(where: str, said: str) -> None:
    """Assert that an evaluation, or a log, which is given no memory ends in one error, not with a signal."""
    command = [sys.executable, "-c", MARCH]
    # glibc would serve large arrays from what was freed before
    known = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
    subprocess.run(
        [*command, "compile"], capture_output=True, check=True
    )  # what compiling leaves free would serve, too
    ended = subprocess.run([*command, where], capture_output=True, text=True, check=False, env=known)
    assert ended.returncode == 1
    assert f"InputError: the system gave no memory for {said}" in ended.stderr
