"""Printed laws, kept with their machine code under what they are printed from: a later process prints nothing again.

What a program replaces at run time in the modules that print is not part of the key; such a program must keep nothing.
"""

from __future__ import annotations

import json
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from xdynamics.kernels import cache, machine
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.newton_matrix import NewtonSystem

_ROOMS = (
    "kernels",
    "methods",
    "expressions",
    "elementary",
    "model",
    "units",
)  # where laws are printed, and what they are read from
_MODULES = ("schema.py",)


@dataclass(frozen=True)
class Printed:
    """What a march needs of a law besides its machine code.

    Attributes
    ----------
    source : str
        The law as Python.
    names : tuple of str
        Names of the programs that are called from outside, in the order of their addresses.
    memory : int
        Numbers of the working memory of a step.
    equations : tuple of Equations
        What the step solves by Newton's method.
    storage : int
        Numbers of the most that a program has in arrays of its own, with one that it calls.
    """

    source: str
    names: tuple[str, ...]
    memory: int
    equations: tuple[NewtonSystem, ...]
    storage: int


def key_of(layout: Layout, *choices: str) -> str:
    """Return a digest of what a law and its machine code follow from: form, method, choices, printers and processor."""
    origin = (layout.model.form, repr(layout.scheme), *choices)
    return cache.text_digest("printed", *origin, _printers(), *machine.processor())


def read(key: str) -> tuple[Printed, bytes] | None:
    """Return a printed law and its machine code; None if they are not kept."""
    content = cache.read(_file_name(key))
    if content is None:
        return None
    head, _, code = content.partition(b"\n")
    fields: dict[str, Any] = json.loads(head)
    return (
        Printed(
            fields["source"],
            tuple(fields["names"]),
            fields["memory"],
            tuple(map(_newton_system, fields["equations"])),
            fields["storage"],
        ),
        code,
    )


def write(key: str, printed: Printed, code: bytes) -> None:
    """Keep a printed law and its machine code."""
    cache.write(_file_name(key), json.dumps(dict(zip(_FIELDS, astuple(printed), strict=True))).encode() + b"\n" + code)


_FIELDS = tuple(Printed.__dataclass_fields__)


def _file_name(key: str) -> str:
    return f"form-{key}.o"


def _newton_system(fields: list[Any]) -> NewtonSystem:
    evaluations, residuals, unknowns, entries, *places = fields
    return NewtonSystem(evaluations, residuals, tuple(map(tuple, unknowns)), tuple(map(tuple, entries)), *places)


@lru_cache(maxsize=1)
def _printers() -> str:
    """Return a digest of the modules that print laws."""
    package = Path(__file__).parents[1]
    files = [
        *(path for room in _ROOMS for path in (package / room).rglob("*.py")),
        *(package / module for module in _MODULES),
    ]
    return cache.text_digest(*(path.read_text(encoding="utf-8") for path in sorted(files)))
