"""Runs beside bounds that are proven: of motions without a closed form, as near as the order of a method promises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.enclosing.enclosure import enclosure_request
from xdynamics.evidence.enclosing.enclosure_dataset import COMPLETED
from xdynamics.evidence.stage_tasks import remembered
from xdynamics.evidence.validating.case_runs import NEAR, ORDER_AT_MOST, CaseRuns
from xdynamics.evidence.validating.ledger_rows import LedgerRow
from xdynamics.evidence.validating.worst_elements import MOST_ALONE, of_worst
from xdynamics.kernels.layout import layout_of
from xdynamics.march.outcomes import GOOD
from xdynamics.model import Model
from xdynamics.model.closed_forms import ORDER
from xdynamics.record.named_elements import get_column
from xdynamics.schema import AT_TIME, bounds_of
from xdynamics.shapes.blocks import Block

if TYPE_CHECKING:
    import xarray as xr

Rows = NDArray[np.int64]
Floats = NDArray[np.float64]

RELATION = "proven bounds"
PARTS = 8  # of the span of a run, at whose ends it is compared: at one time alone an error may pass zero


def rows_of_bounds(model: Model, method: str, prefix: str, stage: int) -> list[LedgerRow]:
    """Return the lines as far as they are known before anything is marched or proven: of many elements one together."""
    where, norm = f"accepted states at eighths of the time to {model.run.get('until', 'the end')}", "largest distance"
    names: list[tuple[str, int]] = []
    for block in layout_of(model).used.blocks:
        names += [(block.name, block.size)] if block.size > MOST_ALONE else [(name, 1) for name in block.elements()]
    row = LedgerRow("", method, stage, RELATION, "", where, ORDER, norm=f"{norm} from the bounds")
    return [replace(row, name=f"{prefix}{name}", observable=name, elements=size) for name, size in names]


def beside_bounds(runs: CaseRuns, prefix: str, stage: int) -> Iterator[LedgerRow]:
    """Yield a line for each coordinate, velocity and state of a model's run, or the worst of many elements of one.

    The bound is that of `order`: how far the run with twice the step is outside, over 2**(p - 1/2), and rounding.
    """
    rows = rows_of_bounds(runs.model, runs.method.name, prefix, stage)
    if runs.refused:
        yield from (replace(row, note=f"the method refuses: {'; '.join(runs.refused)}") for row in rows)
        return
    start = float(runs.model.statement.initial["t"].si)
    times = [start + (runs.end - start) * k / PARTS for k in range(1, PARTS)]
    tube: xr.Dataset = remembered(enclosure_request(runs.model, at=[*times, runs.end]).task())
    if tube.attrs["outcome"] != COMPLETED:
        yield from (replace(row, note=str(tube.attrs["outcome_text"])) for row in rows)
        return
    yield from (_bounded_row(row, runs, tube) for row in rows)


def _bounded_row(row: LedgerRow, runs: CaseRuns, tube: xr.Dataset) -> LedgerRow:
    """Return a line with its residual, bound and scale."""
    run, name = runs.run, row.observable
    row = replace(row, units=str(get_column(run, name).attrs["units"]), run=runs.digest)
    if run.attrs["run_outcome"] not in GOOD or float(run["time"][-1]) != runs.end:
        why = f"the run ended before: {run.attrs['run_outcome_text']}"
        return replace(row, residual=np.inf, bound=0.0, note=why)
    common = np.flatnonzero((_rows_at(run, tube) >= 0) & (_rows_at(runs.coarse, tube) >= 0))
    values, high = get_column(run, name).values, get_column(tube, bounds_of(name)[1]).values
    largest_value, scale = (np.max(np.abs(numbers), axis=0) for numbers in (values, high))
    halved = _distance_outside(runs.coarse, name, tube, common) / runs.by_order
    bound = np.minimum(halved, ORDER_AT_MOST * largest_value) + runs.rounding_of(name)
    block = Block.from_shapes(name, "", runs.model.shapes)
    return of_worst(row, block, _distance_outside(run, name, tube, common), bound, scale)


def _rows_at(run: xr.Dataset, tube: xr.Dataset) -> Rows:
    """Return the rows of a run that are at the times of a tube; -1 where it has none."""
    accepted, times = run["time"].values, tube[AT_TIME].values
    near = NEAR * (accepted[-1] - accepted[0])
    rows = np.searchsorted(accepted, times + near, side="right") - 1
    return np.where(np.abs(accepted[rows] - times) <= near, rows, -1)


def _distance_outside(run: xr.Dataset, name: str, tube: xr.Dataset, common: Rows) -> Floats:
    """Return the largest distance of each element of a run from the bounds, at some of their times; 0 within."""
    values = get_column(run, name).values[_rows_at(run, tube)[common]]
    low, high = (get_column(tube, bound).values[common] for bound in bounds_of(name))
    distances: Floats = np.max(np.maximum(np.maximum(low - values, values - high), 0.0), axis=0)
    return distances
