"""Numbers in sentences and figures, rounded to the digits that their uncertainty supports.

Records keep all digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import ceil, floor, inf, isfinite, log10

MOST = 15  # digits that every double holds
UNKNOWN = 1e-9  # part of a number that its error is taken for, where nothing estimates it
UNESTIMATED = 6  # digits of a number whose uncertainty nobody estimated
OF_DOUBT = 2  # digits of an uncertainty
LEAST, GREATEST = -4, 8  # powers of ten that are written without one
SMALLER = 3  # powers of ten from a number down to an uncertainty that zeros would hide
REACHED = 0.1  # of the relative uncertainty of an input: what is taken to reach a number that follows from it


def digits(value: float, *, uncertainty: float = 0.0, relative: float = 0.0, spacing: float = inf) -> int:
    """Return how many significant digits of a number to write.

    So many that rounding to them moves it by less than half its uncertainty, the larger of `uncertainty` and `relative` times its size; never
    fewer than distinguish it from another number that is `spacing` away.

    Examples
    --------
    >>> digits(3.71119918, uncertainty=0.002), digits(3.71119918, relative=1e-6), digits(3.71119918, spacing=1e-7)
    (5, 7, 9)
    """
    size, doubt = abs(value), max(uncertainty, relative * abs(value))
    if not isfinite(value) or size == 0.0:
        return 1
    needed = [ceil(log10(size / resolution)) + 1 for resolution in (doubt, spacing) if 0.0 < resolution < inf]
    return min(MOST, max(1, *needed)) if needed else MOST


def known_part(tolerance: float | None, inputs: Iterable[tuple[float, float]]) -> float:
    """Return the relative uncertainty that a run leaves in its numbers.

    Parameters
    ----------
    tolerance : float, optional
        The relative tolerance of its steps; without one their error is not known.
    inputs : iterable of (float, float)
        Value and standard uncertainty of every uncertain parameter and start: of those the best known counts, as how much
        each moves a number is what a budget tells.
    """
    parts = [REACHED * doubt / abs(value) for value, doubt in inputs if value and doubt > 0.0]
    return max(UNKNOWN if tolerance is None else tolerance, min(parts, default=0.0))


def with_uncertainty(value: float, uncertainty: float, digit_count: int = OF_DOUBT) -> str:
    """Write a number and its uncertainty, both to the same decimal place (JCGM 100:2008, 7.2.6).

    Brackets, as in 3.71119880(53), are for standard uncertainties alone (7.2.2), so that a small one is written with its power of ten.

    Parameters
    ----------
    value, uncertainty : float
    digit_count : int
        Digits of the uncertainty.

    Examples
    --------
    >>> with_uncertainty(0.000294891463964, 7e-5), with_uncertainty(3.7111988, 5.3e-7)
    ('0.000295 ± 0.000070', '3.71119880 ± 5.3e-7')
    >>> with_uncertainty(-1234.5, 420.0), with_uncertainty(1.234e-6, 1.51e-7), with_uncertainty(-1e-15, 9.2e-12)
    ('-1230 ± 420', '(1.23 ± 0.15)e-6', '(0.0 ± 9.2)e-12')
    >>> with_uncertainty(2.0, 0.0), with_uncertainty(0.5, inf), with_uncertainty(-inf, 0.1)
    ('2 ± 0', '0.5 ± inf', '-inf')
    """
    if not isfinite(value):
        return f"{value:g}"
    if not (isfinite(uncertainty) and uncertainty > 0.0):
        return f"{value:.{UNESTIMATED}g} ± {uncertainty:.{digit_count}g}"
    size = float(f"{uncertainty:.{digit_count - 1}e}")
    places, power = digit_count - 1 - floor(log10(size)), floor(log10(max(abs(value), size)))
    below = floor(log10(size))
    if places + power >= MOST:  # digits that no double has
        return f"{value:.{MOST}g} ± {scientific(size, digit_count - 1)}"
    if LEAST <= power <= GREATEST:
        small = below < LEAST and power - below >= SMALLER
        return f"{_fixed_places(value, places)} ± {scientific(size, digit_count - 1) if small else _fixed_places(size, places)}"
    if below - power < LEAST:
        return f"{scientific(value, places + power)} ± {scientific(size, digit_count - 1)}"
    scaled = (_fixed_places(number / 10.0**power, places + power) for number in (value, size))
    return f"({' ± '.join(scaled)})e{power}"


def uncertainty_alone(size: float, digit_count: int = OF_DOUBT) -> str:
    """Write an uncertainty whose number stands elsewhere: with the digits that it has beside one, or all, if it has fewer.

    Examples
    --------
    >>> uncertainty_alone(0.0013462), uncertainty_alone(1343.0), uncertainty_alone(4.06e-11), uncertainty_alone(0.02)
    ('0.0013', '1300', '4.1e-11', '0.02')
    """
    if not (isfinite(size) and size > 0.0):
        return f"{size:g}"
    digit_count = 1 if float(f"{size:.0e}") == size else digit_count
    rounded = float(f"{size:.{digit_count - 1}e}")
    power = floor(log10(rounded))
    return (
        _fixed_places(rounded, digit_count - 1 - power)
        if LEAST <= power <= GREATEST
        else scientific(rounded, digit_count - 1)
    )


def short_number(value: float, relative: float = 0.0) -> str:
    """Write a number that no uncertainty was estimated of: six digits at most, fewer where a relative uncertainty leaves fewer.

    Examples
    --------
    >>> short_number(13.70902678), short_number(13.70902678, 1e-3)
    ('13.709', '13.71')
    >>> short_number(13.70902678, 1e-2), short_number(0.0)
    ('13.7', '0')
    """
    return f"{value:.{min(UNESTIMATED, digits(value, relative=relative))}g}"


def known_to(value: float, uncertainty: float) -> str:
    """Write a number alone, its last digit at the decimal place of its uncertainty's first digit.

    Examples
    --------
    >>> known_to(0.879488222, 0.0031), known_to(-1234.5, 20.0), known_to(1.5, 0.0), known_to(1.0843e-6, 2e-9)
    ('0.879', '-1230', '1.5', '1.084e-6')
    """
    if not (isfinite(value) and isfinite(uncertainty) and uncertainty > 0.0):
        return f"{value:.{UNESTIMATED}g}"
    places = -floor(log10(uncertainty))
    if value and floor(log10(abs(value))) < LEAST:
        return scientific(value, max(places + floor(log10(abs(value))), 0))
    return _fixed_places(value, places)


def scientific(value: float, places: int) -> str:
    """Write a number with a power of ten and so many decimal places, the power without zeros before it.

    Examples
    --------
    >>> scientific(5.34e-7, 1), scientific(-12345.0, 2)
    ('5.3e-7', '-1.23e4')
    """
    number, power = f"{value:.{places}e}".split("e")
    return f"{number}e{int(power)}"


def _fixed_places(value: float, places: int) -> str:
    """Write a number rounded to decimal places, left of the point where they are negative; zero has no sign."""
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"


def aligned_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield a table in lines: a header and rows of words, each column as wide as its longest.

    Examples
    --------
    >>> [*aligned_table(("term", "size"), [("truncation", "1 m"), ("g", "0.2 m")])]
    ['term        size', 'truncation  1 m', 'g           0.2 m']
    """
    table = [header, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table if len(table) > 1 else ():
        yield "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
