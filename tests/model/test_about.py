"""Who stands for a model and its runs: attributes of every record, outside of every digest."""

from __future__ import annotations

from pathlib import Path

import pytest

import xdynamics as xd
from cases.verdicts import verified

BALL = """
name = "ball"
coordinates = { y = "m" }
parameters = { m = "1 kg", g = "9.81 m s-2" }
mass = { y = "m" }
forces.gravity.potential = "m*g*y"
initial = { y = "1 m", v_y = "0 m s-1" }
run = { method = "velocity_verlet", step = "10 ms", until = "0.2 s" }
"""
ABOUT = """
[about]
creator = "A. Noether"
institution = "Göttingen"
license = "CC-BY-4.0"
id = "doi:10.1000/182"
references = "lesson 4"
comment = "second series"
"""
TOLD = {
    "creator_name": "A. Noether",
    "institution": "Göttingen",
    "license": "CC-BY-4.0",
    "id": "doi:10.1000/182",
    "references": "lesson 4",
    "comment": "second series",
}


def told(run: object) -> dict[str, str]:
    """Return what a record says of who stands for it."""
    return {name: text for name, text in getattr(run, "attrs", {}).items() if name in TOLD}


def test_a_model_file_tells_it_of_every_record(tmp_path: Path) -> None:
    """Assert the attributes of a run, of its archive, of what is made of it and of a sweep, with the digests of the model alone."""
    model, plain = xd.Model.from_text(BALL + ABOUT), xd.Model.from_text(BALL)
    run = xd.simulate(model)
    assert told(run) == told(xd.simulate(model.replace(parameters={"g": 9.8}))) == TOLD
    assert (model.digest, xd.content_digest(run)) == (plain.digest, xd.content_digest(xd.simulate(plain)))
    assert "about" not in model.to_toml()
    path = xd.save(run, tmp_path / "run.nc")
    opened = xd.open_run(path)
    assert told(opened) == TOLD
    assert xd.reproduce(path).attrs["identical"] == 1
    assert told(xd.extend(opened, until="0.4 s")) == TOLD
    assert told(xd.complete(xd.simulate(model, log=["y"]))) == TOLD
    assert told(xd.sweep(model, {"g": [9.8, 9.9]})) == TOLD
    assert told(xd.simulate(plain)) == {}


def test_save_tells_it_too(tmp_path: Path) -> None:
    """Assert keywords of `save` over what the model said, in an archive with the same digest; the run itself stays."""
    run = xd.simulate(xd.Model.from_text(BALL + ABOUT))
    digest = verified(xd.save(run, tmp_path / "run.nc"))
    path = xd.save(run, tmp_path / "noted.nc", creator="B. Russell", comment="third series")
    assert verified(path) == digest
    assert told(xd.open_run(path)) == TOLD | {"creator_name": "B. Russell", "comment": "third series"}
    assert told(run) == TOLD


@pytest.mark.parametrize("wrong", ["", "  ", 3, None, ["A", "B"]])
def test_what_is_no_text_is_refused(wrong: object, tmp_path: Path) -> None:
    """Assert one line and no file; none at all for what is not given."""
    run = xd.simulate(xd.Model.from_text(BALL))
    if wrong is None:
        assert xd.save(run, tmp_path / "run.nc", license=wrong).exists()
        return
    with pytest.raises(xd.InputError, match="license is .*, needs a text"):
        xd.save(run, tmp_path / "run.nc", license=wrong)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'about = { who = "x" }',
            "key 'who' is not known; there are creator, institution, license, id, references, comment",
        ),
        ('about = "me"', r"\[about\] must be a table of names, got 'me'"),
    ],
)
def test_what_is_wrong_in_a_model_file_is_named(text: str, said: str) -> None:
    """Assert one error that names it."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(BALL + text)
