"""Syntax trees to lines of Python, in the order written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from fractions import Fraction

from xdynamics.expressions import Binary, Call, Compare, Name, Negative, Node, Number, exponent_of
from xdynamics.expressions.tree import children

_CALLED = {"min": "_least", "max": "_greatest"}
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2}


class Arithmetic:
    """Writes assignments; a part that stands twice in the trees is computed once.

    Powers are products and square roots: ``x**3`` is ``x*x*x``, ``r**-1.5`` is ``1/(r*sqrt(r))``. Neither changes a bit
    against computing each part where it stands.

    Parameters
    ----------
    trees : iterable of Node
        All the trees that will be assigned, so that shared parts are known.
    prefix : str
        What the names of shared parts begin with.
    """

    def __init__(self, trees: Iterable[Node], prefix: str = "_") -> None:
        self.lines: list[str] = []
        self.prefix = prefix
        self._seen: Counter[Node] = Counter()
        self._placed: dict[Node, str] = {}
        for tree in trees:
            self._count(tree)

    def assign(self, name: str, tree: Node) -> None:
        """Write ``name = tree``."""
        self.lines.append(f"{name} = {self.text(tree)}")

    def text(self, tree: Node) -> str:
        """Write the shared parts of a tree and return the rest as one expression."""
        return self._print(tree)[0]

    def operand(self, tree: Node) -> str:
        """Like `text`, to stand beside an operator: a choice goes in parentheses."""
        return self._wrapped(tree, 1)

    def _count(self, node: Node) -> None:
        self._seen[node] += 1
        if self._seen[node] == 1:
            for child in children(node):
                self._count(child)

    def _print(self, node: Node) -> tuple[str, int]:
        """Return an expression and how strongly it binds."""
        if node in self._placed:
            return self._placed[node], 9
        text, strength = self._printed(node)
        if self._seen[node] > 1 and not isinstance(node, Name | Number | Compare):
            return self._place(node, text), 9
        return text, strength

    def _printed(self, node: Node) -> tuple[str, int]:
        match node:
            case Number():
                return repr(node.value), 9
            case Name():
                return node.name, 9
            case Negative():
                return f"-{self._wrapped(node.operand, 3)}", 3
            case Binary(operator="**"):
                return self._power(node.left, exponent_of(node.right) or Fraction(0))
            case Binary():
                strength = _STRENGTH[node.operator]
                left, right = self._wrapped(node.left, strength), self._wrapped(node.right, strength + 1)
                gap = " " if strength == 1 else ""
                return f"{left}{gap}{node.operator}{gap}{right}", strength
            case Compare():
                return f"{self.operand(node.left)} {node.operator} {self.operand(node.right)}", 0
            case Call(function="where"):
                condition, yes, no = (self._wrapped(one, 1) for one in node.arguments)
                return f"{yes} if {condition} else {no}", 0
            case Call(function="abs"):
                return f"abs({self.text(node.arguments[0])})", 9
            case Call():
                return self._call(_CALLED.get(node.function, node.function), node.arguments), 9

    def _call(self, function: str, arguments: tuple[Node, ...]) -> str:
        texts = [self.text(one) for one in arguments]
        joined = f"{function}({', '.join(texts[:2])})"
        for further in texts[2:]:  # min and max of more than two
            joined = f"{function}({joined}, {further})"
        return joined

    def _wrapped(self, node: Node, needed: int) -> str:
        text, strength = self._print(node)
        return f"({text})" if strength < needed else text

    def _place(self, node: Node, text: str) -> str:
        if text.isidentifier():
            self._placed[node] = text
            return text
        name = f"{self.prefix}{len(self._placed)}"
        self.lines.append(f"{name} = {text}")
        self._placed[node] = name
        return name

    def _atom(self, node: Node) -> str:
        """Return a name or number that stands for the node."""
        text, _ = self._print(node)
        return text if isinstance(node, Number) or text.isidentifier() else self._place(node, text)

    def _power(self, base: Node, exponent: Fraction) -> tuple[str, int]:
        if exponent == 0:
            return "1.0", 9
        if exponent < 0:
            below, strength = self._power(base, -exponent)
            return f"1.0/{below}" if strength > 2 else f"1.0/({below})", 2
        if exponent.denominator == 1:
            return self._product(base, exponent.numerator)
        if exponent.denominator != 2:
            return f"_power({self._atom(base)}, {float(exponent)!r})", 9
        root = Call("sqrt", (base,))
        if exponent < 1:
            return f"sqrt({self.text(base)})", 9
        whole = Binary("**", base, Number(float(exponent.numerator // 2)))
        return f"{self._atom(base) if exponent.numerator == 3 else self._atom(whole)}*{self._atom(root)}", 2

    def _product(self, base: Node, times: int) -> tuple[str, int]:
        atom = self._atom(base)
        if times <= 3:
            return "*".join([atom] * times), 9 if times == 1 else 2
        half = self._atom(Binary("**", base, Number(float(times // 2))))
        return f"{half}*{half}" + (f"*{atom}" if times % 2 else ""), 2
