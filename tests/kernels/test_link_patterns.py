"""Stretches of elements with equal links are those that a look at every element finds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xdynamics.kernels.nests import PIECES, Pattern, patterns
from xdynamics.shapes import Relation


def relations() -> Iterator[tuple[int, Relation]]:
    """Yield chains, rings, second neighbours, a star and links at random, with how many elements there are."""
    random = np.random.default_rng(3)
    for n in (2, 3, 5, 19, 40):
        sites = np.arange(n)
        yield n, Relation("chain", "site", "site", sites[:-1], sites[1:])
        yield n, Relation("ring", "site", "site", sites, (sites + 1) % n)
        yield n, Relation("two", "site", "site", np.repeat(sites, 2), (np.repeat(sites, 2) + np.tile([1, 2], n)) % n)
        yield n, Relation("star", "site", "site", np.zeros(n, int), sites)
        for count in random.integers(0, 2 * n, 20).tolist():
            yield n, Relation("bond", "site", "site", *random.integers(0, n, (2, count)))


def looked_up(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return the stretches, element by element."""
    stride = max(1, int(np.count_nonzero(relation.first == size // 2)))
    found: dict[int, Pattern] = {}
    previous = None
    for element in range(size):
        ends = [
            (int(link), end)
            for end, numbers in enumerate((relation.first, relation.second))
            for link in np.flatnonzero(numbers == element)
            if acting[end]
        ]
        pattern = stride, tuple((end, link - stride * element) for link, end in sorted(ends))
        if pattern != previous:
            found[element] = previous = pattern
    return found


def test_stretches_are_those_of_every_element() -> None:
    """Assert the same stretches with the same links, up to as many as are used."""
    for size, relation in relations():
        for acting in ((True, True), (True, False), (False, True)):
            right = list(looked_up(relation, acting, size).items())
            assert list(patterns(relation, acting, size).items()) == right[: PIECES + 1]
