"""matplotlib without a screen; hypothesis without a clock; some of each class of random cases, or more."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import settings

# what tests import, each with what it imports itself; xarray before dask
LIBRARIES = (
    *("xarray", "numba", "scipy.integrate", "scipy.optimize", "hypothesis", "netCDF4", "pint", "zarr", "distributed"),
    *("s3fs", "moto.server", "nbclient", "openpyxl", "sympy", "matplotlib.pyplot"),
)
DEAR_SHARE = 25
APART = ("assemblies", "solvers")  # parts of the engine that take as long as all others, which share functions
SOURCES = Path(__file__).parents[1] / "src"

os.environ.setdefault("MPLBACKEND", "Agg")
# hundreds of processes are started, each of which would read the sources of xarray and all others anew
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")


class DoctestsAlone:
    """Leave out modules of the package without an example: of over 400, some 60 have one."""

    @pytest.hookimpl
    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        """Say which."""
        if collection_path.suffix != ".py" or SOURCES not in collection_path.parents:
            return None
        return ">>>" not in collection_path.read_text(encoding="utf-8") or None


def pytest_configure(config: pytest.Config) -> None:
    """Choose modules for their examples, and let every second of several processes begin with the last library and test.

    Python compiles what is first imported, and keeps it: two processes that import the same in the same order both
    compile all of it, 45 s each where nothing is kept.
    """
    config.pluginmanager.register(DoctestsAlone())
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as of commands in the background of a script
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if (worker := os.environ.get("PYTEST_XDIST_WORKER")) is None:
        return
    is_odd = worker[-1] in "13579"
    for name in reversed(LIBRARIES) if is_odd else LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(name)
    if is_odd and "tests" in config.args:
        place = config.args.index("tests")
        config.args[place : place + 1] = map(str, sorted(Path("tests").rglob("test_*.py"), reverse=True))


def pytest_collection_finish() -> None:
    """Let each of several processes compile some parts of the engine for all, where no cache holds them, and wait for the rest.

    Otherwise each compiled all of it, a minute of its time. What was collected is not searched for garbage again,
    and the rest more rarely: a million objects are alive, of which a fourteenth of the time was spent.
    """
    gc.freeze()
    gc.set_threshold(5_000, 20, 50)
    if (worker := os.environ.get("PYTEST_XDIST_WORKER")) is None:
        return
    from xdynamics.dynamics.growth import GROWTH
    from xdynamics.kernels import machine
    from xdynamics.march.engine import PARTS

    parts, number = (*PARTS, GROWTH), int(worker.removeprefix("gw"))
    for part in parts:
        if number == min(int(part.name in APART), int(os.environ["PYTEST_XDIST_WORKER_COUNT"]) - 1):
            part.entries()
    kept, end = [machine.folder() / part.name_of_code(part.origin()) for part in parts], time.monotonic() + 60.0
    while not all(path.exists() for path in kept) and time.monotonic() < end:
        time.sleep(0.1)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer more of every class of random cases."""
    parser.addoption(
        "--whole",
        action="store_true",
        help="every 7th case of each random class, not every 47th, or all of one that is named by `::`; all dear tests too",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out most of what is `dear`, and of a test marked `every(n)` all but the first and each n-th; none with --whole.

    Of the dear tests one in 25 runs: which ones follows from the package's source, so that one that rots is found a few
    changes later, and a run of the same source runs the same tests. The order is that of paths, in whichever files were
    collected.
    """
    items.sort(key=lambda item: item.path)
    if config.getoption("--whole") or any("::" in name for name in config.args):  # all, or what was named
        return
    counts: Counter[str] = Counter()
    left_out, turn = [], crc32(b"".join(path.read_bytes() for path in sorted(SOURCES.rglob("*.py"))))
    for item in items:
        if item.get_closest_marker("dear") is not None:
            if (crc32(item.nodeid.encode()) - turn) % DEAR_SHARE:
                left_out.append(item)
        elif (marker := item.get_closest_marker("every")) is not None:
            name = item.nodeid.partition("[")[0]
            if counts[name] % marker.args[0]:
                left_out.append(item)
            counts[name] += 1
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        gone = set(left_out)
        items[:] = [item for item in items if item not in gone]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give a test marked `cases(n)` the numbers of its random cases: every 47th, or every 7th with --whole.

    Primes, so that a test which goes by `case % 2`, or by another small number, meets all of its kinds. All cases of
    all classes take hours: with --whole all are those of a test that is named.
    """
    marker = metafunc.definition.get_closest_marker("cases")
    if marker is not None:
        whole, is_named = metafunc.config.getoption("--whole"), any("::" in name for name in metafunc.config.args)
        metafunc.parametrize("case", range(0, marker.args[0], (1 if is_named else 7) if whole else 47))
