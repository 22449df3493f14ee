"""Rough discs poured into a box until they lie: seconds of CPU by impulses over steps, and by springs of penalty contacts.

`moreau_jean` steps over impacts and solves for the impulses of all links at once: discs are rigid, those that stick do not
move. The peer, where it is installed (``pip install exudyn``), pushes discs apart by stiff springs and regularises friction:
each step costs little, and there are fifty times as many. Its stiffness is chosen for an overlap of a thousandth of a
radius, its damping as critical, its step and the slip below which friction is weaker as large as leaves the heap together.
Run as ``python tests/benchmarks/heaps.py [discs per row ...]``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import xdynamics as xd

Floats = NDArray[np.float64]
PILE = Path(__file__).parents[2] / "data/models/rough_pile.toml"
DISCS = {13: 100, 22: 300, 40: 1000}  # by discs per row, of a box as wide as these
UNTIL, PITCH, FREE = 2.0, 0.115, 0.01
G, DENSITY = 9.80665, 25.0
STIFFNESS, PENALTY_STEP, WEAK_SLIP = 1e6, 2e-5, 5e-3  # N/m of two discs, s, m/s


class Rest(NamedTuple):
    """What a heap costs, and how it lies."""

    cpu: float
    steps: int
    speed: float  # the largest of a disc
    overlap: float  # the deepest of two discs
    energy: float  # at the end, over that at the start


def width_of(across: int) -> float:
    """The width of the box of a heap, in m."""
    return PITCH * across + FREE


def by_impulses(across: int, count: int) -> Rest:
    """March the discs by Moreau's time-stepping."""
    text = (
        PILE.read_text()
        .replace("disc = 24", f"disc = {count}")
        .replace('"0.7 m"', f'"{width_of(across)!r} m"')
        .replace("disc), 6)", f"disc), {across})")
        .replace("disc)/6)", f"disc)/{across})")
    )
    model, asked = xd.Model.from_text(text), {"method": "moreau_jean", "step": "1 ms", "force_samples": "none"}
    xd.simulate(model, until="2 ms", **asked)
    start = process_time()
    run = xd.simulate(model, until=f"{UNTIL!r} s", **asked)
    cpu, end, radius = process_time() - start, run.isel(step=-1), run.radius.values
    rates = np.stack([end[name].values for name in ("v_x", "v_y", "v_theta")], axis=1)
    energy = energy_of(radius, end.y.values, rates) / energy_of(radius, run.y.values[0], 0.0 * rates)
    speed = float(np.hypot(rates[:, 0], rates[:, 1]).max())
    return Rest(cpu, run.sizes["step"] - 1, speed, deepest(end.x.values, end.y.values, radius), energy)


def energy_of(radius: Floats, y: Floats, rates: Floats) -> float:
    """The energy of discs at heights, with rates of x, y and the angle, in J."""
    mass = DENSITY * np.pi * radius**2
    moving = (rates[:, :2] ** 2).sum(1) / 2.0 + radius**2 * rates[:, 2] ** 2 / 4.0
    return float((mass * (moving + G * y)).sum())


def deepest(x: Floats, y: Floats, radius: Floats) -> float:
    """By how much two discs overlap at most."""
    first, second = np.triu_indices(len(x), 1)
    apart = np.hypot(x[first] - x[second], y[first] - y[second]) - radius[first] - radius[second]
    return max(0.0, -float(apart.min()))


def by_springs(across: int, count: int) -> Rest | None:
    """March the discs by Exudyn's springs; None where it is not installed."""
    try:
        import exudyn as exu
        from exudyn import itemInterface as items
    except ImportError:
        return None
    i = np.arange(count)
    radius, width = (45.0 + 5.0 * np.sin(3.0 * i)) * 1e-3, width_of(across)
    x = PITCH * (i % across + 0.55) + 8e-3 * np.sin(2.4 * i**2)
    y = 1.2 * PITCH * (i // across + 0.6) + 8e-3 * np.cos(1.7 * i**2)
    mass, top = DENSITY * np.pi * radius**2, float(y.max()) + 0.5
    # a contact has the stiffness and the damping of two in a row
    pushes: dict[str, Any] = {
        "contactStiffness": 2.0 * STIFFNESS,
        "contactDamping": np.sqrt(STIFFNESS * mass.mean() / 2.0),
        "frictionMaterialIndex": 0,
    }
    system = exu.SystemContainer().AddSystem()
    contact = system.AddGeneralContact()
    contact.SetFrictionPairings(0.4 * np.eye(1))
    contact.frictionProportionalZone, contact.excludeOverlappingTrigSphereContacts = WEAK_SLIP, False
    contact.SetSearchTreeCellSize(numberOfCells=[int(width / 0.11), int(top / 0.11), 1])
    contact.SetSearchTreeBox(pMin=np.full(3, -0.2), pMax=np.array([width + 0.2, top, 0.2]))
    ground = system.AddMarker(items.MarkerBodyRigid(bodyNumber=system.AddObject(items.ObjectGround())))
    corners = np.array([[-1.0, 0.0], [width + 1.0, 0.0], [0.0, -1.0], [0.0, top], [width, top], [width, -1.0]])
    for start, end in ((0, 1), (3, 2), (5, 4)):  # floor, left and right wall: triangles across the plane, which face it
        low, high = corners[start], corners[end]
        points = [np.append(low, -0.1), np.append(high, -0.1), np.append((low + high) / 2.0, 0.9)]
        inwards = np.cross(points[1] - points[0], points[2] - points[0])[:2] @ (corners[[3, 4]].mean(0) / 2.0 - low)
        contact.AddTrianglesRigidBodyBased(
            rigidBodyMarkerIndex=ground,
            pointList=points if inwards > 0.0 else [points[1], points[0], points[2]],
            triangleList=[[0, 1, 2]],
            staticTriangles=True,
            **pushes,
        )
    for j in range(count):
        node = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=[x[j], y[j], 0.0]))
        inertia = mass[j] * radius[j] ** 2 / 2.0
        system.AddObject(items.ObjectRigidBody2D(mass=mass[j], inertia=inertia, nodeNumber=node))
        marker = system.AddMarker(items.MarkerNodeRigid(nodeNumber=node))
        system.AddLoad(items.Force(markerNumber=marker, loadVector=[0.0, -mass[j] * G, 0.0]))
        contact.AddSphereWithMarker(marker, radius=radius[j], **pushes)
    system.Assemble()
    settings = exu.SimulationSettings()
    stepping, steps = settings.timeIntegration, round(UNTIL / PENALTY_STEP)
    stepping.numberOfSteps, stepping.endTime = steps, UNTIL
    settings.solution.file.write, settings.parallel.numberOfThreads = False, 1
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    stepping.explicit.computeMassMatrixInversePerBody = True
    stepping.explicit.computeEndOfStepAccelerations = stepping.explicit.useLieGroupIntegration = False
    start = process_time()
    system.SolveDynamic(settings, solverType=exu.DynamicSolverType.ExplicitEuler)
    cpu = process_time() - start
    moved, rates = (
        np.array(numbers).reshape(count, 3)
        for numbers in (system.systemData.GetODE2Coordinates(), system.systemData.GetODE2Coordinates_t())
    )
    energy = energy_of(radius, y + moved[:, 1], rates) / energy_of(radius, y, 0.0 * rates)
    speed = float(np.hypot(rates[:, 0], rates[:, 1]).max())
    return Rest(cpu, steps, speed, deepest(x + moved[:, 0], y + moved[:, 1], radius), energy)


def main() -> None:
    """Print a row for each heap and each way."""
    print("discs  way                         CPU s   steps  m/s at the end  overlap um  energy left")
    for across in [int(word) for word in sys.argv[1:]] or [13, 22]:
        count = DISCS[across]
        for way, marches in (("impulses, moreau_jean", by_impulses), ("springs, Exudyn", by_springs)):
            rest = marches(across, count)
            if rest is None:
                print(f"{count:5d}  {way:25s}  not installed")
                continue
            print(
                f"{count:5d}  {way:25s} {rest.cpu:7.1f} {rest.steps:7d} {rest.speed:15.1e} {1e6 * rest.overlap:11.1f}"
                f" {rest.energy:12.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
