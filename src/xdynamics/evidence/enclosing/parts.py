"""Sets of starts cut into parts, of which narrower bounds are proven, and these joined."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from xdynamics.evidence.enclosing.tube import EventBounds, Tube
from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.crossings import Crossing


def split_box(start: Box, count: int) -> list[Box]:
    """Cut a box into as many parts, each cut being through the middle of what is widest beside its size.

    Neighbours share the number at which they are cut, so that together they are the whole.
    """
    parts = deque([start])
    while len(parts) < count:
        part = parts.popleft()
        i = int(np.argmax(boxes.width(part) / np.maximum(boxes.magnitude(part), np.finfo(float).tiny)))
        lower, upper = part.copy(), part.copy()
        lower[1, i] = upper[0, i] = boxes.midpoint(part)[i]
        parts += [lower, upper]
    return list(parts)


def join_tubes(tubes: Sequence[Tube]) -> Tube:
    """Return what holds of all motions of some tubes at the same times.

    Bounds are known where they are of every part, and zeros of an event as far as every part has as many of them.
    """
    first = min(tubes, key=lambda tube: tube.reached)
    low, high = (np.stack([tube.bounds[side] for tube in tubes]) for side in range(2))
    bounds = np.stack([low.min(axis=0), high.max(axis=0)])  # nan where one is
    events = [_join_event(same) for same in zip(*(tube.events for tube in tubes), strict=True)]
    steps, changes = sum(tube.steps for tube in tubes), {tube.changes for tube in tubes}
    same = changes.pop() if len(changes) == 1 else 0  # else some motions are changed more often than others
    return replace(first, bounds=bounds, events=events, steps=steps, parts=len(tubes), changes=same)


def _join_event(parts: Sequence[EventBounds]) -> EventBounds:
    """Return what is known of the zeros of an event from what is of each part."""
    event, many = parts[0], [part.crossings for part in parts]
    common = list(_common_crossings([crossings.zeros for crossings in many]))
    beyond = [crossings.zeros[len(common)].time[0] for crossings in many if len(crossings.zeros) > len(common)]
    unknown = min([crossings.unknown_from for crossings in many] + [float(time) for time in beyond], default=inf)
    known_crossings = [crossing for crossing in common if crossing.time[1] < unknown]
    begun_until = max(crossings.begun_until for crossings in many)
    return replace(
        event, crossings=replace(event.crossings, zeros=known_crossings, begun_until=begun_until, unknown_from=unknown)
    )


def _common_crossings(parts: Sequence[Sequence[Crossing]]) -> Iterator[Crossing]:
    """Yield crossings that every part has, each joined, up to the first that one lacks."""
    for same in zip(*parts, strict=False):
        if len({crossing.rising for crossing in same}) > 1:
            return
        joined_crossing = same[0]
        for part_crossing in same[1:]:
            time, state = (
                boxes.hull(joined_crossing.time, part_crossing.time),
                boxes.hull(joined_crossing.state, part_crossing.state),
            )
            joined_crossing = Crossing(time, joined_crossing.rising, state)
        yield joined_crossing
