"""Digests of variables and runs: what they hang on, and what not.

The end of an archive: a seal that is hurt, cut off, buried or left out is found and named, on opening too.
What a record is by comparison with what it was, told on small records that nobody had to march.
"""

from __future__ import annotations

import hashlib
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import ROOT, oscillator
from cases.verdicts import verified
from xdynamics.archive import seals
from xdynamics.archive.content import content_digest
from xdynamics.archive.integrity import (
    check_unchanged,
    marched,
    record_standing,
    rows_within,
    selected_like,
    variable_digest,
)
from xdynamics.archive.seals import MARK, Tail, seal_file, tail_of, utf8_letters
from xdynamics.faults import InputError
from xdynamics.schema import EVENTS, LEFT_OUT_ATOL, SAMPLES, SELECTION, SELECTION_OF, STEPS, TRIALS, Variable

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


SEAL = len(MARK) + 64 + 1
READ = (xd.verify, xd.open_run)


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests, which only read it."""
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("tail") / "whole.nc")


@pytest.fixture
def hurt(archived: Path, tmp_path: Path) -> Callable[[Callable[[bytearray], object]], Path]:
    """Write copies of the archive whose bytes were changed."""

    def changed(change: Callable[[bytearray], object]) -> Path:
        content = bytearray(archived.read_bytes())
        change(content)
        (tmp_path / "hurt.nc").write_bytes(content)
        return tmp_path / "hurt.nc"

    return changed


def flip(bit: int) -> Callable[[bytearray], object]:
    """Change a bit of the seal, counted from its beginning."""

    def change(content: bytearray) -> None:
        content[len(content) - SEAL + bit // 8] ^= 1 << bit % 8

    return change


def cut(n: int) -> Callable[[bytearray], object]:
    """Take bytes away from the end."""
    return lambda content: content.__delitem__(slice(len(content) - n, None))


def test_every_bit_of_the_seal_counts(hurt: Callable[..., Path]) -> None:
    """Assert that all 144 bits of the mark and those of the digest are found, and called what they are."""
    for bit in range(8 * SEAL):
        fault = tail_of(hurt(flip(bit))).fault
        in_digest = len(MARK) <= bit // 8 < SEAL - 1
        assert fault in (("its seal is hurt", "the bytes of the file differ from its seal")[: 1 + in_digest]), bit


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("bit", [0, 8 * 17, 8 * 18 + 1, 8 * 83 - 1])
def test_a_hurt_seal_is_named(hurt: Callable[..., Path], bit: int, read: Callable[[Path], object]) -> None:
    """Assert that opening and verifying say that it is the seal."""
    with pytest.raises(xd.ArchiveError, match=r"no run archive:\n  1\. .*its seal"):
        read(hurt(flip(bit)))


@pytest.mark.dear
def test_every_cut_is_found(hurt: Callable[..., Path]) -> None:
    """Assert that 1 to 200 bytes less are found: what was sealed does not pass as never sealed."""
    for n in range(1, 201):
        path = hurt(cut(n))
        if SEAL - len(MARK) < n <= SEAL:  # of the mark a part is left, and every number is there
            assert xd.verify(path).verdict == "repacked"
            continue
        with pytest.raises(xd.ArchiveError, match="its seal is (hurt|cut off)|cannot be read") as told:
            xd.verify(path)
        assert told.value.verdict == "damaged"


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("n", [1, 40, 60])
def test_a_cut_seal_is_named(hurt: Callable[..., Path], n: int, read: Callable[[Path], object]) -> None:
    """Assert that opening finds what verifying finds."""
    with pytest.raises(xd.ArchiveError, match=rf"its seal is cut off: {n} of its 83 bytes|its seal is hurt"):
        read(hurt(cut(n)))


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize(
    ("n", "fault"),
    [
        (1, "a byte follows its seal"),
        (2, "2 bytes follow its seal"),
        (83, "83 bytes follow its seal"),
        (65_000, "65000 bytes follow its seal"),
    ],
)
def test_what_stands_behind_the_seal_is_found(
    hurt: Callable[..., Path], n: int, read: Callable[..., object], fault: str
) -> None:
    """Assert that bytes that were added are counted."""
    with pytest.raises(xd.ArchiveError, match=rf"no run archive:\n  1\. {fault}"):
        read(hurt(lambda content: content.extend(b"\0" * n)))


@pytest.mark.parametrize(("right", "fault"), [(9, ""), (10, "its seal is hurt")])
def test_what_is_less_than_half_like_a_seal_is_none(tmp_path: Path, right: int, fault: str) -> None:
    """Assert that a file that never had a seal is not called hurt for a few bytes that happen to be those of the mark."""
    path = tmp_path / "file"
    path.write_bytes(MARK[:right] + b"\0" * (SEAL - right))
    assert tail_of(path) == Tail(fault=fault)


def test_a_seal_that_is_lost_among_other_bytes_is_none(hurt: Callable[..., Path]) -> None:
    """Assert that where so many bytes follow that no seal is found, the numbers decide."""
    assert xd.verify(hurt(lambda content: content.extend(b"\0" * 66_000))).verdict == "repacked"


ADDED = {
    "group 'more'": lambda file: file.createGroup("more"),
    "dimension 'more'": lambda file: file.createDimension("more", 3),
    "type 'more'": lambda file: file.createVLType("i4", "more"),
    "variable 'more' differs": lambda file: file.createVariable("more", "f8", ()),
    "attributes differ": lambda file: file.setncattr("more", 1),
    "variable 'x' is not stored as it was written": lambda file: file["x"].setncattr("coordinates", "v_x"),
}


NOTED = "attributes differ"  # that one note more stands beside the record is nobody's fault
BESIDE = {
    "repacked": ("dimension 'more'", NOTED, "variable 'x' is not stored as it was written"),
    "verified": (NOTED,),
}


@pytest.mark.parametrize("fault", ADDED)
def test_what_was_added_is_named(archived: Path, tmp_path: Path, fault: str) -> None:
    """Assert that it is named where a seal was made anew, and without a seal where it changes what the record says."""
    import netCDF4

    path = Path(shutil.copy(archived, tmp_path / "more.nc"))
    with netCDF4.Dataset(path, "a") as file:
        ADDED[fault](file)
    for verdict in "repacked", "verified":
        if fault in BESIDE[verdict]:
            assert xd.verify(path).verdict == verdict
            xd.open_run(path).close()
        else:
            with pytest.raises(xd.ArchiveError, match=fault):
                xd.verify(path)
        seal_file(path)


def test_the_word_of_the_seal_cannot_be_taken_out(archived: Path, tmp_path: Path) -> None:
    """Assert that an archive without seal and without the attribute that tells of it does not pass as it was written."""
    import netCDF4

    path = Path(shutil.copy(archived, tmp_path / "less.nc"))
    with netCDF4.Dataset(path, "a") as file:
        file.delncattr("archive_seal")
    path.write_bytes(path.read_bytes().replace(MARK, b"\n" * len(MARK)))
    assert xd.verify(path).verdict == "repacked"


def test_the_word_of_the_seal_is_of_files_only(archived: Path) -> None:
    """Assert that a run in memory does not say that it ends with a seal."""
    assert "archive_seal" not in xd.open_run(archived).attrs


def test_archives_from_before_seals_still_open(tmp_path: Path) -> None:
    """Assert that a file of version 0.1 that never had a seal is verified by its digests."""
    old = ROOT / "data" / "golden" / "0.1" / "ball_drag_midpoint.nc"
    path = tmp_path / "old.nc"
    path.write_bytes(old.read_bytes()[:-SEAL])
    assert tail_of(path) == Tail()
    assert verified(path) == verified(old)
    assert xd.open_run(path).sizes == xd.open_run(old).sizes


Change = Callable[[xr.Dataset], xr.Dataset]
LONG = 40_000  # rows, more than one slab of a dimension without a size of its own
MANY = {f"p{n:02}": ((), float(n), {}) for n in range(12)}


def record() -> xr.Dataset:
    """A record as it was marched."""
    about = {"units": "m", "atol_si": 1e-9}
    variables = {
        "x": ("step", np.arange(6.0), about),
        "pairs": (("step", "bound"), np.arange(12.0).reshape(6, 2), {"units": "s", "atol_si": 1e-3}),
        "bulk": ("rows", np.arange(float(LONG)), {"units": "1"}),
        "event": ("event", [1.5, np.nan], {"units": "s"}),
        "g": ((), 9.8, {"units": "m s-2", "nothing": np.nan}),
        "text": ((), "abc", {}),
    }
    return marched(xr.Dataset(variables | MANY, attrs={"title": "t", "solver_step": 0.1, "none": np.nan}))


def put(name: str, place: object, value: float) -> Change:
    """Return a change of one value."""

    def change(run: xr.Dataset) -> xr.Dataset:
        values = run[name].values.copy()
        values[place] = value
        return run.assign({name: run[name].copy(data=values)})

    return change


def swapped(run: xr.Dataset) -> xr.Dataset:
    """Take the same bytes for numbers of the other byte order."""
    return run.assign(x=run.x.copy(data=run.x.values.view(">f8")))


EDITS: dict[str, tuple[Change, str]] = {
    "attribute gone": (
        lambda run: run.drop_attrs(deep=False).assign_attrs(title="t", none=np.nan, origin=run.attrs["origin"]),
        "attribute 'solver_step' is gone",
    ),
    "attribute": (lambda run: run.assign_attrs(title="u"), "attribute 'title' is 'u', in the run 't'"),
    "new attribute": (
        lambda run: run.assign_attrs(more=np.float64(1)),
        "attribute 'more' is 1.0, and the run has none",
    ),
    "long attribute": (
        lambda run: run.assign_attrs(title="u" * 70),
        f"attribute 'title' is '{'u' * 56}…, in the run 't'",
    ),
    "rather long attribute": (
        lambda run: run.assign_attrs(title="u" * 58),
        f"attribute 'title' is '{'u' * 58}', in the run 't'",
    ),
    "attribute of one": (
        lambda run: run.assign(x=run.x.assign_attrs(units="km")),
        "attribute 'units' of 'x' is 'km', in the run 'm'",
    ),
    "dims": (
        lambda run: run.assign(x=("other", run.x.values, run.x.attrs)),
        "variable 'x' has the dims ('other',), in the run ('step',)",
    ),
    "new": (lambda run: run.assign(y=run.x), "variable 'y' is not in the run"),
    "number": (lambda run: run.assign(g=run.g.copy(data=2.0)), "variable 'g' is 2.0, in the run 9.8"),
    "text": (lambda run: run.assign(text=((), "abcd")), "variable 'text' is 'abcd', in the run 'abc'"),
    "kind": (lambda run: run.assign(x=run.x.astype("i8")), "variable 'x' is of the type int64, in the run float64"),
    "size": (lambda run: run.assign(x=run.x.astype("f4")), "variable 'x' is of the type float32, in the run float64"),
    "order": (swapped, "variable 'x' is of the type >f8, in the run float64"),
    "value": (put("x", 4, 7.0), "variable 'x' is 7.0 in row 4, in the run 4.0"),
    "row": (put("pairs", (3, 1), 0.0), "variable 'pairs' is 0.0 in row 3, bound 1, in the run 7.0"),
    "nan": (put("event", 1, 2.0), "variable 'event' is 2.0 in row 1, in the run nan"),
    "zero": (put("x", 0, -0.0), "variable 'x' is -0.0 in row 0, in the run 0.0"),
    "far row": (put("bulk", 35_000, 1.0), "variable 'bulk' is 1.0 in row 35000, in the run 35000.0"),
    "row of a part": (
        lambda run: put("x", 4, 7.0)(run).isel(step=slice(2, 6)),
        "row 2 of 'step', with x = 7.0, is none of the run's rows",
    ),
    "order of a part": (lambda run: run.isel(step=[3, 2]), "row 1 of 'step', with x = 2.0, is none of the run's rows"),
    "type of a part": (
        lambda run: run.assign(x=run.x.astype("f4")).isel(step=slice(3)),
        "row 0 of 'step', with x = 0.0, is none of the run's rows",
    ),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_is_named(edit: str) -> None:
    """Assert one fault, with both values, and that such a record is not gone on with."""
    change, fault = EDITS[edit]
    edited = change(record())
    assert record_standing(edited).faults == (fault,)
    with pytest.raises(InputError, match="this is not the record that was computed:\n  1. ") as caught:
        check_unchanged(edited)
    assert fault in str(caught.value)


@pytest.mark.parametrize("are_read", [False, True])
@pytest.mark.parametrize(
    ("name", "at", "value"), [("x", 4, 7.0), ("model_toml", (), "name = 'other'"), ("force_source", 0, "other")]
)
def test_values_written_into_an_opened_run_are_named(
    tmp_path: Path, name: str, at: object, value: object, *, are_read: bool
) -> None:
    """Assert that numbers and texts which are overwritten where they stand, read before or not, are found."""
    with xd.open_run(xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")) as run:
        if are_read:
            run.load()
        run[name][at] = value
        with pytest.raises(InputError, match=f"1. variable '{name}' is {value!r}"):
            xd.save(run, tmp_path / "edited.nc")
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


@pytest.mark.parametrize(
    "same",
    [
        lambda run: run,
        lambda run: run.copy(deep=True),
        lambda run: run.assign_attrs(history="later", content_digest="x"),
        lambda run: run.assign(x=run.x.astype(">f8")),
        lambda run: run.chunk({"step": 4}),
    ],
)
def test_what_was_not_edited_is_the_run(same: Change) -> None:
    """Assert that copies, chunks, byte order and what may be written afterwards are no edit."""
    run = record()
    found = record_standing(same(run))
    assert (found.faults, found.selected, found.left_out_atol) == ((), "", {})
    assert found.source_digest == content_digest(run)
    check_unchanged(same(run))


def test_a_part_is_told_from_the_run() -> None:
    """Assert how many rows are kept, what is left out, ten of it by name, and the tolerances of that."""
    run = record()
    part = run.drop_vars(["pairs", *list(MANY)[:9]]).isel(step=[1, 4], rows=slice(5, 9))
    found = record_standing(part)
    named = ", ".join(["pairs", *list(MANY)[:9]])
    assert found.selected == f"2 of 6 rows of 'step'; 4 of {LONG} rows of 'rows'; without {named}"
    assert (found.faults, found.left_out_atol, found.source_digest) == ((), {"pairs": (1e-3, "s")}, content_digest(run))
    more = record_standing(part.drop_vars(list(MANY)[9:11])).selected
    assert more.endswith(f"; without {named} and 2 more")
    with pytest.raises(InputError, match="this is a part of a run, 2 of 6 rows of 'step'; .*; take the whole one"):
        check_unchanged(part)


def test_a_record_without_a_past_is_known_by_its_digest() -> None:
    """Assert that a digest that holds names the run, and one that does not, or none, is told."""
    run = record()
    digest = content_digest(run)
    plain = run.drop_attrs(deep=False).assign_attrs(
        {name: attr for name, attr in run.attrs.items() if name != "origin"}
    )
    assert record_standing(plain.assign_attrs(content_digest=digest)).source_digest == digest
    for other in (plain, plain.assign_attrs(content_digest=digest, title="u")):
        found = record_standing(other)
        assert found.source_digest == ""
        assert found.faults[0].startswith("its origin is unknown")


def test_where_the_run_is_no_longer_at_hand() -> None:
    """Assert that an edit is told by the digest alone, and that rows cannot be looked for."""
    sent = pickle.loads(pickle.dumps(record()))
    assert record_standing(sent).faults == ()
    assert record_standing(put("x", 4, 7.0)(sent)).faults == ("variable 'x' differs from its digest in the run",)
    assert (
        record_standing(sent.isel(step=slice(3)))
        .faults[0]
        .startswith("rows of 'step' are left out, and the run they were")
    )


def test_arrays_that_were_opened_to_writing_are_told() -> None:
    """Assert that the very array of the march vouches for nothing once it could be written to."""
    run = record()
    run.x.values.flags.writeable = True
    assert record_standing(run).faults == (
        "variable 'x' was opened to writing, and what was computed is no longer known",
    )


def test_rows_are_found_in_their_order() -> None:
    """Assert places of rows by all their variables at once, each place taken once, and the first that is not there."""
    whole = xr.Dataset(
        {"a": ("n", [1.0, 1.0, np.nan, 2.0, 1.0]), "b": (("n", "m"), [[0, 0], [0, 1], [0, 0], [0, 0], [0, 1]])}
    )
    for rows in ([0, 1, 2, 3, 4], [1, 2, 4], [2], []):
        assert list(rows_within(["a", "b"], whole.isel(n=rows), whole)) == rows
    assert list(rows_within(["a"], whole.isel(n=[4, 3]), whole)) == [0, 3]
    assert rows_within(["a"], whole.isel(n=[3, 4, 4]), whole) == 2
    assert rows_within(["b"], whole.isel(n=[0]).astype("i4"), whole) == 0


def test_what_a_selection_kept_is_selected_again() -> None:
    """Assert that of a run marched again the rows and variables of a selection are taken, and the run's digest with them."""
    whole = record().assign_attrs(xdynamics_version="1", math_functions="m")
    part = whole.drop_vars(["event", *MANY]).isel(step=[1, 4])
    kept = part.assign_attrs({SELECTION: "2 rows", SELECTION_OF: "0" * 64, LEFT_OUT_ATOL: "{}"})
    found = selected_like(kept, whole)
    assert {name: variable_digest(str(name), variable) for name, variable in found.variables.items()} == {
        name: variable_digest(str(name), variable) for name, variable in part.variables.items()
    }
    said = {name: found.attrs[name] for name in (SELECTION, SELECTION_OF, LEFT_OUT_ATOL)}
    assert said == {SELECTION: "2 rows", SELECTION_OF: content_digest(whole), LEFT_OUT_ATOL: "{}"}
    assert selected_like(part, whole) is whole
    for name in ("xdynamics_version", "math_functions"):
        assert selected_like(kept, whole.assign_attrs({name: "another"})).attrs[SELECTION_OF] == "0" * 64
    forged = put("x", 0, 7.0)(kept)
    assert selected_like(forged, whole).sizes["step"] == 6
