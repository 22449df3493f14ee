"""Parts of the engine: what numba compiles is one LLVM text, carried by a wheel or kept, and called through a table."""

from __future__ import annotations

import logging
import lzma
import re
import signal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

from xdynamics.dynamics.growth import GROWTH
from xdynamics.kernels import engine_part, machine, numba_text
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.engine_part import NUMBA, WHEEL, EnginePart, toolchain_versions
from xdynamics.kernels.entry_points import FLAG, FLOAT, INTEGER, NOTHING, Fields, array_kind, signature_of
from xdynamics.kernels.machine import HELPERS
from xdynamics.march.engine import PARTS


class Pair(NamedTuple):
    """Two arrays, as a compiled function takes them."""

    row: Any
    block: Any


@jit_separate
def doubled(x: float) -> float:
    """Return twice a number."""
    return 2.0 * x


def filled(pair: Pair, factor: float, count: int, add: bool, found: Any) -> int:
    """Fill a block with products; return how many numbers were added."""
    added = 0
    for i in range(count):
        for j in range(pair.row.shape[0]):
            found[i, j] = pair.block[i, j] * factor
            if add:
                found[i, j] += doubled(pair.row[j])
                added += 1
    return added


def root(address: int, x: float) -> None:
    """Do nothing, with numbers alone."""


def allocated(found: Any) -> None:
    """Fill an array through another one, which takes memory."""
    room = np.zeros(found.shape[0])
    for i in range(found.shape[0]):
        room[i] = i
    for i in range(found.shape[0]):
        found[i] = room[found.shape[0] - 1 - i]


def raised(found: Any) -> None:
    """Raise an exception where the first element is negative."""
    if found[0] < 0.0:
        raise ValueError("negative")


PAIR = Fields(Pair, (array_kind("f8", 1), array_kind("f8", 2)))
FILLED = signature_of(INTEGER, PAIR, FLOAT, INTEGER, FLAG, array_kind("f8", 2))


def tiny() -> EnginePart:
    """A part that is compiled in no time."""
    return EnginePart(
        "tiny", "two tiny functions", 1, ((filled, FILLED), (root, signature_of(NOTHING, INTEGER, FLOAT)))
    )


@pytest.fixture(autouse=True)
def folders(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty cache, and an empty folder of texts, which is returned."""
    monkeypatch.setattr(engine_part, "FOLDER", tmp_path / "text")
    (tmp_path / "text").mkdir()
    return tmp_path / "text"


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An empty cache."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path / "cache"))


def no_compiler(_functions: Any) -> str:
    """Stand for numba where it must not be called."""
    raise AssertionError("numba compiles")


@pytest.mark.usefixtures("cold")
@pytest.mark.parametrize("add", [True, False])
def test_numbers_arrays_and_tuples_go_through_the_table(add: bool) -> None:
    """Assert that machine code returns and writes what Python does."""
    pair, found, expected = (
        Pair(np.arange(3.0), np.arange(12.0).reshape(4, 3) / 7.0),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
    )
    entry, by_numbers = tiny().entries()
    assert entry(pair, 1.5, 3, add, found) == 9 * add
    plain = [pair.block[i] * 1.5 + 2.0 * pair.row * add for i in range(3)]
    expected[:3] = plain
    assert np.array_equal(found, expected)
    assert by_numbers.call(0, 1.0) is None
    assert by_numbers.address > 0


@pytest.mark.usefixtures("cold")
def test_another_array_is_refused() -> None:
    """Assert that an array of other numbers, another shape or another order is not read as what it is not."""
    entry = tiny().entries()[0]
    found = np.zeros((4, 3))
    for other in (found.astype("f4"), found[0], found.T, np.zeros((4, 6))[:, ::2]):
        with pytest.raises(TypeError, match=r"an array of float.., with|an array of float.. with"):
            entry(Pair(np.arange(3.0), found), 1.0, 3, True, other)


@pytest.mark.usefixtures("cold")
@pytest.mark.parametrize(
    ("function", "what"), [(allocated, "zeros"), (raised, "xdynamics_exception, which nothing provides")]
)
def test_a_text_that_does_not_stand_alone_is_refused(function: Any, what: str) -> None:
    """Assert that memory of numba's runtime and exceptions are found when the text is made."""
    part = EnginePart("other", "another function", 1, ((function, signature_of(NOTHING, array_kind("f8", 1))),))
    with pytest.raises((RuntimeError, TypingError), match=what):
        part.packed_text()


@pytest.mark.usefixtures("cold")
def test_what_was_interrupted_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that after Ctrl-C in the middle of numba's work nothing is kept, and that numba compiles the same functions then."""
    part = tiny()
    with monkeypatch.context() as unmade:
        unmade.setattr(numba_text, "entry_text", interrupted)
        with pytest.raises(KeyboardInterrupt):
            part.entries()
    assert not engine_part.is_being_made()
    assert not [*machine.folder().glob("tiny*")]
    found = np.zeros((2, 3))
    assert part.entries()[0](Pair(np.ones(3), np.ones((2, 3))), 1.5, 2, True, found) == 6
    assert (found == 3.5).all()


def interrupted(*_given: Any) -> str:
    """Stand for a step of compiling in which Ctrl-C is pressed."""
    assert engine_part.is_being_made()
    signal.raise_signal(signal.SIGINT)
    return ""


@pytest.mark.usefixtures("cold")
def test_a_wheels_text_is_not_compiled(
    folders: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Assert that machine code is made of the text beside the modules, by LLVM alone, in silence."""
    (folders / tiny().file_name).write_bytes(tiny().packed_text())
    caplog.clear()
    monkeypatch.setenv("XDYNAMICS_CACHE", str(folders.parent / "another cache"))
    monkeypatch.setattr("xdynamics.kernels.numba_text.text_of", no_compiler)
    part = tiny()
    assert len(part.entries()) == 2
    assert part.origin() == WHEEL
    assert not caplog.records
    assert [path.suffix for path in (folders.parent / "another cache").iterdir()] == [".o"]


OTHERS = {
    "another numba": (
        lambda text: text.replace("; numba ", "; numba 9."),
        r"the installed text is by numba 9\..*, and here is numba",
    ),
    "another LLVM": (
        lambda text: text.replace("LLVM ", "LLVM 9", 1),
        r"the installed text is by .*LLVM 9.*, and here is numba",
    ),
    "other sources": (lambda text: text.replace("\n; ", "\n; 0", 1), "the installed text is of other sources"),
    "nothing": (lambda _text: "", "the installed text is by , and here is numba"),
    "damage": (None, "the installed text cannot be read"),
}


@pytest.mark.every(3)
@pytest.mark.usefixtures("cold")
@pytest.mark.parametrize("what", OTHERS)
def test_a_text_that_does_not_fit_is_compiled_and_said(
    what: str, folders: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Assert that other versions, other sources or damage cost a compilation, which one line tells with its reason."""
    change, reason = OTHERS[what]
    packed = tiny().packed_text()
    changed = lzma.compress(change(lzma.decompress(packed).decode()).encode()) if change else packed[:-40]
    (folders / tiny().file_name).write_bytes(changed)
    for path in (folders.parent / "cache").iterdir():
        path.unlink()
    caplog.clear()
    part = tiny()
    assert part.entries()[0](Pair(np.ones(1), np.ones((1, 1))), 1.0, 1, True, np.zeros((1, 1))) == 1
    assert part.origin() == NUMBA
    with caplog.at_level(logging.WARNING):
        (line,) = (record.getMessage() for record in caplog.records)
    assert line.startswith("xdynamics: compiling two tiny functions, once per installation: about 1 s: ")
    assert re.search(reason, line)


@pytest.mark.usefixtures("cold")
def test_what_the_cache_keeps_is_not_compiled_again(monkeypatch: pytest.MonkeyPatch, folders: Path) -> None:
    """Assert that lost machine code is made again of the text that is kept, and that no file is a pickle."""
    first = tiny()
    first.entries()
    kept = {path.name: path.read_bytes()[32:] for path in (folders.parent / "cache").iterdir()}
    assert set(kept) == {first.name_of_text, first.name_of_code(NUMBA)}
    assert kept[first.name_of_text][:6] == b"\xfd7zXZ\0"
    monkeypatch.setattr("xdynamics.kernels.numba_text.text_of", no_compiler)
    (folders.parent / "cache" / first.name_of_code(NUMBA)).unlink()
    assert len(tiny().entries()) == 2


def test_the_texts_of_the_engine_stand_alone() -> None:
    """Assert that all parts are under 1 MB, call only LLVM and three C functions of numba, and name no folder."""
    packed = {part.name: part.packed_text() for part in (*PARTS, GROWTH)}
    assert set(packed) == {"engine", "solvers", "watchers", "contacts", "assemblies", "lanes", "growth"}
    assert sum(map(len, packed.values())) < 1_000_000
    for text in (lzma.decompress(content).decode() for content in packed.values()):
        assert text.startswith(f"; {toolchain_versions()}\n; ")
        declared = {line.split("@")[1].split("(")[0] for line in text.splitlines() if line.startswith("declare ")}
        assert {name for name in declared if not name.startswith("llvm.")} <= {*HELPERS}
        for word in (
            "NRT_",
            "pickle",
            "Py",
            "atomic",
            "fmuladd",
            "llvm.fma",
            " fast ",
            "reassoc",
            "contract",
            str(Path.home()),
        ):
            assert word not in text, word
