"""Linkages with singular positions, and chains of rods: time of a simulated second, error, and growth with their links.

N loops of parallel cranks, rods of 1 m and 1 kg, swing as one pendulum, whose motion scipy has to 1e-13; where all rods are
in line, N of the constraints are implied by the others (benchmark A02, N-four-bar mechanism, of the University of A Coruña).
Each rod is a body of three coordinates. The peer, Exudyn, marches the same bodies and joints by its generalised-alpha
method with given steps (``pip install exudyn``). Run as ``python tests/benchmarks/mechanisms.py [loops] [seconds]``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from scipy.integrate import solve_ivp

import xdynamics as xd

LOOPS, SECONDS, RTOL = 2, 20.0, 1e-10
PEER_STEPS = 100, 1000, 10000  # a second
CHAINS = 10, 30, 100
SPEED = 1.0  # of the cranks at the start, rad s-1


def rods(loops: int) -> Iterator[tuple[str, float, float, float]]:
    """Yield the name, the place of the middle and the angle of every rod: cranks, then those that join them."""
    for k in range(loops + 1):
        yield f"crank{k}", float(k), 0.5, math.pi / 2
    for k in range(1, loops + 1):
        yield f"coupler{k}", k - 0.5, 1.0, 0.0


def end(rod: str, sign: str) -> tuple[str, str]:
    """Return where an end of a rod is."""
    return f"x_{rod} {sign} l/2*cos(turn_{rod})", f"y_{rod} {sign} l/2*sin(turn_{rod})"


def linkage(loops: int) -> xd.Model:
    """Return loops of parallel cranks."""
    bars = list(rods(loops))
    holds: dict[str, str] = {}
    for k in range(loops + 1):
        foot, head = end(f"crank{k}", "-"), end(f"crank{k}", "+")
        holds |= {f"foot{k}_x": f"{foot[0]} - {k}*l", f"foot{k}_y": foot[1]}
        for side, sign, coupler in (("right", "+", k), ("left", "-", k + 1)):
            if 1 <= coupler <= loops:
                tip = end(f"coupler{coupler}", sign)
                holds |= {f"{side}{k}_{axis}": f"{tip[i]} - ({head[i]})" for i, axis in enumerate("xy")}
    initial: dict[str, str] = {}
    for name, x, y, angle in bars:
        initial |= {f"x_{name}": f"{x} m", f"y_{name}": f"{y} m", f"turn_{name}": f"{angle!r} rad"}
        initial |= {f"v_x_{name}": f"{y} m s-1", f"v_turn_{name}": f"{-1.0 if angle else 0.0} rad s-1"}
    return xd.Model(
        name="linkage",
        coordinates={f"{q}_{name}": unit for name, *_ in bars for q, unit in (("x", "m"), ("y", "m"), ("turn", "rad"))},
        parameters={"m": "1 kg", "l": "1 m", "g": "9.81 m s-2"},
        mass={
            f"{q}_{name}": inertia
            for name, *_ in bars
            for q, inertia in zip(("x", "y", "turn"), ("m", "m", "m*l**2/12"), strict=True)
        },
        forces={"weight": {"potential": f"m*g*({' + '.join(f'y_{name}' for name, *_ in bars)})"}},
        constraints={name: {"holds": text} for name, text in holds.items()},
        initial=initial,
    )


def pendulum(loops: int, seconds: float, times: np.ndarray) -> np.ndarray:
    """Return the angle of the cranks."""
    moment, weight = (loops + 1) / 3 + loops, 9.81 * ((loops + 1) / 2 + loops)
    swing = solve_ivp(
        lambda _, y: [y[1], -weight / moment * np.cos(y[0])],
        (0.0, seconds),
        [math.pi / 2, -SPEED],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        dense_output=True,
    )
    return np.asarray(swing.sol(times)[0])


def ours(loops: int, seconds: float) -> tuple[float, float]:
    """March a linkage; return the time of a simulated second and the largest error of an angle."""
    asked = {"method": "dop853", "rtol": RTOL, "until": seconds, "force_samples": "none"}
    begun = perf_counter()
    model = linkage(loops)
    xd.simulate(model, **asked | {"until": 0.01})
    built = perf_counter()
    run = xd.simulate(model, **asked)
    marched = (perf_counter() - built) / seconds
    error = float(abs(run.turn_crank0.values - pendulum(loops, seconds, run.time.values)).max())
    print(
        f"{loops:3} loops  xdynamics  dop853, rtol {RTOL:g}  {marched * 1e3:9.1f} ms a second  error {error:.1e}",
        end="",
    )
    print(f"   {run.sizes['step']} steps, rank {int(run.constraint_rank.min())}, built in {built - begun:.1f} s")
    return marched, error


def peer(loops: int, seconds: float, steps: int) -> tuple[float, float]:
    """March the same by Exudyn; return the same."""
    import exudyn as exu  # type: ignore[import-not-found]

    system = exu.SystemContainer().AddSystem()
    ground = system.AddObject(exu.itemInterface.ObjectGround())
    bodies = {}
    for name, x, y, angle in rods(loops):
        node = exu.itemInterface.NodeRigidBody2D(
            referenceCoordinates=[x, y, angle], initialVelocities=[y, 0.0, -SPEED if angle else 0.0]
        )
        number = system.AddNode(node)
        bodies[name] = system.AddObject(
            exu.itemInterface.ObjectRigidBody2D(mass=1.0, inertia=1 / 12, nodeNumber=number)
        )
        place = exu.itemInterface.MarkerBodyPosition(bodyNumber=bodies[name], localPosition=[0, 0, 0])
        load = exu.itemInterface.LoadForceVector(markerNumber=system.AddMarker(place), loadVector=[0, -9.81, 0])
        system.AddLoad(load)

    def joint(first: int, there: float, second: int, here: float) -> None:
        places = [
            exu.itemInterface.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0])
            for body, x in ((first, there), (second, here))
        ]
        system.AddObject(
            exu.itemInterface.ObjectJointRevolute2D(markerNumbers=[system.AddMarker(one) for one in places])
        )

    for k in range(loops + 1):
        joint(ground, k, bodies[f"crank{k}"], -0.5)
    for k in range(1, loops + 1):
        joint(bodies[f"crank{k - 1}"], 0.5, bodies[f"coupler{k}"], -0.5)
        joint(bodies[f"crank{k}"], 0.5, bodies[f"coupler{k}"], 0.5)
    watched = exu.itemInterface.SensorNode(
        nodeNumber=0, storeInternal=True, outputVariableType=exu.OutputVariableType.Rotation
    )
    sensor = system.AddSensor(watched)
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.endTime, settings.timeIntegration.numberOfSteps = seconds, int(steps * seconds)
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.solution.sensors.writePeriod, settings.solution.file.write = seconds / 100, False
    sparse = exu.LinearSolverType.EigenSparse if loops > 6 else exu.LinearSolverType.EXUdense
    settings.linearSolver.solverType = sparse
    begun = perf_counter()
    system.SolveDynamic(settings)
    marched = (perf_counter() - begun) / seconds
    times, angles = system.GetSensorStoredData(sensor).T[[0, -1]]
    error = float(abs(np.sin(angles) - np.sin(pendulum(loops, seconds, times))).max())
    print(f"{loops:3} loops  Exudyn     {steps:6} steps a second  {marched * 1e3:9.1f} ms a second  error {error:.1e}")
    return marched, error


def chain(links: int) -> xd.Model:
    """Return masses on rods one after the other, let go from the horizontal."""
    return xd.Model(
        name="chain",
        dimensions={"bead": links, "axis": ["x", "y"]},
        coordinates={"r": {"unit": "m", "dims": ["bead", "axis"]}},
        parameters={"m": "1 kg", "l": "0.1 m", "g": "9.81 m s-2"},
        mass={"r": "m"},
        forces={"weight": {"potential": "sum(where(index(axis) > 0, m*g*r, 0*joule), bead, axis)"}},
        constraints={"rod": {"holds": "norm(r - shift(r, bead, 1, 0*metre), axis) - l"}},
        initial={"r": "where(index(axis) < 1, (index(bead) + 1)*l, 0*metre)"},
    )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else LOOPS
    span = float(sys.argv[2]) if len(sys.argv) > 2 else SECONDS
    time, _ = ours(count, span)
    for rate in PEER_STEPS:
        taken, off = peer(count, span, rate)
        print(f"           time over ours {taken / time:.2f}, at an error of {off:.1e}")
    for links in CHAINS:
        model = chain(links)
        asked = {"method": "dop853", "rtol": 1e-9, "until": 0.2, "force_samples": "none"}
        begun = perf_counter()
        xd.simulate(model, **asked)
        first = perf_counter() - begun
        begun = perf_counter()
        run = xd.simulate(model, **asked)
        step = (perf_counter() - begun) / (run.sizes["step"] + run.sizes["trial"])
        worst = float(abs(run.constraint_residual_rod).max())
        print(
            f"{links:3} rods   {step * 1e6 / links:6.2f} us a step and rod, residual {worst:.0e} m, built in {first - step * run.sizes['step']:.1f} s"
        )
