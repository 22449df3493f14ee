"""Boxes of coordinates, by which links that are too far to meet are left out: what is proven to stay in one does."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from cases.plain import between_states, made_by_hand, plain
from xdynamics.march.assembly.broad_phase import stays_inside
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
        run.boxes = np.array([[low], [high]])
        if plain(stays_inside)(run, 0, w):
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
    run.boxes = np.array([[bounds.low - near], [bounds.high + near]])
    assert plain(stays_inside)(run, 0, w)
    for low, high in ((near, 0.0), (0.0, near)):
        run.boxes = np.array([[bounds.low + low], [bounds.high - high]])
        assert not plain(stays_inside)(run, 0, w)
