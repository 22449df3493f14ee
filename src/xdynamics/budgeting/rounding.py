"""A number rounded to the digits that its uncertainty justifies."""

from __future__ import annotations

from math import floor, isfinite, log10

EXPANDED = 2.0  # coverage factor
DIGITS = 2  # of the uncertainty


def rounded(value: float, standard: float, numerical: float, units: str, origin: str = "k = 2") -> str:
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
    >>> rounded(16.87412, 0.0061, 3.1e-9, "m")
    '16.874 ± 0.012 m (k = 2, numerical part 3e-9 m)'
    >>> rounded(-1234.5, 210.0, 0.0, "1")
    '-1230 ± 420 (k = 2, numerical part 0)'
    """
    unit = "" if units == "1" else f" {units}"
    expanded = EXPANDED * standard
    remark = f"{origin}, numerical part {_short(numerical)}{unit}"
    if not (expanded > 0.0 and isfinite(expanded)):
        return f"{value!r}{unit} ({remark})"
    size = float(f"{expanded:.{DIGITS - 1}e}")
    places = DIGITS - 1 - floor(log10(size))
    if abs(value) and not -4 <= floor(log10(abs(value))) <= 8:
        power = floor(log10(abs(value)))
        return (
            f"({_fixed(value / 10.0**power, places + power)} ±"
            f" {_fixed(size / 10.0**power, places + power)})e{power}{unit} ({remark})"
        )
    return f"{_fixed(value, places)} ± {_fixed(size, places)}{unit} ({remark})"


def _fixed(value: float, places: int) -> str:
    return f"{round(value, places):.{max(places, 0)}f}"


def _short(value: float) -> str:
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    digits, power = f"{value:.0e}".split("e")
    return f"{digits}e{int(power)}" if not -3 <= int(power) <= 3 else f"{float(f'{value:.0e}'):g}"
