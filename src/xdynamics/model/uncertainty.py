"""Uncertainty of the numbers of a model: standard uncertainties, bounds, distributions, correlations."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import FUNCTIONS
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.table_keys import read_choice
from xdynamics.units import Quantity, Scale, parse_quantity, parse_unit, unit_text

NORMAL, RECTANGULAR, TRIANGULAR, ARCSINE, STUDENT = "normal", "rectangular", "triangular", "arcsine", "t"
DISTRIBUTIONS = (NORMAL, RECTANGULAR, TRIANGULAR, ARCSINE, STUDENT)
# half widths of bounded distributions, in standard deviations (JCGM 101:2008, 6.4.2 to 6.4.6)
HALF_WIDTHS = {RECTANGULAR: sqrt(3.0), TRIANGULAR: sqrt(6.0), ARCSINE: sqrt(2.0)}
SIZES = ("uncertainty", "half_width")

_BETWEEN = re.compile(r"±|\+/-|\+-")
_LAST_DIGITS = re.compile(r"\s*([+-]?\d+(?:\.\d+)?)\((\d+)\)([^()]*)")
_SCALED = re.compile(r"\s*\(\s*([^()\s]+)\s*(?:±|\+/-|\+-)\s*([^()\s]+)\s*\)([^()]*)")
_PERCENT = re.compile(r"([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(?:%|percent\b)\s*(.*)")
_PERCENTS = ("%", "percent")
NOTHING = 1e-12  # a remaining variance that counts as zero

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """How a number is distributed about its value.

    Attributes
    ----------
    size : Quantity
        As specified: the standard uncertainty, or half the width between the bounds.
    distribution : {"normal", "rectangular", "triangular", "arcsine", "t"}
    bounded : bool
        Whether the size is half a width.
    degrees_of_freedom : float, optional
        Of Student's t, over 2. Its standard deviation is the standard uncertainty; a mean of n readings has
        s/sqrt(n) times sqrt((n - 1)/(n - 3)) (JCGM 101:2008, 6.4.9).
    """

    size: Quantity
    distribution: str = NORMAL
    bounded: bool = False
    degrees_of_freedom: float | None = None

    @property
    def standard(self) -> Quantity:
        """The standard uncertainty, in the unit of the size."""
        factor = HALF_WIDTHS[self.distribution] if self.bounded else 1.0
        return Quantity(self.size.value / factor, self.size.unit)

    def quantiles(self, points: Floats) -> Floats:
        """Return the quantiles of probabilities between 0 and 1, in standard uncertainties from the value.

        For all but Student's t, which is scipy's, the arithmetic is the same on every machine.
        """
        if self.distribution == RECTANGULAR:
            return HALF_WIDTHS[RECTANGULAR] * (2.0 * points - 1.0)
        if self.distribution == TRIANGULAR:
            off = 1.0 - np.sqrt(2.0 * np.minimum(points, 1.0 - points))
            return HALF_WIDTHS[TRIANGULAR] * np.where(points < 0.5, -off, off)
        if self.distribution == ARCSINE:
            sine: Floats = FUNCTIONS["sin"](np.pi * (points - 0.5))
            return HALF_WIDTHS[ARCSINE] * sine
        if self.degrees_of_freedom is not None:
            from scipy import special

            quantile: Floats = special.stdtrit(self.degrees_of_freedom, points)
            return quantile * sqrt(1.0 - 2.0 / self.degrees_of_freedom)
        return normal_quantile(points)


@dataclass(frozen=True)
class Discrepancy:
    """The error in a quantity due to the approximations of the model, as declared by its author."""

    standard: Quantity
    description: str = ""


def is_uncertain(text: str) -> bool:
    """Whether a quantity is written with its uncertainty."""
    return any(
        match is not None for match in (_LAST_DIGITS.fullmatch(text), _SCALED.fullmatch(text), _BETWEEN.search(text))
    )


def split_uncertainty(text: Any) -> tuple[str, str] | None:
    """Split a quantity with its standard uncertainty into both: as `show` prints them, or its last digits in brackets (JCGM 100:2008, 7.2.2).

    Raises
    ------
    InputError
        If the uncertainty is not a quantity.

    Examples
    --------
    >>> split_uncertainty("50 ± 0.5 g"), split_uncertainty("50 g ± 500 mg"), split_uncertainty("(1.23 ± 0.15)e-6 kg")
    (('50 g', '0.5 g'), ('50 g', '500 mg'), ('1.23e-6 kg', '0.15e-6 kg'))
    >>> split_uncertainty("100 N/m ± 5 %"), split_uncertainty("100 ± 5% N/m")
    (('100 N/m', '5 N/m'), ('100 N/m', '5 N/m'))
    >>> split_uncertainty("6.67430(15)e-11 m3 kg-1 s-2")
    ('6.67430e-11 m3 kg-1 s-2', '0.00015e-11 m3 kg-1 s-2')
    """
    if not isinstance(text, str):
        return None
    if match := _LAST_DIGITS.fullmatch(text):
        number, digits, unit_suffix = match.groups()
        places = len(number.partition(".")[2])
        digits = digits.zfill(places + 1)
        cut = len(digits) - places
        return number + unit_suffix, f"{digits[:cut]}.{digits[cut:]}".rstrip(".") + unit_suffix
    if match := _SCALED.fullmatch(text):
        value, size, unit_suffix = match.groups()
        return value + unit_suffix, size + unit_suffix
    if (match := _BETWEEN.search(text)) is None:
        return None
    value, size = text[: match.start()].strip(), text[match.end() :].strip()
    if relative := _PERCENT.fullmatch(size):
        return _of_percent(value, *relative.groups())
    parse_quantity(size)
    return value if unit_text(value) else f"{value} {unit_text(size) or 1}", size


def _of_percent(value: str, percent: str, unit_suffix: str) -> tuple[str, str]:
    """Return a value and its uncertainty, which is given as a part of it: ``100 N/m ± 5 %``, ``100 ± 5 % N/m``.

    Raises
    ------
    InputError
        If both have a unit, or neither, of which percent may then be one.
    """
    number, unit = value.removesuffix(unit_text(value)).strip(), unit_text(value)
    if unit in _PERCENTS and not unit_suffix:  # both are in percent
        return value, f"{percent} {unit}"
    given = unit or unit_suffix
    try:
        half = abs(Decimal(number) * Decimal(percent) / 100)
    except InvalidOperation:
        raise InputError(f"{value!r} ± {percent} % has no number that percent could be of") from None
    if (unit and unit_suffix) or not given:
        example = f"{value} ± {percent} %" if given else f"{value} ± {half.normalize():f}"
        problem = "has two units" if given else "has no unit, and may mean percent of it, or in percent"
        raise InputError(f"'{value} ± {percent} % {unit_suffix}'".replace(" '", "'") + f" {problem}; write '{example}'")
    parse_unit(given)  # a scale with another zero has no part
    return f"{number} {given}", f"{half} {given}"


def read_spread(entry: Mapping[str, Any], value: Quantity, scale: Scale | None = None) -> Spread | None:
    """Read the spread of an entry, if it has one; a bare size is on the scale of the value, else in its unit.

    Raises
    ------
    InputError
        If its keys contradict each other, or its unit is not that of the value.
    """
    sizes = [key for key in SIZES if key in entry]
    if not sizes:
        if "distribution" in entry or "degrees_of_freedom" in entry:
            raise InputError("has a distribution, and no uncertainty or half_width that says how wide it is")
        return None
    if len(sizes) > 1:
        raise InputError("has an uncertainty and a half_width; write one: the other follows from the distribution")
    bounded = sizes == ["half_width"]
    distribution = read_choice(
        entry.get("distribution", RECTANGULAR if bounded else NORMAL), "distribution", DISTRIBUTIONS
    )
    if bounded and distribution not in HALF_WIDTHS:
        raise InputError(f"half_width: a distribution that is {distribution} has no bounds; write its uncertainty")
    size = _read_spread_size(entry[sizes[0]], sizes[0], value, scale or Scale(value.unit))
    return Spread(size, distribution, bounded, _freedom(entry, distribution))


def _read_spread_size(entry: Any, key: str, value: Quantity, scale: Scale) -> Quantity:
    try:
        size = parse_quantity(entry, difference=True)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None
    if size.unit.text == "1":
        size = Quantity(scale.difference(size.value), value.unit)
    if size.value < 0:
        raise InputError(f"{key} {entry!r} needs to be non-negative")
    if size.unit.dimension != value.unit.dimension:
        raise InputError(f"{key} is in '{size.unit.dimension}', the value in '{value.unit.dimension}'")
    return size


def _freedom(entry: Mapping[str, Any], distribution: str) -> float | None:
    value = entry.get("degrees_of_freedom")
    if distribution != STUDENT:
        if value is not None:
            raise InputError(
                f"degrees_of_freedom is {brief_repr(value)}; a distribution that is {distribution} has none"
            )
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 2 < value < float("inf"):
        raise InputError(
            f"degrees_of_freedom is {brief_repr(value)}; a t distribution needs a number over 2, or has no deviation"
        )
    return float(value)


def correlations_of(section: Mapping[str, Any]) -> dict[tuple[str, str], float]:
    """Read the correlation coefficients of pairs of names.

    Raises
    ------
    InputError
        If a coefficient is not a number from -1 to 1, or a pair occurs twice.
    """
    coefficients: dict[tuple[str, str], float] = {}
    for name, coefficient_by_name in section.items():
        if not isinstance(coefficient_by_name, Mapping):
            raise InputError(f"{name} = {coefficient_by_name!r} must be a table, like m = {{ c = 0.3 }}")
        for second_name, value in coefficient_by_name.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not -1 <= value <= 1:
                raise InputError(f"{name} and {second_name}: {value!r} is no number from -1 to 1")
            coefficients[name, second_name] = float(value)
    check_pairs(coefficients, str)
    return coefficients


def check_pairs(pairs: Iterable[tuple[str, str]], internal_name: Callable[[str], str]) -> None:
    """Refuse a number's correlation with itself, and pairs that occur twice, by the names that they have inside.

    Raises
    ------
    InputError
    """
    seen_pairs = set[frozenset[str]]()
    for name, second_name in pairs:
        pair = frozenset(map(internal_name, (name, second_name)))
        if len(pair) == 1 or pair in seen_pairs:
            raise InputError(
                f"{name} and {second_name}: " + ("a number with itself has 1" if len(pair) == 1 else "are there twice")
            )
        seen_pairs.add(pair)


# Wichura 1988, algorithm AS 241 (doi:10.2307/2347330): numerator and denominator near the middle, in the tails, far out
_NEAR = (
    (
        3.3871328727963666080e0,
        1.3314166789178437745e2,
        1.9715909503065514427e3,
        1.3731693765509461125e4,
        4.5921953931549871457e4,
        6.7265770927008700853e4,
        3.3430575583588128105e4,
        2.5090809287301226727e3,
    ),
    (
        1.0,
        4.2313330701600911252e1,
        6.8718700749205790830e2,
        5.3941960214247511077e3,
        2.1213794301586595867e4,
        3.9307895800092710610e4,
        2.8729085735721942674e4,
        5.2264952788528545610e3,
    ),
)
_TAIL = (
    (
        1.42343711074968357734e0,
        4.63033784615654529590e0,
        5.76949722146069140550e0,
        3.64784832476320460504e0,
        1.27045825245236838258e0,
        2.41780725177450611770e-1,
        2.27238449892691845833e-2,
        7.74545014278341407640e-4,
    ),
    (
        1.0,
        2.05319162663775882187e0,
        1.67638483018380384940e0,
        6.89767334985100004550e-1,
        1.48103976427480074590e-1,
        1.51986665636164571966e-2,
        5.47593808499534494600e-4,
        1.05075007164441684324e-9,
    ),
)
_FAR = (
    (
        6.65790464350110377720e0,
        5.46378491116411436990e0,
        1.78482653991729133580e0,
        2.96560571828504891230e-1,
        2.65321895265761230930e-2,
        1.24266094738807843860e-3,
        2.71155556874348757815e-5,
        2.01033439929228813265e-7,
    ),
    (
        1.0,
        5.99832206555887937690e-1,
        1.36929880922735805310e-1,
        1.48753612908506148525e-2,
        7.86869131145613259100e-4,
        1.84631831751005468180e-5,
        1.42151175831644588870e-7,
        2.04426310338993978564e-15,
    ),
)


def normal_quantile(points: Floats) -> Floats:
    """Return the quantiles of the standard normal distribution for probabilities between 0 and 1, to 16 digits."""
    # all limits and shifts below are those of routine PPND16 of AS 241
    off = points - 0.5
    far: Floats = np.sqrt(-FUNCTIONS["log"](np.minimum(points, 1.0 - points)))
    tail = np.where(far <= 5.0, _rational_value(_TAIL, far - 1.6), _rational_value(_FAR, far - 5.0))
    return np.where(
        np.abs(off) <= 0.425, off * _rational_value(_NEAR, 0.180625 - off * off), np.where(off < 0.0, -tail, tail)
    )


def _rational_value(powers: tuple[tuple[float, ...], tuple[float, ...]], x: Floats) -> Floats:
    above, below = (np.zeros_like(x), np.zeros_like(x))
    for p, q in zip(reversed(powers[0]), reversed(powers[1]), strict=True):
        above, below = above * x + p, below * x + q
    return above / below


def draw_deviations(spreads: Sequence[Spread], correlation: Floats, points: Floats) -> Floats:
    """Return draws as deviations from the values in standard uncertainties; normal ones with their correlations.

    Parameters
    ----------
    spreads : sequence of Spread
    correlation : ndarray, shape (n, n)
    points : ndarray, shape (draws, n)
        Independent, uniform from 0 to 1.

    Raises
    ------
    InputError
        If the correlations contradict each other.
    """
    root = cholesky_factor(correlation)
    draws = np.stack([spread.quantiles(points[:, i]) for i, spread in enumerate(spreads)], axis=-1)
    mixed = np.zeros_like(draws)
    for i in range(len(spreads)):
        for k in range(i + 1):
            if root[i, k] != 0.0:
                mixed[:, i] += root[i, k] * draws[:, k]
    return mixed


def cholesky_factor(correlation: Floats) -> Floats:
    """Return the lower Cholesky factor of a correlation matrix, with zero columns where no variance remains.

    Raises
    ------
    InputError
        If the correlations contradict each other.
    """
    n = len(correlation)
    root = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            left = float(correlation[i, j])
            for k in range(j):
                left -= float(root[i, k]) * float(root[j, k])
            if i == j and left < -NOTHING:
                raise InputError("correlations contradict each other: no numbers can have all of them")
            if i == j:
                root[i, i] = sqrt(left) if left > NOTHING else 0.0
            elif root[j, j] > 0.0:
                root[i, j] = left / root[j, j]
            elif abs(left) > NOTHING:
                raise InputError("correlations contradict each other: no numbers can have all of them")
    return root


def correlation_matrix(names: list[str], correlations: Mapping[tuple[str, str], float]) -> Floats:
    """Return the correlation matrix of some names."""
    matrix = np.eye(len(names))
    for (name, second_name), value in correlations.items():
        if name in names and second_name in names:
            i, j = names.index(name), names.index(second_name)
            matrix[i, j] = matrix[j, i] = value
    return matrix
