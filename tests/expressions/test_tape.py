"""Expressions as a list of operations: the bits of `evaluate`, tree by tree, on random trees that share their parts."""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path

import pytest

import xdynamics as xd
from xdynamics.expressions import Binary, Call, Compare, Name, Negative, Node, Number
from xdynamics.expressions.evaluation import Tape, evaluate
from xdynamics.faults import InputError
from xdynamics.model.linearisation import derivative_assignments, initial_state, linearise
from xdynamics.model.motion import constants, drive_pieces, motion

MODELS = sorted((Path(__file__).parents[2] / "data" / "models").glob("*.toml"))
EXPONENTS = (2.0, 3.0, 4.0, 7.0, 0.5, 1.5, 2.5, 0.0, 1.0, 0.25)
VALUES = (0.0, -0.0, 1.0, -2.5, 1e-310, 1e300, math.inf, -math.inf, math.nan)


def any_tree(rng: random.Random, parts: list[Node], depth: int) -> Node:
    """A tree of everything that the language has, parts of which stand in others too."""
    if depth == 0 or rng.random() < 0.1:
        return rng.choice(parts)
    kind = rng.randrange(6)
    inner = [any_tree(rng, parts, depth - 1) for _ in range(3)]
    if kind == 0:
        power = Number(rng.choice(EXPONENTS))
        found: Node = Binary("**", inner[0], rng.choice([power, Negative(power)]))
    elif kind == 1:
        found = Call(rng.choice(["sqrt", "abs", "sign", "sin", "exp", "log", "atan"]), (inner[0],))
    elif kind == 2:
        found = Call(rng.choice(["min", "max", "atan2", "hypot"]), tuple(inner[:2]))
    elif kind == 3:
        comparison = Compare(rng.choice(["<", "<=", ">", ">=", "==", "!="]), inner[0], inner[1])
        found = Call("where", (comparison, inner[1], inner[2]))
    elif kind == 4:
        found = Negative(inner[0])
    else:
        found = Binary(rng.choice("+-*/"), inner[0], inner[1])
    parts.append(found)
    return found


def bits(value: float) -> bytes:
    """What a number is made of; of what is none only that it is none."""
    return b"nan" if math.isnan(value) else struct.pack("<d", value)


@pytest.mark.cases(400)
def test_every_number_has_the_bits_of_its_tree(case: int) -> None:
    """Assert that expressions that use one another give what they give one by one, zeros with their signs."""
    rng = random.Random(case)
    parts: list[Node] = [*(Name(name) for name in "abc"), Number(0.0), Number(2.0), Number(0.1)]
    named = []
    for i in range(rng.randint(1, 5)):
        named.append((f"_{i}", any_tree(rng, parts, rng.randint(0, 5))))
        parts.append(Name(f"_{i}"))
    tape = Tape(named)
    for _ in range(5):
        values = {name: rng.choice([rng.gauss(0.0, 2.0), rng.choice(VALUES)]) for name in "abc"}
        found, expected = tape.evaluate_tape(values), dict(values)
        for name, tree in named:
            expected[name] = evaluate(tree, expected)
        assert {name: bits(value) for name, value in found.items()} == {name: bits(expected[name]) for name, _ in named}


def test_a_sum_may_be_long_and_equal_parts_are_computed_once() -> None:
    """Assert that ten thousand terms are taken in a loop, and that they cost one operation each."""
    term: Node = Call("sin", (Name("a"),))
    total = term
    for _ in range(9_999):
        total = Binary("+", total, Call("sin", (Name("a"),)))
    tape = Tape([("total", total), ("again", total)])
    assert len(tape._steps) == 10_000
    found = tape.evaluate_tape({"a": 1.0})
    assert found == {"total": evaluate(total, {"a": 1.0}), "again": found["total"]}


def test_a_name_means_what_it_was_given_last() -> None:
    """Assert that a tree that stands on both sides of a new meaning has both values, and that a name needs one."""
    tree = Binary("*", Name("a"), Name("a"))
    tape = Tape([("old", tree), ("a", Number(3.0)), ("new", tree)])
    assert tape.evaluate_tape({"a": 2.0}) == {"old": 4.0, "a": 3.0, "new": 9.0}
    with pytest.raises(InputError, match="name 'a' has no value; there are b"):
        tape.evaluate_tape({"b": 1.0})


@pytest.mark.every(3)
@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_jacobians_of_the_gallery_have_the_bits_of_their_trees(path: Path) -> None:
    """Assert it of every derivative at the start, each tree evaluated by itself."""
    model = xd.Model.from_toml(path)
    if model.python_forces or model.drives or len(model.regimes) > 1:
        return
    state = initial_state(model)
    values = dict(constants(model)) | state | {"_regime": 0.0}
    assert drive_pieces(model) == ()
    for one in (*motion(model), *derivative_assignments(model)):
        values[one.name] = evaluate(one.value, values)
    found = linearise(model, state).jacobian.tolist()
    names = (
        *model.statement.coordinates,
        *(f"v_{name}" for name in model.statement.coordinates),
        *model.statement.states,
    )
    n = len(model.statement.coordinates)
    for i, name in enumerate(model.statement.coordinates):
        expected = [values.get(f"_da_{name}_{by}", 0.0) for by in names]
        assert list(map(bits, found[n + i])) == list(map(bits, expected))
