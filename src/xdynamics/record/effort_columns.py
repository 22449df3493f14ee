"""What else a record has of the step to a row: Newton iterations, and how far lengths of quaternions were off."""

from __future__ import annotations

from xdynamics import schema
from xdynamics.kernels import Layout
from xdynamics.record.column import Column, row_of


def effort_columns(layout: Layout) -> list[Column]:
    """Return the columns of what a step took and of what was put right after it."""
    found = []
    if layout.deviations:
        found.append(Column(schema.DEVIATION, row_of(layout.row.place(schema.DEVIATION.name), 1.0)))
    if layout.effort:
        index = layout.row.place(layout.effort[0])
        found.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return found
