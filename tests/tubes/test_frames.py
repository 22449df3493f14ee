"""Frames, and proven products with their inverses."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import FAR, off_orthogonal, orthogonal, solve_in_frame


@pytest.mark.parametrize("off", [0.0, 1e-9, 0.02])
def test_inverses_hold_exact_ones(off: float) -> None:
    """Assert that frame**-1 times frame times a vector holds the vector exactly, of frames that are orthogonal, or nearly."""
    random = np.random.default_rng(32)
    frame = orthogonal(random.normal(size=(4, 4))) + off * random.normal(size=(4, 4))
    assert off_orthogonal(frame) < FAR
    x = random.normal(size=4)
    right = [
        sum((Fraction(a) * Fraction(b) for a, b in zip(row, x.tolist(), strict=True)), Fraction(0))
        for row in frame.tolist()
    ]
    columns = np.stack([boxes.enclosed(number) for number in right], axis=1)[:, :, None]
    found = solve_in_frame(frame, off_orthogonal(frame), columns)[:, :, 0]
    assert ((found[0] <= x) & (x <= found[1])).all()
    assert boxes.width(found).max() < 1e-13 + 60.0 * off


def test_frames_of_any_directions() -> None:
    """Assert that columns in one plane, of any size, zero or not finite give an orthogonal frame, the first along the first."""
    random = np.random.default_rng(33)
    for directions in (
        random.normal(size=(3, 3)) * np.array([1e200, 1e-200, 1.0]),
        np.outer([1.0, 2.0, 2.0], [1.0, 3.0, -1.0]),
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
        np.eye(3)[:, ::-1] * 1e-320,
    ):
        frame = orthogonal(directions)
        assert off_orthogonal(frame) < FAR
        assert np.abs(frame.T @ frame - np.eye(3)).max() < 1e-14
    assert np.abs(orthogonal(np.outer([1.0, 2.0, 2.0], [3.0, 1.0, 1.0]))[:, 0] - [1 / 3, 2 / 3, 2 / 3]).max() < 1e-15
    assert off_orthogonal(np.ones((3, 3))) >= FAR
