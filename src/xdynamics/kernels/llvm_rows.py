"""Rows of links to all elements before one, as LLVM text: the rows of neighbouring elements side by side.

Every two elements meet once. What a link gives to the row's own element is added in its lane; what it gives to the other
is added for one row after the other, so that each sum is ascending, as in plain loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from xdynamics.elementary.llvm_numbers import LaneValue
from xdynamics.kernels.link_rows import LinkRows, link_rows
from xdynamics.kernels.llvm_loops import LoopText, Value, together
from xdynamics.kernels.llvm_places import Index
from xdynamics.kernels.operations import RULES
from xdynamics.kernels.program import Loop, Place


class RowText(LoopText):
    """Prints loops, and those over every two elements by several rows at once."""

    def _loop(self, line: Loop) -> None:
        rows = link_rows(line) if self._abreast > self._runs and not self._places.indices else None
        if rows is None or line.count < 2 * self._abreast or self._into_row(line):
            super()._loop(line)
        else:
            self._rows(line, rows)

    def _rows(self, line: Loop, rows: LinkRows) -> None:
        """Print as many rows at once as there are lanes; of the first block as many as are left over."""
        wide, first = self._abreast, line.count % self._abreast
        lines, sums = self._lines, f"{self._lines.label()}sums"
        lines.lines.insert(0, f"%{sums} = alloca double, i64 {wide * len(rows.links.totals)}, align 8")

        def made(index: Index, _: list[Value]) -> list[Value]:
            last, begin, tiled = lines.line("p", f"add i64 {index.value}, {first or wide}").text, index, "0"
            if first:  # rows of the first block begin at 0, and none is before them
                is_first = lines.line("p", f"icmp eq i64 {index.value}, 0").text
                later = lines.line("p", f"sub i64 {last}, {wide}").text
                begin = Index(lines.line("p", f"select i1 {is_first}, i64 0, i64 {later}").text)
                tiled = lines.line("p", f"select i1 {is_first}, i64 0, i64 {first}").text
            self._before_block(line, rows, begin, tiled, sums)
            return self._inner(partial(self._row, line, rows, begin, sums), str(begin.value), last, [])

        self._inner(made, "0", str(line.count), [], wide)

    def _before_block(self, line: Loop, rows: LinkRows, index: Index, first: str, sums: str) -> None:
        """Print links of the rows of a block to all elements before it, the first ones alone; keep the sums so far."""
        wide, links = self._abreast, rows.links
        with self._side_by_side(wide), self._pass(replace(line, body=rows.before), Index(index.value, 1), []):
            totals = [self._operand(start) for start in links.starts]
            if line.count % wide:
                totals = self._inner(partial(self._tile, rows, 1), "0", first, totals)
            totals = self._inner(partial(self._tile, rows, wide), first, str(index.value), totals, wide)
            for k, total in enumerate(totals):
                assert isinstance(total, LaneValue)  # noqa: S101 - rows are of numbers
                place = self._lines.line("p", f"getelementptr double, ptr %{sums}, i64 {k * wide}").text
                self._put(f"store {self._lines.kind('n')} {total.text}, ptr {place}, align 8")

    def _tile(self, rows: LinkRows, count: int, index: Index, totals: list[Value]) -> list[Value]:
        """Print links of a block to some elements, line by line for all of them: roots and quotients wait less."""
        links = rows.links
        further = (self._lines.line("p", f"add i64 {index.value}, {k}").text for k in range(1, count))
        elements = [index, *map(Index, further)]
        with self._pass(replace(links, body=()), index, totals):
            self._joint = self._joint | together(links.body)
            scopes = [dict(self._values) for _ in elements]
            for inner in rows.links.body:
                for _ in self._elements(links.index, elements, scopes):
                    self._print((inner,))
            added = [
                [self._number(term) for _, term, _ in rows.added] for _ in self._elements(links.index, elements, scopes)
            ]
            for _ in self._elements(links.index, elements, scopes):
                self._values.update(zip(links.totals, totals, strict=True))
                self._print(rows.joining)
                totals = self._joined(links, totals)
            self._places.indices[links.index] = Index(index.value, int(count > 1))
            for (place, _, operation), terms in zip(rows.added, zip(*added, strict=True), strict=True):
                self._add(place, RULES[operation], terms)
        return totals

    def _elements(self, name: str, elements: Sequence[Index], scopes: Sequence[dict[str, Value]]) -> Iterator[None]:
        """Let an index be one element after the other, with values of its own."""
        for element, scope in zip(elements, scopes, strict=True):
            self._values, self._places.indices[name] = scope, element
            yield

    def _add(self, place: Place, add: Callable[..., LaneValue], terms: Sequence[LaneValue]) -> None:
        """Add what some elements get, or one, to their numbers: of one row after the other."""
        lines, kind = self._lines, self._lines.kind("n")
        if len(terms) > 1:
            total = self._places.load(place)
            for row in self._transposed(terms):
                total = add(total, row)
            self._places.store(place, total)
            return
        wide, lines.lanes = lines.lanes, 1
        total = self._places.load(place)
        for lane in range(wide):
            total = add(total, lines.line("n", f"extractelement {kind} {terms[0].text}, i64 {lane}"))
        self._places.store(place, total)
        lines.lanes = wide

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

    def _row(self, line: Loop, rows: LinkRows, block: Index, sums: str, own: Index, totals: list[Value]) -> list[Value]:
        """Print what is left of a row: links to elements of its block before its own."""
        links, lines = replace(rows.links, body=rows.whole), self._lines
        kept: list[Value] = []
        with self._pass(replace(line, body=rows.before), own, []):
            lane = lines.line("p", f"sub i64 {own.value}, {block.value}").text
            for k in range(len(links.totals)):
                place = lines.line("p", f"getelementptr double, ptr %{sums}, i64 {k * self._abreast}").text
                place = lines.line("p", f"getelementptr double, ptr {place}, i64 {lane}").text
                kept.append(lines.line("n", f"load double, ptr {place}, align 8"))
            new = self._inner(partial(self._made, links), str(block.value), str(own.value), kept)
            self._values.update(zip(links.totals, new, strict=True))
            self._print(rows.after)
        return totals


def _mask(lanes: Sequence[int]) -> str:
    return f"<{len(lanes)} x i32> <{', '.join(f'i32 {lane}' for lane in lanes)}>"
