"""The cache of compiled code: shared, damaged, full, read-only or missing, it never stops a run nor changes one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from problems import MODELS
from xdynamics.kernels import cache
from xdynamics.march import engine as engine_room
from xdynamics.march.engine import engine

SCRIPT = """
import sys, logging
import xdynamics as xd
from numba.core import event
with event.install_recorder("numba:compile") as seen:
    run = xd.simulate(xd.Model.from_toml(sys.argv[1]), method="dop853", rtol=1e-8, until=2.0)
    xd.sample(run, [0.5, 1.0])
print(xd.content_digest(run), len(seen.buffer))
"""
KEPLER = str(MODELS / "kepler.toml")
ENGINE = f"engine-{engine_room._key()}"


def told(folder: Path, **more: str) -> tuple[str, int, str]:
    """Run the script with a cache folder: digest, compilations by numba, what was said."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, KEPLER], env=os.environ | {"XDYNAMICS_CACHE": str(folder)} | more,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    digest, compiled = done.stdout.split()
    return digest, int(compiled), done.stderr


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache that holds the engine and one law, copied from this session's, and the digest of the run."""
    engine()
    folder = tmp_path_factory.mktemp("kept")
    shutil.copytree(cache.folder() / ENGINE, folder / ENGINE)
    digest, _, _ = told(folder)
    return folder, digest


def test_a_second_process_compiles_nothing(kept: tuple[Path, str]) -> None:
    """Assert that engine and law are loaded, and nothing is said."""
    digest, compiled, said = told(kept[0])
    assert (digest, compiled, said) == (kept[1], 0, "")


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty"])
def test_a_damaged_law_is_compiled_anew(kept: tuple[Path, str], damage: str, tmp_path: Path) -> None:
    """Assert that every law's file that is not as it was written is replaced."""
    folder = shutil.copytree(kept[0], tmp_path / "cache")
    laws = sorted(folder.glob("law-*.o"))
    assert laws
    for law in laws:
        content = bytearray(law.read_bytes())
        content[len(content) // 2] ^= 1
        law.write_bytes({"truncated": bytes(content[:100]), "flipped": bytes(content), "empty": b""}[damage])
    assert told(folder)[:2] == (kept[1], 0)
    assert [one.read_bytes() for one in laws] == [(kept[0] / one.name).read_bytes() for one in laws]


@pytest.mark.parametrize("what", ["*.nbi", "*.nbc", "sealed"])
def test_a_damaged_engine_is_compiled_anew(kept: tuple[Path, str], what: str, tmp_path: Path) -> None:
    """Assert that a truncated file of the engine costs a compilation, which is told, and is mended for the next process."""
    folder = shutil.copytree(kept[0], tmp_path / "cache")
    for one in (folder / ENGINE).rglob(what):
        one.write_bytes(one.read_bytes()[: one.stat().st_size // 2])
    digest, compiled, said = told(folder)
    assert digest == kept[1]
    assert compiled > 0
    assert "compiling the engine, once per installation" in said
    assert told(folder)[:2] == (kept[1], 0)


def test_a_cache_that_cannot_be_written(kept: tuple[Path, str], tmp_path: Path) -> None:
    """Assert that a file in the place of the folder, as good as a read-only disk to root, costs time alone."""
    (tmp_path / "cache").write_text("no folder")
    digest, compiled, _ = told(tmp_path / "cache")
    assert digest == kept[1]
    assert compiled > 0


def test_a_full_disk_costs_a_compilation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that where the cache has no room nothing is kept and nothing is left behind."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with cache.filling("engine-x") as folder:
        assert folder is None
    monkeypatch.setattr(os, "fdopen", full)
    cache.write("law-x.o", b"code")
    assert [one for one in tmp_path.iterdir() if one.suffix != ".part" or any(one.iterdir())] == []
    assert cache.read("law-x.o") is None


def test_eight_processes_with_one_cold_cache(kept: tuple[Path, str], tmp_path: Path) -> None:
    """Assert that processes that compile one law at once all end right and leave one whole file of it."""
    folder = tmp_path / "cold"
    folder.mkdir()
    shutil.copytree(kept[0] / ENGINE, folder / ENGINE)
    environment = os.environ | {"XDYNAMICS_CACHE": str(folder)}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, KEPLER],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(8)
    ]
    ended = [(one.communicate(), one.returncode) for one in started]
    assert [code for _, code in ended] == [0] * 8
    assert {out.split()[0] for (out, _), _ in ended} == {kept[1]}
    assert not list(folder.glob("*.part"))


def test_a_folder_is_whole_or_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that of two that fill one folder the first one's stays, and that a damaged one is replaced."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    for content in ("first", "second"):
        with cache.filling("engine-x") as folder:
            assert folder is not None
            (folder / "code").write_text(content)
    assert (tmp_path / "engine-x" / "code").read_text() == "first"
    (tmp_path / "engine-x" / "code").write_text("damaged")
    assert cache.sealed("engine-x") is None
    with cache.filling("engine-x") as folder:
        (folder / "code").write_text("third")
    assert (cache.sealed("engine-x") / "code").read_text() == "third"
    assert len(list(tmp_path.iterdir())) == 1


def test_what_is_no_seal_is_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that bytes that are no text, a file and a link to itself in the place of a folder are mended."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    (tmp_path / "engine-a").mkdir()
    (tmp_path / "engine-a" / "sealed").write_bytes(b"\xff\xfe\x00\x81")
    (tmp_path / "engine-b").write_text("a file")
    (tmp_path / "engine-c").symlink_to(tmp_path / "engine-c")
    for name in ("engine-a", "engine-b", "engine-c"):
        assert cache.sealed(name) is None
        with cache.filling(name) as folder:
            (folder / "code").write_text("whole")
        assert (cache.sealed(name) / "code").read_text() == "whole"


def test_an_interrupted_compilation_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that Ctrl-C in the middle leaves no half-filled folder."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    with pytest.raises(KeyboardInterrupt), cache.filling("engine-x"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_relative_cache_stays_where_it_was(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that a process that changes its folder does not begin a second cache there."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDYNAMICS_CACHE", "kept here")
    first = cache.folder()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert cache.folder() == first == tmp_path / "kept here"


def test_the_key_watches_all_that_is_compiled_in() -> None:
    """Assert that a changed flag number of the schema, like any changed line of the engine, asks for another engine."""
    before = engine_room._key()
    schema = Path(engine_room.__file__).parents[1] / "schema.py"
    original = Path.read_text

    def changed(path: Path, *arguments: object, **named: object) -> str:
        text = original(path, *arguments, **named)
        return text.replace("range(7)", "range(8)") if path == schema else text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_text", changed)
        assert engine_room._key() != before
    assert engine_room._key() == before
    assert np.isfinite(len(before))


def test_a_long_compilation_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Assert that compiling a law beyond a second is said, and a quick one passes in silence."""
    import time

    from xdynamics.kernels import machine

    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    monkeypatch.setattr(machine, "_object", lambda text: (time.sleep(0.2), bytes(text, "ascii"))[1])
    monkeypatch.setattr(machine, "Code", lambda kept, _names: kept)
    machine.compiled("quick", ["forces"])
    assert not caplog.records
    monkeypatch.setattr(machine, "PATIENCE", 0.02)
    machine.compiled("slow\nlaw\n", ["forces"])
    assert [one.getMessage() for one in caplog.records] == ["xdynamics: compiling the model and its method, 2 lines"]
