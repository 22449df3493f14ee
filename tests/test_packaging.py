"""The wheel carries the engine's text, and a first run from it compiles no numba; the source distribution is whole."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from cases.problems import ROOT
from xdynamics.dynamics.growth import GROWTH
from xdynamics.kernels.engine_part import NUMBA, WHEEL
from xdynamics.march.engine import PARTS
from xdynamics.packaging import get_requires_for_build_editable, get_requires_for_build_wheel

# every part of the engine once: steps, implicit steps, events, contacts, runs side by side, growth of small changes
PROGRAM = """
import hashlib
import numpy as np
from numba.core import event
import xdynamics as xd
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for
with event.install_recorder("numba:compile") as compilations:
    kepler, ball, pendulum = (xd.Model.from_toml(f"data/models/{name}.toml") for name in ("kepler", "bouncing_ball", "pendulum"))
    runs = [
        xd.simulate(kepler, method="dop853", rtol=1e-8, until=2.0),
        xd.simulate(pendulum, method="radau_iia", rtol=1e-6, until="2 s"),
        xd.simulate(ball),
        xd.diagnose(xd.simulate(pendulum, method="dop853", rtol=1e-8, until="20 s"), lyapunov=True),
    ]
    settings = settings_for(kepler, method="dop853", rtol=1e-8, until=2.0, force_samples="none")
    ensemble = march_many(kepler, settings, initial={"x": np.linspace(0.9, 1.1, 16)}, lanes=8)
    side_by_side = hashlib.sha256(ensemble.log_block.log.rows.tobytes() + ensemble.ends.tobytes()).hexdigest()
print(xd.__file__, runs[0].attrs["engine_origin"], len(compilations.buffer), sep="|")
print(*map(xd.content_digest, runs), side_by_side)
"""
LEFT_OUT = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__", "*.nc.partial")


def elsewhere() -> dict[str, str]:
    """The environment of a process that is not to find this checkout."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a source distribution of the checkout, and the wheel that was built from that."""
    for module in ("build", "setuptools"):
        if not importlib.util.find_spec(module):
            pytest.skip(f"there is no {module} here (the extra 'test' has it)")
    source, folder = tmp_path_factory.mktemp("source") / "xdynamics", tmp_path_factory.mktemp("built")
    shutil.copytree(ROOT, source, ignore=LEFT_OUT)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, source]
    done = subprocess.run(command, env=elsewhere(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    """The wheel."""
    (path,) = built.glob("*.whl")
    return path


def ran(python: str | Path, **environment: str) -> tuple[list[str], str, str]:
    """Run the program elsewhere: where the package is, origin and number of compilations; digests; what is said."""
    done = subprocess.run(
        [python, "-W", "ignore", "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=elsewhere() | environment,
    )
    facts, digests = done.stdout.splitlines()
    return facts.split("|"), digests, done.stderr


@pytest.mark.dear
def test_the_wheel_is_one_of_a_platform_and_small(wheel: Path) -> None:
    """Assert its tag, and that the texts of all parts take less than 1 MB and name no folder."""
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.name.endswith(f"-py3-none-{platform}.whl")
    with zipfile.ZipFile(wheel) as file:
        texts = {Path(entry.filename).name: entry for entry in file.infolist() if entry.filename.endswith(".ll.xz")}
        assert set(texts) == {part.file_name for part in (*PARTS, GROWTH)}
        assert sum(entry.compress_size for entry in texts.values()) < 1_000_000
        assert b"Root-Is-Purelib: false" in file.read("xdynamics-0.2.0.dist-info/WHEEL")
        assert {f"xdynamics/manual/{name}" for name in ("first.md", "starter.toml", "site.css")} <= {*file.namelist()}
        assert not [
            name for name in file.namelist() if name.split("/")[0] not in ("xdynamics", "xdynamics-0.2.0.dist-info")
        ]


@pytest.mark.dear
def test_a_first_run_from_the_wheel_compiles_no_numba(wheel: Path, tmp_path: Path) -> None:
    """Assert that in a fresh environment with an empty cache all parts run, in silence, with this checkout's bits."""
    environment = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    python = environment / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(environment), "platbase": str(environment)}))
    with zipfile.ZipFile(wheel) as file:  # what an installer does with it, but for scripts
        file.extractall(site)
    # the libraries of this environment, but no package that it has in a checkout
    (site / "borrowed.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))
    facts, digests, said = ran(python, XDYNAMICS_CACHE=str(tmp_path / "cache"))
    assert facts == [str(site / "xdynamics" / "__init__.py"), WHEEL, "0"]
    assert said == ""
    here, expected, _ = ran(sys.executable, PYTHONPATH=str(ROOT / "src"))
    assert here[1] == NUMBA
    assert digests == expected


def test_an_editable_installation_needs_no_compiler() -> None:
    """Assert that numba is asked for where a wheel is built, and not where modules stay in their place."""
    asked = get_requires_for_build_editable()
    assert not [requirement for requirement in asked if "numba" in requirement]


def test_a_wheel_needs_what_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that building asks for numba, llvmlite and numpy, as the project does."""
    monkeypatch.chdir(ROOT)
    asked = get_requires_for_build_wheel()
    assert {requirement.split(">")[0] for requirement in asked} == {"numpy", "numba", "llvmlite"}


@pytest.mark.dear
def test_the_source_distribution_is_whole(built: Path) -> None:
    """Assert that it holds tests with their conftest, data, pipelines and sources, and nothing that was made of them."""
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    rooms = ("src", "tests", "data", "pipelines")
    ignored = (".pyc", ".nc.partial")
    wanted = {
        str(path.relative_to(ROOT))
        for room in rooms
        for path in (ROOT / room).rglob("*")
        if path.is_file() and path.suffix not in ignored and "egg-info" not in str(path)
    }
    assert {"pyproject.toml", "README.md", "tests/conftest.py", "data/models/kepler.toml"} <= names
    assert wanted <= names
    assert not [name for name in names if name.endswith((".pyc", ".ll.xz"))]
