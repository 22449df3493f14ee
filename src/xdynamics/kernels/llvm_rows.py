"""Rows of links to all elements before one, as LLVM text: the rows of neighbouring elements side by side.

Every two elements meet once. What a link gives to the row's own element is added in its lane; what it gives to the other
is added for one row after the other, so that each sum is ascending, as in plain loops.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from xdynamics.elementary.llvm_numbers import LaneValue
from xdynamics.elementary.numbers import choose
from xdynamics.kernels.link_rows import LinkRows, link_rows
from xdynamics.kernels.llvm_loops import LoopText, Value, alike, parts_of, together
from xdynamics.kernels.llvm_places import Index
from xdynamics.kernels.operations import RULES
from xdynamics.kernels.program import Loop, Reduction

Terms = Sequence[Sequence[LaneValue]]  # for each number that is added to, what each of some elements gets


class RowText(LoopText):
    """Prints loops, and those over every two elements by several rows at once."""

    def _loop(self, line: Loop) -> None:
        rows = link_rows(line) if self._may_go_abreast() else None
        if rows is None or line.count < 2 * self._abreast or self._into_row(line):
            super()._loop(line)
        else:
            self._rows(line, rows)

    def _rows(self, line: Loop, rows: LinkRows) -> None:
        """Print the first rows one by one, and then as many at once as there are lanes."""
        wide, first = self._abreast, line.count % self._abreast
        if first:
            self._inner(partial(self._made, line), "0", str(first), [])
        if any(isinstance(inner, Reduction) for inner in rows.links.body):
            self._kept = f"{self._lines.label()}kept"
            self._stack.append(f"%{self._kept} = alloca double, i64 {len(rows.added) * wide * wide}, align 64")

        def made(index: Index, _: list[Value]) -> list[Value]:
            self._block(line, rows, index)
            return []

        self._inner(made, str(first), str(line.count), [], wide)

    def _block(self, line: Loop, rows: LinkRows, index: Index) -> None:
        """Print the links of a block of rows to all elements before it, then those among its own."""
        wide, links, first = self._abreast, rows.links, line.count % self._abreast
        with self._side_by_side(wide), self._pass(replace(line, body=rows.before), Index(index.value, 1), []):
            totals = [self._operand(start) for start in links.starts]
            if first:
                totals = self._inner(partial(self._tile, rows, 1), "0", str(first), totals)
            totals = self._inner(partial(self._tile, rows, wide), str(first), str(index.value), totals, wide)
            totals, added = self._links(rows, wide, index, totals, within=True)
            self._values.update(zip(links.totals, totals, strict=True))
            self._print(rows.after)
            self._add(rows, index, added, within=True)

    def _tile(self, rows: LinkRows, count: int, index: Index, totals: list[Value]) -> list[Value]:
        """Print links of a block to some elements before it."""
        totals, added = self._links(rows, count, index, totals)
        self._add(rows, index, added)
        return totals

    def _links(
        self, rows: LinkRows, count: int, index: Index, totals: list[Value], *, within: bool = False
    ) -> tuple[list[Value], Terms]:
        """Print links of a block to some elements; return the sums of its rows, and what the elements get.

        Of elements of the block itself each has links to those before it alone: what other lanes find is not added.
        """
        made = self._one_by_one if any(isinstance(inner, Reduction) for inner in rows.links.body) else self._together
        return made(rows, count, index, totals, within=within)

    def _together(
        self, rows: LinkRows, count: int, index: Index, totals: list[Value], *, within: bool
    ) -> tuple[list[Value], Terms]:
        """Print links line by line for all elements: roots and quotients wait less."""
        links = rows.links
        further = (self._lines.line("p", f"add i64 {index.value}, {k}").text for k in range(1, count - within))
        elements = [index, *map(Index, further)]
        with self._pass(replace(links, body=()), index, totals):
            self._joint = self._joint | together(links.body)
            scopes = [dict(self._values) for _ in elements]
            for inner in links.body:
                for _ in self._elements(links.index, elements, scopes):
                    self._print((inner,))
            added = [
                [self._number(term) for _, term, _ in rows.added] for _ in self._elements(links.index, elements, scopes)
            ]
            for k, _ in enumerate(self._elements(links.index, elements, scopes)):
                self._values.update(zip(links.totals, totals, strict=True))
                self._print(rows.joining)
                after = [lane > k for lane in range(self._abreast)]
                totals = self._chosen(self._truths(after) if within else None, self._joined(links, totals), totals)
        if within:  # the last has no links to elements after it in the block
            added.append([self._lines.constant(0.0) for _ in rows.added])
        return totals, list(zip(*added, strict=True))

    def _one_by_one(
        self, rows: LinkRows, count: int, index: Index, totals: list[Value], *, within: bool
    ) -> tuple[list[Value], Terms]:
        """Print links, which have loops of their own, element by element; what each gets waits in memory."""
        links, wide = rows.links, self._abreast
        if count == 1:
            with self._pass(replace(links, body=rows.alone), index, totals):
                return self._joined(links, totals), [[self._number(term)] for _, term, _ in rows.added]

        def made(element: Index, totals: list[Value]) -> list[Value]:
            lane = self._lines.line("p", f"sub i64 {element.value}, {index.value}").text
            with self._pass(replace(links, body=rows.alone), element, totals):
                for k, (_, term, _) in enumerate(rows.added):
                    value = self._number(term)
                    where = self._kept_at(str(k * wide), lane)
                    self._put(f"store {self._lines.kind('n')} {value.text}, ptr {where}, align 64")
                joined = self._joined(links, totals)
                return self._chosen(self._side(links, element) if within else None, joined, totals)

        last = self._lines.line("p", f"add i64 {index.value}, {count - within}").text
        totals = self._inner(made, str(index.value), last, totals)
        return totals, [[self._kept_row(k * wide + lane) for lane in range(wide)] for k in range(len(rows.added))]

    def _kept_at(self, first: str, lane: str) -> str:
        """Return where the numbers of a row of lanes wait."""
        number = self._lines.line("p", f"add i64 {first}, {lane}").text
        far = self._lines.line("p", f"mul i64 {number}, {self._abreast}").text
        return self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {far}").text

    def _kept_row(self, number: int) -> LaneValue:
        """Return the numbers that wait in a row of lanes."""
        where = self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {number * self._abreast}").text
        return self._lines.line("n", f"load {self._lines.kind('n')}, ptr {where}, align 64")

    def _elements(self, name: str, elements: Sequence[Index], scopes: Sequence[dict[str, Value]]) -> Iterator[None]:
        """Let an index be one element after the other, with values of its own."""
        for element, scope in zip(elements, scopes, strict=True):
            self._values, self._places.indices[name] = scope, element
            yield

    def _add(self, rows: LinkRows, index: Index, added: Terms, *, within: bool = False) -> None:
        """Add what some elements get, or one, to their numbers: of one row after the other."""
        lines, kind, name = self._lines, self._lines.kind("n"), rows.links.index
        outside = dict(self._places.indices), dict(self._places.addresses)
        self._places.indices[name] = Index(index.value, int(len(added[0]) > 1))
        for (place, _, operation), terms in zip(rows.added, added, strict=True):
            add = RULES[operation]
            if len(terms) > 1:
                total = self._places.load(place)
                for lane, row in enumerate(self._transposed(terms)):
                    more = add(total, row)
                    before = [element < lane for element in range(self._abreast)]
                    total = choose(self._truths(before), more, total) if within else more
                self._places.store(place, total)
                continue
            wide, lines.lanes = lines.lanes, 1
            total = self._places.load(place)
            for lane in range(wide):
                total = add(total, lines.line("n", f"extractelement {kind} {terms[0].text}, i64 {lane}"))
            self._places.store(place, total)
            lines.lanes = wide
        self._places.indices, self._places.addresses = outside

    def _truths(self, lanes: Sequence[bool]) -> LaneValue:
        """Return a truth for each lane."""
        return LaneValue(self._lines, "t", f"<{', '.join(f'i1 {str(truth).lower()}' for truth in lanes)}>")

    def _chosen(self, truth: LaneValue | None, new: list[Value], old: list[Value]) -> list[Value]:
        """Return new sums, or in lanes where a truth does not hold old ones."""
        if truth is None:
            return new
        return [
            alike(before, [choose(truth, *pair) for pair in zip(parts_of(after), parts_of(before), strict=True)])
            for before, after in zip(old, new, strict=True)
        ]

    def _transposed(self, rows: Sequence[LaneValue]) -> list[LaneValue]:
        """Exchange rows and lanes of a square of numbers."""
        found, far, kind = list(rows), 1, self._lines.kind("n")
        while far < len(found):
            masks = [
                [lane - far + len(found) if lane & far else lane for lane in range(len(found))],
                [lane + len(found) if lane & far else lane + far for lane in range(len(found))],
            ]
            for k in (k for k in range(len(found)) if not k & far):
                first, second = found[k], found[k + far]
                found[k], found[k + far] = (
                    self._lines.line("n", f"shufflevector {kind} {first.text}, {kind} {second.text}, {_mask(mask)}")
                    for mask in masks
                )
            far *= 2
        return found


def _mask(lanes: Sequence[int]) -> str:
    return f"<{len(lanes)} x i32> <{', '.join(f'i32 {lane}' for lane in lanes)}>"
