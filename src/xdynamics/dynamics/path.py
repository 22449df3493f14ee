"""The path of tangent vectors along a run: its law with derivatives, its rows, and the matrices of its events."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.growth import GrowthLaw, Rows
from xdynamics.dynamics.saltation import SimultaneousEvents
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.dynamics.variational import (
    Equations,
    NotVariedError,
    Variations,
    first_contact_rows,
    refuse_delays,
    refuse_ticks,
)
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.kernels import Layout, machine, model_programs
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.drive_tables import PYTHON_TABLES, concatenated_tables
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import AT, TABLE, WORDS, Program
from xdynamics.kernels.python_text import PYTHON, python_of
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.constraints import beyond_trees
from xdynamics.model.linearisation import jacobian_names, tangent_space
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states, motion_inputs, variables
from xdynamics.model.regime_model import switch_inputs, watched_by
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.switches import STEPPED_OVER, jumping_switches
from xdynamics.reaction_names import contact_state, friction_state
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_named
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import acceleration, rate, velocity

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]

NUDGE = 1e-6  # of a variable's range, by which it is moved to both sides for forces without derivatives
BLOCKS = 2048  # of equal time, in which growth is summed: long steps are divided, short ones combined
NO_MAP = (
    "pole",
    "cluster",
    "rest",
    "takeoff",
    "stick",
    "slip",
    *schema.KINDS_OF_SLIDING,
)  # kinds of events that are not described by a map of the state


def steps_over_impacts(run: xr.Dataset, model: Model) -> bool:
    """Whether contacts act over complete steps in a run, without located events for their impulses."""
    touching = bool(model.elements.contacts or model.assemblies)
    return touching and not METHODS[str(run.attrs["solver_method"])].stepper.locates


@dataclass(frozen=True)
class RunPath:
    """A run and the functions that its model's forces call.

    Attributes
    ----------
    run : xarray.Dataset
    functions : mapping of str to callable, optional
    """

    run: xr.Dataset
    functions: Mapping[str, Callable[..., float]] | None

    @cached_property
    def model(self) -> Model:
        """The record's model."""
        return self._interpolator.model

    @cached_property
    def _interpolator(self) -> StepInterpolator:
        return StepInterpolator.of_run(self.run, self.functions, REINTEGRATE)

    @cached_property
    def _layout(self) -> Layout:
        return self._interpolator.layout

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(variables(self.model))

    def check(self) -> None:
        """Refuse a run along which small changes of the state cannot be followed.

        Raises
        ------
        NotVariedError
            Naming the obstacle.
        """
        model, run = self.model, self.run
        if not self.times[-1] > self.times[0]:
            raise NotVariedError("no time passes in the run")
        if not np.isfinite(self.states).all():
            raise NotVariedError("a state is no number")
        refuse_ticks(model)
        if model.constraints and (
            model.elements.contacts or any(event.reset for event in model.elements.events.values())
        ):
            raise NotVariedError(f"constraint '{next(iter(model.elements.constraints))}' answers to impacts and resets")
        if beyond_trees(model):
            raise NotVariedError(f"constraints couple {len(model.elements.statement.coordinates)} coordinates")
        refuse_delays(model)
        if model.frictions:
            raise NotVariedError(
                f"friction element '{next(iter(model.elements.frictions))}' slips or sticks all the time"
            )
        if model.assemblies:
            raise NotVariedError(
                f"impacts of many links, like those of '{next(iter(model.assemblies))}', have no map of states"
            )
        if steps_over_impacts(run, model):
            raise NotVariedError(f"{run.attrs['solver_method']} locates no impacts")
        if contact_rows := first_contact_rows(run):
            name, row = min(contact_rows.items(), key=lambda entry: entry[1])
            owner = name.removeprefix(contact_state("")).removeprefix(friction_state(""))
            raise NotVariedError(f"contact '{owner}' is not open from t = {float(run['time'][row]):.6g} on")
        stepped_over = str(run.attrs.get("solver_switches", STEPPED_OVER)) == STEPPED_OVER
        if stepped_over and (jumping := jumping_switches(model)):
            raise NotVariedError(f"'{jumping[0].name}' jumps, and the run stepped over it")
        if run.sizes.get("event", 0):
            kinds = zip(words_of_flag(run["event_kind"]), words_of_flag(run["event_detector"]), strict=True)
            if lost := [f"the {kind} of '{name}'" for kind, name in kinds if kind in NO_MAP]:
                raise NotVariedError(f"{lost[0]} has no map of states")

    # ------------------------------------------------------------------------------------------------------ the rows

    @cached_property
    def times(self) -> Floats:
        """Times of the rows, s."""
        return np.asarray(self.run["time"], float)

    @cached_property
    def states(self) -> Floats:
        """States at the rows, SI, shape (rows, n)."""
        units, names = self.model.elements.units, variables(self.model)
        return np.stack([np.asarray(self.run[name], float) * float(units[name].factor) for name in names], axis=1)

    @cached_property
    def changes(self) -> Floats:
        """Independent changes of the first state that keep constraints, in units of the variables, as columns."""
        state = {"t": float(self.times[0])} | dict(zip(variables(self.model), self.states[0].tolist(), strict=True))
        values = motion_inputs(self.model, state, constants(self.model), drive_pieces(self.model))
        return (
            np.asarray(tangent_space(self.model, values) / self.sizes[:, None])
            if self.model.constraints
            else np.eye(self.size)
        )

    @cached_property
    def sizes(self) -> Floats:
        """Units of the variables: their ranges in the run; 1 SI unit for a variable that stays constant."""
        ranges = self.states.max(axis=0) - self.states.min(axis=0)
        return np.asarray(np.where(ranges > 0.0, ranges, 1.0))

    @cached_property
    def rows(self) -> Rows:
        """The run's steps."""
        steps = len(self.times) - 1
        regimes = np.asarray(self.run["regime"])[:-1] if "regime" in self.run else np.zeros(steps)
        jumps, matrices = self._jumps
        parts, _, blocks = self._time_blocks
        return Rows(
            self.times,
            self.states,
            regimes.astype(float),
            self._switch_sides,
            self._table_pieces,
            jumps,
            matrices,
            parts,
            blocks,
        )

    @cached_property
    def _time_blocks(self) -> tuple[IntArray, IntArray, IntArray]:
        """Return the number of parts of each step, the number of blocks that begin with it, and its first block."""
        sizes, width = np.diff(self.times), (self.times[-1] - self.times[0]) / BLOCKS
        parts = np.maximum(1, np.ceil(sizes / width)).astype(np.int64)
        bins = np.floor((self.times[:-1] + sizes / 2.0 - self.times[0]) / width)
        is_divided = parts > 1
        begins = np.ones(len(parts), bool)
        # a divided step has its blocks for itself, so the step behind it begins a new one too
        begins[1:] = is_divided[1:] | is_divided[:-1] | (bins[1:] != bins[:-1])
        counts = np.where(begins, parts, 0)
        # a step that begins no block adds to the latest one, whose number is one less than the blocks begun so far
        return parts, counts, np.cumsum(counts) - np.where(begins, counts, 1)

    @cached_property
    def block_times(self) -> Floats:
        """Beginning of the first block and ends of all blocks."""
        parts, counts, blocks = self._time_blocks
        rows = np.repeat(np.arange(len(parts)), counts)
        number = np.arange(len(rows)) - blocks[rows]
        begins = self.times[rows] + np.diff(self.times)[rows] * (number / parts[rows])
        return np.append(begins, self.times[-1])

    @cached_property
    def _middles(self) -> dict[str, Any]:
        """States in the middle of every step, by Hermite's cubic, where switches and tables are on one side."""
        elements = self.model.elements
        names, units, run = variables(self.model), elements.units, self.run
        speeds = [velocity(name) for name in elements.statement.coordinates]
        rate_names = [
            *speeds,
            *map(acceleration, elements.statement.coordinates),
            *map(rate, elements.statement.states),
        ]
        rates = np.stack(
            [
                np.asarray(run[rate_name], float) * float(units[name].factor)
                for rate_name, name in zip(rate_names, names, strict=True)
            ],
            axis=1,
        )
        steps, states = np.diff(self.times)[:, None], self.states
        middle = (states[:-1] + states[1:]) / 2.0 + steps / 8.0 * (rates[:-1] - rates[1:])
        regimes = np.asarray(run["regime"])[:-1].astype(float) if "regime" in run else np.zeros(len(steps))
        t = self.times[:-1] + np.diff(self.times) / 2.0
        return dict(zip(names, middle.T, strict=True)) | {"t": t, REGIME_NUMBER: regimes}

    @cached_property
    def _switch_sides(self) -> Floats:
        """Side of each switch on which each step is, as the law needs it."""
        model = self._layout.model
        sides = np.zeros((len(self.times) - 1, len(switch_inputs(model))))
        column = 0
        for switch in watched_by(model):
            if switch.drive:
                column += 4  # borders, which forces do not read
                continue
            value = evaluate_over_states(
                self.model, [switch.function], self._middles, constants(self.model), drive_pieces(self.model)
            )[0]
            sides[:, column] = np.where(np.asarray(value) == 0.0, switch.at_zero, np.sign(value))
            column += 1
        return sides

    @cached_property
    def _table_pieces(self) -> IntArray:
        """The piece of every drive's table that each step goes through."""
        pieces = np.zeros((len(self.times) - 1, len(self.model.elements.drives)), np.int64)
        values = dict(constants(self.model)) | self._middles
        places = self.model.elements.looked_up_at.values()
        for i, (argument_tree, (origins, _)) in enumerate(zip(places, drive_pieces(self.model), strict=True)):
            piece = np.searchsorted(origins, evaluate_many(argument_tree, values), side="right") - 1
            pieces[:, i] = np.clip(piece, 0, len(origins) - 1)
        return pieces

    # ---------------------------------------------------------------------------------------------------- the events

    @cached_property
    def _jumps(self) -> tuple[IntArray, Floats]:
        """Return which matrix acts before each step, and the matrices."""
        n, steps = self.size, len(self.times) - 1
        numbers, matrices = np.full(steps, -1, np.int64), [np.zeros((0, n, n))]
        if not self.run.sizes.get("event", 0):
            return numbers, matrices[0]
        variations, first = Variations(self.run, Equations(self.model, ()), 0), 0
        for names, rows_before, rows_after in self._event_instants():
            unit = np.broadcast_to(np.eye(n), (len(rows_before), n, n))
            matrices.append(SimultaneousEvents(variations, rows_before, rows_after, names, unit).changes_after())
            numbers[rows_before] = first + np.arange(len(rows_before))
            first += len(rows_before)
        return numbers, np.concatenate(matrices)

    def _event_instants(self) -> Iterator[tuple[tuple[str, ...], IntArray, IntArray]]:
        """Yield the names of simultaneous events, and the rows before and after all instants with these names."""
        run = self.run
        rows = [rows_named(run, name).tolist() for name in ("event_row_before", "event_row_after")]
        names_at: dict[tuple[int, int], list[str]] = {}
        for row_before, row_after, name in zip(*rows, words_of_flag(run["event_detector"]), strict=True):
            names_at.setdefault((row_before, row_after), []).append(name)
        instants: dict[tuple[str, ...], list[tuple[int, int]]] = {}
        for (row_before, row_after), names in names_at.items():
            if row_before != row_after:
                instants.setdefault(tuple(sorted(set(names))), []).append((row_before, row_after))
        for detectors, pairs in instants.items():
            rows_before, rows_after = np.array(pairs, np.int64).T
            yield detectors, rows_before, rows_after

    # ------------------------------------------------------------------------------------------------------- the law

    def law(self) -> tuple[GrowthLaw, list[Any]]:
        """Return the law, and the objects that must stay alive as long as it is called."""
        layout, model = self._layout, self._layout.model
        coordinates, states = model.elements.statement.coordinates, model.elements.statement.states
        by_differences = bool(model.python_forces)
        program = model_programs.forces(layout) if by_differences else model_programs.linearised(layout)
        tables, places = concatenated_tables(drive_pieces(model))
        p, nc, n = np.array(list(constants(model).values())), len(coordinates), self.size
        column = {name: i for i, name in enumerate(layout.used)}
        row = {name: nc + i for i, name in enumerate((*coordinates, *map(rate, states)))}
        pairs = (
            [] if by_differences else [(row[name], column[column_name]) for name, column_name in jacobian_names(model)]
        )
        # a transpose is in Fortran order, and the compiled signature takes arrays in C order
        entries = np.array(pairs, np.int64).reshape(-1, 2).T.copy()
        weights = self.sizes[entries[1]] / self.sizes[entries[0]]
        width = layout.record.size
        arrays = {
            "at": np.zeros(len(AT)),
            "y": np.zeros(width),
            "p": p,
            "tables": tables,
            "pieces": places,
            "z": np.zeros(width),
            "e": np.zeros(max(1, len(pairs))),
        }
        table = np.zeros((len(TABLE), WORDS), np.int64)
        for name, array in arrays.items():
            table[TABLE.index(name)] = array.ctypes.data, array.shape[0], array.shape[-1]
        entry, code = _compiled_law(program, layout, arrays)
        y, z, time_and_regime = arrays["y"], arrays["z"], arrays["at"]
        law = GrowthLaw(
            entry,
            table.ctypes.data,
            y.ctypes.data,
            z.ctypes.data,
            y,
            z,
            arrays["e"],
            time_and_regime,
            p,
            places,
            entries,
            weights,
            self.sizes,
            self.sizes[nc : 2 * nc] / self.sizes[:nc],
            nc,
            NUDGE if by_differences else 0.0,
        )
        assert n == layout.used.size  # noqa: S101 - forces use exactly the variables
        return law, [arrays, table, code]


def _compiled_law(program: Program, layout: Layout, arrays: Mapping[str, Any]) -> tuple[int, Any]:
    """Compile a program and return its address; without compilation, its key in `UNCOMPILED`."""
    model = layout.model
    functions = {f"_{model_programs.PYTHON}{name}": function for name, function in model.functions.items()}
    if not PLAINLY:
        text = llvm_of([program], 1, [(function.name, len(function.arguments)) for function in model.python_functions])
        code = machine.compiled(text, [program.name], functions)
        return code.addresses[program.name], code
    scope: dict[str, Any] = PYTHON | PYTHON_TABLES | functions | {"_empty": np.empty, "_zero": np.float64(0.0)}
    exec(compile(python_of(program), "<law>", "exec"), scope)  # noqa: S102 - printed from checked trees
    law_function = scope[program.name]
    time_and_regime, y, p, tables, places, z, e = (
        arrays[name] for name in ("at", "y", "p", "tables", "pieces", "z", "e")
    )
    (key,) = keys_of([lambda *_ignored: law_function(time_and_regime, y, p, tables, places, z, e, z, z)])
    return key, law_function
