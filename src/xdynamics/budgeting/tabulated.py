"""Effects of the uncertainties of measured tables on a number: row by row, and of all rows together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import Measurand
from xdynamics.budgeting.sources import ErrorSource
from xdynamics.budgeting.term import COVERED, PHYSICAL, Term
from xdynamics.elementary.arrays import dot
from xdynamics.model.drives import Table
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.uncertainty import normal_quantile
from xdynamics.units import NUMBERS, coherent

Floats = NDArray[np.float64]

COMMON = "_common"  # suffix to the name of a table, for what is common to all rows
MAX_ROWS = 256  # with a slope for each
PAIRS, CONTROLS = 32, 4  # of drawn tables: where slopes do not suffice, and to check that they do
SLOPE_AGREEMENT = 0.02  # relative to a standard uncertainty, within which slopes count as exact
LEAST = 2.0**-54
SIGNS = np.array([1.0, -1.0])
PARTS = np.array([-1.0, -2.0 / 3.0, -1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])  # of a standard uncertainty
SIDE_WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 20.0  # of the sixth-order slope from these


def table_sources(measurand: Measurand) -> Iterator[ErrorSource]:
    """Yield the errors of measured tables with uncertainties: of their rows, and of all rows together."""
    for name, drive in measurand.model.drives.items():
        copies, table = TableCopies(measurand, name, drive.table), drive.table
        for suffix, term, sizes in (
            ("", independent_rows_term, table.uncertainty),
            (COMMON, common_term, table.common),
        ):
            if sizes is not None and sizes.any():
                call = partial(term, copies, sizes)
                yield ErrorSource.of_one(name + suffix, PHYSICAL, (), call, measurand.seed, unit=NUMBERS)


@dataclass(frozen=True)
class TableCopies:
    """Copies of a model that differ in one measured table.

    Attributes
    ----------
    measurand : Measurand
    name : str
        Name of the drive.
    table : Table
    """

    measurand: Measurand
    name: str
    table: Table

    def number(self, change: Floats) -> float:
        """March the model with its table changed by so much, SI; return the number."""
        model = self.measurand.model
        declared = SECTIONS["drives"].write(model.drives[self.name], model.time_unit)
        text = _table_text(self.table, self.table.value + change)
        drive_entries = {key: value for key, value in declared.items() if key not in ("column", "gaps")}
        changed = model.replace(drives={self.name: drive_entries | {"csv": text}})
        return self.measurand.number(changed, time_tolerance=self.measurand.sharp)

    def odd(self, change: Floats) -> float:
        """Return half the difference of the number between a change and its opposite."""
        return (self.number(change) - self.number(-change)) / 2.0


def independent_rows_term(copies: TableCopies, sizes: Floats) -> Term:
    """Return the term of independent rows: from the slope of each, where drawn tables agree with them.

    Otherwise, or with too many rows, it is the standard deviation over drawn tables, known as well as so few allow.
    """
    rows, unchanged_number = np.flatnonzero(sizes), copies.number(np.zeros(sizes.size))
    rng = np.random.default_rng(copies.measurand.seed)
    points = normal_quantile(np.maximum(rng.random((PAIRS, sizes.size)), LEAST))

    def drawn_changes(pairs: int) -> Floats:
        """Return the changes of the number with drawn tables, and with their opposites."""
        return np.array(
            [[copies.number(sign * point * sizes) - unchanged_number for sign in SIGNS] for point in points[:pairs]]
        )

    reason = f"{rows.size} rows are more than {MAX_ROWS}"
    if rows.size <= MAX_ROWS:
        effects = np.array([copies.odd(np.where(np.arange(sizes.size) == i, sizes, 0.0)) for i in rows.tolist()])
        standard = float(np.sqrt(np.sum(effects**2)))
        expected_changes = np.multiply.outer(dot(points[:CONTROLS, rows], effects), SIGNS)
        distance = float(np.sqrt(np.mean((drawn_changes(CONTROLS) - expected_changes) ** 2)))
        if distance <= standard / np.sqrt(2.0 * PAIRS):  # more accurate than draws
            relative_distance = distance / standard if standard else 0.0
            rule = (
                f"rows are independent: slopes by all {rows.size}; {2 * CONTROLS} tables with every row drawn are"
                f" {relative_distance:.1g} of it off"
            )
            doubt = distance if relative_distance > SLOPE_AGREEMENT else 0.0
            return Term(copies.name, PHYSICAL, standard, COVERED * standard, rule, standard_doubt=doubt)
        reason = f"it is not in proportion with the rows, by whose slopes it were {standard:.3g}"
    standard = float(np.sqrt(np.mean(drawn_changes(PAIRS) ** 2)))
    rule = f"rows are independent: {2 * PAIRS} tables with every row drawn from its uncertainty; {reason}"
    # of a linear effect both tables of a pair give the same
    return Term(
        copies.name, PHYSICAL, standard, COVERED * standard, rule, standard_doubt=standard / np.sqrt(2.0 * PAIRS)
    )


def common_term(copies: TableCopies, sizes: Floats) -> Term:
    """Return the term of what is common to all rows: one input, whose standard uncertainty moves the whole table.

    If every row has the same uncertainty, it is that one, with its unit; otherwise the input is a pure number with an
    uncertainty of 1.
    """
    numbers = np.array([copies.number(part * sizes) for part in PARTS])
    effect = float(dot(numbers, SIDE_WEIGHTS))
    doubt = abs(effect - float(numbers[-1] - numbers[0]) / 2.0)
    uniform = bool((sizes == sizes[0]).all())
    size, unit = (float(sizes[0]), coherent(copies.table.value_unit)) if uniform else (1.0, NUMBERS)
    rule = (
        "common to all rows: slope by central differences of sixth order over its uncertainty; over all of it"
        f" {doubt / abs(effect) if effect else 0.0:.1g} of the slope more or less"
    )
    return Term(
        copies.name + COMMON,
        PHYSICAL,
        abs(effect),
        COVERED * (abs(effect) + doubt),
        rule,
        effect / size,
        size,
        unit,
        doubt / size,
    )


def _table_text(table: Table, values: Floats) -> str:
    """Write a table with other values, in its own units."""
    factors = [float(unit.factor) for unit in (table.argument_unit, table.value_unit)]
    head = f"argument [{table.argument_unit.text}],value [{table.value_unit.text}]"
    rows = (
        f"{x!r},{y!r}"
        for x, y in zip((table.argument / factors[0]).tolist(), (values / factors[1]).tolist(), strict=True)
    )
    return "\n".join([head, *rows, ""])
