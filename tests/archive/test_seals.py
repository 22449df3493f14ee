"""Digests of variables and runs: what they hang on, and what not."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from xdynamics.archive import seals
from xdynamics.archive.content import content_digest
from xdynamics.archive.integrity import variable_digest
from xdynamics.archive.seals import utf8_letters
from xdynamics.schema import EVENTS, SAMPLES, STEPS, TRIALS, Variable

NUMBERS = np.arange(6.0).reshape(2, 3)
SAME = variable_digest("a", xr.Variable(("n", "m"), NUMBERS))


@pytest.mark.parametrize(
    ("name", "dims", "values"),
    [
        ("b", ("n", "m"), NUMBERS),
        ("a", ("m", "n"), NUMBERS),
        ("a", ("n", "m"), NUMBERS.reshape(3, 2)),
        ("a", ("n", "m"), NUMBERS.reshape(6, 1)),
        ("a", ("n", "m"), NUMBERS.view("i8")),
        ("a", ("n", "m"), NUMBERS[:, ::-1]),
        ("a", ("n", "m"), np.where(NUMBERS == 0.0, -0.0, NUMBERS)),
    ],
)
def test_a_digest_is_of_name_dims_shape_type_and_bits(name: str, dims: tuple[str, ...], values: np.ndarray) -> None:
    """Assert that no two variables that differ in any of these have one digest, the same bytes in another shape either."""
    assert variable_digest(name, xr.Variable(dims, values)) != SAME


@pytest.mark.parametrize("shape", [(0, 2), (0, 3), (2, 0), ()])
def test_a_digest_of_nothing_is_of_its_shape(shape: tuple[int, ...]) -> None:
    """Assert that variables without a value are told from one another, and from one of a row."""
    others = [(0, 2), (0, 3), (2, 0)]
    dims = ("n", "m")[: len(shape)]
    found = variable_digest("a", xr.Variable(dims, np.zeros(shape)))
    assert [other for other in others if variable_digest("a", xr.Variable(("n", "m"), np.zeros(other))) == found] == [
        other for other in others if other == shape
    ]


def test_a_digest_is_of_no_order_in_memory() -> None:
    """Assert that byte order, strides and chunks of the same numbers change nothing."""
    for values in (NUMBERS.astype(">f8"), np.asfortranarray(NUMBERS), np.repeat(NUMBERS, 2, axis=1)[:, ::2]):
        assert variable_digest("a", xr.Variable(("n", "m"), values)) == SAME
    long = xr.Variable(("n",), np.arange(70_000.0))
    assert variable_digest("a", long.chunk({"n": 999})) == variable_digest("a", long)


def test_the_content_digest_is_of_every_attribute_that_is_no_circumstance() -> None:
    """Assert that attributes of the run and of its variables count, and their order and the date do not."""
    run = xr.Dataset({"a": ("n", [1.0, 2.0], {"units": "m", "role": "state"})}, attrs={"title": "x", "solver_order": 2})
    same = content_digest(run)
    assert content_digest(run.assign_attrs(date_created="now", content_digest="other")) == same
    assert content_digest(run.drop_attrs(deep=False).assign_attrs(solver_order=2, title="x")) == same
    more = run.assign(b=run.a)
    assert content_digest(more[["b", "a"]]) == content_digest(more[["a", "b"]]) != same
    others = [run.assign_attrs(title="y"), run.assign_attrs(more=1), run.assign(a=run.a.assign_attrs(units="s"))]
    assert same not in [content_digest(other) for other in others]


def test_a_digest_of_a_text_is_of_its_letters() -> None:
    """Assert that a text has the digest of its UTF-8, whether it is one value or letters."""
    text = variable_digest("a", xr.Variable((), np.array("kräftig")))
    assert text != variable_digest("a", xr.Variable((), np.array("kraftig")))
    assert text == variable_digest("a", xr.Variable((), np.array("kräftig", dtype=object)))


def test_a_digest_is_begun_before_its_first_value() -> None:
    """Assert that rows that come one by one have the digest of all of them, their form being known beforehand."""
    variable = Variable("a", ("n", "m"), "f8", "m", "some number", "state")
    seal = seals.Seal.for_variable(variable)
    for row in NUMBERS:
        seal.update(row[None])
    assert seal.hexdigest() == SAME


class Stored:
    """A variable of a file, as the library shows it, of which every reading is noted."""

    def __init__(self, values: np.ndarray) -> None:
        self.values, self.read, self.name, self.dimensions = values, [], "a", ("step", "m")[: values.ndim]
        self.shape, self.dtype = values.shape, values.dtype

    def set_auto_chartostring(self, _: object) -> None:
        """Numbers are no text."""

    def __getitem__(self, part: slice) -> np.ndarray:
        self.read.append(len(range(*part.indices(len(self.values)))))
        return self.values[part]


@pytest.mark.parametrize("shape", [(3_000_000,), (5, 2_000_000), (0,)])
def test_a_variable_of_a_file_is_read_in_parts(shape: tuple[int, ...]) -> None:
    """Assert that at most 32 MiB are read at once, or one row, and that the digest is that of the whole."""
    stored = Stored(np.zeros(shape))
    assert seals.stored_digest(stored) == variable_digest("a", xr.Variable(stored.dimensions, stored.values))
    row = stored.values.itemsize * int(np.prod(shape[1:]))
    assert sum(stored.read) == shape[0]
    assert max(stored.read) * row <= 1 << 25
    assert len(stored.read) == max(1, -(-shape[0] // min(8 * seals.CHUNKS[STEPS], (1 << 25) // row)))


def test_rows_of_nothing_are_read_too() -> None:
    """Assert that a variable of a file whose rows have no bytes has the digest that it has in memory."""
    stored = Stored(np.zeros((5, 0)))
    assert seals.stored_digest(stored) == variable_digest("a", xr.Variable(stored.dimensions, stored.values))


def test_chunks_are_a_megabyte_at_most() -> None:
    """Assert that a chunk of what grows by steps is 1 MiB of floats, and of what is rare a few pages."""
    pages = {dim: seals.CHUNKS[dim] * 8 / 4096 for dim in (STEPS, SAMPLES, TRIALS, EVENTS)}
    assert pages == {STEPS: 256, SAMPLES: 256, TRIALS: 8, EVENTS: 1}
    assert seals.OTHER_CHUNK * 8 / 4096 == 8


def test_rows_are_hashed_and_written_in_slabs() -> None:
    """Assert that eight chunks at most are computed at once."""
    rows = [len(part) for part in seals.slabs(xr.Variable((STEPS,), np.zeros(2_500_000)))]
    assert rows == [1_048_576, 1_048_576, 402_848]


def test_a_seal_is_of_every_part_of_a_file(tmp_path: Path) -> None:
    """Assert the digest of the digests of 4 MiB each, and that a flipped bit is found in any of them."""
    whole, path = np.random.default_rng(1).bytes(9 << 20), tmp_path / "file"
    path.write_bytes(whole)
    parts = [hashlib.sha256(whole[start : start + (4 << 20)]).digest() for start in (0, 4 << 20, 8 << 20)]
    assert seals.seal_file(path) == hashlib.sha256(b"".join(parts)).hexdigest()
    assert seals.tail_of(path).digest
    for place in (0, 5 << 20, (9 << 20) - 1):
        with path.open("r+b") as file:
            file.seek(place)
            file.write(bytes([whole[place] ^ 1]))
        assert seals.tail_of(path) == seals.Tail(fault="the bytes of the file differ from its seal")
        with path.open("r+b") as file:
            file.seek(place)
            file.write(whole[place : place + 1])
    assert seals.tail_of(path).digest


@pytest.mark.parametrize(
    "texts", [["a", "bcd"], ["", ""], ["", "x"], ["é", "ab"], [["one", "two"], ["three", ""]], ["\x7f", "\x80"]]
)
def test_letters_are_the_bytes_of_utf_8(texts: Any) -> None:
    """Assert bytes and width against numpy's own encoding, whatever the width that texts are kept with."""
    for kind in (str, "U40", object):
        text = np.array(texts, kind)
        encoded = np.char.encode(text.astype(str), "utf-8")
        expected = np.ascontiguousarray(encoded).view("S1").reshape(*text.shape, encoded.dtype.itemsize)
        found = utf8_letters(text)
        assert found.shape == expected.shape
        assert found.tobytes() == expected.tobytes()
