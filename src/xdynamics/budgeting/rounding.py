"""A number rounded to the digits that its uncertainty justifies."""

from __future__ import annotations

from math import isfinite

from xdynamics.units.digits import with_uncertainty

EXPANDED = 2.0  # coverage factor


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
    return f"{with_uncertainty(value, expanded)}{unit} ({remark})"


def _short(value: float) -> str:
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    digits, power = f"{value:.0e}".split("e")
    return f"{digits}e{int(power)}" if not -3 <= int(power) <= 3 else f"{float(f'{value:.0e}'):g}"
