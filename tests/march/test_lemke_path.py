"""Impulses of many links along Lemke's path, of problems made by hand, judged by Coulomb's law itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from cases.plain import made_by_hand, plain
from xdynamics.march.assembly import banded_factors, friction, lemke_path
from xdynamics.march.assembly.banded_factors import AT_ZERO, BY_T, CHANGE, COORDINATE, ORDERS
from xdynamics.march.assembly.closed_links import FORCE, FREE, GRIP, PIECE, RIGHT, SCALE, TOWARD, VECTORS, X
from xdynamics.march.assembly.lemke_path import GIVES, HOLDS, OPENS, SLIDES_BACK, SLIDES_FORTH
from xdynamics.march.run import Run

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pushed:
    """Discs of the plane, of three coordinates each, that are pushed where they touch each other, or a floor."""

    mass: Floats
    rows: Floats  # of each link its gap's rate by velocities, then its slip's
    rates: Floats
    ratio: float

    @classmethod
    def at_random(cls, seed: int, bodies: int, links: int, ratio: float) -> Pushed:
        """Discs with contacts in random directions: every fourth is one with the floor."""
        random, n = np.random.default_rng(seed), 3 * bodies
        rows = np.zeros((2 * links, n))
        for k in range(links):
            i = int(random.integers(bodies))
            j = -1 if k % 4 == 0 else (i + int(random.integers(1, min(3, bodies)))) % bodies
            angle = random.uniform(0.0, 2.0 * np.pi) if j >= 0 else 0.5 * np.pi
            along, across = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
            for body, sign in ((i, -1.0 if j >= 0 else 1.0), (j, 1.0)):
                if body >= 0:
                    rows[2 * k, 3 * body : 3 * body + 2] = sign * np.array(along)
                    rows[2 * k + 1, 3 * body : 3 * body + 3] = [sign * across[0], sign * across[1], -1.0]
        return cls(np.repeat(random.uniform(0.5, 2.0, bodies), 3), rows, rows @ random.normal(size=n), ratio)

    def run(self) -> Run:
        """A run with this problem in it."""
        count, n = self.rows.shape
        own = np.sqrt(((self.rows**2) / self.mass).sum(1))
        run = made_by_hand(
            n,
            normals=np.zeros((2 * count, 6)),
            unit_responses=np.zeros((2 * count, 6)),
            coordinate_indices=np.zeros((2 * count, 6), np.int64),
            vectors=np.zeros((VECTORS, 2 * count)),
            swing=np.zeros(n),
            chains=np.zeros(n + 12 * count, np.int64),
            problem=np.zeros((0, 2)),  # none are solved for by pivots
            solution=np.zeros(n),
            stiffened=np.zeros((n, 2 * n - 1)),
            changes=np.zeros((BY_T + 1, CHANGE + n)),
            ordering=np.zeros((ORDERS, n), np.int64),
        )
        for k in range(count):
            used = np.flatnonzero((self.rows[k - k % 2] != 0.0) | (self.rows[k - k % 2 + 1] != 0.0))
            run.coordinate_indices[k, : used.size] = used
            run.normals[k, : used.size] = self.rows[k, used]
            run.unit_responses[k, : used.size] = self.rows[k, used] / self.mass[used]
        run.vectors[SCALE, :count] = 1.0 / own
        run.vectors[RIGHT, :count] = -self.rates / own
        run.vectors[GRIP, 1:count:2] = self.ratio
        return run

    def residual(self, impulses: Floats) -> float:
        """How far impulses are from Coulomb's law, over the largest rate."""
        own = ((self.rows**2) / self.mass).sum(1)
        after = self.rows @ (self.rows.T @ impulses / self.mass) + self.rates
        press, pull, opens, slips = impulses[::2], impulses[1::2], after[::2], after[1::2]
        gap = np.minimum(opens, press * own[::2])
        drag = pull - np.clip(pull - slips / own[1::2], -self.ratio * press, self.ratio * press)
        return float(max(np.abs(gap).max(), np.abs(drag * own[1::2]).max()) / np.abs(self.rates).max())


def impulses_of(run: Run, count: int) -> Floats:
    """The impulses that a run has found."""
    return np.asarray(run.vectors[X, :count] * run.vectors[SCALE, :count])


def stiffened(pushed: Pushed, pieces: list[int]) -> Floats:
    """The matrix of all coordinates by its definition: masses, and what links add that hold or slide."""
    own = np.sqrt(((pushed.rows**2) / pushed.mass).sum(1))
    scaled, matrix = pushed.rows / own[:, None], np.diag(pushed.mass)
    for k, piece in enumerate(pieces):
        along, beside = scaled[2 * k], scaled[2 * k + 1]
        drag = pushed.ratio * own[2 * k + 1] / own[2 * k] * {SLIDES_FORTH: -1.0, SLIDES_BACK: 1.0}.get(piece, 0.0)
        matrix += (0.0 if piece == OPENS else 1.0) / GIVES * np.outer(along + drag * beside, along)
        matrix += (1.0 if piece == HOLDS else 0.0) / GIVES * np.outer(beside, beside)
    return matrix


@pytest.mark.parametrize("seed", range(4))
def test_factors_and_their_changes_solve(seed: int) -> None:
    """Assert what a band solves, against NumPy, of bodies in several groups, whose links do one thing after the other."""
    pushed, random = Pushed.at_random(seed, 9, 8, 0.4), np.random.default_rng(seed)
    run, count, pieces = pushed.run(), 16, [HOLDS, OPENS, SLIDES_FORTH, SLIDES_BACK] * 2
    n = plain(banded_factors.order_coordinates)(run, 0, count)
    used = run.ordering[COORDINATE, :n]
    assert sorted(used) == np.flatnonzero(np.abs(pushed.rows).sum(0)).tolist()
    run.vectors[PIECE, :count:2] = pieces
    plain(lemke_path.pose_pieces)(run, 0, count, n, GIVES)
    changes = 0
    steps = [(0, SLIDES_FORTH), (1, SLIDES_BACK), (2, OPENS), (0, OPENS), (3, HOLDS), (4, SLIDES_BACK), (1, HOLDS)]
    for link, piece in [(-1, OPENS), *steps]:
        if link >= 0:
            changes, pieces[link] = plain(lemke_path.take_up)(run, 2 * link, n, changes, piece, GIVES), piece
        run.swing[:] = right = random.normal(size=run.swing.size)
        plain(banded_factors.solve_factors)(run, n, changes)
        expected = np.linalg.solve(stiffened(pushed, pieces)[np.ix_(used, used)], right[used])
        assert run.swing[used] == pytest.approx(expected, rel=1e-5, abs=1e-7)
    assert changes == len(steps)


@pytest.mark.parametrize("seed", range(4))
def test_solutions_follow_pieces(seed: int) -> None:
    """Assert that a solution that is changed with its factors is the one that is made anew."""
    pushed, random = Pushed.at_random(seed, 9, 8, 0.4), np.random.default_rng(seed)
    run, count = pushed.run(), 16
    n = plain(banded_factors.order_coordinates)(run, 0, count)
    run.vectors[PIECE, :count:2] = [HOLDS, OPENS, SLIDES_FORTH, SLIDES_BACK] * 2
    run.vectors[FREE, :count], run.vectors[TOWARD, :count] = random.normal(size=(2, count))
    gives, changes = 1e-2, 0
    plain(lemke_path.pose_pieces)(run, 0, count, n, gives)
    for solved in (AT_ZERO, BY_T):
        plain(lemke_path.solve_pieces)(run, 0, count, n, solved, gives)
    for link, piece in [(0, SLIDES_FORTH), (1, SLIDES_BACK), (2, OPENS), (0, OPENS), (3, HOLDS), (4, SLIDES_BACK)]:
        changes = plain(lemke_path.take_up)(run, 2 * link, n, changes, piece, gives)
    changed = run.changes[AT_ZERO:, CHANGE:].copy()
    plain(lemke_path.pose_pieces)(run, 0, count, n, gives)
    for solved in (AT_ZERO, BY_T):
        plain(lemke_path.solve_pieces)(run, 0, count, n, solved, gives)
    assert changes == 6
    assert changed == pytest.approx(run.changes[AT_ZERO:, CHANGE:], rel=1e-9, abs=1e-11)


def follow(pushed: Pushed, near: float) -> tuple[bool, float, float]:
    """Whether a path leads to impulses, from all links open or near, their residual, and by how much they give way."""
    run, count = pushed.run(), len(pushed.rows)
    n = plain(banded_factors.order_coordinates)(run, 0, count)
    if near == 0.0:
        start = plain(lemke_path.begin_far)(run, 0, count)
    else:
        plain(friction.pose_press_bounds)(run, 0, count)
        assert plain(friction.path_settles)(run, 0, count)
        random, start = np.random.default_rng(1), 1.0
        run.vectors[X, :count] *= 1.0 + near * random.normal(size=count)
        plain(lemke_path.begin_near)(run, 0, count, GIVES)
    led = plain(lemke_path.follow_crossings)(run, 0, count, n, start, 500, np.inf, GIVES, False)
    scale, scaled = run.vectors[SCALE, :count], run.vectors[FORCE, :count]
    gives = GIVES * np.abs(scaled / scale).max() / np.abs(pushed.rates).max()
    return led, pushed.residual(scaled * scale), gives


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("near", [0.0, 1e-3])
def test_the_path_ends_at_impulses(seed: int, near: float) -> None:
    """Assert that it leads to impulses of more links than hold the discs, which obey Coulomb's law but for what they give."""
    led, left, gives = follow(Pushed.at_random(seed, 4, 9, (0.2, 0.6, 1.5)[seed % 3]), near)
    assert led
    assert 0.0 < left <= gives * (1.0 + 1e-3)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("off", [1e-3, 0.3])
def test_factors_are_kept_where_no_piece_has_changed(seed: int, off: float) -> None:
    """Assert that a path from factors that are there ends as one that makes them, whether its links begin as they were or not."""
    pushed, ends = Pushed.at_random(seed, 4, 9, 0.6), []
    for kept in (True, False):
        run, count, gives = pushed.run(), len(pushed.rows), 1e-2
        plain(friction.pose_press_bounds)(run, 0, count)
        n = plain(banded_factors.order_coordinates)(run, 0, count)
        assert plain(lemke_path.follow_from_near)(run, 0, count, n, gives, False)
        run.vectors[RIGHT, :count] *= 1.0 + off * np.random.default_rng(seed).normal(size=count)
        led = plain(lemke_path.follow_from_near)(run, 0, count, n, gives, kept)
        ends.append((led, run.vectors[X, :count].copy()))
    assert ends[0][0] == ends[1][0]
    assert ends[0][1] == pytest.approx(ends[1][1], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_impulses_obey_coulombs_law(seed: int) -> None:
    """Assert Coulomb's law after a step, to digits that are far beyond what links give way by on the path."""
    pushed = Pushed.at_random(seed, 5, 11, (0.2, 0.8, 1.5)[seed % 3])
    run = pushed.run()
    plain(friction.pose_press_bounds)(run, 0, 22)
    assert plain(friction.path_settles)(run, 0, 22)
    assert pushed.residual(impulses_of(run, 22)) < 1e-9


@pytest.mark.parametrize(("seed", "ratio"), [(12, 0.8), (27, 1.5)])
def test_links_are_solved_for_where_sweeps_circle(seed: int, ratio: float) -> None:
    """Assert Coulomb's law after all stages, of links for which turns over one after the other leave far more."""
    pushed = Pushed.at_random(seed, 5, 11, ratio)
    run = pushed.run()
    plain(friction.pose_press_bounds)(run, 0, 22)
    for _ in range(300):
        plain(friction.sweep_links)(run, 0, 22, 1.6, False)
    assert pushed.residual(impulses_of(run, 22)) > 1e-3
    run.vectors[X, :22] = 0.0
    assert plain(friction.relax_all)(run, 0, 22) < 1e-9
    assert pushed.residual(impulses_of(run, 22)) < 1e-9
