"""Expressions as LaTeX, for figures, in the form in which people would write them.

An expression is simplified for print alone: computation and digests use the expression as it was derived.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import reduce

from xdynamics.expressions.tree import (
    DELAYED,
    Along,
    Binary,
    Call,
    Compare,
    Element,
    Name,
    Negative,
    Node,
    Number,
    chain,
    text_of,
)

LONGEST_DECIMAL = 9  # characters of a decimal coefficient; a product with a longer one stays as it is
LARGEST_WHOLE = 10**9
WHOLE_EXPONENTS = tuple(Number(float(n)) for n in range(9))
_ZERO, _ONE = Number(0.0), Number(1.0)


def simplified(node: Node) -> Node:
    """Return an equal expression with numbers multiplied out, nested products flattened, signs combined.

    Names keep their order, and none is cancelled against another, so that it is read as what was written; only a product
    with 0 goes. Its value has other bits.

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> [text_of(simplified(parse(text))) for text in ("-(k*(2*x)/2)", "a + -(3*b)", "0*a + 1*b", "3*x**2/6")]
    ['-k*x', 'a - 3*b', 'b', 'x**2/2']
    """
    match node:
        case Negative() | Binary(operator="*" | "/" | "+" | "-"):
            return _write_sum(node)
        case Binary():
            base = simplified(node.left)
            return base if node.right == _ONE else Binary(node.operator, base, node.right)
        case Call() | Along():
            return replace(node, arguments=tuple(map(simplified, node.arguments)))
    return node  # a comparison too: it stands as it was written


def printed_simply(node: Node) -> str:
    """Print an expression as it stands, or simplified where that is shorter."""
    return min(text_of(node), text_of(simplified(node)), key=len)


def _write_sum(node: Node) -> Node:
    """Write a sum of products, without those that are 0."""
    tree: Node = _ZERO
    for product in _merge_whole_numbers([_Product.from_term(sign, term) for sign, term in _signed_terms(node)]):
        if tree == _ZERO:
            tree = product.as_tree()
        elif product.coefficient != 0:
            operator = "-" if product.coefficient < 0 else "+"
            product.coefficient = abs(product.coefficient)
            tree = Binary(operator, tree, product.as_tree())
    return tree


def _merge_whole_numbers(products: list[_Product]) -> list[_Product]:
    """Add up a sum that consists of whole numbers alone."""
    if not all(product.is_whole and not product.above and not product.below for product in products):
        return products
    total = sum((product.coefficient for product in products), Fraction(0))
    return [_Product(total)] if max(abs(total.numerator), total.denominator) <= LARGEST_WHOLE else products


def _signed_terms(node: Node, sign: int = 1) -> Iterator[tuple[int, Node]]:
    """Yield the terms of a sum with their signs, those of sums in it too."""
    if isinstance(node, Binary) and node.operator in "+-":
        first, links = _operator_links(node, "+-")
        yield from _signed_terms(first, sign)
        for link in links:
            yield from _signed_terms(link.right, -sign if link.operator == "-" else sign)
    else:
        yield sign, node


def _operator_links(node: Binary, operators: str) -> tuple[Node, list[Binary]]:
    """Split a chain of some operators into its first operand and its links."""
    first, links = chain(node)
    foreign_links = [i for i, link in enumerate(links) if link.operator not in operators]
    return (links[foreign_links[-1]], links[foreign_links[-1] + 1 :]) if foreign_links else (first, links)


@dataclass
class _Product:
    """A coefficient, exact, and the factors above and below the stroke in the order in which they stand."""

    coefficient: Fraction = Fraction(1)
    above: list[Node] = field(default_factory=list)
    below: list[Node] = field(default_factory=list)
    is_whole: bool = True

    @classmethod
    def from_term(cls, sign: int, node: Node) -> _Product:
        """Return a term of a sum as a product."""
        product = cls(Fraction(sign))
        product.multiply_by(node)
        return product

    def multiply_by(self, node: Node, *, inverse: bool = False) -> None:
        """Multiply by a node, or divide by it."""
        if isinstance(node, Negative):
            self.coefficient = -self.coefficient
            self.multiply_by(node.operand, inverse=inverse)
        # a division by zero stays to be seen; repr gives the decimal that was written, not the binary number beside it
        elif isinstance(node, Number) and not (inverse and node.value == 0.0):
            self._scale_coefficient(Fraction(repr(node.value)), node, inverse=inverse)
        elif isinstance(node, Binary) and node.operator in "*/":
            first, links = _operator_links(node, "*/")
            self.multiply_by(first, inverse=inverse)
            for link in links:
                self.multiply_by(link.right, inverse=inverse != (link.operator == "/"))
        else:
            inner = simplified(node)
            if isinstance(inner, Number | Negative) and inner != node:
                self.multiply_by(inner, inverse=inverse)
            else:
                (self.below if inverse else self.above).append(inner)

    def _scale_coefficient(self, number: Fraction, node: Number, *, inverse: bool) -> None:
        """Multiply the coefficient by a number, or divide it; one that would get too many digits is a factor as it is."""
        scaled = self.coefficient / number if inverse else self.coefficient * number
        is_whole = self.is_whole and number.denominator == 1
        size = max(abs(scaled.numerator), scaled.denominator)
        if size <= LARGEST_WHOLE if is_whole else _is_short(scaled):
            self.coefficient, self.is_whole = scaled, is_whole
        else:
            (self.below if inverse else self.above).append(node)

    def as_tree(self) -> Node:
        """Return the product as a tree."""
        size = abs(self.coefficient)
        if size == 0:
            return _ZERO
        numerator = Number(float(size.numerator if self.is_whole else size))
        divisor = Number(float(size.denominator if self.is_whole else 1))
        factors = [*([numerator] if numerator != _ONE else []), *_merged_powers(self.above)] or [_ONE]
        if self.coefficient < 0:
            factors[0] = Negative(factors[0])
        tree = reduce(lambda product, factor: Binary("*", product, factor), factors)
        divisors = [*([divisor] if divisor != _ONE else []), *_merged_powers(self.below)]
        return (
            Binary("/", tree, reduce(lambda product, factor: Binary("*", product, factor), divisors))
            if divisors
            else tree
        )


def _merged_powers(factors: list[Node]) -> Iterator[Node]:
    """Yield factors, those that follow one another with one base as its power."""
    exponents: list[tuple[Node, int]] = []
    for factor in factors:
        base, exponent = factor, 1
        if isinstance(factor, Binary) and factor.operator == "**" and factor.right in WHOLE_EXPONENTS:
            base, exponent = factor.left, WHOLE_EXPONENTS.index(factor.right)
        if exponents and exponents[-1][0] == base and not isinstance(base, Number):
            exponents[-1] = base, exponents[-1][1] + exponent
        else:
            exponents.append((base, exponent))
    return (base if n == 1 else Binary("**", base, Number(float(n))) for base, n in exponents)


def _is_short(number: Fraction) -> bool:
    """Whether a number is a decimal of few digits."""
    text = repr(float(number))
    return len(text) <= LONGEST_DECIMAL and Fraction(text) == number


_GREEK = {
    "alpha",
    "beta",
    "gamma",
    "delta",
    "epsilon",
    "zeta",
    "eta",
    "theta",
    "kappa",
    "lambda",
    "mu",
    "nu",
    "xi",
    "pi",
    "rho",
    "sigma",
    "tau",
    "phi",
    "chi",
    "psi",
    "omega",
}
_PLAIN = {"sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "min", "max"}
_SIGNS = {"<=": r"\leq", ">=": r"\geq", "==": "=", "!=": r"\neq"}


def latex(node: Node) -> str:
    r"""Return an expression as LaTeX math (without dollar signs), in matplotlib's subset.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> latex(parse("-c*v_y*abs(v_y)"))
    '-c\\,v_{y}\\,\\left|v_{y}\\right|'
    """
    match node:
        case Number():
            return text_of(node)
        case Name():
            return _symbol_latex(node.name)
        case Negative():
            return f"-{_parenthesised(node.operand)}"
        case Compare():
            return f"{latex(node.left)} {_SIGNS.get(node.operator, node.operator)} {latex(node.right)}"
        case Binary():
            return _chain(node)
        case Call():
            return _call_latex(node)
        case Element():
            return rf"{_symbol_latex(node.name)}\left[{', '.join(map(_upright_word, node.entries))}\right]"
        case Along():
            return _reduction_latex(node)


def _reduction_latex(node: Along) -> str:
    """Return the LaTeX of a function along dimensions: sums and norms as they are printed, others as they are written."""
    dims = ", ".join(map(_upright_word, node.dims))
    if node.function == "sum":
        return rf"\sum_{{{dims}}} {_parenthesised(node.arguments[0])}"
    if node.function == "norm":
        return rf"\left\|{latex(node.arguments[0])}\right\|_{{{dims}}}"
    arguments = [*map(latex, node.arguments), dims]
    if node.function in ("shift", "roll", "take"):
        places = [str(node.places)] if node.function != "take" else []
        arguments = [latex(node.arguments[0]), dims, *places, *map(latex, node.arguments[1:])]
    return rf"\mathrm{{{node.function}}}\left({', '.join(arguments)}\right)"


def _chain(node: Binary) -> str:
    first, links = chain(node)
    text = _closed_operand(first)
    for link in links:
        text = _link_latex(link, text)
    return text


def _link_latex(node: Binary, left: str) -> str:
    """Return the LaTeX of a binary node from that of its left operand."""
    match node.operator:
        case "/":
            return rf"\frac{{{left}}}{{{latex(node.right)}}}"
        case "**":
            base = left if isinstance(node.left, Name | Number) else rf"\left({left}\right)"
            return f"{{{base}}}^{{{latex(node.right)}}}"
        case "*":
            left_factor = rf"\left({left}\right)" if _is_sum(node.left) else left
            return rf"{left_factor}\,{_parenthesised(node.right)}"
    return (
        f"{left} {node.operator} {_parenthesised(node.right) if node.operator == '-' else _closed_operand(node.right)}"
    )


def _call_latex(node: Call) -> str:
    arguments = [latex(argument) for argument in node.arguments]
    if node.function == "abs":
        return rf"\left|{arguments[0]}\right|"
    if node.function == "sqrt":
        return rf"\sqrt{{{arguments[0]}}}"
    if node.function in ("floor", "ceil"):
        return rf"\left\l{node.function}{{}}{arguments[0]}\right\r{node.function}"
    if node.function == DELAYED:
        delayed_value, _ = arguments
        delayed_time = rf"\left(t - {_parenthesised(node.arguments[1])}\right)"
        return (
            delayed_value + delayed_time
            if isinstance(node.arguments[0], Name)
            else rf"\left[{delayed_value}\right]{delayed_time}"
        )
    name = rf"\{node.function}" if node.function in _PLAIN else rf"\mathrm{{{node.function}}}"
    return rf"{name}\left({', '.join(arguments)}\right)"


def _upright_word(word: str | int) -> str:
    return rf"\mathrm{{{str(word).replace('_', chr(92) + '_')}}}"


def _symbol_latex(name: str) -> str:
    r"""Write a name: a letter with a subscript, ``v_y``, as such; a word upright, together with its subscripts.

    Examples
    --------
    >>> _symbol_latex("v_theta"), _symbol_latex("drag_coefficient")
    ('v_{\\theta}', '\\mathrm{drag\\_coefficient}')
    """
    head, *subscripts = name.split("_")
    if any(subscripts) and len(head) > 1 and head not in _GREEK:
        escaped_name = name.replace("_", r"\_")
        return rf"\mathrm{{{escaped_name}}}"
    base_symbol = rf"\{head}" if head in _GREEK else head if len(head) == 1 else rf"\mathrm{{{head}}}"
    return base_symbol + (
        rf"_{{{','.join(_symbol_latex(part) for part in subscripts if part)}}}" if any(subscripts) else ""
    )


def _parenthesised(node: Node) -> str:
    return rf"\left({latex(node)}\right)" if isinstance(node, Negative) or _is_sum(node) else latex(node)


def _closed_operand(node: Node) -> str:
    """Return the LaTeX of an operand, where a sum along a dimension would not show its end."""
    return rf"\left({latex(node)}\right)" if isinstance(node, Along) and node.function == "sum" else latex(node)


def _is_sum(node: Node) -> bool:
    if isinstance(node, Along):
        return node.function == "sum"
    return isinstance(node, Binary) and node.operator in "+-"
