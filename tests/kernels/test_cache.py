"""The cache of compiled code: shared, damaged, full, read-only or missing, it never stops a run nor changes one."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from cases.problems import MODELS
from xdynamics.kernels import engine_part, machine
from xdynamics.kernels.engine_part import NUMBA, EnginePart, source_digest
from xdynamics.march.engine import ENGINE, engine

SCRIPT = """
import sys, logging
import xdynamics as xd
from numba.core import event
with event.install_recorder("numba:compile") as seen:
    run = xd.simulate(xd.Model.from_toml(sys.argv[1]), method="dop853", rtol=1e-8, until=2.0)
    xd.sample(run, [0.5, 1.0])
sys.stdout.write(f"{xd.content_digest(run)} {len(seen.buffer)}\\n")  # one write: four processes share the pipe
"""
KEPLER = str(MODELS / "kepler.toml")
CODE = ENGINE.name_of_code(NUMBA)


def ran(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script with a cache folder."""
    environment = os.environ | {"XDYNAMICS_CACHE": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", script, KEPLER], env=environment, capture_output=True, text=True, check=True
    )


def told(folder: Path) -> tuple[str, int, str]:
    """Run the script with a cache folder: digest, compilations by numba, what was said."""
    done = ran(SCRIPT, folder)
    digest, compiled = done.stdout.split()
    return digest, int(compiled), done.stderr


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache that holds the engine and one law, copied from this session's, and the digest of the run."""
    engine()
    folder = tmp_path_factory.mktemp("kept")
    shutil.copy(machine.folder() / CODE, folder / CODE)
    digest, _, _ = told(folder)
    return folder, digest


def damaged(content: bytes, damage: str) -> bytes:
    """Return a file's content cut, with one bit changed, or none of it."""
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    return {"truncated": content[:100], "flipped": flipped, "empty": b""}[damage]


def put_in_place(path: Path, damage: str) -> None:
    """Put something else where a kept file was."""
    if damage in ("truncated", "flipped", "empty"):
        path.write_bytes(damaged(path.read_bytes(), damage))
        return
    path.unlink()
    if damage == "directory":
        (path / "inside").mkdir(parents=True)
    elif damage == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(path)


@pytest.mark.dear
def test_a_second_process_compiles_nothing(kept: tuple[Path, str]) -> None:
    """Assert that engine and law are loaded, and nothing is said."""
    digest, compiled, said = told(kept[0])
    assert (digest, compiled, said) == (kept[1], 0, "")


@pytest.mark.dear
@pytest.mark.every(3)
@pytest.mark.parametrize("damages", [("truncated", "flipped"), ("empty", "directory"), ("pipe", "link to itself")])
def test_a_damaged_law_is_compiled_anew(kept: tuple[Path, str], damages: tuple[str, str], tmp_path: Path) -> None:
    """Assert that whatever stands in the place of the laws' files is replaced by what was there."""
    folder = shutil.copytree(kept[0], tmp_path / "cache")
    laws = sorted([*folder.glob("law-*.o"), *folder.glob("form-*.o")])
    assert len(laws) >= 2
    for k, law in enumerate(laws):
        put_in_place(law, damages[k % 2])
    assert told(folder) == (kept[1], 0, "")
    assert [law.read_bytes() for law in laws] == [(kept[0] / law.name).read_bytes() for law in laws]


@pytest.mark.dear
def test_no_flipped_bit_is_loaded(kept: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of 200 random bits of each kept file none can change without the file being set aside."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    places = random.Random(4)
    for entry in kept[0].iterdir():
        whole = entry.read_bytes()
        for _ in range(200):
            changed = bytearray(whole)
            changed[places.randrange(len(whole))] ^= 1 << places.randrange(8)
            (tmp_path / entry.name).write_bytes(changed)
            assert machine.read(entry.name) is None
        (tmp_path / entry.name).write_bytes(whole)
        assert machine.read(entry.name) == whole[32:]


KNOWN = """
import lzma
from pathlib import Path
from xdynamics.kernels import numba_text
text = lzma.decompress(Path({path!r}).read_bytes()[32:]).decode().split("\\n", 2)[2]
numba_text.text_of = lambda _functions: print("compiled") or text
"""


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The beginning of a script in which numba is not asked, but what it compiled for this session taken for its answer.

    A session with an empty cache, as one in a fresh checkout, has asked it.
    """
    path = tmp_path_factory.mktemp("known") / ENGINE.name_of_text
    path.write_bytes(bytes(32) + ENGINE.packed_text())
    return KNOWN.format(path=str(path))


@pytest.mark.dear
def test_a_damaged_engine_is_compiled_anew(kept: tuple[Path, str], known: str, tmp_path: Path) -> None:
    """Assert that damaged code costs a compilation, which is told; while the text is whole, LLVM's alone in silence."""
    folder = shutil.copytree(kept[0], tmp_path / "cache")
    put_in_place(folder / CODE, "flipped")
    done = ran(known + SCRIPT, folder)
    assert done.stdout.split() == ["compiled", kept[1], "0"]
    assert "compiling the engine, once per installation" in done.stderr
    put_in_place(folder / CODE, "flipped")
    assert (folder / ENGINE.name_of_text).exists()
    assert told(folder) == (kept[1], 0, "")


@pytest.mark.dear
def test_the_bytes_that_were_verified_are_loaded(kept: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file that is exchanged after its digest was compared changes nothing: it is not read again."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(kept[0]))
    content = machine.read(CODE)
    monkeypatch.setattr(machine, "read", lambda _name: content)
    monkeypatch.setenv("XDYNAMICS_CACHE", "/nowhere")
    loaded = EnginePart("engine", "the engine", 10, ENGINE.functions)
    assert len(loaded.entries()) == len(ENGINE.functions)


@pytest.mark.dear
def test_a_cache_that_cannot_be_written(kept: tuple[Path, str], known: str, tmp_path: Path) -> None:
    """Assert that a file in the place of the folder, as good as a read-only disk to root, costs time and one line of advice."""
    (tmp_path / "cache").write_text("no folder")
    done = ran(known + SCRIPT, tmp_path / "cache")
    assert done.stdout.split() == ["compiled", kept[1], "0"]
    advice = (
        f"xdynamics: compiled code cannot be kept in '{tmp_path / 'cache'}' (File exists), so every process compiles it"
        " again; set XDYNAMICS_CACHE to a folder of your own that nobody else can write to and that has room"
    )
    slow = "xdynamics: compiling the model and its method"  # said where that lasts longer than a second
    lines = [line for line in done.stderr.splitlines() if not line.startswith(slow)]
    assert sorted(lines) == [advice, "xdynamics: compiling the engine: about 18 s"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["cache"]


FULL = """
import resource, sys
from xdynamics.kernels import machine
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
print(machine.caching_obstacle())
for name in ("law-x.o", "law-y.o"):
    machine.write(name, bytes(5000))
    print(machine.read(name))
"""


def test_a_full_disk_costs_a_compilation(tmp_path: Path) -> None:
    """Assert that where a file cannot grow nothing is kept and nothing is left behind, and that it is said once."""
    done = subprocess.run(
        [sys.executable, "-c", FULL],
        env=os.environ | {"XDYNAMICS_CACHE": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["File too large", "None", "None"]
    assert done.stderr.count("cannot be kept in") == len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def homeless(monkeypatch: pytest.MonkeyPatch, temporary: Path) -> None:
    """Make this a process of a user without a home."""

    def no_home() -> Path:
        raise RuntimeError("no home")

    monkeypatch.delenv("XDYNAMICS_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(temporary))


def test_a_user_without_a_home_has_one_temporary_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that it is this user's, and the same one in every process."""
    homeless(monkeypatch, tmp_path)
    for name in ("law-x.o", "law-y.o"):
        machine.write(name, b"code")
        assert machine.read(name) == b"code"
    names = [f"xdynamics-{os.getuid()}", f"xdynamics-{os.getuid()}.secret"]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == names


def test_somebody_elses_temporary_folder_is_not_believed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Assert that code is neither read from nor written to a folder that others can write to, or a link."""
    homeless(monkeypatch, tmp_path)
    monkeypatch.setattr(machine, "_ADVISED", [])
    machine.write("law-x.o", b"code")
    machine.folder().chmod(0o777)
    assert machine.read("law-x.o") is None
    machine.write("law-y.o", b"code")
    assert "others may write to the folder" in machine.caching_obstacle()
    machine.folder().rename(tmp_path / "theirs")
    (tmp_path / "theirs").chmod(0o700)
    machine.folder().symlink_to(tmp_path / "theirs")
    assert machine.read("law-x.o") is None
    assert [entry.name for entry in (tmp_path / "theirs").iterdir()] == ["law-x.o"]
    assert len(caplog.records) == 1


PLANTS = {
    "a folder that others may write to": lambda folder, _file: folder.chmod(0o777),
    "a folder that the group may write to": lambda folder, _file: folder.chmod(0o770),
    "a file that others may write to": lambda _folder, file: file.chmod(0o666),
    "a link in the place of the file": lambda folder, file: (file.rename(folder / "x"), file.symlink_to(folder / "x")),
    "somebody else's folder": lambda folder, _file: os.chown(folder, 12345, -1),
    "somebody else's file": lambda _folder, file: os.chown(file, 12345, -1),
}


@pytest.mark.parametrize("variable", ["XDYNAMICS_CACHE", "XDG_CACHE_HOME", "HOME"])
@pytest.mark.parametrize("plant", PLANTS)
def test_what_others_can_write_is_not_executed(
    plant: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a file which others own or can change is not read, whichever variable names its folder."""
    if plant.startswith("somebody") and os.getuid():
        pytest.skip("only root gives files away")
    for name in ("XDYNAMICS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    machine.write("law-x.o", b"code")
    assert machine.read("law-x.o") == b"code"
    PLANTS[plant](machine.folder(), machine.folder() / "law-x.o")
    assert machine.read("law-x.o") is None


def test_a_file_from_an_open_folder_is_not_believed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that neither an unkeyed digest, nor another user's secret, nor another file's seal passes."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path / "cache"))
    machine.write("law-x.o", b"code")
    whole = (machine.folder() / "law-x.o").read_bytes()
    (machine.folder() / "law-y.o").write_bytes(whole)
    (machine.folder() / "law-z.o").write_bytes(hashlib.sha256(b"code").digest() + b"code")
    assert (machine.read("law-x.o"), machine.read("law-y.o"), machine.read("law-z.o")) == (b"code", None, None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another user's"))
    machine.write("law-z.o", b"theirs")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert (machine.read("law-x.o"), machine.read("law-z.o")) == (b"code", None)


def test_the_secret_is_the_users_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that it has mode 600, lies in no folder that XDYNAMICS_CACHE names, and that another one is refused by name."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path / "shared"))
    monkeypatch.setattr(machine, "_ADVISED", [])
    machine.write("law-x.o", b"code")
    secret = tmp_path / "home" / "xdynamics.secret"
    assert (secret.stat().st_mode & 0o777, secret.stat().st_size) == (0o600, 32)
    assert [path.name for path in (tmp_path / "shared").iterdir()] == ["law-x.o"]
    secret.chmod(0o640)
    assert machine.read("law-x.o") is None
    assert "others may read" in machine.caching_obstacle()
    secret.chmod(0o600)
    secret.write_bytes(b"short")
    assert "holds no secret" in machine.caching_obstacle()
    secret.unlink()
    assert machine.read("law-x.o") is None
    assert not secret.exists()


def test_old_and_seldom_used_files_are_pruned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a write removes what is past its age, and the least used of what is beyond the limit."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    monkeypatch.setenv("XDYNAMICS_CACHE_LIMIT", "0.003")
    for days, name in enumerate(("new", "used", "older", "oldest")):
        machine.write(f"law-{name}.o", bytes(950))
        os.utime(tmp_path / f"law-{name}.o", (time.time() - 86400.0 * (1 + days),) * 2)
    assert machine.read("law-used.o") == bytes(950)  # marks it as used
    machine.write("law-last.o", bytes(950))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        f"law-{name}.o" for name in ("last", "new", "older", "used")
    ]
    monkeypatch.setenv("XDYNAMICS_CACHE_LIMIT", "0.03")
    os.utime(tmp_path / "law-new.o", (time.time() - 86400.0 * (machine.MOST_DAYS + 1),) * 2)
    machine.write("law-last.o", bytes(950))
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"law-{name}.o" for name in ("last", "older", "used")]


def test_the_folder_is_looked_through_seldom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that writing a limit's worth of small files prunes about 32 times, and that more than the limit never stays long."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    monkeypatch.setenv("XDYNAMICS_CACHE_LIMIT", "0.3")
    looks, prune = [], machine._prune
    monkeypatch.setattr(machine, "_prune", lambda *given: (looks.append(given), prune(*given)))
    for number in range(900):
        machine.write(f"law-{number}.o", bytes(1000 - machine._SEAL))
    assert 45 < len(looks) < 160  # 96 are expected; either bound is missed once in 10^7 runs
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 0.3e6 * 1.6  # no look in 170 writes: once in 10^8


@pytest.mark.parametrize(("text", "limit"), [("12", 12.0), ("-1", 256.0), ("much", 256.0), ("nan", 256.0)])
def test_the_limit_of_the_cache(text: str, limit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a limit that is no size is not followed."""
    monkeypatch.setenv("XDYNAMICS_CACHE_LIMIT", text)
    assert machine.max_megabytes() == limit


def test_parts_of_dead_processes_are_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that a part older than an hour goes when the folder is pruned, and a younger one stays."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    monkeypatch.setenv("XDYNAMICS_CACHE_LIMIT", "0.001")
    for name, age in (("old.part", 2 * machine.ABANDONED), ("young.part", 0.0)):
        (tmp_path / name).write_bytes(b"half")
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    machine.write("law-x.o", b"code")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["law-x.o", "young.part"]


def test_an_interrupted_write_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that Ctrl-C in the middle leaves no half a file."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))

    def interrupted(*_: object, **_named: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        machine.write("law-x.o", b"code")
    assert list(tmp_path.iterdir()) == []


FOUR = """
import os
import xdynamics as xd
from xdynamics.simulation import single_run
children = []
for _ in range(4):
    children.append(os.fork())
    if not children[-1]:
        break
else:
    raise SystemExit(sum(os.waitpid(child, 0)[1] != 0 for child in children))
"""


@pytest.mark.dear
def test_four_processes_with_one_cold_cache(kept: tuple[Path, str], tmp_path: Path) -> None:
    """Assert that processes that compile one law at once all end right and leave one whole file of it."""
    folder = tmp_path / "cold"
    folder.mkdir()
    shutil.copy(kept[0] / CODE, folder / CODE)
    lines = ran(FOUR + SCRIPT, folder).stdout.splitlines()
    assert len(lines) == 4
    assert {line.split()[0] for line in lines} == {kept[1]}
    assert not list(folder.glob("*.part"))


def test_a_relative_cache_stays_where_it_was(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that a process that changes its folder does not begin a second cache there."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDYNAMICS_CACHE", "kept here")
    first = machine.folder()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert machine.folder() == first == tmp_path / "kept here"


def test_the_key_watches_all_that_is_compiled_in() -> None:
    """Assert that a changed flag number of the schema, like any changed line of the engine, asks for another engine."""
    before = source_digest()
    schema = engine_part.PACKAGE / "schema.py"
    original = Path.read_text

    def changed(path: Path, *arguments: object, **named: object) -> str:
        text = original(path, *arguments, **named)
        return text.replace("range(7)", "range(8)") if path == schema else text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_text", changed)
        assert source_digest.__wrapped__() != before
    assert source_digest.__wrapped__() == before


def test_a_long_compilation_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Assert that compiling a law beyond a second is said, and a quick one passes in silence."""
    from xdynamics.kernels import machine

    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    monkeypatch.setattr(machine, "_object", lambda text: (time.sleep(0.2), bytes(text, "ascii"))[1])
    monkeypatch.setattr(machine, "Code", lambda kept, _names: kept)
    machine.compiled("quick", ["forces"])
    assert not caplog.records
    monkeypatch.setattr(machine, "PATIENCE", 0.02)
    machine.compiled("slow\nlaw\n", ["forces"])
    assert [record.getMessage() for record in caplog.records] == [
        "xdynamics: compiling the model and its method, 2 lines"
    ]
