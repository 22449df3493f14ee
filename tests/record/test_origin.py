"""What a record remembers of itself, and what of that goes with it elsewhere."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import xarray as xr

from xdynamics.archive import integrity
from xdynamics.archive.content import content_digest
from xdynamics.archive.integrity import Origin, OriginalVariable, marched, remember_archive, variable_digest


def record() -> xr.Dataset:
    """A small record."""
    return xr.Dataset(
        {"x": ("step", np.arange(3.0), {"units": "m"}), "text": ((), "abc")}, attrs={"title": "t", "order": 2}
    )


def test_what_was_marched_is_remembered_as_it_is() -> None:
    """Assert that nothing is copied or hashed, that arrays are closed to writing, and which digests there will be."""
    run = record()
    values, digest = run.x.values, content_digest(run)
    made = marched(run)
    assert made is run
    assert not values.flags.writeable
    kept: Origin = made.attrs["origin"]
    assert kept.parts["x"].variable is not None
    assert kept.parts["x"].variable.data is values
    assert "digest" not in vars(kept.parts["x"])
    assert (kept.parts["x"].dims, kept.parts["x"].shape, kept.parts["x"].attributes) == (
        ("step",),
        (3,),
        {"units": "m"},
    )
    assert kept.parts["x"].digest == variable_digest("x", record().variables["x"])
    assert (kept.content_digest, kept.attributes) == (digest, record().attrs)
    whole = kept.original_record()
    assert whole is not None
    assert content_digest(whole.assign_attrs(record().attrs)) == digest


def test_parts_are_made_when_they_are_asked_for_and_once() -> None:
    """Assert that a run which nobody saves costs nothing."""
    made: list[str] = []
    part = OriginalVariable("x", (), (), {}, known_digest="1" * 64)
    kept = Origin.from_parts(lambda: made.append("made") or {"x": part}, {}, None)
    assert made == []
    assert (kept.parts["x"], kept.parts["x"].digest, made) == (part, "1" * 64, ["made"])


def test_a_run_of_which_a_part_is_gone_is_none() -> None:
    """Assert that values are only at hand where all of them are."""
    kept: Origin = marched(record()).attrs["origin"]
    some = {"x": kept.parts["x"], "text": kept.parts["text"].sent}
    assert Origin.from_parts(lambda: some, {}, None).original_record() is None


def test_a_copy_is_the_same_past_and_a_sent_one_its_digests() -> None:
    """Assert that copies share what is remembered, and that another process is sent digests and the way to the values."""
    kept: Origin = marched(record()).attrs["origin"]
    assert copy.copy(kept) is copy.deepcopy(kept) is kept
    sent = pickle.loads(pickle.dumps(kept))
    assert (sent, sent.attributes, sent.content_digest) == ([integrity.TEXT], record().attrs, kept.content_digest)
    assert sent.parts == {
        name: OriginalVariable(name, part.dims, part.shape, part.attributes, None, part.digest)
        for name, part in kept.parts.items()
    }
    assert (sent.source, sent.original_record()) == (None, None)
    elsewhere = Origin.from_parts(lambda: kept.parts, {}, place)
    assert pickle.loads(pickle.dumps(elsewhere)).original_record() == "the run again"


def place() -> Any:
    """Where a run is read again."""
    return "the run again"


@pytest.mark.parametrize("source", [None, place])
def test_what_was_read_is_known_by_the_digests_of_its_file(source: Any) -> None:
    """Assert that digests are taken off the variables, what is said of storage is no part, and values come from the file."""
    run = record()
    run["x"].attrs |= {"sha256": "1" * 64, "coordinates": "time"}
    kept: Origin = remember_archive(run, source).attrs["origin"]
    assert "sha256" not in run.x.attrs
    assert kept.parts["x"] == OriginalVariable("x", ("step",), (3,), {"units": "m"}, None, "1" * 64)
    assert kept.parts["text"].known_digest == ""
    assert kept.original_record() == (source and "the run again")
