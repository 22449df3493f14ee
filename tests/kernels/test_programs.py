"""Programs: one meaning, printed as Python, as LLVM text, and with any number of lanes.

How programs are printed as Python: signs, and how deep an expression may be.
Programs of sums of two floats: as machine code and as printed Python one computation, to the bit.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.bench import Bench
from cases.problems import MODELS, coupled_springs, particle
from xdynamics.expressions import Name, parse
from xdynamics.kernels import Law, law_of, layout_of
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.law import CONTROL, FORCE_SAMPLES, ROW_ENERGIES, key_of
from xdynamics.kernels.llvm_loops import UNROLLED
from xdynamics.kernels.program import (
    UNSOUND,
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
from xdynamics.methods.scheme import COMPENSATED, DOUBLE_DOUBLE, Scheme, updates
from xdynamics.methods.scheme import PLAIN as PLAIN_SUMS

EXPLICIT = [one for one in xd.METHODS.values() if not one.solves]
LANES = (2, 4, 8, 16)


def chain(n: int) -> xd.Model:
    """Masses on a line, each joined to the next by a spring."""
    names = [f"u{i}" for i in range(n)]
    forces = {}
    for i, name in enumerate(names):
        left = f"({names[i - 1]} - {name})" if i else f"(-{name})"
        right = f"({names[i + 1]} - {name})" if i + 1 < n else f"(-{name})"
        forces[name] = f"k*{left} + k*{right}"
    initial = {name: f"{0.01 * (i % 3)} m" for i, name in enumerate(names)} | {f"v_{name}": "0 m s-1" for name in names}
    return xd.Model(
        name="chain",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "k": "100 N m-1"},
        mass=dict.fromkeys(names, "m"),
        forces={"spring": forces},
        initial=initial,
    )


def two_tables() -> xd.Model:
    """A mass that is driven by a table of time and one of its place, which have their pieces one after the other."""
    tables = {
        "pull": {"table": "p.csv", "csv": "t [s],pull [N]\n0,0\n0.003,3\n2,1\n9,0\n"},
        "wall": {"table": "w.csv", "csv": "x [m],wall [N]\n-1,2\n0.999,1\n1.0004,0\n3,5\n", "argument": "x"},
    }
    return particle(
        name="two tables",
        parameters={"m": "1 kg"},
        forces={"both": {"x": "pull - wall"}},
        drives=tables,
        initial={"x": "1 m", "v_x": "0.1 m s-1"},
    )


@lru_cache
def model_named(name: str) -> xd.Model:
    """A model of data/models, or one made here."""
    made = {"chain": lambda: chain(12), "springs": lambda: coupled_springs().model, "two_tables": two_tables}
    return made[name]() if name in made else xd.Model.from_toml(MODELS / f"{name}.toml")


def law(name: str, method: object, *, sampled: bool = False) -> Law:
    """The law of a model and a method, with the summation that it has unless another is asked for."""
    estimator = "embedded" if method.estimate else "none"
    summation = COMPENSATED if method.symplectic and updates(method) else PLAIN_SUMS
    return law_of(layout_of(model_named(name), Scheme(method, estimator, summation=summation)), sampled=sampled)


def starts(one: Law, lanes: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """States around the initial one, and steps."""
    random = np.random.default_rng(7)
    initial = np.array([one.layout.model.initial[name].si for name in one.layout.used])
    states = initial[:, None] + 1e-3 * random.standard_normal((initial.size, lanes))
    return states, random.uniform(1e-3, 1e-2, lanes)


IN_LANES = ("kepler", "ball_drag", "cart_spring", "chain", "springs", "two_tables", "rocket_c6")
# two methods by every model, the others by two or three in turn
LAWS_IN_LANES = [
    pytest.param(name, method, id=f"{method.name}-{name}")
    for i, method in enumerate(EXPLICIT)
    for j, name in enumerate(IN_LANES)
    if method.name in ("velocity_verlet", "dop853") or (j - i) % 3 == 0
]


@pytest.mark.every(19)
@pytest.mark.parametrize(("name", "method"), LAWS_IN_LANES)
def test_lanes_have_the_bits_of_one(name: str, method: object) -> None:
    """Assert that 2, 4, 8 and 16 lanes compute in each lane what one computes alone, in every program of a law."""
    if method.refusals(model_named(name)):
        pytest.skip("refused")
    one = law(name, method, sampled=True)
    states, steps = starts(one, 16)
    alone = []
    for lane in range(16):
        bench = Bench(one, 1, states[:, [lane]], steps[[lane]])
        for address in one.addresses_inside[len(CONTROL) :]:
            bench.call(int(address))
        alone.append(bench)
    for lanes in {"velocity_verlet": LANES, "dop853": LANES[::3]}.get(method.name, (4,)):
        code = one.compiled(lanes)
        bench = Bench(one, lanes, states[:, :lanes], steps[:lanes])
        for program in one.entries:
            bench.call(code.addresses[program.name])
        for lane in range(lanes):
            for mine, other in zip(
                (bench.z, bench.e, bench.samples), (alone[lane].z, alone[lane].e, alone[lane].samples), strict=True
            ):
                assert mine[:, lane].tobytes() == other[:, 0].tobytes(), (lanes, lane)
        assert np.any(bench.z)


PRINTED = ("two_tables", *sorted(path.stem for path in MODELS.glob("*.toml")))


@pytest.mark.every(13)
@pytest.mark.parametrize("turn", range(len(PRINTED)), ids=PRINTED)
def test_printed_python_has_the_bits_of_machine_code(turn: int, request: pytest.FixtureRequest) -> None:
    """Assert that what a record quotes, run as it stands, computes every number that the compiled law does.

    By two of the methods that take the model, in turn; with --whole by all.
    """
    name = PRINTED[turn]
    methods = [
        one
        for one in ("midpoint", "velocity_verlet", "dop853", "dprkn6")
        if not xd.METHODS[one].refusals(model_named(name))
    ]
    first = turn % len(methods)
    for method in [*methods, *methods][first : first + (len(methods) if request.config.getoption("--whole") else 2)]:
        one = law(name, xd.METHODS[method], sampled=True)
        states, steps = starts(one, 1)
        compiled, printed = Bench(one, 1, states, steps), Bench(one, 1, states, steps)
        for address, key in zip(one.addresses_inside[len(CONTROL) :], one.plain[len(CONTROL) :], strict=True):
            compiled.call(int(address))
            printed.call_plainly(int(key))
        for mine, other in zip(compiled.arrays(), printed.arrays(), strict=True):
            assert mine.tobytes() == other.tobytes(), method


def test_printed_python_tells_what_is_unsound() -> None:
    """Assert, of a state that is no number, that the same programs say so in machine code and as printed."""
    one = law("kepler", xd.METHODS["rk4"])
    states, steps = starts(one, 1)
    states[0] = np.nan
    compiled, printed = Bench(one, 1, states, steps), Bench(one, 1, states, steps)
    said = []
    for address, key in zip(one.addresses_inside[len(CONTROL) :], one.plain[len(CONTROL) :], strict=True):
        compiled.call(int(address))
        printed.call_plainly(int(key))
        said.append([bool(bench.at[UNSOUND, 0] != 0.0) for bench in (compiled, printed)])
    assert any(mine for mine, _ in said)
    assert all(mine == other for mine, other in said)


@pytest.mark.dear
def test_loops_have_the_bits_of_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that vectors as loops and vectors written out are one computation."""
    assert len(model_named("chain").elements.statement.coordinates) > UNROLLED
    from xdynamics.kernels import llvm_loops

    one = law("chain", xd.METHODS["dormand_prince"])
    states, steps = starts(one, 1)
    loops, lines = Bench(one, 1, states, steps), Bench(one, 1, states, steps)
    assert "phi" in one.text()
    monkeypatch.setattr(llvm_loops, "UNROLLED", 1000)
    assert "phi" not in one.text()
    written = one.compiled()
    for program, address in zip(one.entries, one.addresses_inside[len(CONTROL) :], strict=True):
        loops.call(int(address))
        lines.call(written.addresses[program.name])
    for mine, other in zip(loops.arrays(), lines.arrays(), strict=True):
        assert mine.tobytes() == other.tobytes()


def test_nothing_is_contracted_or_reordered() -> None:
    """Assert that the text asks for no fused operation and no licence to reorder, and the lanes for no reduction."""
    text = law("kepler", xd.METHODS["dop853"]).text(8)
    for word in ("fma", "fast", "reassoc", "contract", "reduce.f", "arcp", "nnan"):
        assert word not in text


def test_a_part_that_stands_twice_is_computed_once() -> None:
    """Assert that equal parts share a value, and that powers are products and square roots."""
    lines = Assignments(lambda own, name: own.load(Location("p", ord(name)), name))
    lines.assign("first", parse("a*b + (a*b)**3"))
    lines.assign("second", parse("(a*b)**-1.5"))
    operations = [line.operation for line in lines.lines if isinstance(line, Compute)]
    assert operations == ["multiply", "multiply", "multiply", "add", "sqrt", "multiply", "divide"]
    assert sum(isinstance(line, Load) for line in lines.lines) == 2


def test_names_never_dangle() -> None:
    """Assert that a value that is given two names stays known by both."""
    lines = Assignments(
        lambda own, name: (
            own.compute("sin", own.load(Location("p"), "p0")) if name == "drive" else own.load(Location("y"), name)
        )
    )
    lines.assign("force", Name("drive"))
    lines.assign("other", parse("drive + 1"))
    targets = {line.target for line in lines.lines}
    used = {
        argument
        for line in lines.lines
        if isinstance(line, Compute)
        for argument in line.arguments
        if isinstance(argument, str)
    }
    assert used <= targets
    assert lines.operand_of("force") in targets


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("a - (b - c)", "a - (b - c)"),
        ("a/(b*c)", "a/(b*c)"),
        ("(a/b)*c", "a/b*c"),
        ("-(a + b)*c", "-(a + b)*c"),
        ("where(a < b, a, -b)", "a if a < b else -b"),
        ("max(a, b, c)", "_greatest(_greatest(a, b), c)"),
        ("1/0*a", "1.0/_zero*a"),
        ("1/(2 - 2)*a", "1.0/_zero*a"),
        ("a**(1/3)", "_power(a, 0.3333333333333333)"),
    ],
)
def test_python_keeps_the_grouping(text: str, printed: str) -> None:
    """Assert that a line says what was written, with the parentheses that its order needs."""
    lines = Assignments(lambda own, name: own.load(Location("p", ord(name) - 97), name))
    lines.store(Location("z"), lines.value(parse(text)))
    program = Program("one", "One line.", tuple(lines.lines))
    assert f"    _z[0] = {printed}\n" in python_of(program)


def test_stores_and_loads_are_printed_in_order() -> None:
    """Assert that a store stands behind what it needs."""
    body = (Load("a", Location("y", 1)), Compute("b", "add", ("a", 1.0)), StoreTo(Location("z", 2), "b"))
    assert python_of(Program("one", "About.", body)).splitlines()[2:] == [
        "    a = _y[1]",
        "    b = a + 1.0",
        "    _z[2] = b",
    ]


def test_the_source_in_a_record_is_the_law() -> None:
    """Assert that a record quotes the programs, and names its digest after them."""
    import hashlib

    run = xd.simulate(particle("F"), method="midpoint", step=0.5, until=1.0)
    source = run["force_source"].values.item()
    assert "def forces(" in source
    assert "def propose(" in source
    assert run.attrs["force_digest"] == hashlib.sha256(source.encode()).hexdigest()
    compile(source, "law", "exec")


@pytest.mark.parametrize(
    "exponent", ["2", "3", "4", "5", "7", "11", "16", "-1", "-5", "0.5", "1.5", "2.5", "-2.5", "1/3"]
)
def test_powers_are_the_language_s(exponent: str) -> None:
    """Assert that a power comes out as `evaluate` has it, whose products and roots the language defines."""
    from xdynamics.expressions.evaluation import evaluate
    from xdynamics.kernels.python_text import PYTHON

    tree = parse(f"a**({exponent})")
    lines = Assignments(lambda own, name: own.load(Location("y"), name))
    lines.store(Location("z"), lines.value(tree))
    scope = dict(PYTHON)
    exec(python_of(Program("one", "A power.", tuple(lines.lines))), scope)
    y, z = np.array([1.7]), np.zeros(1)
    scope["one"](None, y, None, None, None, z, None, None, None)
    assert z[0] == evaluate(tree, {"a": 1.7})
    assert z[0] == pytest.approx(1.7 ** float(eval(exponent)), rel=1e-15)


def test_minus_zero_is_another_number() -> None:
    """Assert that 0.0 and -0.0, which are equal, are not taken for one: they are two angles of atan2."""
    run = xd.simulate(
        particle(
            forces={"up": {"x": "F*atan2(0, x/metre)"}, "down": {"x": "F*atan2(-0, x/metre)"}},
            initial={"x": "-1 m", "v_x": "0 m s-1"},
        ),
        method="midpoint",
        step=0.5,
        until=1.0,
    )
    assert float(run.force_up_x[0]) == -float(run.force_down_x[0]) > 0.0


@pytest.mark.parametrize("method", ["rk4", "dop853", "implicit_midpoint", "radau_iia"])
def test_a_law_that_is_kept_is_not_printed_again(method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that another process finds code, text and equations by the model's form, whatever its numbers are."""
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    tmp_path.chmod(0o700)
    scheme, model = Scheme(xd.METHODS[method]), model_named("pendulum")
    first = Law(layout_of(model, scheme), sampled=True)
    assert (first.addresses != 0).sum() == len(first.addresses) - 1  # nothing inside a step yet
    for name in ("python_of", "llvm_of"):
        monkeypatch.setattr(f"xdynamics.kernels.law.{name}", lambda *_, **__: pytest.fail("printed again"))
    second = Law(layout_of(model.replace(parameters={"l": 2.0}), scheme), sampled=True)
    assert (second.addresses != 0).tolist() == (first.addresses != 0).tolist()
    assert (second.source, second.memory, second.equations) == (first.source, first.memory, first.equations)
    assert second.printed.names == tuple(entry.name for entry in first.entries)


def test_what_laws_are_kept_by() -> None:
    """Assert that another form, method, estimator, summation or set of functions is another law, and other numbers are none."""
    model = model_named("pendulum")
    scheme = Scheme(xd.METHODS["rk4"])
    others = [
        Scheme(xd.METHODS["heun"]),
        *(replace(scheme, **{key: "another"}) for key in ("estimator", "summation", "math_functions")),
    ]
    layouts = [layout_of(model, one) for one in (scheme, *others)] + [layout_of(model_named("kepler"), scheme)]
    unread = ((), (ROW_ENERGIES,), (FORCE_SAMPLES,), (ROW_ENERGIES, FORCE_SAMPLES))
    keys = [key_of(layout, sampled, *left) for layout in layouts for sampled in ("True", "False") for left in unread]
    assert len(set(keys)) == len(keys) == 48
    assert key_of(layout_of(model.replace(parameters={"l": 2.0}), scheme), "True") == keys[0]


@pytest.mark.parametrize(("argument", "header"), [("t", "time [s]"), ("x", "x [m]")])
def test_resampled_tables_have_one_law(argument: str, header: str) -> None:
    """Assert that models whose tables differ in numbers alone share a law, and one whose table has another unit does not."""

    def pulled(points: int, unit: str = "N") -> xd.Model:
        rows = "\n".join(f"{k},{k % 3}" for k in range(points))
        table = {
            "table": f"{points}.csv",
            "csv": f"{header},pull [{unit}]\n{rows}\n",
            "argument": argument,
            "outside": "hold",
        }
        force = "pull" if unit == "N" else "pull*newton/metre"
        return xd.Model(
            name=f"{points} points",
            coordinates={"x": "m"},
            mass={"x": "1*kilogram"},
            forces={"pull": {"x": force}},
            drives={"pull": table},
            initial={"x": "1 m"},
        )

    def law_of_it(model: xd.Model) -> Law:
        return law_of(layout_of(model, Scheme(xd.METHODS["rk4"], "none")), sampled=True)

    laws = [law_of_it(pulled(points)) for points in range(4, 68)]
    assert len({id(one) for one in laws}) == 1
    assert law_of_it(pulled(5, "m")) is not laws[0]
    ends = [float(xd.simulate(pulled(points), method="rk4", step=0.01, until=0.5).x[-1]) for points in (4, 5)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)  # within the first two rows both are the same table


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


CHEAP = [("kepler", "velocity_verlet"), ("driven", "velocity_verlet")]
DEAR = [(name, method) for name in ("kepler", "driven") for method in ("rk4", "heun", "dop853", "taylor")]
FUNCTIONS = "sin(u)*cos(u) + exp(-u) + log(1 + u*u) + sqrt(1 + u*u) + atan2(u, 2) + tanh(u) + abs(u) + (1 + u*u)**(1/3)"
MARCHED = """
import xdynamics as xd
model = xd.Model(
    name="driven", coordinates={"x": {"unit": "mm"}}, parameters={"k": "0.1 N m-1", "m": "0.3 kg", "w": "1.1 s-1"},
    mass={"x": "m"}, forces={"spring": {"x": "-k*x + 0.01*newton*sin(w*t)"}},
    events={"middle": {"function": "x", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
    initial={"x": "1.1 mm", "v_x": "-12.3 mm s-1"})
run = xd.simulate(model, until="0.25 s", method="rk4", step="0.1 s", precision="double_double")
print(run.sizes["event"], xd.content_digest(run))
"""


def driven() -> xd.Model:
    """Return a point under a force of most functions of the language, with a table, an event and what it sets."""
    table = {"table": "p.csv", "csv": "t [s],pull [N]\n0,0\n0.1,3\n0.4,1\n9,0\n"}
    return particle(
        name="driven",
        parameters={"m": "0.3 kg"},
        forces={
            "all": {"x": f"0.1*newton*({FUNCTIONS.replace('u', 'x/metre')}) + pull*where(v_x > 0*metre/second, 1, 3)"}
        },
        drives={"pull": table},
        events={"gate": {"function": "x - 0.3*metre", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
        observables={"height": "x**2/metre"},
        initial={"x": "0.1 m", "v_x": "0.7 m s-1"},
    )


@pytest.mark.parametrize(("name", "method"), [*CHEAP, *(pytest.param(*case, marks=pytest.mark.dear) for case in DEAR)])
def test_printed_python_with_rests_has_the_bits_of_machine_code(name: str, method: str) -> None:
    """Assert that every program of a law fills every array alike, with numbers that have rests."""
    model = driven() if name == "driven" else xd.Model.from_toml(MODELS / f"{name}.toml")
    one = law_of(layout_of(model, Scheme(xd.METHODS[method], precision=DOUBLE_DOUBLE)), sampled=True)
    states = np.array([[one.layout.model.initial[used].si + 0.01] for used in one.layout.used])
    compiled, printed = (Bench(one, 1, states, np.array([0.01])) for _ in range(2))
    before = compiled.p.tobytes()
    for address, key in zip(one.addresses_inside[len(CONTROL) :], one.plain[len(CONTROL) :], strict=True):
        compiled.call(int(address))
        printed.call_plainly(int(key))
    for mine, other in zip(compiled.arrays(), printed.arrays(), strict=True):
        assert mine.tobytes() == other.tobytes()
    assert compiled.p.tobytes() == before
    distance = one.layout.used.size + one.layout.evaluation.size
    ends, rests = compiled.z[: one.layout.used.size, 0], compiled.z[distance : distance + one.layout.used.size, 0]
    assert np.all(rests)
    assert np.all(np.abs(rests) <= np.spacing(np.abs(ends)) / 2)


@pytest.mark.dear
def test_a_march_has_the_same_bits_without_a_compiler() -> None:
    """Assert equal digests of a march with a root and a reset in it."""
    said = [
        subprocess.run(
            [sys.executable, "-c", MARCHED], env=os.environ | more, capture_output=True, text=True, check=True
        ).stdout.split()
        for more in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert said[0] == said[1]
    assert said[0][0] == "1"
