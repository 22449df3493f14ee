"""A grid of runs: a model, its axes, the settings that all members share, and the numbers of its members.

Members are found by their values along the axes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME
from xdynamics.faults import InputError
from xdynamics.march import Runs, Settings, march_each, march_many
from xdynamics.march.configuration import RECORDING, settings_for, unthinned_settings_for
from xdynamics.march.log import Room
from xdynamics.march.settings import EARLIEST_FIRST, FILIPPOV, JUDGED
from xdynamics.march.tolerances import OF_TERMS
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model
from xdynamics.model.sliding import may_slide_along_switches
from xdynamics.model.toml import section_tables
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.sweeping.axes import (
    INITIAL,
    MODEL_SECTIONS,
    NUMBERS,
    PARAMETER,
    RTOL,
    SETTING,
    START,
    STEP,
    TABLE,
    Axis,
    AxisColumn,
    axis_numbers,
    matching_dim,
)
from xdynamics.units import Scale

Places = NDArray[np.int64]
AxisIndices = Sequence[int] | Places
Arrays = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Members that differ in numbers alone, so that one call of the engine can march them.

    Attributes
    ----------
    model : Model
    settings : Settings
    block_indices : ndarray of int, shape (n,)
        Indices of the members in the block.
    arrays : dict
        Those of `parameters`, `initial`, `steps` and `rtols` for `march_many` that vary, SI.
    grid : SweepGrid
    axis_indices : ndarray of int, shape (n, axes)
        Indices of the members along the axes.
    """

    model: Model
    settings: Settings
    block_indices: Places
    arrays: Arrays
    grid: SweepGrid
    axis_indices: Places

    def excluding(self, known_members: NDArray[np.bool_]) -> Group:
        """Return the group without the known members of the block."""
        remaining = ~known_members[self.block_indices]
        if remaining.all():
            return self
        return replace(
            self,
            block_indices=self.block_indices[remaining],
            arrays=self._arrays(remaining),
            axis_indices=self.axis_indices[remaining],
        )

    def march_members(self, member_slice: slice, *, logs: bool | Sequence[str], room: Room | None = None) -> Runs:
        """March some of the members; sums of two floats, and the past of delays, are each member's own."""
        if self.settings.precision == FLOAT64 and not self.model.delays:
            return march_many(self.model, self.settings, **self._arrays(member_slice), logs=logs, room=room)
        grid, samples = self.grid, self.settings.samples
        members = [
            (grid.member_model(axis_indices), replace(grid.settings_of(axis_indices), samples=samples))
            for axis_indices in self.axis_indices[member_slice]
        ]
        return march_each(members, logs=bool(logs))

    def _arrays(self, selection: slice | NDArray[np.bool_]) -> Arrays:
        """Return the numbers of some of the members."""
        return {
            key: (
                {name: values[selection] for name, values in numbers.items()}
                if isinstance(numbers, dict)
                else numbers[selection]
            )
            for key, numbers in self.arrays.items()
        }


@dataclass(frozen=True)
class SweepGrid:
    """Every combination of the values along its axes.

    Attributes
    ----------
    model : Model
    axes : tuple of Axis
    shared_settings : dict
        Arguments of `simulate` that all members share.
    """

    model: Model
    axes: tuple[Axis, ...]
    shared_settings: dict[str, Any] = field(default_factory=dict)

    def __reduce__(self) -> Any:
        return SweepGrid, (self.model, self.axes, self.shared_settings)

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimensions, in order."""
        return tuple(axis.dim for axis in self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each dimension."""
        return tuple(axis.size for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of members."""
        return prod(self.shape)

    @cached_property
    def columns(self) -> tuple[tuple[int, AxisColumn], ...]:
        """All columns, each with the index of its axis."""
        return tuple((k, column) for k, axis in enumerate(self.axes) for column in axis.columns)

    @cached_property
    def word_axes(self) -> tuple[int, ...]:
        """Axes along which something other than numbers varies, as does the order of a method by its tolerance."""
        kinds = tuple(kind for kind in NUMBERS if kind != RTOL or not self._follows_rtol)
        return tuple({k: None for k, column in self.columns if column.kind not in kinds})

    @property
    def _follows_rtol(self) -> bool:
        """Whether the order of a member follows from its relative tolerance."""
        varied_values = {column.name: column.values.tolist() for _, column in self.columns if column.kind == SETTING}
        methods = varied_values.get("method", [self.shared_settings.get("method") or self.model.run.get("method")])
        has_order = (
            "order" in varied_values or (self.shared_settings.get("order") or self.model.run.get("order")) is not None
        )
        return not has_order and any(name in METHODS and METHODS[name].has_orders for name in methods)

    def check(self) -> None:
        """Check the settings of every combination of words, with the first of all numbers, before anything is marched.

        Raises
        ------
        InputError
            If a member cannot be marched; it is named.
        """
        sizes = [size if k in self.word_axes else 1 for k, size in enumerate(self.shape)]
        for axis_indices in np.ndindex(*sizes):
            try:
                self.recorded_settings_of(axis_indices) if self.recording else self.settings_of(axis_indices)
            except InputError as error:
                if not self.word_axes:
                    raise
                raise InputError(f"member {self.member_name(axis_indices)}: {error}", error.faults) from None

    def member_name(self, axis_indices: AxisIndices) -> str:
        """Name a member by its values."""
        return ", ".join(f"{column.label} = {_value_text(column, axis_indices[k])}" for k, column in self.columns)

    def member_model(self, axis_indices: AxisIndices) -> Model:
        """Return a member's own model."""
        sections: dict[str, dict[str, Any]] = {}
        for k, column in self.columns:
            if column.kind in MODEL_SECTIONS:
                values = dict.fromkeys(column.names, column.quantity(axis_indices[k]))
                sections.setdefault(MODEL_SECTIONS[column.kind], {}).update(values)
        model = self._model_with_tables(axis_indices)
        return model.replace(**sections) if sections else model

    def simulate_arguments(self, axis_indices: AxisIndices) -> dict[str, Any]:
        """Return a member's own arguments of `simulate`, without those for recording complete runs."""
        varied_settings = {
            entry.name: entry.quantity(axis_indices[k])
            for k, entry in self.columns
            if entry.kind not in (*MODEL_SECTIONS, TABLE)
        }
        return {name: entry for name, entry in self.shared_settings.items() if name not in RECORDING} | varied_settings

    def settings_of(self, axis_indices: AxisIndices) -> Settings:
        """Return a member's settings, without the thinning of records that its model file asks for.

        Raises
        ------
        InputError
            If a setting is wrong.
        """
        return unthinned_settings_for(self._model_with_tables(axis_indices), **self.simulate_arguments(axis_indices))

    @property
    def recording(self) -> dict[str, Any]:
        """The given arguments for recording complete runs."""
        return {name: value for name, value in self.shared_settings.items() if name in RECORDING}

    def recorded_settings_of(self, axis_indices: AxisIndices) -> Settings:
        """Return the settings of a member's complete run, with the arguments for its recording."""
        return settings_for(
            self._model_with_tables(axis_indices),
            **self.simulate_arguments(axis_indices),
            **(RECORDING | self.recording),
        )

    @property
    def unrecorded(self) -> SweepGrid:
        """The grid without recording of complete runs."""
        return replace(
            self, shared_settings={name: value for name, value in self.shared_settings.items() if name not in RECORDING}
        )

    @property
    def math_functions(self) -> str:
        """The set of elementary functions that all members use."""
        return str(self.shared_settings.get("math_functions") or NAME)

    @property
    def event_root_method(self) -> str:
        """How events of all members are located."""
        return str(self.shared_settings.get("event_root_method") or EARLIEST_FIRST)

    @property
    def event_start(self) -> str:
        """How all members treat acting events whose functions are zero at the start."""
        return str(self.shared_settings.get("event_start") or JUDGED)

    @property
    def sliding(self) -> str:
        """What becomes of a motion that switches drive back; empty where the model has none that it may slide along."""
        rule = str(self.shared_settings.get("sliding") or FILIPPOV)
        return rule if may_slide_along_switches(self.model) else ""

    @property
    def atol_floor(self) -> str:
        """The floor of tolerances that follow of all members."""
        return str(self.shared_settings.get("atol_floor") or OF_TERMS)

    def block_shape(self, block: Sequence[slice]) -> tuple[int, ...]:
        """Return the number of members of a block along each axis."""
        return tuple(len(range(*extent.indices(size))) for extent, size in zip(block, self.shape, strict=True))

    def indices_in(self, block: Sequence[slice]) -> Places:
        """Return the indices of a block's members along the axes, shape (n, axes)."""
        ranges = [np.arange(*part.indices(size)) for part, size in zip(block, self.shape, strict=True)]
        # ij: the last axis fastest, as members are counted
        return np.stack([part.ravel() for part in np.meshgrid(*ranges, indexing="ij")], axis=1)

    def groups(self, block: Sequence[slice]) -> Iterator[Group]:
        """Split a block of the grid into groups of members that differ in numbers alone."""
        axis_indices = self.indices_in(block)
        keys = axis_indices[:, list(self.word_axes)]
        # without axes of words one empty key, which all members have: they are one group
        for key in np.unique(keys, axis=0) if self.word_axes else np.zeros((1, 0), np.int64):
            block_indices = np.flatnonzero((keys == key).all(axis=1))
            members = axis_indices[block_indices]
            settings = replace(self.settings_of(members[0]), samples=False)
            yield Group(
                self._model_with_tables(members[0]), settings, block_indices, self._arrays(members), self, members
            )

    def _arrays(self, axis_indices: Places) -> Arrays:
        """Return the numbers of members, SI."""
        arrays: Arrays = {}
        for k, column in self.columns:
            if column.kind in (PARAMETER, INITIAL):
                values = dict.fromkeys(column.names, column.si[axis_indices[:, k]])
                arrays.setdefault(MODEL_SECTIONS[column.kind], {}).update(values)
            elif column.kind in NUMBERS:
                arrays[{STEP: "steps", RTOL: "rtols"}[column.kind]] = column.si[axis_indices[:, k]]
        if not arrays:  # only words vary
            name = next(iter(self.model.elements.units))
            arrays["initial"] = {name: np.full(len(axis_indices), self.model.elements.statement.initial[name].si)}
        return arrays

    def _model_with_tables(self, axis_indices: AxisIndices) -> Model:
        """Return the model with a member's tables and start, and the numbers of the model itself."""
        drives = {
            column.name: (str(column.values[axis_indices[k]]), column.tables[axis_indices[k]])
            for k, column in self.columns
            if column.kind == TABLE
        }
        start = next((column.quantity(axis_indices[k]) for k, column in self.columns if column.kind == START), "")
        return _replace_tables(self.model, tuple(drives.items()), start) if drives or start else self.model


def _value_text(column: AxisColumn, i: int) -> str:
    value = column.values[i]
    return str(value) if column.values.dtype == object else f"{float(value)!r} {column.unit.text}"


@lru_cache(maxsize=256)
def _replace_tables(model: Model, tables: tuple[tuple[str, tuple[str, str]], ...], start: str) -> Model:
    """Replace tables of drives, whose text goes into the model, and the initial t."""
    declared = section_tables(model.statement).get("drives", {})
    drives = {name: declared[name] | {"table": f"{label}.csv", "csv": text} for name, (label, text) in tables}
    return model.replace(drives=drives, initial={"t": start} if start else {})


CONVERSION_RTOL = 1e-12  # relative difference of values that were converted between units


def indices_of_labels(grid: SweepGrid, labels: Mapping[str, Any]) -> list[int]:
    """Find the index along every axis of a member given by its values.

    Raises
    ------
    InputError
        If an axis has no such value (the nearest is named), there is no such axis, or the value of one is missing.
    """
    labels = {matching_dim(grid.dims, name): label for name, label in labels.items()}
    unknown = [name for name in labels if name not in grid.dims]
    if unknown:
        raise InputError(f"the sweep has no axis '{unknown[0]}'; there are {', '.join(grid.dims)}")
    indices = []
    for axis in grid.axes:
        if axis.size == 1 and axis.dim not in labels:
            indices.append(0)
        elif axis.dim not in labels:
            raise InputError(f"a member needs a value of every axis, and of '{axis.dim}' there is none")
        else:
            indices.append(index_on_axis(axis, labels[axis.dim]))
    return indices


def index_on_axis(axis: Axis, label: Any) -> int:
    """Find a value on one axis; an axis along which several columns vary takes the number of the member.

    Raises
    ------
    InputError
        If the axis has no such value.
    """
    matching = [column for column in axis.columns if column.label == axis.dim]
    return _index_in_column(matching[0], label) if matching else _member_number(axis.dim, axis.size, label)


def _index_in_column(column: AxisColumn, label: Any) -> int:
    if column.values.dtype == object:
        words = [str(value) for value in column.values]
        if str(label) not in words:
            raise InputError(f"axis '{column.label}' has no {str(label)!r}; there are {', '.join(words)}")
        return words.index(str(label))
    try:
        values, unit = axis_numbers(label, Scale(column.unit))
    except InputError as error:
        raise InputError(f"{column.label} {error}") from None
    if len(values) != 1:
        raise InputError(f"{column.label} is {label!r}, needs one value")
    target_si, values_si = unit.to_si(float(values[0])), column.si
    i = int(np.argmin(np.abs(values_si - target_si)))
    if abs(values_si[i] - target_si) > CONVERSION_RTOL * max(abs(values_si[i]), abs(target_si)):
        raise InputError(
            f"axis '{column.label}' has no {label!r}; the nearest is {float(column.values[i])!r} {column.unit.text}"
        )
    return i


def _member_number(dim: str, size: int, label: Any) -> int:
    if isinstance(label, bool) or not isinstance(label, int | np.integer) or not 0 <= label < size:
        raise InputError(f"{dim} is {label!r}, needs the number of a member, from 0 to {size - 1}")
    return int(label)
