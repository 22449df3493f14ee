"""What else a record has of the step to a row: Newton iterations, and how far lengths of quaternions were off."""

from __future__ import annotations

from xdynamics import schema
from xdynamics.kernels import Layout
from xdynamics.record.column import Column, take_row


def effort_columns(layout: Layout) -> list[Column]:
    """Return the columns of what a step took and of what was put right after it."""
    collected = []
    if layout.deviations:
        collected.append(Column(schema.DEVIATION, take_row(layout.row.offset_of(schema.DEVIATION.name), 1.0)))
    if layout.effort:
        index = layout.row.offset_of(layout.effort[0])
        collected.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return collected
