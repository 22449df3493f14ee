"""Phases: functions of a run that are compiled apart from those that call them, and return what they find.

A phase is declared where it is written, with the part of the engine that has it (`engine.PARTS`), and called as any function.
In compiled code the call goes by the address that `run.phases` has of it, so that no caller compiles it again, and a part
that no model needs is never made. Nothing is passed but the run, perhaps a number, and the result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from xdynamics.kernels.compiling import declare
from xdynamics.kernels.entry_points import FLAG, FLOAT, INTEGER, NOTHING, Handle, Signature, signature_of

F = TypeVar("F", bound=Callable[..., Any])

WATCHERS, CONTACTS, ASSEMBLIES = "watchers", "contacts", "assemblies"  # parts of the engine that have phases


class Phase(NamedTuple):
    """A function, the part of the engine that has it, and what it takes and returns."""

    function: Callable[..., Any]
    part: str
    signature: Signature


PHASES: dict[str, Phase] = {}  # by the names of their functions


def phase(part: str) -> Callable[[F], F]:
    """Declare a function of a run, and perhaps of a number, as a phase that a part of the engine has."""

    def declared(function: F) -> F:
        notes = function.__annotations__
        kinds = [_KINDS[notes[name]] for name in notes if name != "return"]
        PHASES[function.__name__] = Phase(function, part, signature_of(_KINDS[notes["return"]], *kinds))
        return declare(function, lambda: _instruction(function.__name__))

    return declared


def later(name: str) -> Callable[..., Any]:
    """Return a phase that is declared in a room above the caller's, by its name."""

    def called(*given: Any) -> Any:
        return PHASES[name].function(*given)

    return declare(called, lambda: _instruction(name))


def phases_of(part: str) -> list[tuple[Callable[..., Any], Signature]]:
    """Return the phases that a part of the engine has, as it compiles them."""
    return [(each.function, each.signature) for _, each in sorted(PHASES.items()) if each.part == part]


def phase_numbers() -> dict[str, int]:
    """Return the place of each phase in `run.phases`, the same in every process."""
    return {name: i for i, name in enumerate(sorted(PHASES))}


def _instruction(name: str) -> Any:
    # late: only a process that compiles the engine needs numba, and it knows all phases
    from xdynamics.march.run_in_code import phase_instruction

    return phase_instruction(name, phase_numbers()[name], PHASES[name].signature)


def _run_in_code() -> Any:
    from xdynamics.march.run_in_code import RUN

    return RUN


RUN_HANDLE = Handle(_run_in_code)
_KINDS: dict[str, Any] = {
    "Run": RUN_HANDLE,
    "float": FLOAT,
    "int": INTEGER,
    "bool": FLAG,
    "None": NOTHING,
}
