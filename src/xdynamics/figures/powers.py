"""Powers of ten of an axis: in its label, where nothing else lies, and not beside its ticks."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from xdynamics.figures.marks import superscript

POWER = re.compile(r"10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+ ?")
OFFSET = re.compile("1e([-\u2212]?[0-9]+)")  # as matplotlib writes a power alone
UNIT = re.compile(r" \(([^()]*)\)$")  # behind a label, and not an argument: E(0)
PLAIN = (-4, 5)  # powers from which to which numbers are written out: those of matplotlib


def fold_power(axis: Any) -> None:
    """Move the power of ten that all ticks of an axis share into its label: ``x (10⁻¹² m)``."""
    from matplotlib.ticker import ScalarFormatter

    formatter = axis.get_major_formatter()
    if not isinstance(formatter, ScalarFormatter):
        return
    low, high = sorted(axis.get_view_interval())
    formatter.set_locs([tick for tick in axis.get_majorticklocs() if low <= tick <= high])
    if not (match := OFFSET.fullmatch(formatter.get_offset())):  # none, or beside a number that is taken from all ticks
        return
    power = int(match[1].replace("\u2212", "-"))
    formatter.set_powerlimits((power, power))  # whichever ticks another size has
    axis.offsetText.set_visible(False)
    axis.set_label_text(with_power(axis.get_label_text(), power))


def with_power(label: str, power: int) -> str:
    """Return a label with a power of ten before its unit.

    Examples
    --------
    >>> with_power("x (m)", -12), with_power("E - E(0)", 7), with_power("", 7)
    ('x (10⁻¹² m)', 'E - E(0) (10⁷)', '10⁷')
    """
    ten = f"10{superscript(power)}"
    if match := UNIT.search(label):
        return f"{label[: match.start()]} ({ten} {match[1]})"
    return f"{label} ({ten})" if label else ten


def without_power(label: str) -> str:
    """Return a label as it was before, for axes that write numbers in their own way.

    Examples
    --------
    >>> without_power("x (10⁻¹² m)"), without_power("share (10⁷)"), without_power("x (m)")
    ('x (m)', 'share', 'x (m)')
    """
    return POWER.sub("", label).removesuffix(" ()")


def shared_power(values: Any) -> int:
    """Return the power of ten in which to write numbers of several axes; 0 where they are written out."""
    largest = float(np.abs(values).max(initial=0.0))
    power = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    return 0 if PLAIN[0] <= power < PLAIN[1] else power
