"""Expressions: text to checked syntax tree; dimensions, derivatives, printing.

Nothing in a text is ever executed: its tree is walked, and that is all.
"""

from xdynamics.expressions.calculus import derivative, derivatives, expand
from xdynamics.expressions.dimensions import dimension_of
from xdynamics.expressions.latex import latex
from xdynamics.expressions.parser import parse
from xdynamics.expressions.tree import (
    ALONG,
    CALLED_ALONE,
    FUNCTIONS,
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
    digest,
    exponent_of,
    free_names,
    limits_domain,
    shortened_text,
    size,
    text_of,
)

__all__ = [
    "ALONG",
    "CALLED_ALONE",
    "FUNCTIONS",
    "Along",
    "Binary",
    "Call",
    "Compare",
    "Element",
    "Name",
    "Negative",
    "Node",
    "Number",
    "chain",
    "derivative",
    "derivatives",
    "digest",
    "dimension_of",
    "expand",
    "exponent_of",
    "free_names",
    "latex",
    "limits_domain",
    "parse",
    "shortened_text",
    "size",
    "text_of",
]
