"""Quotients of coefficients by what stays the same in all orders: products with its reciprocal."""

from __future__ import annotations

from collections.abc import Sequence

from xdynamics.kernels.jets.series import Order, Series, reciprocal
from xdynamics.kernels.program import Operand


def begin_quotient(order: Order, target: Series, divisor: Operand) -> None:
    """Keep the reciprocal of what all coefficients are divided by, to 106 bits."""
    if not order.fused or _is_literal(divisor):
        return
    nearest, low_part = (order.part(target, name) for name in ("reciprocal", "rest"))
    nearest.constant = low_part.constant = True
    order.keep(nearest, order.compute("divide", 1.0, divisor))
    left = order.compute("fma", order.compute("negative", divisor), order.now(nearest), 1.0)
    order.keep(low_part, order.compute("divide", left, divisor))


def divide_coefficient(order: Order, target: Series, value: Operand, divisor: Operand) -> Operand:
    """Divide a coefficient by what `begin_quotient` was given: rounded to nearest as a division is, in half the time."""
    if not order.fused:
        return order.compute("divide", value, divisor)
    nearest, low_part = _reciprocal(order, target, divisor)
    if order.high or low_part == 0.0:
        return order.compute("multiply", value, nearest)
    return order.compute("fma", value, nearest, order.compute("multiply", value, low_part))


def _reciprocal(order: Order, target: Series, divisor: Operand) -> tuple[Operand, Operand]:
    """Return the reciprocal and what is left of it."""
    if _is_literal(divisor):
        return reciprocal(float(divisor))
    nearest, low_part = (order.first(order.part(target, name)) for name in ("reciprocal", "rest"))
    return nearest, low_part


def multiple_of(order: Order, name: str, target: Series, operands: Sequence[Series]) -> tuple[Series, Operand] | None:
    """Return the series that another is a multiple of and the factor, if it is one, where factors stay the same."""
    match name, operands:
        case "negative", (of,):
            return of, -1.0
        case "multiply", (a, b) if a.constant != b.constant:
            return (b, order.first(a)) if a.constant else (a, order.first(b))
        case "divide", (a, b) if b.constant and order.fused:
            return a, _reciprocal(order, target, order.first(b))[0]
    return None


def _is_literal(divisor: Operand) -> bool:
    """Whether it is a literal, of which the reciprocal is known when the program is written."""
    return not isinstance(divisor, str) and 1e-150 < abs(divisor) < 1e150


def or_nothing(order: Order, divisor: Operand, value: Operand) -> Operand:
    """Return a coefficient, or 0 where what it was divided by is 0."""
    return order.compute("choose", order.compute("equal", divisor, 0.0), 0.0, value)
