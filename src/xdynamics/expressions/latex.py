"""Expressions as LaTeX, for figures."""

from __future__ import annotations

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
    r"""Set a name: a letter with an index, ``v_y``, as such; a word upright, and whole with what follows it.

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
