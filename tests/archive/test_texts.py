"""Outcomes as flags and digests as bytes in a file: what is read, and every digest, is that of texts kept as letters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import without_dates
from cases.verdicts import verified
from xdynamics.archive import writing
from xdynamics.archive.seals import seal_file, utf8_letters
from xdynamics.archive.text_encoding import encoded_texts, text_form

ASKED: dict[str, Any] = {"method": "heun", "rtol": 1e-6, "members_per_task": 2}
AXES = {"vt": "20:40:5 m s-1", "y": [0.0, 1.0]}


def swept(path: Path) -> Path:
    """March a sweep into a folder; return its catalogue."""
    xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, path=path, **ASKED).close()
    return path / "catalogue.nc"


@pytest.mark.cases(400)
def test_texts_come_back_from_numbers(case: int) -> None:
    """Assert that random texts are read as they were, each and any part of them; or stay letters where they are none of the kind."""
    draw = np.random.default_rng(case)
    shape = tuple(draw.integers(1, 7, draw.integers(1, 4)))
    alphabet = np.array(list("0123456789abcdef" if draw.random() < 0.7 else "0123456789abcdefgA é"))
    role = ["digest", "outcome"][draw.integers(2)]
    count = int(np.prod(shape)) if role == "digest" else int(draw.integers(1, 6))
    same = draw.integers(0, 40)
    words = ["".join(draw.choice(alphabet, same if role == "digest" else draw.integers(0, 9))) for _ in range(count)]
    texts = np.array(words)[np.arange(count) if role == "digest" else draw.integers(0, count, np.prod(shape))]
    texts = texts.reshape(shape)
    found = encoded_texts("a", role, utf8_letters(texts))
    even = role == "digest" and (same == 0 or same % 2 or not {*"".join(words)} <= {*"0123456789abcdef"})
    spoilt = role == "outcome" and (any(" " in one or "é" in one for one in texts.flat) or not any(texts.flat))
    assert (found is None) == (even or spoilt)
    if found is None:
        return
    form = text_form(found.attributes, found.values.dtype, (*"abcd"[: found.values.ndim],), found.values.shape)
    assert form is not None
    np.testing.assert_array_equal(form.texts(found.values), texts)
    np.testing.assert_array_equal(form.letters(found.values), utf8_letters(texts))
    at = tuple(int(draw.integers(n)) for n in shape)
    assert str(form.texts(found.values[at])) == texts[at]


@pytest.mark.dear
def test_a_catalogue_of_numbers_is_that_of_letters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert words, types, attributes and digests of a catalogue as it was kept before, whose file still opens."""
    new = swept(tmp_path / "new")
    monkeypatch.setattr(writing, "encoded_texts", lambda *_: None)
    old = swept(tmp_path / "old")
    with netCDF4.Dataset(new) as one, netCDF4.Dataset(old) as other:
        kinds = [[file[name].dtype.str for name in ("run_outcome", "run_digest")] for file in (one, other)]
        assert kinds == [["|i1", "|u1"], ["|S1", "|S1"]]
        assert one["run_outcome"].flag_meanings == "stopped_by_event"
        assert one["run_outcome"].sha256 == other["run_outcome"].sha256
        assert one["run_digest"].sha256 == other["run_digest"].sha256
    assert verified(new) == verified(old)
    with xd.open_sweep(new.parent) as one, xd.open_sweep(old.parent) as other:
        assert {name: each.dtype for name, each in one.items()} == {name: each.dtype for name, each in other.items()}
        xr.testing.assert_identical(without_dates(one.compute()), without_dates(other.compute()))
        assert xd.content_digest(one) == one.attrs["content_digest"]
        assert str(one.run_outcome[1, 1].values) == "stopped_by_event"
        xd.save(one.compute(), tmp_path / "copy.nc")
    assert verified(tmp_path / "copy.nc") == verified(new)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("run_digest", "'run_digest' differs from its digest"),
        ("run_outcome", "'run_outcome' cannot be read: a flag"),
        ("flag_meanings", "'run_outcome' cannot be read: it is no text"),
        ("text_form", "'run_digest' cannot be read: it is no text in the form 'base64'"),
        ("of a number", "'end_y' cannot be read: it is no text in the form 'hexadecimal'"),
        ("two forms", "'run_digest' cannot be read: it is no text in the form 'hexadecimal'"),
    ],
)
def test_damage_to_numbers_is_named(tmp_path: Path, name: str, said: str) -> None:
    """Assert that a changed number or meaning, in a file that is sealed again, is damage."""
    path = swept(tmp_path / "s")
    with netCDF4.Dataset(path, "a") as file:
        if name in ("run_digest", "run_outcome"):
            file[name].set_auto_maskandscale(False)
            file[name][0, 0] = file[name][0, 0] + 1
        elif name == "of a number":
            file["end_y"].text_form = "hexadecimal"
        elif name == "two forms":
            file["run_digest"].flag_meanings = "a b"
        else:
            one = file["run_outcome" if name == "flag_meanings" else "run_digest"]
            one.setncattr(name, "two words" if name == "flag_meanings" else "base64")
    seal_file(path)
    with pytest.raises(xd.ArchiveError, match=said):
        xd.verify(path)
