"""How long the arrays of a run live, and what their elements are, as the run's annotations say it."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np


class ArrayKind(NamedTuple):
    """What the elements of an array are, and how many dimensions it has; the name tells compiled code kinds apart.

    With `either_order` the elements along the last dimension may be as far apart as the first one is long.
    """

    name: str
    elements: Any
    dimensions: int = 1
    either_order: bool = False


class Lifetime(Enum):
    """How long an array lives, and whose it is."""

    LASTING = "it is part of the memory to continue from, even after the end"
    PASSING = "it belongs to a step: part of the memory within a march, but after a node nothing needs it"
    GIVEN = "by the model and the settings: runs side by side share it"
    OWN = "given to a run by itself"
    SCRATCH = "computed where it is needed"
    ADDRESS = "it belongs to a process: runs side by side share it"
    LOG = "lent to the run until it is full"


class Within(NamedTuple):
    """The array that another one is a part of."""

    owner: str


class Array(NamedTuple):
    """What the annotation of an array of a run says."""

    kind: ArrayKind
    lifetime: Lifetime
    owner: str  # the array that it is a part of, if any

    @classmethod
    def read(cls, annotation: Any) -> Array:
        """Read the marks of an annotation; without a lifetime it is `LASTING`."""
        kind, *marks = annotation.__metadata__
        lifetimes = [mark for mark in marks if isinstance(mark, Lifetime)]
        owners = [mark.owner for mark in marks if isinstance(mark, Within)]
        return cls(kind, lifetimes[0] if lifetimes else Lifetime.LASTING, owners[0] if owners else "")


T = TypeVar("T")
Passing = Annotated[T, Lifetime.PASSING]
Given = Annotated[T, Lifetime.GIVEN]
Own = Annotated[T, Lifetime.OWN]
Scratch = Annotated[T, Lifetime.SCRATCH]
Address = Annotated[T, Lifetime.ADDRESS]
Log = Annotated[T, Lifetime.LOG]


def record_type(floats: str, integers: str) -> np.dtype[Any]:
    """Return the type of a row of named numbers, floats and then whole ones."""
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in integers.split()]
    return np.dtype((np.record, fields))
