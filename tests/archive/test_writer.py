"""A file while it is filled: what is defined, given and read back, and how much room it takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from xdynamics.archive import writing
from xdynamics.archive.seals import CHUNKS, OTHER_CHUNK
from xdynamics.archive.writing import Writer
from xdynamics.schema import BOUNDS, EVENTS, STEPS

FLOAT = np.dtype("f8")


@pytest.fixture
def file(tmp_path: Path) -> Iterator[netCDF4.Dataset]:
    """An empty file."""
    with netCDF4.Dataset(tmp_path / "run.nc", "w", format="NETCDF4") as file:
        yield file


def filled(file: netCDF4.Dataset, rows: int) -> Writer:
    """Fill a file with a variable of steps, one of pairs, a number and a text."""
    made = Writer(file)
    made.define("x", (STEPS,), FLOAT, {"units": "m", "coordinates": "no"}, {})
    made.define("pairs", (EVENTS, BOUNDS), FLOAT, {}, {EVENTS: 3})
    made.define("g", (), FLOAT, {}, {})
    made.define("text", (), np.dtype(object), {}, {})
    for name, values in (("x", np.arange(rows, dtype=float)), ("pairs", np.ones((3, 2))), ("g", np.array(9.8))):
        made.append(name, values)
    made.append("text", np.array("größer", dtype=object))
    return made


def test_what_may_grow_and_what_not(file: netCDF4.Dataset) -> None:
    """Assert dimensions and chunks: whole ones for what may grow, as many rows as there are for what may not."""
    filled(file, 5)
    assert [(dimension.name, len(dimension), dimension.isunlimited()) for dimension in file.dimensions.values()][
        :3
    ] == [
        (STEPS, 5, True),
        (EVENTS, 3, False),
        (BOUNDS, 2, False),
    ]
    assert [file[name].chunking() for name in ("x", "pairs", "g")] == [[CHUNKS[STEPS]], [3, 2], "contiguous"]
    made = Writer(file)
    made.define("empty", ("none", "other"), FLOAT, {}, {"none": 0, "other": 2 * OTHER_CHUNK})
    assert file["empty"].chunking() == [1, OTHER_CHUNK]


@pytest.mark.parametrize(
    ("sizes", "chunk"),
    [
        ({"site": 300}, [436, 300]),
        ({"site": 10_000}, [13, 10_000]),
        ({"site": 1_000_000}, [1, 125_000]),
        ({"body": 100_000, "axis": 3}, [1, 33_334, 3]),
    ],
    ids=str,
)
def test_rows_of_many_elements_are_whole_or_in_equal_parts(
    file: netCDF4.Dataset, sizes: dict[str, int], chunk: list[int]
) -> None:
    """Assert chunks of up to a megabyte that hold rows in one piece, so that one row a time is written once."""
    Writer(file).define("r", (STEPS, *sizes), FLOAT, {}, sizes)
    assert file["r"].chunking() == chunk


def test_a_variable_has_room_for_two_chunks(file: netCDF4.Dataset) -> None:
    """Assert that the library keeps no more of a variable in memory than what is being filled."""
    filled(file, 5)
    assert [file[name].get_var_chunk_cache()[0] for name in ("x", "pairs")] == [2 * 8 * CHUNKS[STEPS], 2 * 8 * 6]


def test_what_was_given_is_read_back(file: netCDF4.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert names, types, shapes and values of all that came since a moment, in parts of a bounded length."""
    monkeypatch.setattr(writing, "BACK", 4)
    made = filled(file, 5)
    before = made.filled
    assert before == {"x": 5, "pairs": 3, "g": 0, "text": 0}
    made.append("x", np.arange(5.0, 15.0))
    numbers = {"x": 3, "pairs": 3, "g": 0, "text": 0}
    assert made.shapes_since({"x": 3, "pairs": 3})[:2] == [("x", FLOAT, (12,)), ("pairs", FLOAT, (0, 2))]
    assert [part.tolist() for part in made.since(numbers)] == [[3, 4, 5, 6], [7, 8, 9, 10], [11, 12, 13, 14]]
    assert [part.shape for part in made.since(before)] == [(4,), (4,), (2,)]
    assert made.filled["x"] == 15


@pytest.mark.parametrize(("outcome", "complete"), [("completed", True), ("interrupted", False), (None, False)])
def test_a_finished_file_says_what_it_is(file: netCDF4.Dataset, outcome: str | None, *, complete: bool) -> None:
    """Assert the attributes of a file and of its variables, old digests left out, and whether the run ended well."""
    made = filled(file, 5)
    digests = made.digests()
    given = {"title": "t", "content_digest": "old", "volatile_digest": "old"}
    made.finish(given | ({"run_outcome": outcome} if outcome else {}))
    assert made.complete is complete
    assert {"title", "archive_seal", "content_digest", "volatile_digest"} <= {*file.ncattrs()}
    assert "old" not in {str(file.getncattr(name)) for name in file.ncattrs()}
    assert file["x"].__dict__ == {"units": "m"}
    assert file["text"].__dict__ == {"_Encoding": "utf-8"}
    assert dict(line.split() for line in file.variable_digests.splitlines()) == digests
    assert str(file["text"][:].tobytes(), "utf-8") == "größer"
