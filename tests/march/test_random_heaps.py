"""Heaps of rough discs at random: momentum, energy, Coulomb's law, and of smooth ones what a mirror leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from cases.random_heaps import STEP, G, Heap

CASES = [pytest.param(seed, marks=[] if seed in (1, 4) else pytest.mark.dear, id=str(seed)) for seed in range(100)]


def lifts_of(run: xr.Dataset) -> np.ndarray:
    """The force of floor and walls on all discs, upwards, in every step."""
    names, contact = run.closed_contact.attrs["flag_meanings"].split(), run.closed_contact.values
    upwards = np.where(contact == names.index("floor"), run.closed_force.values, 0.0)
    for wall in ("left", "right"):
        upwards += np.where(contact == names.index(wall), run.closed_friction_force.values, 0.0)
    return np.bincount(run.closed_step.values, upwards, minlength=run.sizes["step"])


@pytest.mark.parametrize("seed", CASES)
def test_every_step_of_a_heap_obeys_the_laws_of_impulses(seed: int) -> None:
    """Assert in every step momentum by weight and forces of the box, Coulomb's cone, no pull, and that energy falls."""
    heap = Heap.at_random(seed)
    run, weight = heap.run(), G * heap.mass.sum()
    assert run.attrs["run_outcome"] == "completed"
    gained = np.diff((heap.mass * run.v_y.values).sum(1))
    assert gained == pytest.approx(STEP * (lifts_of(run)[1:] - weight), abs=1e-9 * STEP * weight)
    force, rubs = run.closed_force.values, np.abs(run.closed_friction_force.values)
    assert force.min() >= 0.0
    assert (rubs - heap.mu * force).max() <= 1e-9 * force.max()
    # directions turn while a step lasts, which is of second order in it
    assert np.diff(run.total_energy.values).max() < 1e-5 * float(run.total_energy[0])


@pytest.mark.parametrize("seed", CASES[4:24:4])
def test_a_smooth_heap_moves_as_its_mirror_shows_and_in_any_order(seed: int) -> None:
    """Assert positions of the mirrored heap and of one with its discs in another order.

    Without friction: with it, impulses of a step may be one of several solutions (Stewart, SIAM Rev. 42, 2000, 3,
    doi:10.1137/S0036144599360110), and which depends on the order in which links are solved for.
    """
    heap = replace(Heap.at_random(seed), mu=0.0)
    order = np.random.default_rng(seed).permutation(len(heap.radius))
    run = heap.run()
    assert heap.width - heap.mirrored().run().x.values == pytest.approx(run.x.values, abs=1e-6)
    assert heap.permuted(order).run().x.values == pytest.approx(run.x.values[:, order], abs=1e-6)
