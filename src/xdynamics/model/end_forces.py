"""Forces at both ends of links between two dimensions: what acts on one acts, opposite, on the other."""

from __future__ import annotations

from collections.abc import Mapping

from xdynamics.expressions import Binary, Node, shortened_text
from xdynamics.expressions.calculus import negative
from xdynamics.faults import Ledger, ModelError
from xdynamics.model.parts import Function
from xdynamics.model.statement import Statement
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import expand_definitions

Components = Mapping[str, Node | Function]


def check_end_forces(statement: Statement, shapes: Shapes) -> None:
    """Refuse forces over links between two dimensions that leave one moving end without its opposite.

    Asked of what people write, not of records: those of before are marched again as they are.

    Raises
    ------
    ModelError
        With every such force.
    """
    ledger = Ledger(f"model '{statement.name}'", ModelError)
    for term, force in statement.forces.items():
        relation = shapes.relations.get(force.over)
        if relation is None or relation.source == relation.target or not force.components:
            continue
        ends = [
            [name for name in statement.coordinates if end_dim in shapes.dims.get(name, ())]
            for end_dim in (relation.source, relation.target)
        ]
        about = f"force '{term}' over '{force.over}'"
        _check_one_sided(about, (relation.source, relation.target), ends, force.components, ledger)
        for name in ends[0]:
            for second_name in ends[1]:
                if name != second_name and _cancels(force.components, name, second_name, statement, shapes):
                    text = _component_text(force.components[name])
                    ledger.note(
                        f"{about} pushes both ends of each link the same way: its opposite acts on the second end by"
                        f' itself; write the same of both, {second_name} = "{text}" as {name} = "{text}"'
                    )
    ledger.raise_faults()


def _check_one_sided(
    about: str, dims: tuple[str, str], ends: list[list[str]], components: Components, ledger: Ledger
) -> None:
    acted = [[name for name in names if name in components] for names in ends]
    if all(acted) or not all(ends) or not any(acted):
        return
    missing = 0 if acted[1] else 1
    name = acted[1 - missing][0]
    text, missing_name = _component_text(components[name]), ends[missing][0]
    word, end_phrase = (
        ("first", "on the first end as written") if missing == 0 else ("second", "opposite on the second end")
    )
    ledger.note(
        f"{about} acts on '{name}' alone, and on nothing at the {word} end of each link, where '{missing_name}' moves along"
        f' \'{dims[missing]}\'; write it of both, {missing_name} = "{text}", which acts {end_phrase}, or {missing_name} = "0*({text})"'
        " where nothing does"
    )


def _component_text(part: Node | Function) -> str:
    return part.name if isinstance(part, Function) else shortened_text(part)


def _cancels(components: Components, name: str, second_name: str, statement: Statement, shapes: Shapes) -> bool:
    """Whether the second of two components is written as the negative of the first."""
    first_tree, second_tree = components.get(name), components.get(second_name)
    if (
        first_tree is None
        or second_tree is None
        or isinstance(first_tree, Function)
        or isinstance(second_tree, Function)
    ):
        return False
    return _are_opposite(
        *(expand_definitions(tree, statement.definitions, shapes) for tree in (first_tree, second_tree))
    )


def _are_opposite(a: Node, b: Node) -> bool:
    """Whether two expressions are each other's negatives by their signs, factors, and the order of differences."""
    if a == negative(b) or b == negative(a):
        return True
    if not (isinstance(a, Binary) and isinstance(b, Binary) and a.operator == b.operator):
        return False
    if a.operator in "*/":
        return (a.right == b.right and _are_opposite(a.left, b.left)) or (
            a.left == b.left and _are_opposite(a.right, b.right)
        )
    if a.operator == "-" and a.left == b.right and a.right == b.left:
        return True
    return a.operator in "+-" and _are_opposite(a.left, b.left) and _are_opposite(a.right, b.right)
