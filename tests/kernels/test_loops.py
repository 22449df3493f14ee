"""Programs with loops, gathers and sums: the bits of plain Python, however they are printed."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from cases.array_programs import compiled, enclosed, gravity, in_python, plain_gravity
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import (
    AT,
    INTERVAL,
    Compute,
    Gather,
    Instruction,
    Line,
    Load,
    Location,
    Loop,
    Ordinal,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    line_count,
    loop_element,
)

Floats = NDArray[np.float64]
WIDTHS = (1, 4, 8, 16)


def bodies(n: int, case: int = 0) -> tuple[Floats, Floats]:
    """Places by axis and body, and masses."""
    random = np.random.default_rng([n, case])
    return random.normal(size=(3, n)), random.uniform(0.1, 2.0, n)


def program(*body: Instruction, **parts: object) -> Program:
    """A program of these lines."""
    return Program("lines", "Lines.", body, **parts)  # type: ignore[arg-type]


@pytest.mark.every(3)
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 9, 16, 30, 37])
@pytest.mark.parametrize("by_body", [False, True])
def test_gravity_has_the_bits_of_plain_python(n: int, *, by_body: bool) -> None:
    """Assert that one run has the bits of plain loops with 1, 4, 8, 16 bodies side by side, and printed as Python."""
    places, masses = bodies(n)
    wanted = plain_gravity(places, masses)
    y = np.ascontiguousarray(places.T if by_body else places).ravel()
    for call in [
        in_python(gravity(n, by_body=by_body)),
        *(compiled(gravity(n, by_body=by_body), abreast=w) for w in WIDTHS),
    ]:
        z = np.full(3 * n, 7.0)
        call(y=y, p=masses, z=z)
        found = z.reshape(n, 3).T if by_body else z.reshape(3, n)
        assert np.ascontiguousarray(found).tobytes() == wanted.tobytes()


@pytest.mark.parametrize("n", [3, 12])
@pytest.mark.parametrize("runs", WIDTHS)
def test_runs_side_by_side_have_the_bits_of_plain_python(n: int, runs: int) -> None:
    """Assert that every lane has the bits of plain loops."""
    cases = [bodies(n, case) for case in range(runs)]
    y = np.stack([places.ravel() for places, _ in cases], axis=1)
    p, z = np.stack([masses for _, masses in cases], axis=1), np.zeros((3 * n, runs))
    compiled(gravity(n), runs=runs)(y=y, p=p, z=z)
    for lane, case in enumerate(cases):
        assert z[:, lane].tobytes() == plain_gravity(*case).tobytes()


@pytest.mark.dear
@pytest.mark.parametrize("n", [3, 12])
def test_gravity_of_intervals(n: int) -> None:
    """Assert that bounds hold plain Python's numbers, are narrow, and have the same bits however they are printed."""
    (places, masses), wide = bodies(n), enclosed(gravity(n))
    y, p, plain = np.repeat(places.ravel(), 2), np.repeat(masses, 2), np.zeros(6 * n)
    in_python(wide)(y=y.tolist(), p=p.tolist(), z=plain)
    low, high = plain[::2], plain[1::2]
    wanted = plain_gravity(places, masses).ravel()
    assert np.all((low < wanted) & (wanted < high))
    assert np.all(high - low < 1e-11 * np.abs(wanted).max())
    for abreast in WIDTHS:
        z = np.zeros(6 * n)
        compiled(wide, abreast=abreast)(y=y, p=p, z=z)
        assert z.tobytes() == plain.tobytes(), abreast
    for runs in WIDTHS:
        z = np.zeros((6 * n, runs))
        compiled(wide, runs=runs)(y=np.repeat(y[:, None], runs, 1), p=np.repeat(p[:, None], runs, 1), z=z)
        assert all(z[:, lane].tobytes() == plain.tobytes() for lane in range(runs))


@pytest.mark.parametrize("by_body", [False, True])
def test_bodies_are_side_by_side(*, by_body: bool) -> None:
    """Assert that the text computes with eight bodies at once, and with one where those left over are fewer."""
    for n, wide in ((7, False), (8, True), (9, True)):
        text = llvm_of([gravity(n, by_body=by_body)], abreast=8)
        assert ("fdiv <8 x double>" in text) is wide
        assert ("fdiv double" in text) is (n % 8 > 0)


def test_the_size_of_a_program_is_that_of_all_its_passes() -> None:
    """Assert the number of lines when loops are written out."""
    assert line_count(lattice(5, 4).body) == 3 * 2 * 13
    assert line_count(program(Reduction("i", 7, (Load("x", loop_element("y")),), ("x",), ("all",))).body) == 7


def test_a_text_does_not_grow_with_what_it_loops_over() -> None:
    """Assert that a thousand bodies take as many lines as forty, with the same remainder by eight."""
    lines = [llvm_of([gravity(n)], abreast=8).count("\n") for n in (40, 1000)]
    assert lines[0] == lines[1] < 500


def test_passes_left_over_by_neighbours_are_a_loop() -> None:
    """Assert that two to seven elements beyond a multiple of eight take the same lines, and no pass is written twice."""
    lines = (Load("x", loop_element("y")), Compute("r", "multiply", ("x", "x")), StoreTo(loop_element("z"), "r"))
    texts = [llvm_of([program(Loop("i", 40 + rest, lines))], abreast=8) for rest in range(2, 8)]
    assert len({text.count("\n") for text in texts}) == 1
    assert texts[0].count("fmul double") == 1


def test_an_address_is_written_once_in_a_pass() -> None:
    """Assert that an element which is read, changed and stored has one address, and another pass has its own."""
    change = (Load("x", loop_element("z", 5)), Compute("r", "add", ("x", 1.0)), StoreTo(loop_element("z", 5), "r"))
    text = llvm_of([program(Loop("i", 40, change), Loop("i", 40, change))])
    assert text.count("ptr %_z, i64 %block") == 2


def test_a_value_from_before_a_loop_serves_neighbours() -> None:
    """Assert that what is computed once is repeated for elements side by side, and stays what it was after them."""
    lines = (Load("x", loop_element("y")), Compute("r", "multiply", ("m", "x")), StoreTo(loop_element("z"), "r"))
    after = (Compute("s", "add", ("m", 1.0)), StoreTo(Location("z", 17), "s"))
    made = program(Load("m", Location("p", 2)), Loop("i", 17, lines), *after)
    y, p, z = np.arange(17.0), np.array([0.0, 0.0, 3.0]), np.zeros(18)
    compiled(made, abreast=8)(y=y, p=p, z=z)
    assert "fmul <8 x double>" in llvm_of([made], abreast=8)
    assert z.tolist() == [*(3.0 * y), 4.0]


def test_short_loops_are_written_out() -> None:
    """Assert that eight passes are eight stores, and nine are a loop."""
    for count, stores, branches in ((8, 8, 0), (9, 1, 1)):
        text = llvm_of([program(Loop("i", count, (StoreTo(loop_element("z"), 2.0),)))])
        assert text.count("store double 0x4000000000000000") == stores
        assert text.count("= phi i64") == branches


def test_loops_around_loops_are_written_out_up_to_a_size() -> None:
    """Assert that six passes of fifty around two lines are six loops, and of fifty-one one loop within another."""
    for count, loops in ((50, 6), (51, 2)):
        inner = Loop(
            "i", count, (Load("x", loop_element("y")), StoreTo(Location("z", 0, (("i", 1), ("j", count))), "x"))
        )
        assert llvm_of([program(Loop("j", 6, (inner,)))]).count("= phi i64") == loops


@pytest.mark.parametrize("runs", [1, 4])
def test_a_function_from_outside_is_called_for_each_run(runs: int) -> None:
    """Assert that what is no operation of the language is called with plain numbers, and its result is used."""
    body = (Load("x", Location("y")), Compute("r", "outside", ("x",)), StoreTo(Location("z"), "r"))
    text = llvm_of([program(*body)], runs)
    calls = re.findall(r"(\S+) = call double @_outside\(double", text)
    assert len(calls) == runs
    assert all(len(re.findall(rf"{re.escape(call)}(?!\d)", text)) == 2 for call in calls)


@pytest.mark.parametrize("runs", [1, 4])
def test_large_local_arrays_are_on_the_heap(runs: int) -> None:
    """Assert that an array of up to 10,000 numbers, of all runs together, is on the stack; a larger one is freed where it is used, and where it is not."""
    for count, on_heap in ((10_000 // runs, False), (10_000 // runs + 1, True)):
        lines = (StoreTo(loop_element("own", count - 1, "i"), 3.0), Load("x", loop_element("own", count - 1, "i")))
        body = (Loop("i", 1, (*lines, StoreTo(loop_element("z"), "x"))),)
        made = program(*body, local={"own": count})
        text = llvm_of([made], runs)
        assert (f"%own = call ptr @malloc(i64 {8 * count * runs})" in text) is on_heap
        assert (f"%own = alloca double, i64 {count * runs}, align 8" in text) is not on_heap
        assert text.count("call void @free(ptr %own)") == 2 * on_heap  # with memory for all, and without
        z = np.zeros((1, runs))
        compiled(made, runs=runs)(z=z)
        assert z.tolist() == [[3.0] * runs]


def test_a_body_that_is_left_out_keeps_the_sign_of_zero() -> None:
    """Assert that a pass that adds nothing does not make -0.0 into 0.0."""
    never = (Ordinal("n", "i"), Compute("later", "more", ("n", 99.0)))
    total = Reduction("i", 12, never, ("n",), ("total",), start=-0.0, where="later")
    for call in map(compiled_or_printed(program(total, StoreTo(Location("z"), "total"))), (False, True)):
        z = np.ones(1)
        call(z=z)
        assert z.tobytes() == np.array([-0.0]).tobytes()


def compiled_or_printed(made: Program):
    """Return both ways to execute a program."""
    return lambda printed: in_python(made) if printed else compiled(made)


@pytest.mark.parametrize("count", [0, 5, 40])
@pytest.mark.parametrize(("operation", "start"), [("add", 0.0), ("least", np.inf), ("greatest", -np.inf)])
def test_reductions_are_ascending(operation: str, start: float, count: int) -> None:
    """Assert that numbers are joined one after the other, from the first on."""
    joined = Reduction("i", count, (Load("x", loop_element("y")),), ("x",), ("all",), operation, start)
    y = np.random.default_rng(count).normal(size=max(1, count)) * 10.0 ** np.arange(max(1, count))
    total = start
    for x in y[:count].tolist():
        total = {"add": total + x, "least": min(total, x), "greatest": max(total, x)}[operation]
    for call in (
        in_python(program(joined, StoreTo(Location("z"), "all"))),
        compiled(program(joined, StoreTo(Location("z"), "all"))),
    ):
        z = np.zeros(1)
        call(y=y, z=z)
        assert z[0] == total


@pytest.mark.every(3)
@pytest.mark.parametrize("side", ["below", "above"])
@pytest.mark.parametrize("kind", ["float", INTERVAL])
@pytest.mark.parametrize("n", [1, 3, 21])
def test_sums_over_those_before_or_after(n: int, kind: str, side: str) -> None:
    """Assert that each element sums over all before it, or after it, ascending, in every form and in every run."""
    terms: list[Line] = [Load("x", loop_element("y", index="j")), Load("m", loop_element("p", index="i"))]
    terms.append(Compute("f", "multiply", ("x", "m")))
    total = Reduction("j", n, tuple(terms), ("f",), ("total",), start=0.25, **{side: "i"})  # type: ignore[arg-type]
    made = program(Loop("i", n, (total, StoreTo(loop_element("z"), "total"))))
    made = enclosed(made) if kind == INTERVAL else made
    random = np.random.default_rng(n)
    y, p = random.normal(size=(2, n, 4))
    wanted = np.full((n, 4), 0.25)
    for i in range(n):
        for j in range(i) if side == "below" else range(i + 1, n):
            wanted[i] += y[j] * p[i]
    each = 2 if kind == INTERVAL else 1
    y, p, first = np.repeat(y, each, axis=0), np.repeat(p, each, axis=0), np.zeros((each * n, 4))
    compiled(made, runs=4)(y=y, p=p, z=first)
    alone = [np.ascontiguousarray(array[:, 2]) for array in (y, p)]
    for call in (in_python(made), *(compiled(made, abreast=abreast) for abreast in WIDTHS)):
        z = np.zeros(each * n)
        call(y=alone[0], p=alone[1], z=z)
        assert z.tobytes() == first[:, 2].tobytes()
    if kind == INTERVAL:
        assert np.all((first[::2] <= wanted) & (wanted <= first[1::2]))
        assert np.all(first[1::2] - first[::2] < 1e-13)
    else:
        assert first.tobytes() == wanted.tobytes()


def lattice(rows: int, columns: int) -> Program:
    """The sum of four neighbours less four times a site, for the inner sites of a lattice; corners add a constant site."""

    def at(row: int, column: int, array: str = "y") -> Location:
        return Location(array, (1 + row) * columns + 1 + column, (("row", columns), ("column", 1)))

    own = [Load("u", at(0, 0)), Load("corner", Location("y", 0))]
    own += [Load(f"u{k}", at(*moved)) for k, moved in enumerate([(-1, 0), (1, 0), (0, -1), (0, 1)])]
    own += [Compute("_a", "add", ("u0", "u1")), Compute("_b", "add", ("_a", "u2")), Compute("_c", "add", ("_b", "u3"))]
    own += [
        Compute("_d", "multiply", (4.0, "u")),
        Compute("_e", "subtract", ("_c", "_d")),
        Compute("f", "add", ("_e", "corner")),
    ]
    inner = Loop("column", columns - 2, (*own, StoreTo(at(0, 0, "z"), "f")))
    return program(Loop("row", rows - 2, (inner,)))


@pytest.mark.parametrize("abreast", WIDTHS)
def test_nested_loops_with_strides_over_two_indices(abreast: int) -> None:
    """Assert the bits of NumPy on a lattice of 23 by 12 sites, whose outer loop strides over rows."""
    u = np.random.default_rng(3).normal(size=(23, 12))
    wanted = (((u[:-2, 1:-1] + u[2:, 1:-1]) + u[1:-1, :-2]) + u[1:-1, 2:]) - 4.0 * u[1:-1, 1:-1] + u[0, 0]
    for call in (in_python(lattice(23, 12)), compiled(lattice(23, 12), abreast=abreast)):
        z = np.zeros((23, 12))
        call(y=u.ravel(), z=z.reshape(-1))
        assert z[1:-1, 1:-1].tobytes() == wanted.tobytes()
        assert not z[0].any()


def springs(links: list[tuple[int, int]], n: int) -> Program:
    """Forces of springs on a line: of every link once, to the local array `pull`; of each body those of its links in order."""
    ends = {end: tuple(link[k] for link in links) for k, end in enumerate(("first", "second"))}
    own = [[(k, side) for k, link in enumerate(links) for side in (0, 1) if link[side] == body] for body in range(n)]
    most = max(map(len, own))
    padded = [[*each, *[(0, 0)] * (most - len(each))] for each in own]
    tables = ends | {
        "count": tuple(map(len, own)),
        "link": tuple(k for each in padded for k, _ in each),
        "side": tuple(side for each in padded for _, side in each),
    }
    pulls = (
        Gather("a", Location("first", 0, (("k", 1),))),
        Gather("b", Location("second", 0, (("k", 1),))),
        Load("ua", Location("y", 0, (("a", 1),))),
        Load("ub", Location("y", 0, (("b", 1),))),
        Compute("d", "subtract", ("ub", "ua")),
        Compute("f", "sin", ("d",)),
        StoreTo(Location("pull", 0, (("k", 1),)), "f"),
    )
    gathered = (
        Gather("k", Location("link", 0, (("i", most), ("m", 1)))),
        Gather("s", Location("side", 0, (("i", most), ("m", 1)))),
        Load("f", Location("pull", 0, (("k", 1),))),
        Ordinal("ns", "s"),
        Ordinal("nm", "m"),
        Compute("t", "negative", ("f",)),
        Compute("second", "more", ("ns", 0.5)),
        Compute("own", "choose", ("second", "t", "f")),
        Compute("there", "less", ("nm", "many")),
    )
    of_body = (
        Gather("c", Location("count", 0, (("i", 1),))),
        Ordinal("many", "c"),
        Reduction("m", most, gathered, ("own",), ("total",), where="there"),
        StoreTo(Location("z", 0, (("i", 1),)), "total"),
    )
    return program(Loop("k", len(links), pulls), Loop("i", n, of_body), local={"pull": len(links)}, tables=tables)


@pytest.mark.every(3)
@pytest.mark.parametrize("abreast", WIDTHS)
def test_bodies_gather_the_forces_of_their_links(abreast: int) -> None:
    """Assert that links are done once and summed by bodies in order, with the bits of plain Python, in every form."""
    from xdynamics.elementary import FUNCTIONS

    random = np.random.default_rng(5)
    links = [(int(a), int(b)) for a, b in random.integers(0, 21, (57, 2))]
    u, wanted = random.normal(size=21), np.zeros(21)
    for i in range(21):
        for a, b in links:
            f = FUNCTIONS["sin"](float(u[b] - u[a]))
            wanted[i] += f if a == i else 0.0
            wanted[i] -= f if b == i else 0.0
    made = springs(links, 21)
    for call in (in_python(made), compiled(made, abreast=abreast)):
        z = np.zeros(21)
        call(y=u, z=z)
        assert z.tobytes() == wanted.tobytes()
    runs, z = np.stack([u, -u, u + 1.0, 2.0 * u], axis=1), np.zeros((21, 4))
    compiled(made, runs=4)(y=np.ascontiguousarray(runs), z=z)
    assert z[:, 0].tobytes() == wanted.tobytes()


@pytest.mark.parametrize("runs", [1, 4])
def test_calls_where_some_lane_asks_for_them(runs: int) -> None:
    """Assert calls: one always, one where a number is not zero in some lane, one until it is zero in all."""
    less = (
        Load("n", Location("w")),
        Compute("some", "more", ("n", 0.0)),
        Compute("m", "subtract", ("n", 1.0)),
        Compute("left", "choose", ("some", "m", "n")),
        StoreTo(Location("w"), "left"),
        Load("k", Location("y")),
        Compute("more", "add", ("k", 1.0)),
        StoreTo(Location("z"), "more"),
    )
    more = (Load("n", Location("w", 1)), Compute("m", "add", ("n", 5.0)), StoreTo(Location("w", 1), "m"))
    called = Program("less", "Less.", less), Program("more", "More.", more)
    own = program(
        ProgramCall("more", "at", "y", "z"),
        While(Location("w"), ProgramCall("less", "at", "e", "e")),
        When(Location("w"), ProgramCall("more", "at", "y", "z")),
        When(Location("w", 2), ProgramCall("more", "at", "y", "z")),
    )
    w, e = np.array([[3.0, 1.0, 2.0, 0.0], [0.0] * 4, [0.0, 0.0, 0.0, 1.0]])[:, -runs:].copy(), np.zeros(runs)
    repeated = w[0].max()
    compiled(own, *called, runs=runs)(w=w, e=e)
    assert w.tolist() == [[0.0] * runs, [10.0] * runs, [*[0.0] * (runs - 1), 1.0]]
    assert e.tolist() == [repeated] * runs


def test_what_has_one_argument_is_computed_together() -> None:
    """Assert that a sine and a cosine are one call with the bits of two, and a sine alone is a call of its own."""
    from xdynamics.elementary import FUNCTIONS

    sine = (Load("x", loop_element("y")), Compute("s", "sin", ("x",)), StoreTo(loop_element("z"), "s"))
    both = Compute("c", "cos", ("x",)), StoreTo(loop_element("z", 20), "c")
    apart, together = program(Loop("i", 20, sine)), program(Loop("i", 20, (*sine, *both)))
    for abreast in (1, 8):
        assert "@elementary_sin_cos" not in llvm_of([apart], abreast=abreast)
        assert "call double @elementary_sin(" not in llvm_of([together], abreast=abreast)
        y, z = np.linspace(-9.0, 9.0, 20), np.zeros(40)
        compiled(together, abreast=abreast)(y=y, z=z)
        assert z.tolist() == [FUNCTIONS[name](x) for name in ("sin", "cos") for x in y.tolist()]


@pytest.mark.parametrize("runs", [1, 4])
@pytest.mark.parametrize("count", [3, 20])
def test_a_program_answers_for_its_numbers(runs: int, count: int) -> None:
    """Assert that `unsound` is 0 if the numbers are finite, nan in lanes where one is not; those beside do not count."""
    copied = Loop("i", count + 2, (Load("x", loop_element("y")), StoreTo(loop_element("z"), "x")))
    y, at = np.ones((count + 2, runs)), np.ones((len(AT), runs))
    y[0], y[count + 1], y[count, 0] = np.inf, np.nan, np.nan
    for answered, sound in ((count - 1, True), (count, False)):
        compiled(program(copied, sound=(1, answered)), runs=runs)(y=y, z=np.zeros_like(y), at=at)
        assert np.isnan(at[AT.index("unsound")]).tolist() == [not sound, *[False] * (runs - 1)]
        assert np.nansum(at[AT.index("unsound")]) == 0.0


def test_rows_as_long_as_there_are_runs() -> None:
    """Assert that a stride equal to the number of runs is still multiplied by it."""
    u, z = np.random.default_rng(8).normal(size=(56, 4)), np.zeros((56, 4))
    compiled(lattice(14, 4), runs=4)(y=u, z=z)
    for lane in range(4):
        alone = np.zeros(56)
        in_python(lattice(14, 4))(y=u[:, lane], z=alone)
        assert z[:, lane].tobytes() == alone.tobytes()


@pytest.mark.parametrize("view", ["z", "part"])
@pytest.mark.parametrize("runs", [1, 4])
def test_a_row_of_the_log_is_written_to_its_column(runs: int, view: str) -> None:
    """Assert that elements of a row go as far apart as the log says, by number and in loops, and nowhere else."""
    body = Load("x", Location("y", 1, (("i", 3), J))), Compute("twice", "add", ("x", "x"))
    loops = Loop("i", 40, (Loop("j", 3, (*body, StoreTo(Location(view, 2, (("i", 3), J)), "twice"))),))
    made = program(StoreTo(Location("z"), 7.0), loops, spread=True, views={"part": ("z", 3, 122)})
    first = 2 + 3 * (view == "part")
    y, log = np.random.default_rng(9).normal(size=(121, runs)), np.zeros((130, 11, runs))
    wanted = log.copy()
    wanted[0, 4], wanted[first : first + 120, 4] = 7.0, 2.0 * y[1:]
    compiled(made, runs=runs, abreast=8, apart=11)(y=y, z=log.reshape(-1)[4 * runs :])
    assert log.tobytes() == wanted.tobytes()
    plain = np.zeros((130, 11))
    in_python(made)(y=y[:, 0], z=plain[:, 4])
    assert plain.tobytes() == wanted[..., 0].tobytes()


@pytest.mark.parametrize("abreast", WIDTHS)
def test_gathered_indices_have_strides(abreast: int) -> None:
    """Assert that elements of vectors that lie body by body are read at gathered bodies."""
    order = tuple(np.random.default_rng(4).permutation(19).tolist())
    body = (
        Gather("k", Location("order", 0, (("i", 1),))),
        Load("x", Location("y", 2, (("k", 3),))),
        Load("m", Location("p", 0, (("k", 1),))),
        Compute("mx", "multiply", ("x", "m")),
        StoreTo(loop_element("z"), "mx"),
    )
    y, p, z = np.arange(57.0), np.linspace(1.0, 2.0, 19), np.zeros(19)
    made = program(Loop("i", 19, body), tables={"order": order})
    for call in (in_python(made), compiled(made, abreast=abreast)):
        call(y=y, p=p, z=z)
        assert z.tolist() == [y[3 * k + 2] * p[k] for k in order]
        z[:] = 0.0


@pytest.mark.parametrize("runs", WIDTHS)
def test_lanes_look_up_tables_as_python_does(runs: int) -> None:
    """Assert that every lane finds its piece of the second of two tables, and its value and slope, with Python's bits."""
    origins = np.array([-2.0, -1.0, 0.5, 0.75, 4.0, 7.0])
    tables = np.concatenate([np.full(10, 9.0), origins, np.random.default_rng(2).normal(size=24)])
    places, x = np.array([0, 2, 1, 10, 6, 3]), np.linspace(-2.5, 7.0, runs)
    made = program(
        Load("x", Location("y")),
        Compute("k", "find_piece", ("x", 1)),
        Compute("kept", "piece_of", (1,)),
        Compute("a", "value_at", ("x", "k", 1)),
        Compute("b", "slope_at", ("x", "kept", 1)),
        StoreTo(Location("z"), "a"),
        StoreTo(Location("z", 1), "b"),
    )
    z, plain = np.zeros((2, runs)), np.zeros((2, runs))
    compiled(made, runs=runs)(y=x, z=z, tables=tables, pieces=np.repeat(places[:, None], runs, axis=1))
    for lane in range(runs):
        in_python(made)(y=x[lane : lane + 1], z=plain[:, lane], tables=tables, pieces=places)
    assert z.tobytes() == plain.tobytes()
    assert np.all(np.abs(np.diff(z[0])) > 0.0)


I, J = ("i", 1), ("j", 1)


@pytest.mark.parametrize(
    ("body", "independent"),
    [
        ((Load("x", Location("y", 0, (I,))), StoreTo(Location("z", 3, (I,)), "x")), True),
        ((Load("x", Location("y", 0, (I,))), StoreTo(Location("y", 0, (I,)), "x")), True),  # each its own
        ((Load("x", Location("y", 1, (I,))), StoreTo(Location("y", 0, (I,)), "x")), False),  # what the next pass writes
        ((Load("x", Location("y", 0, (I,))), StoreTo(Location("z", 3), "x")), False),  # one element for all
        ((Load("x", Location("z", 3)), StoreTo(Location("z", 0, (I,)), "x")), False),
        ((Loop("j", 4, (StoreTo(Location("z", 0, (("i", 4), J)), 0.0),)),), True),
        ((Loop("j", 4, (StoreTo(Location("z", 0, (I, ("j", 9))), 0.0),)),), True),
        ((Loop("j", 4, (StoreTo(Location("z", 0, (I, ("j", 8))), 0.0),)),), False),  # 9 passes reach the next row
        ((Loop("j", 4, (StoreTo(Location("z", 0, (("i", 3), J)), 0.0),)),), False),
        ((Gather("k", Location("t", 0, (I,))), StoreTo(Location("z", 0, (("k", 1),)), 0.0)), False),
        ((Gather("k", Location("t", 0, (I,))), StoreTo(Location("z", 0, (("k", 1), ("i", 99))), 0.0)), False),
        ((StoreTo(Location("z", 0, (I,)), 0.0), StoreTo(Location("z", 9, (I,)), 0.0)), True),
        ((StoreTo(Location("z", 0, (I,)), 0.0), StoreTo(Location("z", 8, (I,)), 0.0)), False),
        ((StoreTo(Location("z", 2, (("i", 3),)), 0.0), StoreTo(Location("z", 1, (("i", 3),)), 0.0)), True),
        ((StoreTo(Location("z", 0, (("i", 3),)), 0.0), StoreTo(Location("z", 99, (I,)), 0.0)), False),
        (
            (StoreTo(Location("z", 0, (("i", 3),)), 0.0), StoreTo(Location("z", 3, (("i", 3),)), 0.0)),
            False,
        ),  # where the next is
    ],
)
def test_passes_are_independent_where_none_meets_another(body: tuple[Line, ...], *, independent: bool) -> None:
    """Assert which loops may be computed side by side."""
    assert Loop("i", 9, body).independent is independent
