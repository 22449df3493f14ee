"""A number rounded to the digits that its uncertainty justifies."""

from __future__ import annotations

import re
from math import inf, isfinite

from xdynamics.units.digits import UNESTIMATED, known_to, scientific, with_uncertainty

EXPANDED = 2.0  # coverage factor
FINELY = 1e-3  # of an interval: to which its ends are written where nothing else says how well they are known
_NUMBER = re.compile(r"\d+(\.\d+)?(e-?\d+)?")
_SCALED = re.compile(r"\(([-\d.]+) ± ([\d.]+)\)e(-?\d+)")


def rounded_result(value: float, standard: float, numerical: float, units: str, origin: str = "k = 2") -> str:
    """Write a value rounded to its expanded uncertainty (JCGM 100:2008, 7.2.6), and the numerical part separately.

    Parameters
    ----------
    value, standard : float
        The value and its standard uncertainty from all terms.
    numerical : float
        Sum of the numerical bounds.
    units : str
    origin : str
        Text on the coverage factor and the origin of the standard uncertainty.

    Examples
    --------
    >>> rounded_result(16.87412, 0.0061, 3.1e-9, "m")
    '16.874 ± 0.012 m (k = 2, numerical part 3e-9 m)'
    >>> rounded_result(-1234.5, 210.0, 0.0, "1")
    '-1230 ± 420 (k = 2, numerical part 0)'
    >>> rounded_result(16.87412, inf, inf, "m")
    '16.8741 m, of unknown uncertainty'
    """
    unit = "" if units == "1" else f" {units}"
    if standard == inf:
        return f"{value:.{UNESTIMATED}g}{unit}, of unknown uncertainty"
    expanded = EXPANDED * standard
    remark = f"{origin}, numerical part {short_size(numerical)}{unit}"
    if not (expanded > 0.0 and isfinite(expanded)):
        return f"{value!r}{unit} ({remark})"
    return f"{with_uncertainty(value, expanded)}{unit} ({remark})"


def drawn_interval(
    low: float, high: float, doubt: float, numerical: float, units: str, origin: str = "95 % of the draws"
) -> str:
    """Write a number as the interval that holds most draws of it, widened by its numerical part (JCGM 101:2008, 5.3).

    Parameters
    ----------
    low, high, doubt : float
        Ends of the interval, and how far each may be off.
    numerical : float
        Sum of the numerical bounds.
    units, origin : str
        As in `rounded_result`.

    Examples
    --------
    >>> drawn_interval(0.00612, 0.36391, 0.0021, 3.1e-9, "m")
    '0.006 to 0.364 m (95 % of the draws, numerical part 3e-9 m)'
    >>> drawn_interval(0.00612, 0.36391, inf, inf, "m")
    'of unknown uncertainty'
    """
    unit = "" if units == "1" else f" {units}"
    if not isfinite(numerical):
        return "of unknown uncertainty"
    end_doubt = doubt if 0.0 < doubt < inf else FINELY * (high - low)
    ends = (known_to(end, end_doubt) for end in (low - numerical, high + numerical))
    return f"{' to '.join(ends)}{unit} ({origin}, numerical part {short_size(numerical)}{unit})"


def short_size(value: float, digits: int = 1) -> str:
    """Write the size of an uncertainty or of a bound.

    Examples
    --------
    >>> short_size(3.1e-9), short_size(0.0061), short_size(12345.0, 2), short_size(0.00614, 2)
    ('3e-9', '0.006', '1.2e4', '0.0061')
    """
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    size_text = scientific(value, digits - 1)
    return size_text if not -3 <= int(size_text.partition("e")[2]) <= 3 else f"{float(size_text):g}"


def same_number(first: str, second: str) -> bool:
    """Whether two results say the same, though earlier versions wrote a small uncertainty with zeros.

    Examples
    --------
    >>> same_number("3.71119880 ± 0.00000053 s (k = 2)", "3.71119880 ± 5.3e-7 s (k = 2)")
    True
    >>> same_number("(9.87654321 ± 0.00000064)e12 m", "9.87654321e12 ± 6.4e5 m"), same_number("3.71 s", "3.72 s")
    (True, False)
    """
    normalised = [
        _NUMBER.sub(lambda number: repr(float(number[0])), _SCALED.sub(r"\1e\3 ± \2e\3", text))
        for text in (first, second)
    ]
    return normalised[0] == normalised[1]
