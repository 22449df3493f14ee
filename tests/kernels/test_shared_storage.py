"""Large arrays of a step that stand where others are read no more: less memory, the same numbers."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd
from cases.chain_steps import EXPLICIT, chain_law, executed, left_by, lengths_of
from xdynamics.documenting.manual import manual_text
from xdynamics.kernels.program import Compute, Gather, Load, Location, Loop, Program, ProgramCall, StoreTo, loop_element
from xdynamics.kernels.shared_storage import coalesce_copies, effects_of, with_shared_storage
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record.run_dataset import sizes_of_march

# numbers for each site in arrays of a step: of dop853 velocities and accelerations at its eight stages that the result
# is made of, where all the others stood before; of methods that drift and kick those at one state
NUMBERS = {"dop853": 16, "dormand_prince": 9, "rk4": 6, "bogacki_shampine": 5, "midpoint": 0, "yoshida8": 4, "ruth3": 3}


@pytest.mark.parametrize("sampled", [True, False])
@pytest.mark.parametrize("name", EXPLICIT)
def test_steps_keep_their_numbers(name: str, sampled: bool) -> None:
    """Assert that a step of every explicit method leaves the same bits everywhere, in no more numbers than before."""
    law = chain_law(name, sampled=sampled)
    lengths, thin = lengths_of(law), dict[str, Program]()
    for program in law.programs:
        fewer = coalesce_copies(program, thin, lengths)
        thin[program.name] = with_shared_storage(fewer, thin, lengths, 2)
        assert sum(thin[program.name].local.values()) <= sum(fewer.local.values())
    for name_of_program in ("propose", "inside"):
        plain, other = (left_by(law, [*texts], name_of_program) for texts in (law.programs, thin.values()))
        for array, values in plain.items():
            assert values.tobytes() == other[array].tobytes(), array


@pytest.mark.parametrize("name", NUMBERS)
def test_a_step_holds_what_it_reads_again(name: str) -> None:
    """Assert how many numbers a site the arrays of a step have, where force samples are not kept."""
    model = xd.Model.from_text(MASSES)
    march = March(model, settings_for(model, method=name, step=0.1, until=1.0, log="states"))
    assert march.law.storage / MANY == pytest.approx(NUMBERS[name], abs=0.05)
    assert sizes_of_march(march)["stages"] == 8.0 * march.law.storage


def test_help_tells_what_stages_take() -> None:
    """Assert that `help shapes` has the bytes of stages for each mass."""
    told = [8 * NUMBERS[name] for name in ("rk4", "dormand_prince", "dop853")]
    assert "take {}, {} and {}".format(*told) in " ".join(manual_text("shapes.md").replace("`", "").split())


MANY = 12_000
MASSES = f"""
name = "masses on springs"
[dimensions]
site = {MANY}
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[mass]
u = "1*kilogram"
[forces.spring]
u = "-u*newton/metre"
[initial]
u = "1 m"
"""


def copy(source: str, target: str, first: int = 0, name: str = "") -> Loop:
    """Return a loop that adds 1 to five numbers of an array on their way to another."""
    names = f"_{source}{target}{name}", f"_{target}{source}{name}"
    lines = Load(names[0], loop_element(source, first)), Compute(names[1], "add", (names[0], 1.0))
    return Loop("i", 5, (*lines, StoreTo(loop_element(target), names[1])))


SIZES = {"at": 8, "y": 10, "p": 1, "tables": 1, "pieces": 1, "z": 5, "e": 5, "samples": 1, "w": 1}
GIVEN = {"y": 10, "z": 5, "e": 5}


def program(*body: Any, **local: int) -> Program:
    """Return a program with arrays of its own."""
    return Program("one", "About.", body, local=local)


@pytest.mark.parametrize(
    ("before", "left"),
    [
        # a in e, which is written last; b not in z, as a line does not write where it reads
        (program(copy("y", "a"), copy("a", "b"), copy("b", "z"), copy("y", "e"), a=5, b=5), 5),
        # a in z, and c after it
        (program(copy("y", "a"), copy("a", "b"), copy("b", "c"), copy("c", "b"), copy("b", "z"), a=5, b=5, c=5), 5),
        # all three are read in the end
        (
            program(
                copy("y", "a"),
                copy("y", "b"),
                copy("y", "c"),
                copy("a", "z"),
                copy("b", "e"),
                copy("c", "z"),
                a=5,
                b=5,
                c=5,
            ),
            10,
        ),
        # e is not written at all: what it had is to stay
        (program(copy("y", "a"), copy("a", "b"), copy("b", "z"), a=5, b=5), 5),
    ],
)
def test_arrays_stand_where_others_are_read_no_more(before: Program, left: int) -> None:
    """Assert how many numbers are left, and that given arrays have the same bits afterwards."""
    after = with_shared_storage(before, {}, GIVEN, 2)
    assert sum(after.local.values()) == left
    plain, other = (executed([text], "one", SIZES) for text in (before, after))
    assert all(values.tobytes() == other[array].tobytes() for array, values in plain.items())


def test_what_a_call_reads_and_writes_lies_apart() -> None:
    """Assert that a called program, told that its arrays lie apart, is given none that overlap."""
    load, add, _ = copy("y", "z").body
    half = Program("forces", "About.", (Loop("i", 5, (load, add, StoreTo(loop_element("z", 5), "_zy"))),))
    body = copy("y", "f"), ProgramCall("forces", "at", "f", "f"), copy("f", "z", 5), copy("f", "e", 5, "more")
    before = program(*body, f=10)
    after = with_shared_storage(before, {"forces": half}, GIVEN, 2)
    (call,) = (line for line in after.body if isinstance(line, ProgramCall))
    assert call.y != call.z
    (effect,) = effects_of((call,), {"forces": half}, {}) or []
    ends = []
    for (name, low, high), by in zip((*effect.reads, *effect.writes), (call.y, call.z), strict=True):
        assert name == by
        array, first, _ = after.views.get(name, (name, 0, 0))
        ends.append((array, first + low, first + high))
    assert ends[0][0] != ends[1][0] or ends[0][2] <= ends[1][1] or ends[1][2] <= ends[0][1]
    plain, other = (executed([half, text], "one", SIZES) for text in (before, after))
    assert all(values.tobytes() == other[array].tobytes() for array, values in plain.items())


def test_what_is_not_understood_stays() -> None:
    """Assert that a program that calls what is not known is left as it is; one that gathers keeps all it may read."""
    calls = program(copy("y", "a"), ProgramCall("forces", "at", "a", "z"), a=5, b=5)
    assert with_shared_storage(calls, {}, GIVEN, 2) is calls
    gathered = Loop(
        "i",
        5,
        (
            Gather("_k", loop_element("numbers")),
            Load("_v", Location("a", 0, (("_k", 1),))),
            StoreTo(loop_element("z"), "_v"),
        ),
    )
    before = Program(
        "one",
        "About.",
        (copy("y", "e"), copy("y", "a"), copy("y", "b"), gathered, copy("b", "e")),
        local={"a": 5, "b": 5},
        tables={"numbers": (4, 3, 2, 1, 0)},
    )
    after = with_shared_storage(before, {}, GIVEN, 2)
    plain, other = (executed([text], "one", SIZES) for text in (before, after))
    assert all(values.tobytes() == other[array].tobytes() for array, values in plain.items())
    assert sum(after.local.values()) == 10
