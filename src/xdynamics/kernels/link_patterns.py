"""The order that links of a relation follow: what loops over them need no table of ends for."""

from __future__ import annotations

import math

import numpy as np

from xdynamics.shapes import Relation

PIECES = 16  # stretches of a relation, in each of which ends follow one another, up to which it has no table of ends
Pattern = tuple[int, tuple[tuple[int, int], ...]]  # links for an element; the ends and how far from it they are


def of_every_two(relation: Relation) -> bool:
    """Whether a relation has every two elements of a dimension, in their order."""
    n = round((1 + math.sqrt(1 + 8 * relation.size)) / 2)
    if relation.source != relation.target or n * (n - 1) // 2 != relation.size or n < 3:
        return False
    first, second = np.triu_indices(n, 1)
    return bool((relation.first == first).all() and (relation.second == second).all())


def stretches(numbers: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[int]:
    """Return where stretches begin in which every number is one more than that before it."""
    return [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist()]


def patterns(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return stretches of elements with equal links, by the first of each; too many, if links follow no order."""
    meeting = relation.meeting
    stride = max(1, len(meeting[0].get(size // 2, ())))
    found: dict[int, Pattern] = {}
    previous = None
    for element in range(size):
        links = sorted((link, end) for end in (0, 1) if acting[end] for link in meeting[end].get(element, ()))
        pattern = stride, tuple((end, link - stride * element) for link, end in links)
        if pattern != previous:
            found[element] = previous = pattern
            if len(found) > PIECES:
                break
    return found
