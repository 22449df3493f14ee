"""The order that links of a relation follow: what loops over them need no table of ends for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.shapes import Relation

PIECES = 16  # stretches of a relation, in each of which ends follow one another, up to which it has no table of ends
IntArray = NDArray[np.int64]
Pattern = tuple[int, tuple[tuple[int, int], ...]]  # links for an element; the ends and how far from it they are


def stretch_starts(numbers: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[int]:
    """Return where stretches begin in which every number is one more than that before it."""
    return [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist()]


def patterns(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return stretches of elements with equal links, by the first of each; too many, if links follow no order."""
    ends = [_Meeting.sort_links(numbers, size) for numbers in (relation.first, relation.second)]
    stride = max(1, ends[0].links_of(size // 2).size)
    acts = [meeting for meeting, is_acting in zip(ends, acting, strict=True) if is_acting]
    changes = np.zeros(size, bool)
    changes[:1] = True
    for meeting in acts:
        changes[1:] |= meeting.differs(stride)
    stretch_patterns: dict[int, Pattern] = {}
    for element in np.flatnonzero(changes)[: PIECES + 1].tolist():
        links = sorted(
            (link, end)
            for end, meeting in enumerate(ends)
            if acting[end]
            for link in meeting.links_of(element).tolist()
        )
        stretch_patterns[element] = stride, tuple((end, link - stride * element) for link, end in links)
    return stretch_patterns


class _Meeting(NamedTuple):
    """The links at one of their ends: by elements, ascending; and where those of each element begin."""

    links: IntArray
    starts: IntArray

    @classmethod
    def sort_links(cls, numbers: IntArray, size: int) -> _Meeting:
        """Sort links by the elements at one end."""
        starts = np.concatenate([[0], np.cumsum(np.bincount(numbers, minlength=size))])
        return cls(np.argsort(numbers, kind="stable"), starts)

    def links_of(self, element: int) -> IntArray:
        """Return the links of an element."""
        return self.links[self.starts[element] : self.starts[element + 1]]

    def differs(self, stride: int) -> NDArray[np.bool_]:
        """Return of every element but the first whether its links are not those before it, `stride` farther on."""
        counts = np.diff(self.starts)
        differs = counts[1:] != counts[:-1]
        link_ranks = np.arange(self.links.size) - np.repeat(
            self.starts[:-1], counts
        )  # the place of a link at its element
        elements = np.repeat(np.arange(counts.size), counts)
        later = elements > 0
        previous_links = (self.starts[elements - 1] + link_ranks)[later]
        is_other = self.links[np.minimum(previous_links, self.links.size - 1)] + stride != self.links[later]
        np.logical_or.at(differs, elements[later][is_other] - 1, True)  # noqa: FBT003 - a number of numpy's
        return differs
