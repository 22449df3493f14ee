"""Verbs that are killed while they write: under every name the old file or the new one, and the same call comes to its end."""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import select
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import dask
import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import segments, target
from xdynamics.archive.writing import Writer
from xdynamics.cli import main

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::xdynamics.faults.ResumeWarning"),
]

PENDULUM, OSCILLATOR, ORBIT = (str(MODELS / f"{one}.toml") for one in ("pendulum", "harmonic_oscillator", "kepler"))
GRID = ["--method", "rk4", "--step"]
RUN = ["run", PENDULUM, *GRID, "1 ms", "--until", "1 s"]
THIN = ["--keep-every", "7", "--log", "theta,total_energy"]
BUDGET = [OSCILLATOR, *GRID, "50 ms", "--quantity", "x", "--at", "1 s"]
FIT = ["--parameter", "k", *GRID, "20 ms", "--until", "1 s", "--set", "k=3.9 N m-1", "--starts", "1"]
SWEEP = ["sweep", OSCILLATOR, *GRID, "2 ms", "--until", "1 s", "-o", "grid"]
LOGS = ["--keep", "log"]

# what verbs read, and what stands under their names before: how it is made
SOURCES: dict[str, list[str]] = {
    "one.nc": [*RUN, "-o", "one.nc"],
    "other.nc": [*RUN, "--set", "theta=0.5 rad", "-o", "other.nc"],
    "thin.nc": [*RUN, *THIN, "-o", "thin.nc"],
    "swung.nc": ["run", OSCILLATOR, *GRID, "1 ms", "--until", "1 s", "-o", "swung.nc"],
    "data.csv": ["sample", "swung.nc", "--times", "0:1:21 s", "-o", "data.csv"],
    "orbit.nc": ["run", ORBIT, *GRID, "10 ms", "--until", "1 s", "-o", "orbit.nc"],
    "certificate.nc": ["certify", *BUDGET, "-o", "certificate.nc"],
    "bundle": ["bundle", "certificate.nc", "-o", "bundle"],
    "key.pem": ["sign", "--new-key", "key.pem"],
    "grid": [*SWEEP, *LOGS, "--axis", "k=1,2 N m-1"],
    "ends": [*SWEEP, "--axis", "k=1,2 N m-1"],
}


class Verb(NamedTuple):
    """What is called, what it reads, what it writes, and what stands there before in half of the cases."""

    call: list[str] | Callable[[], object]
    reads: str
    name: str
    before: str


def _many() -> None:
    runs = {name: xd.open_run(f"{name}.nc") for name in ("one", "other")}
    xd.save_many(runs, "many")


def _page() -> None:
    xd.report("page", **{name: xd.open_run(f"{name}.nc") for name in ("one", "other")})


# the cheap ones first, which every 47th case is of
VERBS: dict[str, Verb] = {
    "a new key": Verb(["sign", "--new-key", "key.pem"], "", "key.pem", ""),
    "a new model": Verb(["new", "model.toml"], "", "model.toml", ""),
    "sign": Verb(["sign", "one.nc", "--key", "key.pem"], "one.nc key.pem", "one.nc.sig", "thin.nc"),
    "run": Verb([*RUN, "-o", "new.nc"], "", "new.nc", "other.nc"),
    "extend": Verb(["extend", "one.nc", "--until", "2 s", "-o", "new.nc"], "one.nc", "new.nc", "other.nc"),
    "complete": Verb(["complete", "thin.nc", "-o", "new.nc"], "thin.nc", "new.nc", "other.nc"),
    "sweep of ends": Verb([*SWEEP, "--axis", "k=1,2,3,4 N m-1"], "", "grid", "ends"),
    "save_many": Verb(_many, "one.nc other.nc", "many", ""),
    "thinned": Verb([*RUN, *THIN, "-o", "new.nc"], "", "new.nc", "other.nc"),
    "compressed, with a table": Verb(
        [*RUN, "--compress", "--times", "0:1:9 s", "-o", "new.nc"], "", "new.nc", "other.nc"
    ),
    "sweep of logs": Verb([*SWEEP, *LOGS, "--axis", "k=1,2,3,4 N m-1"], "", "grid", "grid"),
    "compare": Verb(["compare", "one.nc", "one.nc", "-o", "new.nc"], "one.nc", "new.nc", "thin.nc"),
    "plot": Verb(
        ["plot", "one.nc", "--only", "energy", "--size", "4x2", "-o", "new.png"], "one.nc", "new.png", "other.nc"
    ),
    "refine": Verb(
        ["refine", OSCILLATOR, *GRID, "40 ms", "--levels", "3", "--at", "1 s", "-o", "new.nc"], "", "new.nc", "other.nc"
    ),
    "budget": Verb(["budget", *BUDGET, "-o", "new.nc"], "", "new.nc", "other.nc"),
    "validate": Verb(["validate", "--method", "heun", "-o", "new.nc"], "", "new.nc", "other.nc"),
    "certify": Verb(["certify", *BUDGET, "-o", "new.nc"], "", "new.nc", "other.nc"),
    "report": Verb(_page, "one.nc other.nc", "page", ""),
    "bundle": Verb(["bundle", "certificate.nc", "-o", "bundle"], "certificate.nc", "bundle", "empty"),
    "sample": Verb(["sample", "one.nc", "--times", "0:1:201 s", "-o", "new.csv"], "one.nc", "new.csv", "one.nc"),
    "diagnose": Verb(["diagnose", "one.nc", "--no-companion", "-o", "new.nc"], "one.nc", "new.nc", "other.nc"),
    "fit": Verb(
        ["fit", OSCILLATOR, "data.csv", *FIT, "-o", "new.nc", "--model", "new.toml"], "data.csv", "new.nc", "other.nc"
    ),
    "animate": Verb(["animate", "orbit.nc", "--seconds", "0.2", "-o", "new.gif"], "orbit.nc", "new.gif", "one.nc"),
    "document": Verb(["report", "bundle", "-o", "new.html"], "bundle", "new.html", "one.nc"),
}
MADE_OF = {"bundle": "certificate.nc", "data.csv": "swung.nc"}
ONCE = {"a new key", "a new model", "bundle"}  # what these write is not written over


class Writing:
    """Counts what a process asks of the file system that changes something; may do something at one of these calls."""

    CALLS = (
        "replace",
        "rename",
        "link",
        "unlink",
        "remove",
        "mkdir",
        "rmdir",
        "truncate",
        "fsync",
        "fchmod",
        "write",
        "close",
    )

    def __init__(self, at: int = -1, act: Callable[[], object] = lambda: None) -> None:
        self.count, self.at, self.act = 0, at, act

    def met(self) -> None:
        """Count a call, and act at the one that was asked for."""
        self.count += 1
        if self.count - 1 == self.at:
            self.act()

    def _counted(self, function: Callable[..., Any], changes: Callable[..., bool] = lambda *_, **__: True) -> Any:
        def called(*arguments: Any, **named: Any) -> Any:
            if changes(*arguments, **named):
                self.met()
            return function(*arguments, **named)

        return called

    @contextmanager
    def watched(self) -> Iterator[Writing]:
        """Stand before the calls of the system, the library's `open`, and what is written through netCDF."""
        with pytest.MonkeyPatch.context() as patch:
            for name in self.CALLS:
                patch.setattr(os, name, self._counted(getattr(os, name)))
            flags = os.O_WRONLY | os.O_RDWR | os.O_CREAT
            patch.setattr(os, "open", self._counted(os.open, lambda _path, flag, *_, **__: bool(flag & flags)))
            patch.setattr(
                io, "open", self._counted(io.open, lambda _path, mode="r", *_, **__: bool({*mode} & {*"wax+"}))
            )
            patch.setattr(target, "sync_file_systems", self._counted(target.sync_file_systems))
            for name in ("define", "append", "finish"):
                patch.setattr(Writer, name, self._counted(getattr(Writer, name)))
            yield self


def call(verb: list[str] | Callable[[], object]) -> tuple[int, str]:
    """Call a verb here; return its exit code and what it says."""
    if callable(verb):
        verb()
        return 0, ""
    done = CliRunner().invoke(main, verb)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output


def visible(folder: Path) -> list[Path]:
    """List the files of a folder and of those in it, but for what is being built."""
    return [
        entry
        for entry in sorted(folder.rglob("*"))
        if entry.is_file() and not any(part.startswith(".") for part in entry.relative_to(folder).parts)
    ]


def hidden(folder: Path) -> list[str]:
    """List what is being built, or was left behind."""
    every = [entry.relative_to(folder) for entry in sorted(folder.rglob("*"))]
    return [str(node) for node in every if any(part.startswith(".") for part in node.parts)]


def digests(folder: Path) -> dict[str, str]:
    """Digest every file of a folder: archives by their content, lists of digests by the files that they are of."""
    found = {}
    for path in visible(folder):
        name = str(path.relative_to(folder))
        if path.read_bytes()[:8] == b"\x89HDF\r\n\x1a\n":
            found[name] = _verified(path)
        elif path.suffix == ".pem":
            found[name] = _key(path)
        elif path.name in ("SHA256SUMS", "ro-crate-metadata.json"):
            assert len(sums := _sums(path)) > 8
            assert all(_sha256(path.with_name(name)) == digest for name, digest in sums.items())
            found[name] = "the digests of its files"
        else:
            found[name] = _sha256(path)
    return found


_contents: dict[str, str] = {}  # content digests of files that were verified, by those of their bytes


def _verified(path: Path) -> str:
    """Verify an archive, whose very bytes were not verified before; return its content digest."""
    if (seen := _sha256(path)) not in _contents:
        _contents[seen] = verified(path)
    return _contents[seen]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _sums(path: Path) -> dict[str, str]:
    """Read which digests a bundle says its files have."""
    if path.name == "SHA256SUMS":
        return {line[66:]: line[:64] for line in path.read_text().splitlines()}
    return {one["@id"]: one["sha256"] for one in json.loads(path.read_text())["@graph"] if "sha256" in one}


def _key(path: Path) -> str:
    """Name the kind of a key, which must be whole."""
    from cryptography.hazmat.primitives import serialization

    text = path.read_bytes()
    if ".public" in path.name:
        return type(serialization.load_pem_public_key(text)).__name__
    return type(serialization.load_pem_private_key(text, None)).__name__


class Stage(NamedTuple):
    """A folder before a verb is called, what is in it before and afterwards, and how many calls write."""

    folder: Path
    old: dict[str, str]
    new: dict[str, str]
    calls: int


class Stages:
    """Stages of verbs, each set when it is first asked for, in this process: whatever is compiled is compiled then."""

    def __init__(self, place: Path) -> None:
        self.place, self._known = place, dict[tuple[str, bool], Stage]()

    def source(self, name: str) -> Path:
        """Return a file or folder that a verb reads."""
        made = self.place / "sources"
        made.mkdir(exist_ok=True)
        if name == "empty":
            (made / name).mkdir(exist_ok=True)
        elif not (made / name).exists():
            if name in MADE_OF:
                self.source(MADE_OF[name])
            words = SOURCES[name]
            if name == "ends":  # a call that writes under the name of another
                words = ["ends" if word == "grid" else word for word in words]
            with self.inside(made):
                code, said = call(words)
            assert code == 0, said
        return made / name

    @staticmethod
    @contextmanager
    def inside(folder: Path) -> Iterator[None]:
        """Work in a folder."""
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            yield

    def of(self, name: str, *, over: bool) -> Stage:
        """Return the stage of a verb, with or without something under the name that it writes."""
        if (name, over) not in self._known:
            self._known[name, over] = self._set(name, self.place / f"{name} {over}", over=over)
        return self._known[name, over]

    def _set(self, name: str, folder: Path, *, over: bool) -> Stage:
        verb = VERBS[name]
        folder.mkdir()
        for word in verb.reads.split():
            copied(self.source(word), folder / word)
            if word == "key.pem":
                copied(self.source(word).with_suffix(".public.pem"), folder / "key.public.pem")
        if over and verb.before:
            copied(self.source(verb.before), folder / verb.name)
        whole, old = folder.with_name(f"{folder.name} done"), digests(folder)
        copied(folder, whole)
        with self.inside(whole), Writing().watched() as writing:
            code, said = call(verb.call)
        assert code == 0, said
        assert hidden(whole) == []
        return Stage(folder, old, digests(whole), writing.count)


def copied(old: Path, new: Path) -> None:
    """Copy a file, or all of a folder."""
    if old.is_dir():
        shutil.copytree(old, new)
    else:
        shutil.copy(old, new)


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stages]:
    """Stages of verbs that keep segments of all that they march, and work in one thread, as a fork needs it."""
    with pytest.MonkeyPatch.context() as patch, dask.config.set(scheduler="synchronous"):
        patch.setattr(segments, "EVERY", 0.0)
        patch.setattr(segments, "SHARE", 0.0)
        patch.setattr(segments.Segments, "patience", float("inf"))
        patch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 200)
        yield Stages(tmp_path_factory.mktemp("kills"))


def killed(verb: list[str] | Callable[[], object], at: int, delay: float | None) -> bool:
    """Kill a copy of this process that calls a verb: at one of its calls that write, or a while after; whether it was.

    Parameters
    ----------
    verb : list of str or callable
    at : int
        Which of the calls; -1 as soon as it works.
    delay : float, optional
        s, after that call began; None kills it right before the call.
    """
    reading, telling = os.pipe()
    write, dies = os.write, lambda: os.kill(os.getpid(), signal.SIGKILL)
    number = os.fork()
    if not number:
        try:
            os.dup2(os.open(os.devnull, os.O_RDWR), 2)
            if at < 0:
                write(telling, b"x")
            with Writing(at, dies if delay is None else lambda: write(telling, b"x")).watched():
                call(verb)
        finally:
            os._exit(0)
    os.close(telling)
    select.select([reading], [], [], 60.0)
    os.close(reading)
    if delay is not None:
        time.sleep(delay)
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) == -signal.SIGKILL


def again(name: str, folder: Path, new: dict[str, str]) -> None:
    """Call a verb that was killed once more: it comes to its end, or says in a line that all of it is there already."""
    verb = VERBS[name]
    goes_on = isinstance(verb.call, list) and verb.call[0] in ("run", "extend", "complete")
    code, said = call([*verb.call, "--resume"] if isinstance(verb.call, list) and goes_on else verb.call)
    if code and name in ONCE:
        assert code == 2
        assert "already" in said
        assert said.count("\n") == 1
        if name == "a new key":  # the private one may be alone, from which the other can be made
            assert "openssl" in said or digests(folder) == new
            return
    else:
        assert code == 0, said
    assert digests(folder) == new
    assert hidden(folder) == []


@pytest.mark.every(3)
@pytest.mark.cases(300)
def test_a_killed_verb_leaves_the_old_or_the_new(case: int, stages: Stages, tmp_path: Path) -> None:
    """Assert whole files under every name, each the old or the new one, and that the same call makes them all, without a rest."""
    dice, turn = random.Random(case), case // 46  # of every 47th case two in a row share a stage, of a cheap verb
    name = list(VERBS)[(case % 23 + turn) % len(VERBS)]
    stage = stages.of(name, over=bool(turn % 2))
    folder = tmp_path / "here"
    for attempt in range(3):
        shutil.rmtree(folder, ignore_errors=True)
        copied(stage.folder, folder)
        # the first call of all, by which they were counted, may have written compiled code to the cache too
        at, delay = dice.randrange(stage.calls) >> 2 * attempt, None
        if attempt == 0 and case % 3 == 1:
            delay = 10.0 ** dice.uniform(-5.0, -2.0)
        elif attempt == 0 and case % 3 == 2:
            at, delay = -1, 10.0 ** dice.uniform(-3.0, -0.3)
        with stages.inside(folder):
            if killed(VERBS[name].call, at, delay):
                break
    else:
        pytest.fail("it was never killed")
    for file, digest in digests(folder).items():
        assert digest in (stage.old.get(file), stage.new.get(file)), file
    assert not {*stage.old} - {*digests(folder)}
    if (folder / "grid").is_dir() and not (folder / "grid" / "catalogue.nc").exists():
        with pytest.raises(xd.InputError, match="not finished|holds no sweep"):
            xd.open_sweep(folder / "grid")
    with stages.inside(folder):
        again(name, folder, stage.new)
