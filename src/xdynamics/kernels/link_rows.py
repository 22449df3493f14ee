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
    Loop,
    Operand,
    Ordinal,
    Place,
    Reduction,
    StoreTo,
    apart,
    nested,
)


@dataclass(frozen=True)
class LinkRows:
    """What a loop does at each element: a row of links to all elements before it.

    Attributes
    ----------
    before : tuple of Line
        Lines before the row.
    links : Reduction
        The row, without the sums of other elements that it adds to.
    added : tuple of (Place, operand, str)
        To which number of the other element each link adds what; or "subtract", a number whose negative it adds.
    after : tuple of Line
        Lines after the row.
    """

    before: tuple[Line, ...]
    links: Reduction
    added: tuple[tuple[Place, Operand, str], ...]
    after: tuple[Line, ...]


def link_rows(line: Loop) -> LinkRows | None:
    """Return the rows of a loop if some can be made side by side, as long as no two of their elements meet; else None.

    That is so if a row changes nothing that another reads, but for sums of which it adds to those of elements before
    its own, and sets its own when it is done.
    """
    at = next((k for k, inner in enumerate(line.body) if isinstance(inner, Reduction)), None)
    if at is None:
        return None
    links, before, after = line.body[at], line.body[:at], line.body[at + 1 :]
    assert isinstance(links, Reduction)  # noqa: S101 - it was found as one
    if links.below != line.index or links.count != line.count or links.where:
        return None
    if any(inner.kind != FLOAT for inner in nested((line,)) if isinstance(inner, Compute | Reduction)):
        return None
    plain = Load | Compute | Ordinal
    if not all(isinstance(inner, plain) for inner in before):
        return None
    if not all(isinstance(inner, plain | StoreTo | Reduction) for inner in links.body):
        return None
    if not all(isinstance(inner, plain | StoreTo) for inner in (*nested(_sums(links.body)), *after)):
        return None
    added, rest = _added(links)
    own = {_of_row(place, links.index, line.index) for place, *_ in added}
    stored = {inner.place for inner in after if isinstance(inner, StoreTo)}
    changed = {place.array for place, *_ in added} | {place.array for place in stored}
    read = {inner.place.array for inner in nested((*before, *rest, *after)) if isinstance(inner, Load)}
    sums = {place.array for place, *_ in added}
    links = replace(links, body=rest)
    if (
        not added
        or len({place for place, *_ in added}) < len(added)
        or any(isinstance(inner, StoreTo) and inner.place.array not in line.own for inner in rest)
        or sums & line.own
        or read & changed
        or {term for _, term, _ in added} & {*links.totals, *(inner.target for inner in apart_from_totals(links)[1])}
        or any(place.array in sums and place not in own for place in stored)
        or not all(
            apart([_of_links(place, links) for place, *_ in added if place.array == array], {links.index: links.count})
            for array in sums
        )
    ):
        return None
    return LinkRows(before, links, added, after)


def apart_from_totals(line: Reduction) -> tuple[tuple[Line, ...], tuple[Compute, ...]]:
    """Return the lines of a pass that do not read its totals, and those that read them, or what others of them compute."""
    known, lines, joining = set(line.totals), list[Line](), list[Compute]()
    for inner in line.body:
        if isinstance(inner, Compute) and known.intersection(inner.arguments):
            known.add(inner.target)
            joining.append(inner)
        else:
            lines.append(inner)
    return tuple(lines), tuple(joining)


def _sums(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield the lines of sums inside links."""
    for inner in lines:
        if isinstance(inner, Reduction):
            yield from inner.body


def _of_row(place: Place, other: str, own: str) -> Place:
    """Return the number of the row's own element that stands for one of the other element."""
    return replace(place, strides=tuple((own if index == other else index, by) for index, by in place.strides))


def _of_links(place: Place, links: Reduction) -> Place:
    """Return a place without indices of loops around the rows, which are the same for all of them."""
    return replace(place, strides=tuple((index, by) for index, by in place.strides if index == links.index))


def _added(links: Reduction) -> tuple[tuple[tuple[Place, Operand, str], ...], tuple[Line, ...]]:
    """Return what is added to numbers of the elements of an index, and the other lines."""
    defined = {inner.target: inner for inner in links.body if isinstance(inner, Load | Compute)}
    uses = Counter(_operands(links.terms, links.body))
    added, parts = [], set[int]()
    for store in links.body:
        total = defined.get(str(store.value)) if isinstance(store, StoreTo) else None
        if not isinstance(store, StoreTo) or not isinstance(total, Compute) or total.operation != "add":
            continue
        loaded = defined.get(str(total.arguments[0]))
        if (
            isinstance(loaded, Load)
            and loaded.place == store.place
            and links.index in (indices := dict(store.place.strides))
            and links.below not in indices
            and uses[loaded.target] == uses[total.target] == 1
        ):
            term = defined.get(str(total.arguments[1]))
            if isinstance(term, Compute) and term.operation == "negative":
                added.append((store.place, term.arguments[0], "subtract"))
            else:
                added.append((store.place, total.arguments[1], "add"))
            parts |= {id(loaded), id(total), id(store)}
    return tuple(added), tuple(inner for inner in links.body if id(inner) not in parts)


def _operands(terms: Iterable[Operand], lines: Iterable[Line]) -> Iterator[Operand]:
    """Yield what the lines of a row read."""
    yield from terms
    for inner in lines:
        if isinstance(inner, Compute):
            yield from inner.arguments
        elif isinstance(inner, StoreTo):
            yield inner.value
        elif isinstance(inner, Reduction):
            yield from _operands((*inner.terms, *inner.starts), inner.body)
