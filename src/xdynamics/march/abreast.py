"""Many runs side by side: which go so, and what they are given; `march.lanes` marches them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import config
from numpy.typing import NDArray

from xdynamics.kernels import Law
from xdynamics.kernels.machine import vector_lanes
from xdynamics.kernels.program import TABLE, WORDS
from xdynamics.kernels.striding import lane_width
from xdynamics.kernels.watching import can_be_watched
from xdynamics.march.engine import lanes as side_by_side
from xdynamics.march.lanes import EVENTS, NONE
from xdynamics.march.log import Log, allocate
from xdynamics.march.parts import Arrays, Part, inputs_of
from xdynamics.march.posing import addresses_of, posed
from xdynamics.march.run import EVENT_ROW
from xdynamics.march.settings import Settings
from xdynamics.model import Model

LANE_ROWS = 1 << 5  # of the log of a lane, which the single march writes to now and then
EVENT_ROOM = 1 << 16  # events that lanes hold before they are taken out
FEWEST_A_LANE = 4  # runs from which on lanes pay


def lanes_for(law: Law, settings: Settings, runs: int, asked: int | None) -> int:
    """Return how many runs may go side by side: one, where a step is more than a program, or nothing is gained."""
    scheme, layout = law.scheme, law.layout
    plain = not (scheme.method.implicit or scheme.halved or scheme.method.stepping or isinstance(settings.step, tuple))
    if not plain or layout.model.python_functions or config.DISABLE_JIT or not can_be_watched(layout):  # type: ignore[attr-defined]
        return 1
    if asked is not None:
        return max(1, asked)
    return vector_lanes() if runs >= FEWEST_A_LANE * vector_lanes() else 1


def march_abreast(model: Model, settings: Settings, law: Law, arrays: Arrays, lanes: int) -> Part:
    """March runs side by side."""
    n, layout = len(next(iter(arrays.values()))), law.layout
    log = allocate(layout, LANE_ROWS, sampled=0)
    one = posed(model, settings, law, log, addresses_of(law))
    twins, inputs = one.twins(lanes), inputs_of(model, settings, law, one, arrays)
    part = Part.of(n, law, inputs[2])
    blocks = {name: np.zeros((len(getattr(one, name)), lanes)) for name in ("at", "y", "p", "z", "e")}
    blocks |= {"pieces": np.zeros((len(one.places), lanes), np.int64), "w": np.zeros((lane_width(layout), lanes))}
    table, stride = (
        _table(blocks | {"tables": one.tables}),
        law.striding(lanes, adaptive=settings.adaptive, followers=tuple(map(bool, one.followers))),
    )
    given = [blocks[name] for name in ("at", "y", "p", "pieces", "z", "w")]
    met = _room(log, 2 * lanes * len(log.events) + min(n, EVENT_ROOM) if layout.watched else 0)
    owners, standing = np.zeros(len(met.events), np.int64), np.array([lanes, 0, 0])
    whose, members, over = [], np.full(lanes, NONE), False
    while not over:
        over = side_by_side()(
            twins.addresses, stride, table, *given, members, standing, *inputs,
            part.ends, part.lasts, part.largest, part.passed, met.events, met.rates, met.impulses, owners,
        )  # fmt: skip
        count, standing[EVENTS] = int(standing[EVENTS]), 0
        part.logs.append(_events(met, np.arange(count)))
        whose.append(owners[:count].copy())
    together = [np.concatenate(pieces, axis=-1) for pieces in zip(*((one.events, one.rates, one.impulses) for one in part.logs), strict=True)]  # fmt: skip
    order = np.argsort(np.concatenate(whose), kind="stable")  # a run's own stand in their order
    part.logs = [_events(met._replace(events=together[0], rates=together[1], impulses=together[2]), order)]
    return part


def _room(log: Log, events: int) -> Log:
    """Return a log for so many events, and nothing else."""
    return Log(
        log.base, log.rows[:, :0], log.flags[:, :0], log.samples[:, :0], log.trials[:0], np.zeros(events, EVENT_ROW),
        np.zeros((len(log.rates), events)), np.zeros((len(log.impulses), events)),
    )  # fmt: skip


def _events(log: Log, which: NDArray[np.int64]) -> Log:
    """Take some events out of a log."""
    return log._replace(events=log.events[which], rates=log.rates[:, which], impulses=log.impulses[:, which])


def _table(blocks: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Return where a program in lanes finds its arrays."""
    table = np.zeros(WORDS * len(TABLE), np.int64)
    for i, name in enumerate(TABLE):
        if name in blocks:
            table[WORDS * i] = blocks[name].ctypes.data
    return table
