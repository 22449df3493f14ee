"""What does not change within a step of a proof: the regime, and the pieces of measured tables that a time is in.

A piece is a polynomial, the one that runs look up: its origin and its coefficients are floats, and count as what they are.
So do the points of tables, on which steps land.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Operand
from xdynamics.model import Model
from xdynamics.model.drive_arguments import Table
from xdynamics.model.motion import drive_pieces
from xdynamics.tubes.boxes import Floats

HELD = "tables"  # the array that lines read them from: the regime, then of each table origin and coefficients
REGIME = Location("at", AT.index("regime"))
ROWS = 5  # of a table


@dataclass(frozen=True)
class StepConstants:
    """The tables that a motion looks up at a time.

    Attributes
    ----------
    tables : mapping of str to (ndarray, ndarray)
        Origins and coefficients of pieces, by drive.
    """

    tables: dict[str, Table]

    @classmethod
    def of_model(cls, model: Model) -> StepConstants:
        """Return those of a model whose drives are all of time."""
        return cls(dict(zip(model.drives, drive_pieces(model), strict=True)) if model.drives else {})

    @property
    def nodes(self) -> Floats:
        """The times at which a piece ends and another begins, ascending, s."""
        times = [origins[np.isfinite(origins)] for origins, _ in self.tables.values()]
        return np.unique(np.concatenate(times)) if times else np.empty(0)

    def values_from(self, regime: float, time: float) -> Floats:
        """Return what holds from a time on."""
        step_values = [np.array([regime])]
        for origins, powers in self.tables.values():
            piece = int(np.searchsorted(origins[1:], time, side="right"))
            step_values.append(np.append(origins[piece], powers[:, piece]))
        return np.concatenate(step_values)

    def lacking(self, step_values: Floats) -> str:
        """Say which table has no value; empty if all have."""
        for i, name in enumerate(self.tables):
            if np.isnan(step_values[1 + ROWS * i : 1 + ROWS * (i + 1)]).any():
                return f"the table of drive '{name}' goes no further, and its outside is \"error\""
        return ""


def with_pieces(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines that read from `HELD` what does not change within a step, and evaluate pieces of tables there.

    Parameters
    ----------
    lines : iterable of Line
        Whose tables are all of time.
    """
    for line in lines:
        match line:
            case Load() if line.location == REGIME:
                yield Load(line.target, Location(HELD, 0))
            case Compute(operation="piece_of"):
                continue
            case Compute(target, "value_at" | "slope_at" as operation, (time_operand, _, drive)):
                yield from _polynomial(target, time_operand, int(drive), sloped=operation == "slope_at")
            case _:
                yield line


def _polynomial(target: str, time_operand: Operand, drive: int, *, sloped: bool) -> Iterator[Line]:
    """Yield the value of a piece, or its slope, by Horner's rule."""
    row = [f"{target}.{name}" for name in ("origin", "cubic", "square", "slope", "value")]
    yield from (Load(name, Location(HELD, 1 + ROWS * drive + k)) for k, name in enumerate(row))
    since = f"{target}.since"
    yield Compute(since, "subtract", (time_operand, row[0]))
    factors, total = ((3.0, 2.0, 1.0) if sloped else (1.0, 1.0, 1.0, 1.0)), ""
    for k, factor in enumerate(factors):
        term: Operand = row[1 + k]
        last = k == len(factors) - 1
        if factor != 1.0:
            term = f"{target}.times{k}"
            yield Compute(term, "multiply", (factor, row[1 + k]))
        if total:
            yield Compute(f"{target}.way{k}", "multiply", (total, since))
            total = target if last else f"{target}.sum{k}"
            yield Compute(total, "add", (f"{target}.way{k}", term))
        else:
            total = str(term)
