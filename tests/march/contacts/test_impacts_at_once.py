"""Rows of balls that touch, hit and part: random ones against closed forms, and each group against laws written anew.

Linear complementarity problems, against all their solutions.
"""

from __future__ import annotations

from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ellipj

import xdynamics as xd
from cases.plain import made_by_hand, plain
from xdynamics.march.contacts import delassus
from xdynamics.march.run import Run

Floats = NDArray[np.float64]
G, L = 9.81, 0.2
METHODS = ("dop853", "dormand_prince")
LAWS = ("newton", "poisson", "sequential")


def cradle(law: str, angles: Floats, until: float, method: str, rtol: float) -> Any:
    """March elastic balls on equal pendulums, let go at some angles."""
    names = [f"q{i}" for i in range(len(angles))]
    model = xd.Model(
        name="cradle",
        coordinates=dict.fromkeys(names, "rad"),
        parameters={"m": "50 g", "g": f"{G} m s-2", "l": f"{L} m"},
        mass=dict.fromkeys(names, "m*l**2"),
        forces={"weight": {"potential": "m*g*l*(" + " + ".join(f"1 - cos({q})" for q in names) + ")"}},
        initial={q: f"{angle!r} rad" for q, angle in zip(names, angles.tolist(), strict=True)}
        | {f"v_{q}": "0 rad s-1" for q in names},
        contacts={f"c{i}": {"gap": f"q{i + 1} - q{i}", "restitution": 1, "law": law} for i in range(len(names) - 1)},
    )
    return xd.simulate(model, method=method, rtol=rtol, until=until)


def ghosts(angles: Floats, times: Floats) -> Floats:
    """Pendulums that pass through each other, sorted: what equal elastic balls that hit in pairs do."""
    found = np.empty((len(angles), len(times)))
    for i, angle in enumerate(angles):
        k = np.sin(angle / 2.0)
        _, cosine, delta, _ = ellipj(np.sqrt(G / L) * times, k * k)
        found[i] = 2.0 * np.arcsin(k * cosine / delta)
    return np.sort(found, axis=0)


def struck(law: str, masses: Floats, speeds: Floats, touching: list[int], e: float) -> Floats:
    """Speeds behind an impact by a law for all at once, the active contacts by trying every set; again while two approach."""
    rows = np.zeros((len(touching), len(masses)))
    for row, k in zip(rows, touching, strict=True):
        row[k], row[k + 1] = -1.0, 1.0
    tiny = 1e-10 * max(1e-300, np.abs(speeds).max())
    while (rows @ speeds).min() < -tiny:
        own = rows[rows @ speeds <= tiny]
        rates = own @ speeds
        if law == "newton":
            speeds = speeds + own.T @ pressed(own, masses, (1.0 + e) * np.minimum(rates, 0.0), tiny) / masses
        else:
            first = pressed(own, masses, rates, tiny)
            speeds = speeds + own.T @ (first * (1.0 + e)) / masses
            speeds = speeds + own.T @ pressed(own, masses, own @ speeds, tiny) / masses
    return speeds


def pressed(rows: Floats, masses: Floats, rates: Floats, tiny: float) -> Floats:
    """Impulses p that are not negative, with rates + G p not negative, one of each two zero."""
    gram = rows @ (rows / masses).T
    for count in range(len(rows) + 1):
        for chosen in combinations(range(len(rows)), count):
            at, found = list(chosen), np.zeros(len(rows))
            found[at] = np.linalg.solve(gram[np.ix_(at, at)], -rates[at])
            if found.min() >= 0.0 and (rates + gram @ found).min() >= -tiny:
                return found
    raise AssertionError("there is always one")


def groups(run: Any) -> list[tuple[int, int, list[int]]]:
    """Row before, row behind and the events of each group."""
    before, after = (run[f"event_row_{side}"].values for side in ("before", "after"))
    return [
        (int(row), int(after[before == row][0]), np.flatnonzero(before == row).tolist()) for row in np.unique(before)
    ]


def check_groups(run: Any, masses: Floats, names: list[str]) -> None:
    """Assert what holds at every group whatever the law: positions, gaps of impacts, momentum and energy in the record."""
    q, v = (np.array([run[f"{one}{name}"].values for name in names]) for one in ("", "v_"))
    impulses = np.array([run[f"event_impulse_{name}"].values for name in names])
    offsets = np.array([run[f"event_offset_{name}"].values for name in names])
    kinetic, lost = (v**2 * masses[:, None]).sum(axis=0) / 2, run.event_energy_lost.values
    kinds = run.event_kind.attrs["flag_meanings"].split()
    for row, behind, events in groups(run):
        assert q[:, behind] - q[:, row] == pytest.approx(offsets[:, events].sum(axis=1), rel=1e-12, abs=1e-300)
        assert np.abs(offsets[:, events]).max() < 1e-11
        scale = np.abs(v[:, [row, behind]]).max() * masses.max()
        assert masses * (v[:, behind] - v[:, row]) == pytest.approx(impulses[:, events].sum(axis=1), abs=1e-11 * scale)
        assert kinetic[row] - kinetic[behind] == pytest.approx(lost[events].sum(), abs=1e-11 * kinetic.max())
        for event in events:
            if kinds[run.event_kind.values[event]] == "impact":
                name = run.event_detector.attrs["flag_meanings"].split()[run.event_detector.values[event]]
                assert abs(float(run[f"contact_gap_{name}"][row])) < 1e-11


@pytest.mark.every(3)
@pytest.mark.cases(400)
@pytest.mark.filterwarnings("ignore:cradle. the tolerances did not control")
def test_elastic_cradles(case: int) -> None:
    """Assert energy, gaps, each group's speeds by its law, and positions where impacts are of two at a time."""
    rng = np.random.default_rng(case)
    n, law, method, rtol = (
        int(rng.integers(3, 7)),
        LAWS[case % 3],
        METHODS[int(rng.integers(2))],
        [1e-6, 1e-8][int(rng.integers(2))],
    )
    pulled = int(rng.integers(1, n)) if rng.random() < 0.7 else n
    angles = np.zeros(n)
    apart = rng.random() < 0.5
    angles[:pulled] = np.sort(-np.radians(rng.uniform(10.0, 60.0, pulled if apart else 1)))
    angles = np.sort(angles + (np.sort(rng.uniform(0.0, 0.5, n)) if pulled == n else 0.0))
    run = cradle(law, angles, 8.0, method, rtol)
    assert run.attrs["run_outcome"] == "completed"
    assert "energy rose" not in run.attrs["run_outcome_text"]
    names = [f"q{i}" for i in range(n)]
    q, v = (np.array([run[f"{one}{name}"].values for name in names]) for one in ("", "v_"))
    energy = run.total_energy.values
    assert np.abs(energy / energy[0] - 1.0).max() < 300.0 * rtol
    assert np.diff(q, axis=0).min() > -1e-11
    assert run.sizes["trial"] < 60 * (run.sizes["step"] + run.sizes["event"])
    check_groups(run, np.full(n, 0.05 * L**2), names)
    if law == "sequential":
        # in a row of groups positions are those of pairs whatever touches: speeds are handed on
        assert q == pytest.approx(ghosts(angles, run.time.values), abs=3e3 * rtol)
        return
    for row, behind, _ in groups(run):
        touching = np.flatnonzero(np.diff(q[:, row]) < 1e-11).tolist()
        if touching and np.diff(v[:, row])[touching].min() < -1e-9:
            told = struck(law, np.ones(n), v[:, row], touching, 1.0)
            assert v[:, behind] == pytest.approx(told, abs=1e-9 * np.abs(v[:, row]).max())


def flights(
    masses: Floats, x: Floats, v: Floats, e: Floats, width: float, until: float
) -> tuple[Floats, Floats, list[float]]:
    """Free balls on a line between walls at 0 and a width, one impact after the other: positions, speeds, times."""
    t, times, n = 0.0, [], len(x)
    while True:
        gaps = np.concatenate([[x[0]], np.diff(x), [width - x[-1]]])
        rates = np.concatenate([[v[0]], np.diff(v), [-v[-1]]])
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.where(rates < 0.0, np.maximum(gaps, 0.0) / -rates, np.inf)
        k = int(np.argmin(left))
        if not t + left[k] < until:
            return x + v * (until - t), v, times
        x, v, t = x + v * left[k], v.copy(), t + left[k]
        times.append(t)
        if k in (0, n):
            v[max(0, k - 1)] *= -e[k]
            continue
        one, other = masses[k - 1], masses[k]
        impulse = (1.0 + e[k]) * rates[k] / (1.0 / one + 1.0 / other)
        v[k - 1], v[k] = v[k - 1] + impulse / one, v[k] - impulse / other


@pytest.mark.every(3)
@pytest.mark.cases(400)
def test_rows_between_walls(case: int) -> None:
    """Assert times of impacts, positions and energies of unequal balls between two walls, with any restitution."""
    rng = np.random.default_rng(1000 + case)
    n, width, until = int(rng.integers(2, 6)), 1.0, 2.0
    masses, e = rng.uniform(0.2, 5.0, n), rng.uniform(0.6, 1.0, n + 1) if case % 2 else np.ones(n + 1)
    x, v = np.sort(rng.uniform(0.05, 0.95, n)), rng.uniform(-1.5, 1.5, n)
    names = [f"x{i}" for i in range(n)]
    gaps = [names[0], *(f"{b} - {a}" for a, b in pairwise(names)), f"w - {names[-1]}"]
    model = xd.Model(
        name="row",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"w": f"{width} m"} | {f"m{i}": f"{m!r} kg" for i, m in enumerate(masses.tolist())},
        mass={name: f"m{i}" for i, name in enumerate(names)},
        forces={},
        initial={name: f"{one!r} m" for name, one in zip(names, x.tolist(), strict=True)}
        | {f"v_{name}": f"{one!r} m s-1" for name, one in zip(names, v.tolist(), strict=True)},
        contacts={
            f"c{i}": {"gap": gap, "restitution": float(one), "law": LAWS[case % 3]}
            for i, (gap, one) in enumerate(zip(gaps, e, strict=True))
        },
    )
    asked: list[dict[str, Any]] = [
        {"method": "rk4", "step": 0.037},
        {"method": "velocity_verlet", "step": 0.3},
        {"method": "dop853"},
    ]
    run = xd.simulate(model, until=until, **asked[int(rng.integers(3))])
    at, speeds, times = flights(masses, x, v, e, width, until)
    assert run.attrs["run_outcome"] == "completed"
    assert "energy rose" not in run.attrs["run_outcome_text"]
    assert run.event_time.values == pytest.approx(times, abs=1e-8)
    assert [float(run[name][-1]) for name in names] == pytest.approx(at, abs=1e-7)
    energies = [float((masses * one**2).sum() / 2) for one in (v, speeds)]
    assert float(run.kinetic_energy[-1]) == pytest.approx(energies[1], rel=1e-7)
    assert float(run.event_energy_lost.sum()) == pytest.approx(energies[0] - energies[1], abs=1e-7 * energies[0])
    check_groups(run, masses, names)


def solved(matrix: Floats, q: Floats) -> Floats | None:
    """Solve by the engine."""
    n = len(q)
    run = posed(matrix, q)
    return run.solution.copy() if plain(delassus.solve_complementarity)(run, n) else None


def posed(matrix: Floats, q: Floats) -> Run:
    """A run with a problem in it."""
    n = len(q)
    run = made_by_hand(problem=np.zeros((n, 2 * n + 2)), basis=np.zeros(3 * n + 1, np.int64), solution=np.zeros(n))
    plain(delassus.clear_tableau)(run, n)
    run.problem[:, n : 2 * n], run.problem[:, 2 * n + 1] = -matrix, q
    return run


def solutions(matrix: Floats, q: Floats) -> list[Floats]:
    """Every solution with a regular set of positive unknowns, by trying all sets."""
    n, found = len(q), []
    for chosen in product((False, True), repeat=n):
        some = np.flatnonzero(chosen)
        z = np.zeros(n)
        if some.size:
            part = matrix[np.ix_(some, some)]
            if abs(np.linalg.det(part)) < 1e-12:
                continue
            z[some] = np.linalg.solve(part, -q[some])
        if (z > -1e-10).all() and (matrix @ z + q > -1e-10).all():
            found.append(z)
    return found


@pytest.mark.parametrize("seed", range(60))
def test_the_solution_of_a_p_matrix_is_found(seed: int) -> None:
    """Assert the one solution of problems with positive definite, not symmetric, matrices."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 7))
    root = random.normal(size=(n, n))
    skew = random.normal(size=(n, n))
    matrix = root @ root.T + 0.1 * np.eye(n) + (skew - skew.T)
    q = random.normal(size=n)
    every = solutions(matrix, q)
    assert len({tuple(node.round(6)) for node in every}) == 1
    assert solved(matrix, q) == pytest.approx(every[0], abs=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_what_holds_a_motion_twice_has_an_answer(seed: int) -> None:
    """Assert that semidefinite problems are solved: more contacts than motions."""
    random = np.random.default_rng(seed)
    rows = random.normal(size=(5, 2))
    matrix, q = rows @ rows.T, rows @ random.normal(size=2)
    z = solved(matrix, q)
    assert z is not None
    w = matrix @ z + q
    assert (z >= 0).all()
    assert (w > -1e-9).all()
    assert abs(z @ w) < 1e-9


def test_friction_with_ties_does_not_circle() -> None:
    """Assert an answer where all ratios are equal: a block with friction that nothing pushes along."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 1, -1, 1], [0, -1, 1, 1], [0.3, -1, -1, 0]])
    z = solved(matrix, np.array([-9.81, 0, 0, 0]))
    assert z == pytest.approx([9.81, 0, 0, 0])


def test_no_solution_is_a_ray() -> None:
    """Assert that a problem without a solution is told from others."""
    assert solved(np.array([[-1.0]]), np.array([-1.0])) is None


def test_nothing_to_do() -> None:
    """Assert zero where nothing approaches."""
    assert solved(np.eye(2), np.array([0.0, 3.0])) == pytest.approx([0, 0])
