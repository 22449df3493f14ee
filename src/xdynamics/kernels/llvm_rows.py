"""Rows of links to all elements before one, as LLVM text: the rows of neighbouring elements side by side.

Every two elements meet once. What a link gives to the row's own element is added in its lane; what it gives to the other
is added for one row after the other, so that each sum is ascending, as in plain loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from xdynamics.elementary.llvm_numbers import LaneValue
from xdynamics.elementary.numbers import choose
from xdynamics.kernels.link_rows import LinkRows, link_rows
from xdynamics.kernels.llvm_loops import LoopText, Value, rebuild_value, value_parts
from xdynamics.kernels.llvm_places import Index
from xdynamics.kernels.operations import RULES
from xdynamics.kernels.program import Loop

FEWEST = 4  # rows side by side: exchanging rows and lanes costs what fewer gain


class RowText(LoopText):
    """Prints loops, and those over every two elements by several rows at once."""

    def _print_loop(self, line: Loop) -> None:
        rows, lanes = link_rows(line) if self._may_go_abreast() else None, self._abreast
        while line.count < 2 * lanes:
            lanes //= 2
        if rows is None or lanes < FEWEST or self._into_row(line):
            super()._print_loop(line)
        else:
            self._abreast, lanes = lanes, self._abreast
            self._print_rows(line, rows)
            self._abreast = lanes

    def _print_rows(self, line: Loop, rows: LinkRows) -> None:
        """Print as many rows at once as there are lanes: blocks that end at the last row, of which the first may be short."""
        wide, first = self._abreast, line.count % self._abreast
        self._kept = f"{self._lines.label()}kept"
        self._stack.append(f"%{self._kept} = alloca double, i64 {len(rows.added) * wide * wide}, align 64")
        self._dynamic_passes(partial(self._print_block, line, rows), str(first or wide), str(line.count + 1), [], wide)

    def _print_block(self, line: Loop, rows: LinkRows, end: Index, _: list[Value]) -> list[Value]:
        """Print the links of the rows before an end to the elements up to their own, as many at once as there are rows.

        A short block has lanes for rows that are not its own: those have no links yet, and are set again by their block.
        """
        wide, first, lines = self._abreast, line.count % self._abreast, self._lines
        begin = self._block_begin(end, first)
        with self._side_by_side(wide), self._pass_scope(replace(line, body=rows.lines_before), Index(begin, 1), []):
            row_numbers, beyond = (lines.broadcast("w", text) for text in (begin, f"{end.value}"))
            row_numbers = row_numbers + self._lanes()
            row_numbers = choose(row_numbers < beyond, row_numbers, 0)
            last = lines.line("p", f"add i64 {end.value}, 1").text
            starts = [self._operand_value(start) for start in rows.links.starts]
            self._dynamic_passes(partial(self._tile, rows, row_numbers, first), str(first or wide), last, starts, wide)
        return []

    def _block_begin(self, end: Index, first: int) -> str:
        """Return where the elements before an end begin, as many as there are lanes; the first are fewer, and begin at 0."""
        begin = self._lines.line("p", f"sub i64 {end.value}, {self._abreast}").text
        if not first:
            return begin
        short = self._lines.line("t", f"icmp ult i64 {end.value}, {self._abreast}").text
        return self._lines.line("p", f"select i1 {short}, i64 0, i64 {begin}").text

    def _tile(self, rows: LinkRows, row_numbers: LaneValue, first: int, end: Index, totals: list[Value]) -> list[Value]:
        """Print links of a block to the elements before an end; return the sums of its rows.

        What they find for elements beyond the end, or not before the row's own, is not added.
        """
        lines, wide, begin = self._lines, self._abreast, self._block_begin(end, first)
        beyond = lines.broadcast("w", f"{end.value}")
        bound = choose(row_numbers < beyond, row_numbers, beyond) - lines.broadcast("w", begin)

        def print_element(element: Index, totals: list[Value]) -> list[Value]:
            lane = lines.line("p", f"sub i64 {element.value}, {begin}").text
            with self._pass_scope(rows.links, element, totals):
                for k, (_, term, _) in enumerate(rows.added):
                    where = self._kept_at(str(k * wide), lane)
                    self._append_text(f"store {lines.kind('n')} {self._lane_number(term).text}, ptr {where}, align 64")
                new_totals = self._join_terms(rows.links, totals)
                return self._select_totals(bound > lines.broadcast("w", lane), new_totals, totals)

        last = lines.line("p", f"add i64 {begin}, {wide}").text
        totals = self._dynamic_passes(print_element, begin, last, totals)
        with self._pass_scope(replace(rows.links, body=rows.lines_after), Index(begin, 1), totals):
            self._add(rows, bound)
        return totals

    def _kept_at(self, first: str, lane: str) -> str:
        """Return where the numbers of a row of lanes wait."""
        number = self._lines.line("p", f"add i64 {first}, {lane}").text
        far = self._lines.line("p", f"mul i64 {number}, {self._abreast}").text
        return self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {far}").text

    def _kept_row(self, number: int) -> LaneValue:
        """Return the numbers that wait in a row of lanes."""
        where = self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {number * self._abreast}").text
        return self._lines.line("n", f"load {self._lines.kind('n')}, ptr {where}, align 64")

    def _add(self, rows: LinkRows, bound: LaneValue) -> None:
        """Add what the elements of a tile get to their numbers: of one row after the other, up to its bound."""
        wide, lines = self._abreast, self._lines
        for k, (location, _, operation) in enumerate(rows.added):
            total = self._places.load(location)
            for lane, row in enumerate(self._transposed([self._kept_row(k * wide + lane) for lane in range(wide)])):
                of_row = lines.line("p", f"extractelement {lines.kind('w')} {bound.text}, i64 {lane}").text
                more = RULES[operation](total, row)
                total = choose(self._lanes() < lines.broadcast("w", of_row), more, total)
            self._places.store(location, total)

    def _lanes(self) -> LaneValue:
        """Return the number of each lane."""
        return LaneValue(self._lines, "w", f"<{', '.join(f'i64 {lane}' for lane in range(self._abreast))}>")

    def _select_totals(self, truth: LaneValue, new: list[Value], old: list[Value]) -> list[Value]:
        """Return new sums, or in lanes where a truth does not hold old ones."""
        return [
            rebuild_value(
                old_total,
                [choose(truth, *pair) for pair in zip(value_parts(new_total), value_parts(old_total), strict=True)],
            )
            for old_total, new_total in zip(old, new, strict=True)
        ]

    def _transposed(self, rows: Sequence[LaneValue]) -> list[LaneValue]:
        """Exchange rows and lanes of a square of numbers."""
        square, far, kind = list(rows), 1, self._lines.kind("n")
        while far < len(square):
            masks = [
                [lane - far + len(square) if lane & far else lane for lane in range(len(square))],
                [lane + len(square) if lane & far else lane + far for lane in range(len(square))],
            ]
            for k in (k for k in range(len(square)) if not k & far):
                first, second = square[k], square[k + far]
                square[k], square[k + far] = (
                    self._lines.line("n", f"shufflevector {kind} {first.text}, {kind} {second.text}, {_mask(mask)}")
                    for mask in masks
                )
            far *= 2
        return square


def _mask(lanes: Sequence[int]) -> str:
    return f"<{len(lanes)} x i32> <{', '.join(f'i32 {lane}' for lane in lanes)}>"
