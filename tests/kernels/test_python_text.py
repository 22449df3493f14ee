"""How programs are printed as Python: signs, and how deep an expression may be."""

from __future__ import annotations

from itertools import pairwise

import pytest

from xdynamics.kernels.program import (
    Compute,
    EngineCall,
    Load,
    Location,
    Loop,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    loop_element,
)
from xdynamics.kernels.python_text import HIGHEST, python_of


def printed(*body: Compute) -> list[str]:
    """Lines of a program that computes `_r` of `_a` and `_b`, and stores it."""
    used = {argument for line in body for argument in line.arguments}
    loads = [Load(name, Location("y", k)) for k, name in enumerate(("_a", "_b")) if name in used]
    whole = (*loads, *body, StoreTo(Location("z"), "_r"))
    return [line.strip() for line in python_of(Program("lines", "Lines.", whole)).splitlines()[2:]]


@pytest.mark.parametrize(
    ("operation", "of", "line"),
    [
        ("negative", ("_s",), "_z[0] = --_y[0]"),
        ("add", ("_s", "_b"), "_z[0] = -_y[0] + _y[1]"),
        ("multiply", ("_s", "_b"), "_z[0] = -_y[0]*_y[1]"),
        ("divide", ("_b", "_s"), "_z[0] = _y[1]/-_y[0]"),
        ("divide", ("_s", 0.0), "_z[0] = -_y[0]/_zero"),
        ("subtract", (-1.0, "_s"), "_z[0] = -1.0 - -_y[0]"),
        ("multiply", ("_s", -2.0), "_z[0] = -_y[0]*-2.0"),
    ],
)
def test_signs_need_no_parentheses(operation: str, of: tuple[str | float, ...], line: str) -> None:
    """Assert that a sign binds more tightly than sums, products and other signs."""
    assert printed(Compute("_s", "negative", ("_a",)), Compute("_r", operation, of))[-1] == line


@pytest.mark.parametrize(("levels", "lines"), [(HIGHEST - 1, 1), (HIGHEST, 2), (2 * HIGHEST - 1, 2), (2 * HIGHEST, 3)])
def test_expressions_have_so_many_levels(levels: int, lines: int) -> None:
    """Assert that an expression is nested up to the limit, and parted above it, so that Python can compile it."""
    names = ["_a", *(f"_{k}" for k in range(1, levels)), "_r"]
    body = [Compute(new, "sin", (old,)) for old, new in pairwise(names)]
    made = printed(*body)
    assert len(made) == lines
    assert "".join(made).count("sin(") == levels


def test_the_deepest_expressions_can_be_compiled() -> None:
    """Assert that Python takes calls within calls as deep as they are printed: its parser allows 200 parentheses."""
    names = ["_a", *(f"_{k}" for k in range(1, 1000)), "_r"]
    body = [Compute(new, "sin", (old,)) for old, new in pairwise(names)]
    compile("\n".join(printed(*body)), "deep", "exec")


def test_the_deeper_operand_counts() -> None:
    """Assert that an expression is as deep as the deepest of its operands, in either place."""
    names = ["_a", *(f"_{k}" for k in range(1, HIGHEST))]
    deep = [Compute(new, "sin", (old,)) for old, new in pairwise(names)]
    for of in ((names[-1], "_b"), ("_b", names[-1])):
        assert len(printed(*deep, Compute("_s", "add", of), Compute("_r", "sin", ("_s",)))) == 2


def test_products_divided_by_zero_need_no_parentheses() -> None:
    """Assert that a quotient by zero, which Python's own division refuses, groups its numerator where it has to."""
    for operation, line in (("multiply", "_z[0] = _y[0]*_y[1]/_zero"), ("add", "_z[0] = (_y[0] + _y[1])/_zero")):
        assert printed(Compute("_p", operation, ("_a", "_b")), Compute("_r", "divide", ("_p", 0.0)))[-1] == line


def test_the_parts_of_a_function_in_their_order() -> None:
    """Assert that views of given arrays come first, then local arrays, views of these, tables, and the lines."""
    program = Program(
        "parts",
        "All parts.",
        (EngineCall(4),),
        {"k2": ("own", 0, 2), "q": ("y", 3, 2)},
        {"own": 5},
        tables={"ends": (0, 2)},
        sound=(1, 3),
    )
    assert [line.strip() for line in python_of(program).splitlines()[1:]] == [
        '"""All parts."""',
        "q = _y[3:5]",
        "own = _empty(5)",
        "k2 = own[0:2]",
        "ends = (0, 2)",
        "_entered(_p[4], _p[5], _at[0], _z)",
        "_at[7] = _unsound(_z[1:4])",
    ]


def test_a_choice_that_is_compared_is_in_parentheses() -> None:
    """Assert that what binds less tightly than a comparison is grouped on both of its sides."""
    choice = Compute("_s", "choose", ("_t", "_a", "_b"))
    for of, line in ((("_s", 2.0), "(_a if _a < _b else _b) < 2.0"), ((2.0, "_s"), "2.0 < (_a if _a < _b else _b)")):
        made = printed(Compute("_t", "less", ("_a", "_b")), choice, Compute("_r", "less", of))
        assert made[-1] == f"_z[0] = {line}"


@pytest.mark.parametrize(("line", "word"), [(When, "if"), (While, "while")])
def test_a_call_under_a_condition(line: type[When | While], word: str) -> None:
    """Assert that a call is made where a number is not zero, and that nothing else is."""
    body = (line(Location("w", 3), ProgramCall("forces", "own_at", "y", "w")),)
    made = python_of(Program("lines", "Lines.", body)).splitlines()[2:]
    assert made[0].strip() == f"{word} _w[3]:"
    assert made[1].startswith("        forces(own_at, _y, ")
    assert len(made) == 2


@pytest.mark.parametrize("where", ["", "_truth"])
def test_a_masked_sum_leaves_passes_out(where: str) -> None:
    """Assert that the truth of a pass is written where it decides, and that a sum without one decides nothing."""
    place = Location("y", 0, (("i", 1),))
    body = (Load("_x", place), *((Compute("_truth", "less", ("_x", 1.0)),) if where else ()))
    total = Reduction("i", 4, body, ("_x",), ("_total",), "add", (0.0,), where)
    made = python_of(Program("lines", "Lines.", (total, StoreTo(Location("z"), "_total")))).splitlines()[2:]
    inner = [line.strip() for line in made]
    assert inner[0] == "_total = 0.0"
    assert inner[1] == "for i in range(4):"
    assert inner[-1] == "_z[0] = _total"
    if where:
        assert inner[2:-1] == ["_x = _y[i]", "if _x < 1.0:", "_total = _total + _x"]
        assert made[-2].startswith("            ")
    else:
        assert inner[2:-1] == ["_total = _total + _y[i]"]


@pytest.mark.parametrize("before", [True, False])
def test_what_a_loop_reads_is_computed_before_it(*, before: bool) -> None:
    """Assert that a value from outside a loop has a line of its own, read once there, and before or not."""
    loop = Loop("i", 4, (StoreTo(loop_element("z", 1), "_s"),))
    stored = (StoreTo(Location("z"), "_s"),) if before else ()
    body = (Load("_a", Location("y")), Compute("_s", "sin", ("_a",)), *stored, loop)
    made = python_of(Program("lines", "Lines.", body)).splitlines()[2:]
    wanted = ["_s = sin(_y[0])", "_z[0] = _s", "for i in range(4):", "_z[1 + i] = _s"]
    assert [line.strip() for line in made] == [line for line in wanted if before or line != "_z[0] = _s"]


def test_the_newest_term_takes_the_place_of_the_total() -> None:
    """Assert that joining by "newest" prints the term alone."""
    place = Location("y", 0, (("i", 1),))
    total = Reduction("i", 4, (Load("_x", place),), ("_x",), ("_total",), "newest", (0.0,))
    made = python_of(Program("lines", "Lines.", (total, StoreTo(Location("z"), "_total")))).splitlines()[2:]
    assert [line.strip() for line in made] == ["_total = 0.0", "for i in range(4):", "_total = _y[i]", "_z[0] = _total"]
