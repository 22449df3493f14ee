"""The gallery: a picture and a word for every model."""

from __future__ import annotations

from cases.problems import MODELS, ROOT
from gallery import page


def test_every_model_is_in_the_gallery() -> None:
    """Assert that the page is the one that the models make, and that its pictures are there."""
    assert (ROOT / "data" / "README.md").read_text() == page()
    for path in MODELS.glob("*.toml"):
        assert (ROOT / "data" / "figures" / f"{path.stem}.png").stat().st_size > 5_000
