"""Loops over elements and over those before each, in which every two meet once and each adds to the other's sum."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from xdynamics.kernels.program import (
    FLOAT,
    Compute,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Reduction,
    StoreTo,
    are_distinct,
    nested_lines,
)


@dataclass(frozen=True)
class LinkRows:
    """The body of a loop at each element: a row of links to all elements before it.

    Attributes
    ----------
    lines_before : tuple of Line
        Lines before the row.
    links : Reduction
        The row, without the sums of other elements that it adds to.
    added : tuple of (Place, operand, str)
        To which number of the other element each link adds what; or "subtract", a number whose negative it adds.
    lines_after : tuple of Line
        Lines after the row.
    """

    lines_before: tuple[Line, ...]
    links: Reduction
    added: tuple[tuple[Location, Operand, str], ...]
    lines_after: tuple[Line, ...]


def link_rows(line: Loop) -> LinkRows | None:
    """Return the rows of a loop if some can be made side by side, as long as no two of their elements meet; else None.

    That is so if a row changes nothing that another reads, but for sums of which it adds to those of elements before
    its own, and sets its own when it is done.
    """
    row_position = next((k for k, inner in enumerate(line.body) if isinstance(inner, Reduction)), None)
    if row_position is None:
        return None
    links, lines_before, lines_after = line.body[row_position], line.body[:row_position], line.body[row_position + 1 :]
    assert isinstance(links, Reduction)  # noqa: S101 - it was found as one
    if links.below != line.index or links.count != line.count or links.where:
        return None
    if any(inner.kind != FLOAT for inner in nested_lines((line,)) if isinstance(inner, Compute | Reduction)):
        return None
    plain = Load | Compute | Ordinal
    if not all(isinstance(inner, plain) for inner in lines_before):
        return None
    if not all(isinstance(inner, plain | StoreTo | Reduction) for inner in links.body):
        return None
    if not all(
        isinstance(inner, plain | StoreTo) for inner in (*nested_lines(_inner_sum_lines(links.body)), *lines_after)
    ):
        return None
    added, remaining_lines = _split_additions(links)
    own_locations = {_row_location(location, links.index, line.index) for location, *_ in added}
    stored = {inner.location for inner in lines_after if isinstance(inner, StoreTo)}
    changed = {location.array for location, *_ in added} | {location.array for location in stored}
    read = {
        inner.location.array
        for inner in nested_lines((*lines_before, *remaining_lines, *lines_after))
        if isinstance(inner, Load)
    }
    sums = {location.array for location, *_ in added}
    links = replace(links, body=remaining_lines)
    if (
        not added
        or len({location for location, *_ in added}) < len(added)
        or any(
            isinstance(inner, StoreTo) and inner.location.array not in line.exclusive_arrays
            for inner in remaining_lines
        )
        or sums & line.exclusive_arrays
        or read & changed
        or {term for _, term, _ in added} & {*links.totals, *(inner.target for inner in apart_from_totals(links)[1])}
        or any(location.array in sums and location not in own_locations for location in stored)
        or not all(
            are_distinct(
                [_link_location(location, links) for location, *_ in added if location.array == array],
                {links.index: links.count},
            )
            for array in sums
        )
    ):
        return None
    return LinkRows(lines_before, links, added, lines_after)


def apart_from_totals(line: Reduction) -> tuple[tuple[Line, ...], tuple[Compute, ...]]:
    """Return the lines of a pass that are independent of its totals, and those that depend on them."""
    total_names, lines, joining = set(line.totals), list[Line](), list[Compute]()
    for inner in line.body:
        if isinstance(inner, Compute) and total_names.intersection(inner.arguments):
            total_names.add(inner.target)
            joining.append(inner)
        else:
            lines.append(inner)
    return tuple(lines), tuple(joining)


def _inner_sum_lines(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield the lines of sums inside links."""
    for inner in lines:
        if isinstance(inner, Reduction):
            yield from inner.body


def _row_location(location: Location, other_index: str, row_index: str) -> Location:
    """Return the number of the row's own element that stands for one of the other element."""
    return replace(
        location,
        strides=tuple((row_index if index == other_index else index, stride) for index, stride in location.strides),
    )


def _link_location(location: Location, links: Reduction) -> Location:
    """Return a location without indices of loops around the rows, which are constant over all rows."""
    return replace(
        location, strides=tuple((index, stride) for index, stride in location.strides if index == links.index)
    )


def _split_additions(links: Reduction) -> tuple[tuple[tuple[Location, Operand, str], ...], tuple[Line, ...]]:
    """Return the additions to numbers of an index's elements, and the other lines."""
    defined = {inner.target: inner for inner in links.body if isinstance(inner, Load | Compute)}
    uses = Counter(_row_operands(links.terms, links.body))
    added, parts = [], set[int]()
    for store in links.body:
        total = defined.get(str(store.value)) if isinstance(store, StoreTo) else None
        if not isinstance(store, StoreTo) or not isinstance(total, Compute) or total.operation != "add":
            continue
        loaded = defined.get(str(total.arguments[0]))
        if (
            isinstance(loaded, Load)
            and loaded.location == store.location
            and links.index in (indices := dict(store.location.strides))
            and links.below not in indices
            # nothing else may read the two: they are taken out of the row
            and uses[loaded.target] == uses[total.target] == 1
        ):
            term = defined.get(str(total.arguments[1]))
            if isinstance(term, Compute) and term.operation == "negative":
                added.append((store.location, term.arguments[0], "subtract"))
            else:
                added.append((store.location, total.arguments[1], "add"))
            parts |= {id(loaded), id(total), id(store)}
    return tuple(added), tuple(inner for inner in links.body if id(inner) not in parts)


def _row_operands(terms: Iterable[Operand], lines: Iterable[Line]) -> Iterator[Operand]:
    """Yield the operands of a row's lines."""
    yield from terms
    for inner in lines:
        if isinstance(inner, Compute):
            yield from inner.arguments
        elif isinstance(inner, StoreTo):
            yield inner.value
        elif isinstance(inner, Reduction):
            yield from _row_operands((*inner.terms, *inner.starts), inner.body)
