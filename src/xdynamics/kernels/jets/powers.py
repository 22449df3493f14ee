"""Values that are powers of one other value times what does not change: one recurrence makes such a series.

Of m/norm(d)**3 with d*d for s, the series follows from that of s alone, y = c s**(-3/2): the root, its square and its cube
have no series that anyone reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TypeGuard

from xdynamics.kernels.program import Compute, Line, Load, Loop, Operand, Reduction, StoreTo

Form = tuple[str, Fraction]  # a base and the exponent


@dataclass
class Powers:
    """Which values of a program are made as powers.

    Attributes
    ----------
    made : dict of str to (str, Fraction)
        Values with their bases and exponents.
    passed_over : set of str
        Values of which no series is needed, as only powers are made of them.
    """

    made: dict[str, Form] = field(default_factory=dict)
    passed_over: set[str] = field(default_factory=set)


def powers_of(body: Sequence[Line]) -> Powers:
    """Find the powers in loops of a program; those outside of loops stay as they are."""
    powers, still_values = Powers(), set[str]()
    for line in body:
        if isinstance(line, Loop | Reduction):
            _find_powers(line, still_values, powers)
        elif _is_still(line, still_values):
            still_values.add(line.target)
    return powers


def _find_powers(line: Loop | Reduction, constants: set[str], powers: Powers) -> None:
    """Find the powers among the lines of a loop, and in those inside it."""
    still_values, forms = set(constants), dict[str, Form]()
    computed: dict[str, Compute] = {}
    for inner in line.body:
        if isinstance(inner, Loop | Reduction):
            _find_powers(inner, still_values, powers)
        elif _is_still(inner, still_values):
            still_values.add(inner.target)
        elif isinstance(inner, Compute) and (form := _power_form(inner, forms, still_values)):
            forms[inner.target], computed[inner.target] = form, inner
    needed_names = {str(operand) for operand in _series_operands(line, forms) if operand in forms}
    made: dict[str, Form] = {}
    waiting = sorted(needed_names)
    while waiting:
        name = waiting.pop()
        operands = [str(operand) for operand in computed[name].arguments if operand in forms]
        exponent = forms[name][1]
        # a root, a multiple and an inverse of what has a series take no more than a power; whole powers go through zero
        if operands and (exponent < 0 or exponent.denominator > 1) and not needed_names.issuperset(operands):
            made[name] = forms[name]
            continue
        waiting += sorted(set(operands) - needed_names)
        needed_names |= set(operands)
    powers.made |= made
    powers.passed_over |= forms.keys() - needed_names


def _power_form(line: Compute, forms: dict[str, Form], still_values: set[str]) -> Form | None:
    """Return what a value is a power of, but for a factor; None of one that is none."""

    def form_of(operand: Operand) -> Form | None:
        return None if _is_constant(operand, still_values) else forms.get(str(operand), (str(operand), Fraction(1)))

    arguments = line.arguments
    operand_forms = [form_of(operand) for operand in arguments]
    match line.operation, operand_forms:
        case "sqrt", [(base, exponent)]:
            return base, exponent / 2
        case "negative", [(base, exponent)] if arguments[0] in forms:
            return base, exponent
        case "multiply", [(base, exponent), None] | [None, (base, exponent)] if base in _bases(line, forms):
            return base, exponent
        case "multiply", [(base, exponent), (other, more)] if base == other and not forms.keys().isdisjoint(arguments):
            return base, exponent + more
        case "divide", [(base, exponent), None] if arguments[0] in forms:
            return base, exponent
        case "divide", [None, (base, exponent)]:
            return base, -exponent
        case "divide", [(base, exponent), (other, less)] if base == other and exponent != less:
            return base, exponent - less
    return None


def _bases(line: Compute, forms: dict[str, Form]) -> set[str]:
    """Return the bases of what is known to be powers among the arguments."""
    return {forms[str(operand)][0] for operand in line.arguments if operand in forms}


def _is_still(line: Line, still_values: set[str]) -> TypeGuard[Load | Compute]:
    """Whether a line gives what does not change with time."""
    if isinstance(line, Load):
        return line.location.array == "p"
    return isinstance(line, Compute) and all(_is_constant(operand, still_values) for operand in line.arguments)


def _is_constant(operand: Operand, still_values: set[str]) -> bool:
    return not isinstance(operand, str) or operand in still_values


def _series_operands(line: Loop | Reduction, forms: dict[str, Form]) -> Iterable[Operand]:
    """Yield what lines read that are no powers themselves, also in loops inside."""
    if isinstance(line, Reduction):
        yield from (*line.terms, *line.starts)
        if line.where:
            yield line.where
    for inner in line.body:
        match inner:
            case Compute() if inner.target not in forms:
                yield from inner.arguments
            case StoreTo():
                yield inner.value
            case Loop() | Reduction():
                yield from _series_operands(inner, {})
