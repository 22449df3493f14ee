"""Impacts a second of elastic discs in a box, and how many times as fast an event-driven program for discs alone is.

The peer knows that discs fly straight between impacts: it solves for the time of each pair in closed form, keeps the next
partner of each disc, and asks for nothing else: no forces, no method, no proof, no record. Run as
``python tests/benchmarks/many_contacts.py [impacts]``.
"""

from __future__ import annotations

import sys
from math import ceil, inf, sqrt
from time import perf_counter
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

Floats = NDArray[np.float64]
SIZES = (30, 100, 300, 1000)


def discs(count: int) -> xd.Model:
    """Return equal discs on a lattice in a unit box, with random velocities."""
    side = ceil(sqrt(count))
    places = (np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5) / side
    speeds = np.random.default_rng(0).normal(size=(count, 2))
    contact = {"restitution": 1}
    return xd.Model(
        name="discs",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"m": "1 kg", "radius": f"{0.3 / side!r} m"},
        mass={"r": "m"},
        contacts={
            "low": {"gap": "r - radius", **contact},
            "high": {"gap": "metre - radius - r", **contact},
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", **contact},
        },
        initial={
            "r": {"unit": "m", "value": places.tolist()},
            "v_r": {"unit": "m s-1", "value": speeds.tolist()},
        },
    )


@numba.njit
def meeting(r: Floats, v: Floats, i: int, j: int, radius: float) -> float:
    """Return when two discs, or a disc and wall -1 to -4, meet."""
    if j < 0:
        k, high = (-1 - j) // 2, (-1 - j) % 2
        if high:
            return (1.0 - radius - r[i, k]) / v[i, k] if v[i, k] > 0.0 else inf
        return (radius - r[i, k]) / v[i, k] if v[i, k] < 0.0 else inf
    x, y, u, w = r[j, 0] - r[i, 0], r[j, 1] - r[i, 1], v[j, 0] - v[i, 0], v[j, 1] - v[i, 1]
    b, a, c = x * u + y * w, u * u + w * w, x * x + y * y - 4.0 * radius * radius
    root = b * b - a * c
    return c / (sqrt(root) - b) if b < 0.0 and root > 0.0 else inf


@numba.njit
def look(r: Floats, v: Floats, i: int, radius: float, now: float, times: Floats, partners: Any) -> None:
    """Find what a disc meets next."""
    times[i], partners[i] = inf, 0
    for j in range(-4, r.shape[0]):
        t = now + meeting(r, v, i, j, radius) if j != i else inf
        if t < times[i]:
            times[i], partners[i] = t, j


@numba.njit
def peer(r: Floats, v: Floats, radius: float, impacts: int) -> float:
    """Advance discs by a number of impacts; return the time."""
    n, now = r.shape[0], 0.0
    times, partners = np.empty(n), np.empty(n, np.int64)
    for i in range(n):
        look(r, v, i, radius, now, times, partners)
    for _ in range(impacts):
        i = np.argmin(times)
        j, step = partners[i], times[i] - now
        r += v * step
        now += step
        if j < 0:
            v[i, (-1 - j) // 2] *= -1.0
        else:
            normal = (r[j] - r[i]) / (2.0 * radius)
            change = (v[j] - v[i]) @ normal
            v[i] += change * normal
            v[j] -= change * normal
        for k in range(n):
            if k in (i, j) or partners[k] == i or (j >= 0 and partners[k] == j):
                look(r, v, k, radius, now, times, partners)
            else:
                for other in (i, j):
                    t = now + meeting(r, v, k, other, radius) if other >= 0 else inf
                    if t < times[k]:
                        times[k], partners[k] = t, other
    return now


def main(impacts: int) -> None:
    """Print impacts a second of both, the ratio, what the march kept, and how deep times of impacts allow overlaps to be."""
    print("discs impacts  march/s   peer/s  ratio  energy kept to  deepest overlap (m)  allowed (m)")
    for count in SIZES:
        model = discs(count)
        start = model.initial
        r, v = (
            np.reshape([start[name].si for name in start if name.startswith(word)], (count, 2))
            for word in ("r[", "v_r[")
        )
        radius = model.parameters["radius"].quantity.si
        peer(r.copy(), v.copy(), radius, 1)
        until = peer(r.copy(), v.copy(), radius, impacts)
        begin = perf_counter()
        peer(r.copy(), v.copy(), radius, impacts)
        theirs = impacts / (perf_counter() - begin)
        settings = settings_for(
            model, method="velocity_verlet", step=f"{0.2 / count!r} s", until=f"{until!r} s", force_samples="none"
        )
        for block in March(model, settings_for(model, method="velocity_verlet", step="1 us", until="2 us")).blocks():
            del block
        march, found, energies, deepest, fastest = March(model, settings), 0, [], inf, 0.0
        first, second = np.triu_indices(count, 1)
        spent, begin = 0.0, perf_counter()
        for block in march.blocks(1 << 9):
            spent += perf_counter() - begin
            found += block.events
            rows = block.log.rows[:, : block.rows]
            place, energy = march.layout.row.index("r·0·x"), march.layout.row.index("kinetic_energy")
            energies += [rows[energy].min(), rows[energy].max()]
            last = rows[place : place + 2 * count, -1].reshape(count, 2)
            place = march.layout.row.index("v_r·0·x")
            fastest = max(fastest, float(np.hypot(*rows[place : place + 2 * count, -1].reshape(count, 2).T).max()))
            deepest = min(deepest, (np.hypot(*(last[first] - last[second]).T) - 2.0 * radius).min())
            begin = perf_counter()
        ours, kept = found / spent, max(energies) / min(energies) - 1.0
        allowed = 2.0 * fastest * float(march.run.assemblies["tolerance"].max())
        print(
            f"{count:5d} {found:7d} {ours:8.0f} {theirs:8.0f} {theirs / ours:6.1f}  {kept:14.1e}"
            f"  {min(0.0, deepest):19.1e}  {-allowed:11.1e}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
