"""The elementary functions, in one room: the only place from which generated code reaches them.

`sqrt`, `hypot` and the choices are IEEE operations and the same everywhere. The others are the C library's until a
portable set takes their place; a run says so in `math_functions`.
"""

from __future__ import annotations

import math

from xdynamics.kernels.compiling import compiled

MATH_FUNCTIONS = "libm"


@compiled
def sqrt(x: float) -> float:
    """Square root; nan below zero."""
    return math.sqrt(x)


@compiled
def exp(x: float) -> float:
    """Exponential; inf above 709.78."""
    return math.exp(x)


@compiled
def log(x: float) -> float:
    """Natural logarithm; nan below zero."""
    return math.log(x)


@compiled
def sin(x: float) -> float:
    """Sine of an angle in rad."""
    return math.sin(x)


@compiled
def cos(x: float) -> float:
    """Cosine of an angle in rad."""
    return math.cos(x)


@compiled
def tan(x: float) -> float:
    """Tangent of an angle in rad."""
    return math.tan(x)


@compiled
def asin(x: float) -> float:
    """Arcsine in rad; nan outside [-1, 1]."""
    return math.asin(x)


@compiled
def acos(x: float) -> float:
    """Arccosine in rad; nan outside [-1, 1]."""
    return math.acos(x)


@compiled
def atan(x: float) -> float:
    """Arctangent in rad."""
    return math.atan(x)


@compiled
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y) in rad."""
    return math.atan2(y, x)


@compiled
def sinh(x: float) -> float:
    """Hyperbolic sine."""
    return math.sinh(x)


@compiled
def cosh(x: float) -> float:
    """Hyperbolic cosine."""
    return math.cosh(x)


@compiled
def tanh(x: float) -> float:
    """Hyperbolic tangent."""
    return math.tanh(x)


@compiled
def power(x: float, exponent: float) -> float:
    """x**exponent where the exponent is no multiple of 1/2; nan below zero."""
    return math.pow(x, exponent)


@compiled
def hypot(x: float, y: float) -> float:
    """sqrt(x**2 + y**2), by IEEE operations."""
    return math.sqrt(x * x + y * y)


@compiled
def sign(x: float) -> float:
    """-1, 0 or 1; nan stays nan."""
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else x)


@compiled
def least(x: float, y: float) -> float:
    """Return the smaller; nan if either is."""
    return x if x < y or x != x else y


@compiled
def greatest(x: float, y: float) -> float:
    """Return the larger; nan if either is."""
    return x if x > y or x != x else y


@compiled
def positive(x: float) -> float:
    """X where it is positive, else nan: a mass that is none ends the run."""
    return x if x > 0.0 else math.nan
