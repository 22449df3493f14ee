"""Boxes of coordinates, by which links that are too far to meet are left out: what is proven to stay in one does."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from cases.balls import balls
from cases.plain import between_states, made_by_hand, plain
from xdynamics.march import March
from xdynamics.march.assembly.broad_phase import ASSEMBLY, FIRST, LINK, NARROW, NEAR, SECOND, WIDE, stays_in_narrow_box
from xdynamics.march.configuration import settings_for
from xdynamics.march.run import Run


def stepped(random: np.random.Generator, degree: int) -> tuple[Run, Polynomial, float]:
    """Return a run with the states at both ends of a step along a polynomial, with the polynomial and its width."""
    run, w = made_by_hand(n=1), 10.0 ** random.uniform(-3, 1)
    s, motion = Polynomial([0.0, 1.0 / w]), Polynomial([10.0 ** random.uniform(-3, 3)])
    for k in range(degree + 1):  # each of Bernstein's coefficients may be the least or the greatest
        motion += random.normal() * comb(degree, k) * s**k * (1.0 - s) ** (degree - k)
    for state, t in ((run.y, 0.0), (run.z, w)):
        state[:3] = motion(t), motion.deriv()(t), motion.deriv(2)(t)
    return run, motion, w


def boxed(low: float, high: float) -> NDArray[np.float64]:
    """Return a narrow box of one coordinate, in a wide one that is everywhere."""
    return np.array([[-np.inf], [np.inf], [low], [high]])


@pytest.mark.cases(200)
def test_boxes_hold_the_polynomials_that_stay_inside(case: int) -> None:
    """Assert for random cubics and quintics that those proven to stay in a box are in it at each of 500 places."""
    random, proven = np.random.default_rng([30, 1, case]), 0
    run, motion, w = stepped(random, 5 if case % 2 else 3)
    values = motion(np.linspace(0.0, w, 500))
    reach = values.max() - values.min()
    for _ in range(40):
        out, up = 1e3 * reach * random.uniform([-0.2, -0.2], [1.0, 1.0]) ** 5
        low, high = values.min() - out, values.max() + up
        run.boxes = boxed(low, high)
        if plain(stays_in_narrow_box)(run, 0, w):
            proven += 1
            assert low <= values.min()
            assert high >= values.max()
    assert proven > 0


@pytest.mark.cases(200)
def test_boxes_are_as_narrow_as_bounds_of_steps(case: int) -> None:
    """Assert that a motion stays in a box a billionth wider than the bounds of its step, and in none that is narrower."""
    random = np.random.default_rng([30, 2, case])
    run, _, w = stepped(random, 5 if case % 2 else 3)
    bounds = between_states("position", run.y, run.z, (0, 1, 2), w)
    near = 1e-9 * max(abs(bounds.low), abs(bounds.high))
    run.boxes = boxed(bounds.low - near, bounds.high + near)
    assert plain(stays_in_narrow_box)(run, 0, w)
    for low, high in ((near, 0.0), (0.0, near)):
        run.boxes = boxed(bounds.low + low, bounds.high - high)
        assert not plain(stays_in_narrow_box)(run, 0, w)


def test_what_boxes_leave_out_is_apart_all_over_them() -> None:
    """Assert for 27 balls that pairs which wide or narrow boxes leave out are farther apart than they can meet in them."""
    model = balls(3, radius=0.1, seed=2)
    settings = settings_for(model, method="velocity_verlet", step="5 ms", until="2 s", force_samples="none")
    march, radius, left_out = March(model, settings), 0.1, 0
    first, second = np.triu_indices(27, 1)
    for block in march.blocks(16):
        run = march.run
        places = run.y[:81].reshape(27, 3)
        for row in (WIDE, NARROW):
            low, high = run.boxes[row : row + 2].reshape(2, 27, 3)
            assert ((low <= places) & (places <= high)).all()
            away = np.maximum(np.maximum(low[first] - high[second], low[second] - high[first]), 0.0)
            may_meet = np.linalg.norm(away, axis=1) <= 2.0 * radius
            listed = [c for c in run.candidates[: run.counters[0]] if row == WIDE or c[NEAR] == 1]
            pairs = {(c[FIRST], c[SECOND]) for c in listed if c[ASSEMBLY] == 2}
            assert pairs >= set(zip(first[may_meet], second[may_meet], strict=True))
            left_out += len(first) - len(pairs)
            walls = [{c[LINK] for c in listed if c[ASSEMBLY] == wall} for wall in (0, 1)]
            assert walls[0] >= set(np.flatnonzero(low.ravel() <= radius))
            assert walls[1] >= set(np.flatnonzero(high.ravel() >= 1.0 - radius))
        assert (run.boxes[WIDE] <= run.boxes[NARROW]).all()
        assert (run.boxes[NARROW + 1] <= run.boxes[WIDE + 1]).all()
        del block
    assert left_out > 0
