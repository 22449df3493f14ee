"""Calls of functions that numba compiled: numbers as in C, arrays through a table of words.

A function of numbers alone has these as its arguments, so that compiled code can call it by its address. One that takes
arrays, or named tuples of them, has one argument: the address of a table of words of eight bytes. A number is one word,
an array is the address of its first element and then its shape. The Python in this module fills the table; the LLVM
text that reads it is `kernels.numba_text`.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from xdynamics.kernels.machine import Code, address_of


class Scalar(Enum):
    """A kind of number of a compiled function, or nothing at all."""

    INTEGER = "int64"
    FLOAT = "float64"
    FLAG = "boolean"
    NOTHING = "none"


INTEGER, FLOAT, FLAG, NOTHING = Scalar


class ArrayElements(NamedTuple):
    """An array in C order."""

    dtype: np.dtype[Any]
    dims: int


class Handle(NamedTuple):
    """An address that compiled code takes as a type of its own, which is returned where numba is at work."""

    type_in_code: Callable[[], Any]


class Fields(NamedTuple):
    """A named tuple, and the kinds of its fields."""

    tuple_type: type
    kinds: tuple[Any, ...]


Kind = Scalar | Handle | ArrayElements | Fields


class Signature(NamedTuple):
    """The results and arguments of a compiled function."""

    result: Scalar
    arguments: tuple[Kind, ...]

    @property
    def by_table(self) -> bool:
        """Whether the function is called with the address of a table."""
        return not all(isinstance(kind, Scalar | Handle) for kind in self.arguments)


def signature_of(result: Scalar, *arguments: Kind) -> Signature:
    """Return the signature of a function with some arguments."""
    return Signature(result, arguments)


def array_kind(dtype: Any, dims: int) -> ArrayElements:
    """Return the kind of an array in C order."""
    return ArrayElements(np.dtype(dtype), dims)


class Entry:
    """Machine code of a function, to be called from Python.

    Parameters
    ----------
    code : Code
        Stays in memory as long as the entry.
    name : str
    signature : Signature
        Of what was compiled.
    """

    def __init__(self, code: Code, name: str, signature: Signature) -> None:
        self.code, self.address = code, code.addresses[name]
        self._kinds = signature.arguments
        result = None if signature.result is NOTHING else ctypes.c_int64
        c_types = (
            [ctypes.c_void_p]
            if signature.by_table
            else [_C_TYPES.get(kind, ctypes.c_void_p) for kind in signature.arguments]
        )
        # the interpreter is free while the function runs
        self.call: Callable[..., Any] = ctypes.CFUNCTYPE(result, *c_types)(self.address)

    def __call__(self, *arguments: Any) -> Any:
        """Call the function with a table of its arguments.

        Raises
        ------
        TypeError
            If an array is not what the function was compiled for, which it would read as something else.
        """
        words = [
            word
            for kind, argument in zip(self._kinds, arguments, strict=True)
            for word in _argument_words(kind, argument)
        ]
        return self.call((ctypes.c_int64 * len(words))(*words))


_C_TYPES: dict[Any, Any] = {INTEGER: ctypes.c_int64, FLOAT: ctypes.c_double}


def _argument_words(kind: Kind, argument: Any) -> Iterator[int]:
    """Yield the words of an argument."""
    if isinstance(kind, ArrayElements):
        if argument.dtype != kind.dtype or argument.ndim != kind.dims or not argument.flags.c_contiguous:
            raise TypeError(
                f"an array of {argument.dtype} with {argument.ndim} dimensions, C order"
                f" {argument.flags.c_contiguous}; needed are {kind.dtype} with {kind.dims} in C order"
            )
        yield address_of(argument)
        yield from argument.shape
    elif isinstance(kind, Fields):
        for part_kind, part in zip(kind.kinds, argument, strict=True):
            yield from _argument_words(part_kind, part)
    elif kind is FLOAT:
        # the word holds the bits of a float, not its value
        yield struct.unpack("=q", struct.pack("=d", argument))[0]
    else:
        yield int(argument)
