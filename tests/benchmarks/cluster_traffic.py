"""Studies as one graph on a cluster of this machine: tasks in flight, their order, and bytes through the scheduler.

python tests/benchmarks/cluster_traffic.py [WORKERS] [SECONDS]

Ten methods are refined over eight levels each, of so many seconds of motion, and computed at once. Dask takes 2 to 3 ms
from one task of a worker to its next, so with few seconds most of what is seen is that. Then a sweep is marched lazily, and
one with whole runs into a folder, whose states are then read together; a budget is drawn, a ledger is filled. What every
process writes to the scheduler, and the scheduler to every process, is counted as it is sent.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import xdynamics as xd
from xdynamics.evidence.cluster import cluster_of
from xdynamics.evidence.stages import compute_datasets

MODELS = Path(__file__).parents[2] / "data" / "models"
MODEL = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
METHODS = [
    "rk4",
    "heun",
    "midpoint",
    "velocity_verlet",
    "position_verlet",
    "ruth3",
    "pefrl",
    "yoshida6",
    "dop853",
    "implicit_midpoint",
]
LEVELS = 8
SENT: Counter[tuple[str, str]] = Counter()  # bytes of this process, by the addresses of both ends


def count() -> None:
    """Count what this process writes from now on."""
    from distributed.comm.tcp import TCP

    library: Any = TCP
    write = library.write

    async def counted(self: Any, *message: Any, **how: Any) -> int:
        size = await write(self, *message, **how)
        SENT[self.local_address, self.peer_address] += size
        return int(size)

    library.write = counted


def sent() -> dict[tuple[str, str], int]:
    """Return what this process wrote so far."""
    return dict(SENT)


@contextmanager
def traffic(client: Any, what: str, members: int) -> Iterator[None]:
    """Print the bytes that pass the scheduler in both directions, by member."""
    begin = passed(client)
    yield
    into, out = (after - before for after, before in zip(passed(client), begin, strict=True))
    print(f"{what}: {into / members / 1e3:.2f} kB a member into the scheduler, {out / members / 1e3:.2f} kB out of it")


def passed(client: Any) -> tuple[int, int]:
    """Return the bytes that were sent to the scheduler so far, and by it."""
    time.sleep(1.0)  # what is under way comes in
    scheduler = client.scheduler.address
    counts = [sent(), *client.run(sent).values()]
    into = sum(size for one in counts for (_, peer), size in one.items() if peer == scheduler)
    return into, sum(size for (local, _), size in sent().items() if local == scheduler)


def refined(client: Any, until: float) -> None:
    """Refine by every method in one graph, and print what was in flight when."""
    from distributed import get_task_stream

    steps = [0.02 / 2**k for k in range(LEVELS)]
    studies = [xd.refine(MODEL, method=method, steps=steps, until=until, compute=False) for method in METHODS]
    tasks = {key for study in studies for key in study.encoding["stage"].delayed(study).__dask_graph__()}
    marches = {key for key in tasks if str(key).startswith("march-")}
    print(f"{len(marches)} marches, {len(tasks)} tasks in the graph")
    with traffic(client, "refinements", len(marches)), get_task_stream(client) as stream:
        begin = time.perf_counter()
        compute_datasets(*studies)
        took = time.perf_counter() - begin
    spans = [
        (part["start"], part["stop"], task["key"])
        for task in stream.data
        for part in task["startstops"]
        if part["action"] == "compute"
    ]
    first, last = min(start for start, _, _ in spans), max(stop for _, stop, _ in spans)
    flight = sum(stop - start for start, stop, _ in spans) / (last - first)
    print(f"{took:.1f} s; {flight:.2f} tasks in flight on {len(client.nthreads())} workers from first to last")
    moved = sum(
        part["stop"] - part["start"]
        for task in stream.data
        for part in task["startstops"]
        if part["action"] == "transfer"
    )
    print(f"{moved:.1f} s spent on moving results between workers")
    ends = sorted((stop - first) / (last - first) for _, stop, key in spans if str(key).startswith("refinement-"))
    print(f"studies were whole after {', '.join(f'{end:.0%}' for end in ends)} of the time")


def main() -> None:
    """Measure on so many workers."""
    workers = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    with cluster_of(None, workers) as client:
        count()
        client.run(count)
        axes = {"k": "1:2:4000 N m-1"}
        asked: dict[str, Any] = {"method": "rk4", "step": "20 ms", "until": "5 s"}
        xd.refine(MODEL, method="rk4", steps=[0.02, 0.01], until=1.0)  # compiles
        for method in METHODS:
            client.run(xd.refine, MODEL, method=method, steps=[0.02, 0.01], until=1.0)
        refined(client, float(sys.argv[2]) if len(sys.argv) > 2 else 400.0)
        with traffic(client, "a sweep of 4,000 members, gathered", 4000):
            xd.sweep(MODEL, axes, keep=["end", "x", "v_x"], times=[0.25, 0.5], **asked).compute()
        with tempfile.TemporaryDirectory() as folder:
            with traffic(client, "200 members with whole runs, in a folder", 200):
                grid = xd.sweep(MODEL, {"k": "1:2:200 N m-1"}, keep=["log"], path=folder, **asked)
            with traffic(client, "states of these runs at 20 times, opened together", 200):
                xd.open_logs(grid, "0.25:5:20 s").compute()
        with traffic(client, "a budget of 10,000 draws, by block of 512", 20):
            compute_datasets(
                xd.error_budget(BALL, "y", at="1 s", draws=10_000, method="rk4", step="20 ms", compute=False)
            )
        ledger = xd.validate(METHODS[:3], compute=False)
        with traffic(client, "a ledger of three methods, by case", ledger.sizes["case"]):
            compute_datasets(ledger)


if __name__ == "__main__":
    main()
