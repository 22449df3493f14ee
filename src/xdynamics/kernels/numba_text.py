"""Functions that numba compiles, as one LLVM text that stands alone.

numba translates them for a plain processor and makes no machine code. The text calls neither Python nor numba's runtime:
what could raise an exception or count references is optimised away, or the text is refused.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import llvmlite.binding as llvm
from numba import njit
from numba.core.codegen import AOTCodeLibrary, AOTCPUCodegen
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import overload

from xdynamics.elementary import numbers
from xdynamics.kernels import machine
from xdynamics.kernels.compiling import UNCOUNTED, install_numba_functions
from xdynamics.kernels.entry_points import Signature
from xdynamics.kernels.entry_text import entry_text, in_numba
from xdynamics.runtime.fork_safety import waited_for

waited_for(getattr(global_compiler_lock, "_lock"))  # noqa: B009 - numba's own, which a child needs to compile
# what functions of any kind of number call is compiled for floats as it is meant
overload(numbers.choose)(lambda truth, yes, no: lambda truth, yes, no: yes if truth else no)  # noqa: ARG005
overload(numbers.absolute)(lambda x: lambda x: abs(x))  # noqa: ARG005, PLW0108

# IEEE 754 has one square root: the processor's, in place of the C library's, which tells errors apart
_SQUARE_ROOT = """
declare double @llvm.sqrt.f64(double)
define double @sqrt(double %x) alwaysinline {
    %root = call double @llvm.sqrt.f64(double %x)
    ret double %root
}
"""


def text_of(functions: Sequence[tuple[Any, Signature]]) -> str:
    """Compile functions to LLVM text.

    Parameters
    ----------
    functions : sequence of (function, Signature)
        Each is an entry of the text, by its name, called as `kernels.entry_points` says.

    Raises
    ------
    RuntimeError
        If the text needs a symbol that is not provided.
    """
    # in LLVM's context of the whole process, as numba's own modules, which its lock keeps to one thread
    with global_compiler_lock, _without_collection():
        install_numba_functions()
        module = _link_functions(functions)
        entries = {function.__name__ for function, _ in functions}
        for symbol in (*module.functions, *module.global_variables):
            if not symbol.is_declaration and symbol.name not in entries:
                symbol.linkage = "internal"
        for level in (3, 1):  # then once more, since that an exception cannot occur is found from the inside outward
            machine.optimise(module, machine.plain_machine(), level)
        _check_symbols(module)
        return str(module)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Search for no garbage meanwhile: numba makes millions of objects that live until its end, a quarter of its time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _link_functions(functions: Sequence[tuple[Any, Signature]]) -> Any:
    """Return a module of all functions, their entries, and what they call."""
    module = llvm.parse_assembly(_SQUARE_ROOT)
    with _plain_processor() as context:
        for function, signature in functions:
            numba_signature = in_numba(signature)
            dispatcher: Any = njit(**UNCOUNTED)(function)
            dispatcher.compile(numba_signature)
            compiled = dispatcher.overloads[numba_signature.args]
            _, _, bitcode = compiled.library.serialize_using_bitcode()
            module.link_in(llvm.parse_bitcode(bitcode))
            entry = entry_text(context, compiled.fndesc, signature, function.__name__)
            module.link_in(llvm.parse_assembly(entry))
    return module


def _check_symbols(module: Any) -> None:
    needed = {
        symbol.name
        for symbol in (*module.functions, *module.global_variables)
        if symbol.is_declaration and not symbol.name.startswith("llvm.")
    }
    if missing := needed - {*machine.HELPERS}:
        raise RuntimeError(f"the engine's LLVM text needs {', '.join(sorted(missing))}, which nothing provides")


class _Library(AOTCodeLibrary):
    """Compiled functions that are linked as they are: the whole text is optimised once, at the end."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = str(self._codegen.target_data)

    def _optimize_final_module(self) -> None:
        pass

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        """Return that there is no machine code."""
        return 0


class _Codegen(AOTCPUCodegen):
    """Code for a plain processor, of which none is executed."""

    _library_class = _Library

    def set_env(self, env_name: str, env: Any) -> None:
        """Ignore the Python names that functions could look up: they look up none."""


@contextmanager
def _plain_processor() -> Iterator[Any]:
    """Let numba compile for a plain processor; under its lock, no other thread compiles meanwhile."""
    context: Any = cpu_target.target_context
    original_codegen = context._internal_codegen  # noqa: SLF001 - nested functions are compiled for this context alone
    context._internal_codegen = _Codegen("xdynamics")  # noqa: SLF001
    try:
        yield context
    finally:
        context._internal_codegen = original_codegen  # noqa: SLF001
