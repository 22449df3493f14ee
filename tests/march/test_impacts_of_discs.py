"""Elastic and inelastic discs, and balls: against an event-driven solution of flights and impacts, written for them alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.balls import balls
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

Floats = NDArray[np.float64]
UNTIL, MOST = 0.35, 25  # s; impacts, after which neighbouring motions part too far


class Discs:
    """Discs of several sizes, masses and restitutions in a box of 1 m, at random places of a lattice."""

    def __init__(self, case: int) -> None:
        random = np.random.default_rng([30, 5, case])
        count = int(random.integers(5, 8))
        self.radii, self.masses = random.uniform(0.08, 0.14, count), 10.0 ** random.uniform(-1, 1, count)
        cells = random.permutation(9)[:count]
        self.places = (np.stack(np.divmod(cells, 3), axis=1) + random.uniform(0.47, 0.53, (count, 2))) / 3.0
        self.speeds = random.normal(size=(count, 2))
        self.first, self.second = np.triu_indices(count, 1)
        self.restitutions, self.of_walls = random.uniform(0.4, 1.0, len(self.first)), random.uniform(0.6, 1.0)

    def model(self) -> xd.Model:
        """Return their model."""
        wall = {"restitution": repr(float(self.of_walls))}
        return xd.Model(
            name="discs",
            dimensions={"disc": len(self.radii), "axis": ["x", "y"]},
            relations={"pair": {"of": "disc"}},
            coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
            parameters={
                "m": {"unit": "kg", "dims": ["disc"], "value": self.masses.tolist()},
                "radius": {"unit": "m", "dims": ["disc"], "value": self.radii.tolist()},
                "e": {"dims": ["pair"], "value": self.restitutions.tolist()},
            },
            mass={"r": "m"},
            contacts={
                "low": {"gap": "r - radius", **wall},
                "high": {"gap": "metre - radius - r", **wall},
                "discs": {
                    "gap": "norm(second(r, pair) - first(r, pair), axis) - first(radius, pair) - second(radius, pair)",
                    "restitution": "e",
                },
            },
            initial={
                "r": {"unit": "m", "value": self.places.tolist()},
                "v_r": {"unit": "m s-1", "value": self.speeds.tolist()},
            },
        )

    def meetings(self, r: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return after what time each pair meets, and each disc each wall: (pair), (disc, axis)."""
        x, u = r[self.second] - r[self.first], v[self.second] - v[self.first]
        b, a = (x * u).sum(axis=1), (u * u).sum(axis=1)
        c = (x * x).sum(axis=1) - (self.radii[self.first] + self.radii[self.second]) ** 2
        root = b * b - a * c
        meets = (b < 0.0) & (root > 0.0)
        pairs = np.full(len(b), np.inf)
        pairs[meets] = c[meets] / (np.sqrt(root[meets]) - b[meets])
        free = np.where(v > 0.0, 1.0 - self.radii[:, None] - r, r - self.radii[:, None])
        return pairs, free / np.abs(v)

    def solution(self) -> tuple[list[float], list[Floats], Floats]:
        """Return times of impacts, velocities after each, and places at the end."""
        r, v, t = self.places.copy(), self.speeds.copy(), 0.0
        times: list[float] = []
        after: list[Floats] = []
        while True:
            pairs, walls = self.meetings(r, v)
            step = min(pairs.min(), walls.min())
            if t + step > UNTIL:
                return times, after, r + v * (UNTIL - t)
            r, t = r + v * step, t + step
            if pairs.min() < walls.min():
                k = int(pairs.argmin())
                i, j = self.first[k], self.second[k]
                normal = (r[j] - r[i]) / np.linalg.norm(r[j] - r[i])
                mass = self.masses[i] * self.masses[j] / (self.masses[i] + self.masses[j])
                impulse = (1.0 + self.restitutions[k]) * mass * ((v[j] - v[i]) @ normal) * normal
                v[i] += impulse / self.masses[i]
                v[j] -= impulse / self.masses[j]
            else:
                place = np.unravel_index(walls.argmin(), walls.shape)
                v[place] *= -self.of_walls
            times.append(t)
            after.append(v.copy())


@pytest.mark.parametrize("case", range(5))
def test_discs_meet_when_an_event_driven_solution_says(case: int) -> None:
    """Assert times of impacts, velocities after each, places at the end, momenta and energies, to 1e-9."""
    discs = Discs(case)
    times, after, last = discs.solution()
    assert 3 <= len(times) <= MOST
    model = discs.model()
    assert model.assemblies
    run = xd.simulate(model, method="velocity_verlet", step="10 ms", until=f"{UNTIL} s")
    assert run.attrs["run_outcome"] == "completed"
    near = {"rtol": 0.0, "atol": 1e-9}
    np.testing.assert_allclose(run["event_time"], times, **near)
    rows = run["event_row_after"].values
    v = run["v_r"].values
    np.testing.assert_allclose(v[rows], after, **near)
    np.testing.assert_allclose(run["r"].values[-1], last, **near)
    m = discs.masses[:, None]
    energies = (m * np.square(after)).sum(axis=(1, 2)) / 2.0
    np.testing.assert_allclose(run["kinetic_energy"].values[rows], energies, **near)
    of_pairs = run["event_detector"].values == run["event_detector"].attrs["flag_meanings"].split().index("discs")
    assert of_pairs.any()
    momenta = (m * v).sum(axis=1)
    before = run["event_row_before"].values
    np.testing.assert_allclose(momenta[rows[of_pairs]], momenta[before[of_pairs]], rtol=0.0, atol=1e-14 * m.sum())


@pytest.mark.dear
def test_a_thousand_balls_keep_their_energy() -> None:
    """Assert that over 10,000 impacts of 1,000 elastic balls energy is kept to rounding, and none is in another."""
    radius, impacts, energies = 0.03, 0, []
    model = balls(10, radius=radius, seed=1)
    settings = settings_for(model, method="velocity_verlet", step="0.5 ms", until="1 s", force_samples="none")
    march = March(model, settings)
    places, speeds = (march.layout.row.index(name) for name in ("r·0·x", "v_r·0·x"))
    first, second = np.triu_indices(1000, 1)
    for block in march.blocks(1 << 9):
        impacts += block.events
        rows = block.log.rows[:, : block.rows]
        energies.append((rows[speeds : speeds + 3000] ** 2).sum(axis=0))
        r = rows[places : places + 3000, -1].reshape(1000, 3)
        v = rows[speeds : speeds + 3000, -1].reshape(1000, 3)
        depth = 2.0 * radius - np.linalg.norm(r[second] - r[first], axis=1).min()
        assert depth <= 2.0 * np.linalg.norm(v, axis=1).max() * float(march.run.assemblies["tolerance"].max())
        if impacts >= 10_000:
            break
    assert impacts >= 10_000
    energy = np.concatenate(energies)
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-13
