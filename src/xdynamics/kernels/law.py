"""The law of a march: what one model and one method compute, as text and as machine code.

A printed law is stored with its machine code under a digest of its sources: a later process prints nothing again. What
a program replaces at run time in the modules that print is not part of the key; such a program must store nothing.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS
from xdynamics.elementary.text import declarations, definitions
from xdynamics.kernels import line_writing, machine, model_programs
from xdynamics.kernels.compiling import PLAINLY, UNCOMPILED, keys_of
from xdynamics.kernels.constraint_programs import constraint_projection
from xdynamics.kernels.double_double import double_double_program
from xdynamics.kernels.drive_tables import PYTHON_TABLES
from xdynamics.kernels.lane_step import STRIDE, stride_programs
from xdynamics.kernels.layout import Layout, curve_size
from xdynamics.kernels.line_writing import Steps
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.newton_matrix import NewtonSystem
from xdynamics.kernels.program import AT, Program, ProgramCall
from xdynamics.kernels.python_text import python_of, python_of_set
from xdynamics.kernels.shared_storage import MOST_ON_STACK, coalesce_copies, with_shared_storage
from xdynamics.kernels.term_sizes import TERM_SIZES, term_sizes_program
from xdynamics.methods.scheme import Scheme
from xdynamics.model.motion import constant_names
from xdynamics.runtime.fork_safety import waited_for
from xdynamics.runtime.lazy_imports import cached_property

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
    """The printed parts of a law that a march needs besides its machine code.

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
    """Return a digest of the sources of a law's machine code: form, method, choices, printers and processor."""
    origin = (layout.model.form, repr(layout.scheme), *choices)
    return machine.text_digest("printed", *origin, _printers(), *machine.processor())


def read(key: str) -> tuple[Printed, bytes] | None:
    """Return a printed law and its machine code; None if they are not stored."""
    content = machine.read(_file_name(key))
    if content is None:
        return None
    # JSON has no bare line feed, so the first one ends the head, whatever bytes the code has
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
    machine.write(
        _file_name(key), json.dumps(dict(zip(_FIELDS, astuple(printed), strict=True))).encode() + b"\n" + code
    )


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
    # sorted, as the order of rglob is that of the file system
    return machine.text_digest(*(path.read_text(encoding="utf-8") for path in sorted(files)))


MOST_SIZED = 200_000  # characters of a law, some three thousand operations of its forces

# positions among the addresses of a law; the programs of a step come last
EXP, LOG, FORCES, DETECT, SLOPES, RESETS, TOUCHING, ROW, INSIDE, PROPOSE = range(10)
EXPAND = PROPOSE + 1  # of a method by series
LINEARISED = PROPOSE  # of a method whose step `march.implicit.radau` makes
CONTROL = ("exp", "log")  # what step control calls
FLOATS_ALONE = ("slopes", "touching")  # programs that no rest matters to
ROW_ENERGIES, FORCE_SAMPLES = "energies", "samples"  # what a log may leave out
HEADER = (
    '"""{title}\n\nWritten by xdynamics from the model and the method: this is the order of every operation.\n"""\n'
)

_LOCK = waited_for(threading.RLock())


@dataclass(frozen=True)
class Law:
    """The programs of a model and a method.

    Attributes
    ----------
    layout : Layout
        Of the model with a scheme.
    sampled : bool
        Whether a step keeps every force evaluation.
    unread : frozenset of str
        What nothing reads: the `ROW_ENERGIES` of rows, which are sums over all links, force `FORCE_SAMPLES`. It is left out as the
        law is run; `source` has it all the same.
    """

    layout: Layout
    sampled: bool
    unread: frozenset[str] = frozenset()

    @property
    def scheme(self) -> Scheme:
        """The method with its estimator."""
        assert self.layout.scheme is not None  # noqa: S101 - a layout without one has no steps
        return self.layout.scheme

    @cached_property
    def steps(self) -> Steps:
        """The programs of one step."""
        return line_writing.step_program_set(self.layout, self.scheme, sampled=self.sampled)

    @cached_property
    def entries(self) -> tuple[Program, ...]:
        """The programs called from outside, in the order of their addresses, which follow those of `CONTROL`."""
        layout = self.layout
        model_entries = (
            model_programs.forces(layout),
            model_programs.events(layout),
            model_programs.event_rates(layout),
            model_programs.resets(layout),
            model_programs.touching(layout),
            model_programs.row(layout, self.steps.memory),
        )
        curves = (
            ()
            if not curve_size(layout)
            else (line_writing.polynomial_program(layout, self.steps.memory - curve_size(layout)),)
        )
        programs = (
            *model_entries,
            line_writing.interpolation_program(layout, self.scheme),
            *self.steps.programs,
            *self.constraining[-1:],
        )
        return (*self._in_precision(programs), *curves)

    def _in_precision(self, programs: Sequence[Program]) -> tuple[Program, ...]:
        """Return programs in the law's kind of number: floats, or sums of two floats."""
        layout = self.layout
        if not layout.is_doubled:
            return tuple(programs)
        distance = layout.used.size + layout.evaluation.size
        rests = {
            "y": distance,
            "z": distance,
            "w": self.steps.memory,
            "p": len(constant_names(layout.model)),
            "at": len(AT),
        }
        result_distances = {
            "row": 0,
            "detect": 0,
            "resets": len(layout.resets) + len(layout.ticking),
        }  # programs whose results are no state
        return tuple(
            program
            if program.name in FLOATS_ALONE
            else double_double_program(program, rests | {"z": result_distances.get(program.name, distance)})
            for program in programs
        )

    @cached_property
    def programs(self) -> tuple[Program, ...]:
        """Every program, each after those that it calls."""
        by_elements = any(equation.state < 0 for equation in self.steps.equations)
        inner = (model_programs.linearised(self.layout),) if by_elements else ()
        return (self.entries[0], *self.constraining[:-1], *inner, *self.entries[1:])

    @property
    def _run_programs(self) -> tuple[Program, ...]:
        """The programs as run, without lines whose results nothing reads."""
        programs = Law(self.layout, sampled=False).programs if FORCE_SAMPLES in self.unread else self.programs
        if ROW_ENERGIES not in self.unread:
            return programs
        row = model_programs.row(self.layout, self.steps.memory, energies=False)
        return tuple(row if entry.name == row.name else entry for entry in programs)

    @cached_property
    def constraining(self) -> tuple[Program, ...]:
        """The programs that project the result of a step onto constraints."""
        return constraint_projection(self.layout)

    @cached_property
    def printed(self) -> Printed:
        """The printed parts of the law that a march needs besides machine code: read from the cache, or printed now."""
        if self._cached_law is not None:
            return self._cached_law[0]
        title = f"A step by {self.scheme.method.name}, and the forces that it asks for."
        source = "\n\n".join([HEADER.format(title=title), *map(python_of, self.programs)])
        names, storage = tuple(program.name for program in self.entries), self._storage
        return Printed(source, names, self.steps.memory, self.steps.equations, storage)

    @property
    def _storage(self) -> int:
        storage_by_program: dict[str, int] = {}
        for program in self.thin_programs(excluded=[self.entries[INSIDE - FORCES]]):
            callee_storage = (
                storage_by_program.get(line.program, 0) for line in program.body if isinstance(line, ProgramCall)
            )
            # calls follow one another, so of all callees only the largest counts
            storage_by_program[program.name] = sum(program.local.values()) + max(callee_storage, default=0)
        return max(storage_by_program.values())

    @property
    def source(self) -> str:
        """The law as Python: quoted in the record, and run where nothing is compiled."""
        return self.printed.source

    @cached_property
    def _cached_law(self) -> tuple[Printed, bytes] | None:
        """The printed law and machine code of an earlier process; None for models with Python functions."""
        return read(self._cache_key) if self._can_be_kept else None

    @cached_property
    def _cache_key(self) -> str:
        return key_of(self.layout, str(self.sampled), *sorted(self.unread))

    @property
    def _can_be_kept(self) -> bool:
        # code that calls Python functions holds their addresses in this process
        return not (PLAINLY or self.layout.model.python_functions)

    @cached_property
    def source_digest(self) -> str:
        """The SHA-256 digest of `source`."""
        return hashlib.sha256(self.source.encode()).hexdigest()

    @property
    def equations(self) -> tuple[NewtonSystem, ...]:
        """The equations of the step that Newton's method solves."""
        return self.printed.equations

    @property
    def memory(self) -> int:
        """Numbers of the working memory of a step."""
        return self.printed.memory

    @property
    def storage(self) -> int:
        """Numbers of the most that a program of a march has in arrays of its own, with one that it calls."""
        return self.printed.storage

    @property
    def curve(self) -> int:
        """Where in that memory the coefficients of a step's polynomial begin, if it leaves one."""
        return self.memory - curve_size(self.layout)

    @property
    def addresses(self) -> NDArray[np.int64]:
        """Addresses of the compiled programs of a march; without a compiler, keys of `UNCOMPILED`."""
        with _LOCK:  # of two threads that compile at once, one would free code that the other uses
            return self._march_addresses

    @property
    def is_sized(self) -> bool:
        """Whether there is a program of the sizes of terms: of the longest laws it would take minutes to compile."""
        return len(self.printed.source) <= MOST_SIZED

    @property
    def sizing_address(self) -> int:
        """Address of the compiled program of the sizes of terms, or its key: only step control asks for it."""
        with _LOCK:
            return self._sizing

    @cached_property
    def _sizing(self) -> int:
        if PLAINLY:
            return int(keys_of([self._python_scope(python_of(self.term_sizes))[TERM_SIZES]])[0])
        return self._sized.addresses[TERM_SIZES]

    @cached_property
    def _sized(self) -> machine.Code:
        """Machine code of the program of term sizes, cached like the law's."""
        if not self._can_be_kept:
            return machine.compiled(self._llvm_text([self.term_sizes]), [TERM_SIZES], self._python_functions)
        name = f"sizes-{machine.text_digest(self._cache_key, TERM_SIZES)}.o"
        code = machine.read(name)
        if code is None:
            code = machine.emit_object(
                self._llvm_text([self.term_sizes])
            )  # it runs seldom: passes would cost more than they save
            machine.write(name, code)
        return machine.Code(code, [TERM_SIZES])

    @cached_property
    def term_sizes(self) -> Program:
        """The program of the sizes of terms."""
        return term_sizes_program(self.layout)

    @property
    def addresses_inside(self) -> NDArray[np.int64]:
        """The law's addresses with the program for times inside a step, which no march needs."""
        with _LOCK:
            return self._addresses_inside

    @cached_property
    def _march_addresses(self) -> NDArray[np.int64]:
        if PLAINLY:
            return self.plain
        by_name = self._marching.addresses
        return np.array(
            [*_control_code(CONTROL).addresses.values(), *(by_name.get(name, 0) for name in self.printed.names)],
            np.int64,
        )

    @cached_property
    def _addresses_inside(self) -> NDArray[np.int64]:
        addresses = self._march_addresses.copy()
        if not PLAINLY:
            addresses[INSIDE] = self._interpolation_code.addresses[self.entries[INSIDE - FORCES].name]
        return addresses

    @cached_property
    def plain(self) -> NDArray[np.int64]:
        """Keys of the programs in `UNCOMPILED`, as Python functions."""
        scope = self._python_scope("\n\n".join(map(python_of, self._run_programs)) if self.unread else self.source)
        control = (SETS[self.scheme.math_functions][name] for name in CONTROL)
        return np.array(keys_of([*control, *(scope[entry.name] for entry in self.entries)]), np.int64)

    def _python_scope(self, source: str) -> dict[str, Any]:
        """Return the Python functions of a printed law."""
        scope: dict[str, Any] = (
            python_of_set(self.scheme.math_functions)
            | PYTHON_TABLES
            | self._python_functions
            | {"_empty": np.empty, "_entered": _enter_engine, "_zero": np.float64(0.0)}
        )
        exec(compile(source, "<law>", "exec"), scope)  # noqa: S102 - printed from checked trees, never from a file
        return scope

    @property
    def _python_functions(self) -> dict[str, Any]:
        """The model's functions in Python, by the names that programs call them by."""
        return {f"_{model_programs.PYTHON}{name}": entry for name, entry in self.layout.model.functions.items()}

    def text(self, lanes: int = 1, excluded: Sequence[Program] = ()) -> str:
        """Return the law as LLVM text, without some of the programs."""
        return self._llvm_text(self.thin_programs(excluded), lanes)

    def _llvm_text(self, programs: Sequence[Program], lanes: int = 1) -> str:
        functions = [(entry.name, len(entry.arguments)) for entry in self.layout.model.python_functions]
        # `vector_lanes` counts two vectors of the processor: elements go side by side in one
        abreast = machine.vector_lanes() // 2 if self._is_thinned else 1
        return llvm_of(programs, lanes, functions, math_functions=self.scheme.math_functions, abreast=abreast)

    @property
    def _is_thinned(self) -> bool:
        return model_programs.has_loops(self.layout.model)

    def thin_programs(self, excluded: Sequence[Program] = ()) -> list[Program]:
        """Return the programs as they are run, without some: with few copies, and large arrays in one where loops are."""
        programs = [entry for entry in self._run_programs if entry not in excluded]
        if not self._is_thinned:
            return programs
        layout, thin = self.layout, self._thin
        lengths = {"y": layout.record.size, "z": layout.record.size, "e": layout.used.size}
        for program in programs:  # each after those that it calls, as they are then
            if program.name not in thin:
                fewer = coalesce_copies(program, thin, lengths)
                thin[program.name] = with_shared_storage(fewer, thin, lengths, MOST_ON_STACK)
        return [thin[program.name] for program in programs]

    @cached_property
    def _thin(self) -> dict[str, Program]:
        return {}

    def compiled(self, lanes: int = 1, excluded: Sequence[Program] = ()) -> machine.Code:
        """Compile the law for a number of lanes, without some of the programs."""
        names = [entry.name for entry in self.entries if entry not in excluded]
        return machine.compiled(self.text(lanes, excluded), names, self._python_functions)

    def stride_address(
        self, lanes: int, *, adaptive: bool, adaptive_atol: tuple[bool, ...] = (), weighs: bool = False
    ) -> int:
        """Return the address of one ordinary step in that many lanes, compiled; see `lane_step.stride_programs`."""
        with _LOCK:
            form = lanes, adaptive, adaptive_atol, weighs
            if form not in self._strides:
                self._strides[form] = self._striding(*form)
            return self._strides[form].addresses[STRIDE]

    @cached_property
    def _strides(self) -> dict[tuple[int, bool, tuple[bool, ...], bool], machine.Code]:
        """Code of those addresses: it lives as long as the law, which users of the addresses hold."""
        return {}

    def _striding(self, lanes: int, adaptive: bool, adaptive_atol: tuple[bool, ...], weighs: bool) -> machine.Code:  # noqa: FBT001
        sizes = self.term_sizes if weighs else None
        step = stride_programs(self.layout, self.steps, adaptive=adaptive, adaptive_atol=adaptive_atol, sizes=sizes)
        programs = (self.entries[0], *self.constraining, *step)
        text = llvm_of(programs, lanes, entered=(STRIDE,), math_functions=self.scheme.math_functions)
        return machine.compiled(text, [STRIDE])

    def parting_addresses(self, lanes: int) -> tuple[int, int]:
        """Return the addresses of a force evaluation and of a step in that many lanes, compiled."""
        programs = (self.entries[0], *self.constraining, *self.steps.programs)
        names = (programs[0].name, self.entries[PROPOSE - FORCES].name)
        with _LOCK:
            if lanes not in self._parting_code:
                text = llvm_of(programs, lanes, entered=names, math_functions=self.scheme.math_functions)
                self._parting_code[lanes] = machine.compiled(text, names)
            addresses = self._parting_code[lanes].addresses
        return addresses[names[0]], addresses[names[1]]

    @cached_property
    def _parting_code(self) -> dict[int, machine.Code]:
        """Code of those addresses: it lives as long as the law."""
        return {}

    @cached_property
    def _marching(self) -> machine.Code:
        """Code of all programs but the one for times inside a step."""
        if not self._can_be_kept:
            return self.compiled(excluded=[self.entries[INSIDE - FORCES]])
        names = [name for i, name in enumerate(self.printed.names, FORCES) if i != INSIDE]
        if self._cached_law is not None:
            return machine.Code(self._cached_law[1], names)
        code = machine.build_object(self.text(excluded=[self.entries[INSIDE - FORCES]]))
        write(self._cache_key, self.printed, code)
        return machine.Code(code, names)

    @cached_property
    def _interpolation_code(self) -> machine.Code:
        return self.compiled(
            excluded=[
                entry
                for i, entry in enumerate(self.entries, FORCES)
                if i not in (FORCES, INSIDE) and entry not in self.constraining  # which the end of a step calls
            ]
        )


@lru_cache(maxsize=1)
def _control_code(names: tuple[str, ...]) -> machine.Code:
    """Return machine code of functions of one number, for the engine to call."""
    entry = "define double @{0}(double %x) {{\n  %y = call double @elementary_{0}(double %x)\n  ret double %y\n}}"
    text = [declarations(1), definitions(dict.fromkeys(names, True), 1), *map(entry.format, names)]
    return machine.compiled("\n".join(text), names)


@lru_cache(maxsize=128)
def law_of(layout: Layout, *, sampled: bool, unread: frozenset[str] = frozenset()) -> Law:
    """Return the law of a layout, made once for all models that differ in numbers alone; see `Law`.

    Energies are left out of rows of models with dimensions alone, and not where contacts judge impacts by them.

    Its layout is that of the first such model: names and places hold for all of them, numbers do not.
    """
    is_judged = bool(layout.model.elements.contacts or layout.model.assemblies)
    if is_judged or not model_programs.has_loops(layout.model) or layout.is_doubled:
        unread -= {ROW_ENERGIES}
    if not sampled:
        unread -= {FORCE_SAMPLES}
    if layout.model.python_functions:
        return Law(layout, sampled, unread)
    return _law_of_form(_Form((layout.model.form, layout.scheme, sampled, unread), layout))


@dataclass(frozen=True)
class _Form:
    """The sources of a law, with one layout that has them."""

    key: tuple[Any, ...]
    layout: Layout = field(compare=False)


@lru_cache(maxsize=64)
def _law_of_form(form: _Form) -> Law:
    return Law(form.layout, *form.key[2:])


def _enter_engine(run: float, entry: float, t: float, z: NDArray[np.float64]) -> None:
    """Call an entry of the engine by the keys of `UNCOMPILED` that stand for the addresses of the run and the entry."""
    UNCOMPILED[int(entry)](UNCOMPILED[int(run)], t, z)
