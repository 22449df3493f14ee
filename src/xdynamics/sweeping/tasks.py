"""Cutting a grid into blocks, each enough work for a task; dask does the scheduling."""

from __future__ import annotations

import time
from functools import partial
from hashlib import sha256
from itertools import product
from operator import itemgetter
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from xdynamics.evidence.cluster import connected, log_worker_event, worker_events
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.sweeping.members import Block, Plan, march_block

SECOND = 1.0  # of work in a task; scheduling it costs about a millisecond
MIN_TASK_TIME = 0.05  # s, where there are few members for many workers
TASKS_PER_WORKER = 4  # tasks per worker, so that none is idle for long
UNMEASURED = 16  # where it is not known what a member costs, and members may differ by much
LANE_MEMBERS = 64  # members of a task, from which on they are marched abreast
MAX_MEMBERS = 1 << 15  # members of a task, each of which takes about a kilobyte while marched
BLOCKS_PER_TOPIC = 500  # blocks under one topic of a cluster, which keeps the last thousand notes of each
PROBE_MEMBERS, PROBE_GROWTH = (
    8,
    16,
)  # members marched to measure the cost of one, and the growth factor while they cost little

Chunks = tuple[tuple[int, ...], ...]


def measured_chunks(plan: Plan, members: int | None = None) -> Chunks:
    """Cut a sweep into tasks of so many members, by default about a second of work; results do not depend on it.

    Some members are marched for it, unless their number is given.
    """
    grid = plan.grid
    if members is not None:
        return cut_grid(grid, members)
    cost = _cost(plan)
    fewest = max(grid.size // (TASKS_PER_WORKER * _processors()), int(MIN_TASK_TIME / cost))
    return cut_grid(grid, max(1, min(MAX_MEMBERS, int(SECOND / cost), fewest)))


def counted_chunks(grid: SweepGrid, members: int | None = None) -> Chunks:
    """Cut a grid into tasks of so many members, by default by their count alone: nothing is marched for it."""
    if members is None:
        processors = _processors()
        members = max(grid.size // (UNMEASURED * processors), min(LANE_MEMBERS, grid.size // processors), 1)
    return cut_grid(grid, min(MAX_MEMBERS, members))


def _processors() -> int:
    """Return how many tasks run at once: on the cluster that is connected, else on the CPUs of this process."""
    from dask.system import CPU_COUNT

    client = connected()
    return CPU_COUNT if client is None else max(1, sum(client.nthreads().values()))


def cut_grid(grid: SweepGrid, members: int) -> Chunks:
    """Cut a grid into blocks of at most so many members, with one value each along axes of words."""
    chunks: list[tuple[int, ...]] = []
    remaining = max(1, members)
    for k in reversed(range(len(grid.shape))):
        size = grid.shape[k]
        width = 1 if k in grid.word_axes else min(size, remaining)
        chunks.append((*[width] * (size // width), *([size % width] if size % width else [])))
        remaining = max(1, remaining // width) if width == size or k in grid.word_axes else 1
    return tuple(reversed(chunks))


def blocks_of(chunks: Chunks) -> list[tuple[tuple[int, ...], Block]]:
    """Return the blocks, each with its index among them."""
    ends = [np.cumsum(entries).tolist() for entries in chunks]
    parts = [
        [slice(end - width, end) for width, end in zip(entries, last, strict=True)]
        for entries, last in zip(chunks, ends, strict=True)
    ]
    places = product(*(range(len(entries)) for entries in parts))
    return [(block_index, tuple(part[i] for part, i in zip(parts, block_index, strict=True))) for block_index in places]


Key = tuple[Any, ...]


class Digests(dict[Key, bytes]):
    """Digests of a sweep's blocks, as they were marched here or on a cluster; they live as long as Datasets of the sweep."""

    def __init__(self, token: str) -> None:
        super().__init__()
        self.token = token

    def __reduce__(self) -> Any:
        return _digests_of, (self.token,)  # another process has its own, and asks the cluster for the others


def _digests_of(token: str) -> Digests:
    return _DIGESTS_BY_TOKEN.setdefault(token, Digests(token))


_DIGESTS_BY_TOKEN: WeakValueDictionary[str, Digests] = WeakValueDictionary()  # by a sweep's token


def lazy_arrays(plan: Plan, chunks: Chunks) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return every variable as a dask array, marching a block once for all, and checks whether values came of it."""
    import dask.array
    from dask.base import tokenize
    from dask.highlevelgraph import HighLevelGraph

    da: Any = dask.array  # its functions are not typed
    token = tokenize(plan.digest, chunks, plan.check)
    plan_key, name = f"plan-{token}", f"march-{token}"
    blocks = blocks_of(chunks)
    layers: dict[str, Any] = {
        plan_key: {plan_key: plan},
        name: {
            (name, *block_index): (_march_and_note, plan_key, list(block), [token, number])
            for number, (block_index, block) in enumerate(blocks)
        },
    }
    dependencies: dict[str, set[str]] = {plan_key: set(), name: {plan_key}}
    arrays, checks, digests = {}, {}, _digests_of(token)
    for variable in plan.variables:
        key = f"{variable.name}-{token}"
        inner = (0,) * len(variable.sizes)
        graph = {
            (key, *block_index, *inner): (itemgetter(variable.name), (name, *block_index)) for block_index, _ in blocks
        }
        graph_layers = HighLevelGraph(layers | {key: graph}, dependencies | {key: {name}})
        arrays[variable.name] = da.Array(
            graph_layers, key, (*chunks, *((n,) for n in variable.sizes)), dtype=np.dtype(variable.dtype)
        )
        checks[variable.name] = partial(_is_of_blocks, digests, variable.name, blocks)
    return arrays, checks


def _march_and_note(plan: Plan, block: Block, token_and_number: list[Any]) -> dict[str, Any]:
    """March a block, and note the digests of its arrays, in this process and for the cluster's client."""
    values = march_block(plan, block)
    token, number = token_and_number
    block_digests = {name: _array_digest(array) for name, array in values.items()}
    digests = _DIGESTS_BY_TOKEN.get(token)
    if digests is not None:  # otherwise no Dataset here can ask for them
        digests.update({(name, number): digest for name, digest in block_digests.items()})
    log_worker_event(_note_topic(token, number), [number, block_digests])
    return values


def _note_topic(token: str, number: int) -> str:
    return f"sweep-{token}-{number // BLOCKS_PER_TOPIC}"


def _is_of_blocks(digests: Digests, name: str, blocks: list[tuple[tuple[int, ...], Block]], array: Any) -> bool:
    """Return whether values are those that the blocks of a variable gave in this process, or on the cluster."""
    values = np.asarray(array.values)
    if any((name, number) not in digests for number in range(len(blocks))):
        for first in range(0, len(blocks), BLOCKS_PER_TOPIC):
            for number, noted_digests in worker_events(_note_topic(digests.token, first)):
                digests.update({(entry, number): bytes(digest) for entry, digest in noted_digests.items()})
    return all(
        digests.get((name, number)) == _array_digest(values[tuple(block)]) for number, (_, block) in enumerate(blocks)
    )


def _array_digest(values: Any) -> bytes:
    values = np.ascontiguousarray(values)
    return sha256(f"{values.dtype.str}{values.shape}".encode() + values.tobytes()).digest()


def _cost(plan: Plan) -> float:
    """March a member, and if that is fast some more, spread over the grid; return the time of one, s.

    Measured in CPU time, so that a busy machine does not cut a sweep finer.
    """
    grid = plan.grid
    first = tuple(slice(0, 1) for _ in grid.shape)
    march_block(plan, first)  # compiles
    started = time.thread_time()
    march_block(plan, first)
    cpu_time = time.thread_time() - started
    if cpu_time * PROBE_MEMBERS > SECOND or grid.size == 1:
        # not zero, which a coarse clock may tell: the cost is divided by
        return max(1e-7, cpu_time)
    k = max((i for i in range(len(grid.shape)) if i not in grid.word_axes), key=lambda i: grid.shape[i], default=0)
    probe_count = PROBE_MEMBERS
    while True:  # with few members the cost is mostly that of the call
        sample = _spread_members(grid, k, probe_count)
        started = time.thread_time()
        march_block(plan, sample)
        cpu_time, count = time.thread_time() - started, int(np.prod(grid.block_shape(sample)))
        if (
            cpu_time > MIN_TASK_TIME
            or PROBE_GROWTH * PROBE_GROWTH * count > grid.size
            or PROBE_GROWTH * probe_count > grid.shape[k]
        ):
            return max(1e-7, cpu_time / max(1, count))
        probe_count *= PROBE_GROWTH


def _spread_members(grid: SweepGrid, k: int, count: int) -> Block:
    """Choose so many members, spread over one axis."""
    step = max(1, grid.shape[k] // count)
    return tuple(
        slice(None, None, step) if i == k and i not in grid.word_axes else slice(0, 1) for i in range(len(grid.shape))
    )
