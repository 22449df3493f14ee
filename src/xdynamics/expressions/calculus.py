"""Derivatives of expressions by textbook rules on the package's own tree, and coefficients of polynomials.

A derivative becomes arithmetic of a run. In a computer-algebra system the order of terms depends on its version; these
rules keep the order in which the expression was written, whatever is installed. The tests compare the rules with such a
system.

An expression that is a polynomial in one of its names is read as the coefficients of its powers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce

from xdynamics.expressions.tree import (
    Along,
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    chain,
    children,
    exponent_of,
    free_names,
    text_of,
)
from xdynamics.faults import InputError

ZERO, ONE, TWO = Number(0.0), Number(1.0), Number(2.0)
MOST_EXPANDED = 1_000_000
MOST_LEVELS = 150  # so that every recursion into a tree, or into its derivatives, stays far from Python's own limit

Rates = Mapping[str, Node]  # the derivative by each variable; those not listed are zero


def expand(node: Node, definitions: Mapping[str, Node]) -> Node:
    """Substitute definitions, themselves expanded, for their names.

    Raises
    ------
    InputError
        If the result has more than 1,000,000 nodes, or more than 150 nested levels.
    """
    if not definitions:
        return node
    nodes, levels = _Sizes(definitions).count_nodes(node)
    if levels > MOST_LEVELS:
        raise InputError(f"definitions of '{text_of(node)[:60]}' are nested too deeply; shorten the chain")
    if nodes > MOST_EXPANDED:
        raise InputError(f"definitions expand '{text_of(node)[:60]}' to over {MOST_EXPANDED} nodes; shorten them")
    return _expand(node, definitions, {})


def derivative(node: Node, rates: Rates) -> Node:
    """Return the derivative by the chain rule.

    Parameters
    ----------
    node : Node
        An expression with definitions expanded.
    rates : mapping of str to Node
        The derivative of each name that varies: ``{"y": Number(1)}`` gives the partial derivative by y,
        ``{"t": Number(1), "y": Name("v_y"), …}`` the time derivative. A name not listed is constant.

    Notes
    -----
    At the kink of ``abs``, ``min``, ``max``, ``where`` the derivative is that of the branch taken; that of ``sign``,
    ``floor``, ``ceil`` and ``round`` is zero everywhere, and ``mod`` is differentiated between its jumps.
    """
    single_rates = {
        name: {"": rates[name]} for name in free_names(node) if name in rates
    }  # there may be a million rates
    return derivatives(node, single_rates).get("", ZERO)


def derivatives(node: Node, rates: Mapping[str, Rates]) -> dict[str, Node]:
    """Return the non-zero derivatives by many variables at once.

    Parameters
    ----------
    node : Node
    rates : mapping of str to mapping
        For each name that varies its derivative by each variable: ``{"x": {"x": Number(1)}, "y": {"y": Number(1)}}``
        gives the gradient.

    Notes
    -----
    Each term of a sum is differentiated only by the variables it mentions: the gradient of a chain's potential costs as
    much as writing it, however long the chain is.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> found = derivatives(parse("k*x**2/2 + x*y"), {"x": {"x": ONE}, "y": {"y": ONE}})
    >>> {by: text_of(slope) for by, slope in found.items()}
    {'x': 'k*(2*x)/2 + y', 'y': 'x'}
    """
    match node:
        case Name():
            return {variable: rate for variable, rate in rates.get(node.name, {}).items() if rate != ZERO}
        case Negative():
            return {variable: negative(rate) for variable, rate in derivatives(node.operand, rates).items()}
        case Binary():
            first, links = chain(node)
            gradient = derivatives(first, rates)
            for part in links:
                gradient = _derivatives_of_link(part, gradient, derivatives(part.right, rates))
            return gradient
        case Call():
            inner = [derivatives(part, rates) for part in node.arguments]
            return _differentiate_operands(inner, lambda operand_rates: operation_derivative(node, operand_rates))
    return {}


def operation_derivative(node: Negative | Binary | Call, rates: Sequence[Node]) -> Node:
    """Return the derivative of an operation from those of its operands, in which it is linear."""
    if isinstance(node, Negative):
        return negative(*rates)
    if isinstance(node, Call):
        return _call_derivative(node, rates)
    left, right = rates
    if node.operator in "+-":
        return add(left, right if node.operator == "+" else negative(right))
    return _product_derivative(node, left, right)


def _derivatives_of_link(node: Binary, left: dict[str, Node], right: dict[str, Node]) -> dict[str, Node]:
    """Return the derivatives of a binary node from those of its operands."""
    if node.operator not in "+-":
        return _differentiate_operands([left, right], lambda operand_rates: operation_derivative(node, operand_rates))
    # in place: copied at every term, the gradient of a long sum would take the square of its length
    for variable, rate in right.items():  # derivatives of the preceding terms stay as they are
        total = add(left.get(variable, ZERO), rate if node.operator == "+" else negative(rate))
        if total == ZERO:
            left.pop(variable, None)
        else:
            left[variable] = total
    return left


def _differentiate_operands(inner: list[dict[str, Node]], rule: Callable[[list[Node]], Node]) -> dict[str, Node]:
    """Apply a rule to the derivatives of the operands by each variable that one of them depends on."""
    rates = {
        variable: rule([operand.get(variable, ZERO) for operand in inner])
        for variable in dict.fromkeys(variable for operand in inner for variable in operand)
    }
    return {variable: rate for variable, rate in rates.items() if rate != ZERO}


class _Sizes:
    """The number of nodes and of levels of an expression when it is expanded; a chain is one level."""

    def __init__(self, definitions: Mapping[str, Node]) -> None:
        self._definitions = definitions
        self._definition_sizes: dict[str, tuple[int, int]] = {}

    def count_nodes(self, node: Node, above: int = 0) -> tuple[int, int]:
        nodes, deepest, waiting = 0, 0, [(node, 0)]
        while waiting:
            current, level = waiting.pop()
            nodes, deepest = nodes + 1, max(deepest, level)
            if isinstance(current, Name) and current.name in self._definitions:
                inner = self._of_definition(current.name, above + level + 1)
                nodes, deepest = nodes - 1 + inner[0], max(deepest, level + 1 + inner[1])
            elif isinstance(current, Binary):
                waiting += [(current.left, level), (current.right, level + 1)]
            else:
                waiting += [(child, level + 1) for child in children(current)]
        return nodes, deepest

    def _of_definition(self, name: str, above: int) -> tuple[int, int]:
        if above > MOST_LEVELS:  # circular definitions end here too
            return 0, 0
        if name not in self._definition_sizes:
            self._definition_sizes[name] = self.count_nodes(self._definitions[name], above)
        return self._definition_sizes[name]


def _expand(node: Node, definitions: Mapping[str, Node], expanded: dict[str, Node]) -> Node:
    """Expand; a node without definitions is returned as it is, and each definition is expanded once."""
    match node:
        case Name() if node.name in definitions:
            if node.name not in expanded:
                expanded[node.name] = _expand(definitions[node.name], definitions, expanded)
            return expanded[node.name]
        case Negative():
            operand = _expand(node.operand, definitions, expanded)
            return node if operand is node.operand else Negative(operand, node.column)
        case Binary():
            first, links = chain(node)
            tree = _expand(first, definitions, expanded)
            for part in links:
                right = _expand(part.right, definitions, expanded)
                same = tree is part.left and right is part.right
                tree = part if same else Binary(part.operator, tree, right, part.column)
            return tree
        case Compare():
            left, right = _expand(node.left, definitions, expanded), _expand(node.right, definitions, expanded)
            return Compare(node.operator, left, right, node.column)
        case Call() | Along():
            return replace(node, arguments=tuple(_expand(part, definitions, expanded) for part in node.arguments))
    return node


def negative(node: Node) -> Node:
    """Return ``-node``; signs cancel and zero stays."""
    if node == ZERO:
        return ZERO
    return node.operand if isinstance(node, Negative) else Negative(node)


def add(left: Node, right: Node) -> Node:
    """Return ``left + right`` without zeros."""
    if left == ZERO:
        return right
    if right == ZERO:
        return left
    return Binary("-", left, right.operand) if isinstance(right, Negative) else Binary("+", left, right)


def sum_of_terms(terms: Sequence[Node]) -> Node:
    """Return the sum of some terms, in their order."""
    sum_tree = terms[0]
    for term in terms[1:]:
        sum_tree = add(sum_tree, term)
    return sum_tree


def multiply(left: Node, right: Node) -> Node:
    """Return ``left*right`` without zeros, ones and inner signs."""
    if ZERO in (left, right):
        return ZERO
    if isinstance(left, Negative):
        return negative(multiply(left.operand, right))
    if isinstance(right, Negative):
        return negative(multiply(left, right.operand))
    if left == ONE:
        return right
    return left if right == ONE else Binary("*", left, right)


def divide(left: Node, right: Node) -> Node:
    """Return ``left/right`` without zeros, ones and an inner sign."""
    if left == ZERO:
        return ZERO
    if isinstance(left, Negative):
        return negative(divide(left.operand, right))
    return left if right == ONE else Binary("/", left, right)


def _product_derivative(node: Binary, left_rate: Node, right_rate: Node) -> Node:
    """Differentiate a product, a quotient or a power."""
    left, right = node.left, node.right
    match node.operator:
        case "*":
            return add(multiply(left_rate, right), multiply(left, right_rate))
        case "/":
            return add(divide(left_rate, right), negative(divide(multiply(left, right_rate), Binary("**", right, TWO))))
    exponent = exponent_of(right)
    if exponent is None or exponent == 0:
        return ZERO
    lower = exponent - 1
    power = left if lower == 1 else ONE if lower == 0 else Binary("**", left, _signed_number(float(lower)))
    return multiply(multiply(_signed_number(float(exponent)), power), left_rate)


def _signed_number(value: float) -> Node:
    return Number(value) if value >= 0 else Negative(Number(-value))


def _call_derivative(node: Call, inner_rates: Sequence[Node]) -> Node:
    if node.function in ("min", "max"):
        return _choice_derivative(node, inner_rates)
    if node.function == "where":
        _, yes, no = inner_rates
        return ZERO if yes == no == ZERO else Call("where", (node.arguments[0], yes, no))
    if node.function == "atan2":
        y, x = node.arguments
        above = add(multiply(inner_rates[0], x), negative(multiply(y, inner_rates[1])))
        return divide(above, Binary("+", Binary("**", x, TWO), Binary("**", y, TWO)))
    if node.function == "mod":
        a, b = node.arguments
        # mod(a, b) is a - b*floor(a/b), and between jumps floor stands still
        return add(inner_rates[0], negative(multiply(Call("floor", (Binary("/", a, b),)), inner_rates[1])))
    if node.function == "hypot":
        terms = [multiply(argument, rate) for argument, rate in zip(node.arguments, inner_rates, strict=True)]
        return divide(add(*terms), node)
    return _OUTER[node.function](node.arguments[0], node, inner_rates[0])


MOST_CHAINED = 16  # arguments of min and max whose derivative is a chain: it is as deep as they are many


def _choice_derivative(node: Call, inner_rates: Sequence[Node]) -> Node:
    """Differentiate min and max as an equivalent chain of `where`; of many arguments as one of either half."""
    operator = "<=" if node.function == "min" else ">="
    if len(node.arguments) > MOST_CHAINED:
        middle = len(node.arguments) // 2
        left, right = Call(node.function, node.arguments[:middle]), Call(node.function, node.arguments[middle:])
        rates = _choice_derivative(left, inner_rates[:middle]), _choice_derivative(right, inner_rates[middle:])
        return ZERO if rates == (ZERO, ZERO) else Call("where", (Compare(operator, left, right), *rates))
    *leading_arguments, _ = node.arguments
    result = inner_rates[-1]
    for position in range(len(leading_arguments) - 1, -1, -1):
        later_arguments = node.arguments[position + 1 :]
        best = later_arguments[0] if len(later_arguments) == 1 else Call(node.function, later_arguments)
        rate = inner_rates[position]
        if not rate == result == ZERO:
            result = Call("where", (Compare(operator, leading_arguments[position], best), rate, result))
    return result


# f(u)' by function, from u, f(u) itself and u'
_OUTER: dict[str, Callable[[Node, Node, Node], Node]] = {
    "abs": lambda u, _, rate: multiply(Call("sign", (u,)), rate),
    **dict.fromkeys(("sign", "floor", "ceil", "round"), lambda _u, _f, _rate: ZERO),
    "sqrt": lambda _, f, rate: divide(rate, Binary("*", TWO, f)),
    "exp": lambda _, f, rate: multiply(f, rate),
    "log": lambda u, _, rate: divide(rate, u),
    "sin": lambda u, _, rate: multiply(Call("cos", (u,)), rate),
    "cos": lambda u, _, rate: negative(multiply(Call("sin", (u,)), rate)),
    "tan": lambda u, _, rate: divide(rate, Binary("**", Call("cos", (u,)), TWO)),
    "asin": lambda u, _, rate: divide(rate, Call("sqrt", (Binary("-", ONE, Binary("**", u, TWO)),))),
    "acos": lambda u, _, rate: negative(divide(rate, Call("sqrt", (Binary("-", ONE, Binary("**", u, TWO)),)))),
    "atan": lambda u, _, rate: divide(rate, Binary("+", ONE, Binary("**", u, TWO))),
    "sinh": lambda u, _, rate: multiply(Call("cosh", (u,)), rate),
    "cosh": lambda u, _, rate: multiply(Call("sinh", (u,)), rate),
    "positive": lambda _u, _f, rate: rate,
    "tanh": lambda u, _, rate: divide(rate, Binary("**", Call("cosh", (u,)), TWO)),
}


def polynomial_coefficients(node: Node, name: str) -> tuple[Node, ...]:
    """Return the coefficients of a polynomial in a name, that of its zeroth power first.

    Raises
    ------
    ValueError
        If it is none: the name stands in a function, in a divisor, or under a power that is not whole.

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> [text_of(part) for part in polynomial_coefficients(parse("a + s*(b + (1 - s)*c)"), "s")]
    ['a', 'b + c', '-c']
    """
    if name not in free_names(node):
        return (node,)
    match node:
        case Name():
            return ZERO, ONE
        case Negative():
            return tuple(map(negative, polynomial_coefficients(node.operand, name)))
        case Binary(operator="+" | "-" | "*" | "/", left=left, right=right):
            parts = polynomial_coefficients(left, name), polynomial_coefficients(right, name)
            if node.operator == "/" and len(parts[1]) == 1:
                return tuple(divide(part, right) for part in parts[0])
            if node.operator == "*":
                return _coefficient_product(*parts)
            if node.operator != "/":
                return _coefficient_sum(parts[0], parts[1] if node.operator == "+" else tuple(map(negative, parts[1])))
        case Binary(operator="**", left=left, right=right):
            exponent = exponent_of(right)
            if exponent is not None and exponent.denominator == 1 and exponent > 0:
                return reduce(_coefficient_product, [polynomial_coefficients(left, name)] * int(exponent))
    raise ValueError(f"'{text_of(node)}' is no polynomial in {name}")


def _coefficient_sum(left: tuple[Node, ...], right: tuple[Node, ...]) -> tuple[Node, ...]:
    length = max(len(left), len(right))
    padded = ((*part, *[ZERO] * (length - len(part))) for part in (left, right))
    return tuple(map(add, *padded))


def _coefficient_product(left: tuple[Node, ...], right: tuple[Node, ...]) -> tuple[Node, ...]:
    terms: list[Node] = [ZERO] * (len(left) + len(right) - 1)
    for i, factor in enumerate(left):
        for j, right_factor in enumerate(right):
            terms[i + j] = add(terms[i + j], multiply(factor, right_factor))
    return tuple(terms)
