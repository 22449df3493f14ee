"""A grid of runs: a model, its axes, and the settings that all members share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from xdynamics.march.root_methods import EARLIEST_FIRST, JUDGED
from xdynamics.march.tolerances import OF_TERMS
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model
from xdynamics.model.toml import tables_of
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.sweeping.axes import (
    INITIAL,
    NUMBERS,
    OF_MODEL,
    PARAMETER,
    RTOL,
    SETTING,
    START,
    STEP,
    TABLE,
    Axis,
    AxisColumn,
)

Places = NDArray[np.int64]
At = Sequence[int] | Places
Arrays = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Members that differ in numbers alone, so that one call of the engine can march them.

    Attributes
    ----------
    model : Model
    settings : Settings
    places : ndarray of int, shape (n,)
        Indices of the members in the block.
    arrays : dict
        Those of `parameters`, `initial`, `steps` and `rtols` for `march_many` that vary, SI.
    grid : SweepGrid
    at : ndarray of int, shape (n, axes)
        Indices of the members along the axes.
    """

    model: Model
    settings: Settings
    places: Places
    arrays: Arrays
    grid: SweepGrid
    at: Places

    def without(self, known: NDArray[np.bool_]) -> Group:
        """Return the group without the known members of the block."""
        remaining = ~known[self.places]
        if remaining.all():
            return self
        return replace(self, places=self.places[remaining], arrays=self._arrays(remaining), at=self.at[remaining])

    def marched(self, which: slice, *, logs: bool | Sequence[str], room: Room | None = None) -> Runs:
        """March some of the members; sums of two floats, and the past of delays, are each member's own."""
        if self.settings.precision == FLOAT64 and not self.model.delays:
            return march_many(self.model, self.settings, **self._arrays(which), logs=logs, room=room)
        grid, samples = self.grid, self.settings.samples
        members = [(grid.model_of(at), replace(grid.settings_of(at), samples=samples)) for at in self.at[which]]
        return march_each(members, logs=bool(logs))

    def _arrays(self, which: slice | NDArray[np.bool_]) -> Arrays:
        """Return the numbers of some of the members."""
        return {
            key: (
                {name: values[which] for name, values in numbers.items()}
                if isinstance(numbers, dict)
                else numbers[which]
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
    asked : dict
        Arguments of `simulate` that all members share.
    """

    model: Model
    axes: tuple[Axis, ...]
    asked: dict[str, Any] = field(default_factory=dict)

    def __reduce__(self) -> Any:
        return SweepGrid, (self.model, self.axes, self.asked)

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
    def words(self) -> tuple[int, ...]:
        """Axes along which something other than numbers varies, as does the order of a method by its tolerance."""
        kinds = tuple(kind for kind in NUMBERS if kind != RTOL or not self._follows_rtol)
        return tuple({k: None for k, column in self.columns if column.kind not in kinds})

    @property
    def _follows_rtol(self) -> bool:
        """Whether the order of a member follows from its relative tolerance."""
        varied = {column.name: column.values.tolist() for _, column in self.columns if column.kind == SETTING}
        methods = varied.get("method", [self.asked.get("method") or self.model.run.get("method")])
        given = "order" in varied or (self.asked.get("order") or self.model.run.get("order")) is not None
        return not given and any(name in METHODS and METHODS[name].has_orders for name in methods)

    def check(self) -> None:
        """Check the settings of every combination of words, with the first of all numbers, before anything is marched.

        Raises
        ------
        InputError
            If a member cannot be marched; it is named.
        """
        sizes = [size if k in self.words else 1 for k, size in enumerate(self.shape)]
        for at in np.ndindex(*sizes):
            try:
                self.recorded_settings_of(at) if self.recording else self.settings_of(at)
            except InputError as error:
                if not self.words:
                    raise
                raise InputError(f"member {self.name_of(at)}: {error}", error.faults) from None

    def name_of(self, at: At) -> str:
        """Name a member by its values."""
        return ", ".join(f"{column.label} = {_shown(column, at[k])}" for k, column in self.columns)

    def model_of(self, at: At) -> Model:
        """Return a member's own model."""
        sections: dict[str, dict[str, Any]] = {}
        for k, column in self.columns:
            if column.kind in OF_MODEL:
                values = dict.fromkeys(column.names, column.quantity(at[k]))
                sections.setdefault(OF_MODEL[column.kind], {}).update(values)
        model = self._common(at)
        return model.replace(**sections) if sections else model

    def asked_of(self, at: At) -> dict[str, Any]:
        """Return a member's own arguments of `simulate`, except those for the recording of whole runs."""
        own = {entry.name: entry.quantity(at[k]) for k, entry in self.columns if entry.kind not in (*OF_MODEL, TABLE)}
        return {name: entry for name, entry in self.asked.items() if name not in RECORDING} | own

    def settings_of(self, at: At) -> Settings:
        """Return a member's settings, without the thinning of records that its model file asks for.

        Raises
        ------
        InputError
            If a setting is wrong.
        """
        return unthinned_settings_for(self._common(at), **self.asked_of(at))

    @property
    def recording(self) -> dict[str, Any]:
        """The arguments given for the recording of whole runs."""
        return {name: value for name, value in self.asked.items() if name in RECORDING}

    def recorded_settings_of(self, at: At) -> Settings:
        """Return the settings of a member's whole run, with the arguments for its recording."""
        return settings_for(self._common(at), **self.asked_of(at), **(RECORDING | self.recording))

    @property
    def unrecorded(self) -> SweepGrid:
        """The same grid without recording of whole runs."""
        return replace(self, asked={name: value for name, value in self.asked.items() if name not in RECORDING})

    @property
    def math_functions(self) -> str:
        """The set of elementary functions that all members use."""
        return str(self.asked.get("math_functions") or NAME)

    @property
    def event_root_method(self) -> str:
        """How events of all members are located."""
        return str(self.asked.get("event_root_method") or EARLIEST_FIRST)

    @property
    def event_start(self) -> str:
        """What becomes of acting events of all members whose functions are zero at the start."""
        return str(self.asked.get("event_start") or JUDGED)

    @property
    def atol_floor(self) -> str:
        """The floor of tolerances that follow of all members."""
        return str(self.asked.get("atol_floor") or OF_TERMS)

    def shape_of(self, block: Sequence[slice]) -> tuple[int, ...]:
        """Return the number of members of a block along each axis."""
        return tuple(len(range(*extent.indices(size))) for extent, size in zip(block, self.shape, strict=True))

    def places(self, block: Sequence[slice]) -> Places:
        """Return the indices of a block's members along the axes, shape (n, axes)."""
        ranges = [np.arange(*part.indices(size)) for part, size in zip(block, self.shape, strict=True)]
        return np.stack([part.ravel() for part in np.meshgrid(*ranges, indexing="ij")], axis=1)

    def groups(self, block: Sequence[slice]) -> Iterator[Group]:
        """Split a block of the grid into groups of members that differ in numbers alone."""
        at = self.places(block)
        keys = at[:, list(self.words)]
        for key in np.unique(keys, axis=0) if self.words else np.zeros((1, 0), np.int64):
            places = np.flatnonzero((keys == key).all(axis=1))
            members = at[places]
            settings = replace(self.settings_of(members[0]), samples=False)
            yield Group(self._common(members[0]), settings, places, self._arrays(members), self, members)

    def _arrays(self, at: Places) -> Arrays:
        """Return the numbers of members, SI."""
        arrays: Arrays = {}
        for k, column in self.columns:
            if column.kind in (PARAMETER, INITIAL):
                values = dict.fromkeys(column.names, column.si[at[:, k]])
                arrays.setdefault(OF_MODEL[column.kind], {}).update(values)
            elif column.kind in NUMBERS:
                arrays[{STEP: "steps", RTOL: "rtols"}[column.kind]] = column.si[at[:, k]]
        if not arrays:  # only words vary
            name = next(iter(self.model.units))
            arrays["initial"] = {name: np.full(len(at), self.model.statement.initial[name].si)}
        return arrays

    def _common(self, at: At) -> Model:
        """Return the model with a member's tables and start, and the numbers of the model itself."""
        drives = {
            column.name: (str(column.values[at[k]]), column.tables[at[k]])
            for k, column in self.columns
            if column.kind == TABLE
        }
        start = next((column.quantity(at[k]) for k, column in self.columns if column.kind == START), "")
        return _with(self.model, tuple(drives.items()), start) if drives or start else self.model


def _shown(column: AxisColumn, i: int) -> str:
    value = column.values[i]
    return str(value) if column.values.dtype == object else f"{float(value)!r} {column.unit.text}"


@lru_cache(maxsize=256)
def _with(model: Model, tables: tuple[tuple[str, tuple[str, str]], ...], start: str) -> Model:
    """Replace tables of drives, whose text goes into the model, and the initial t."""
    declared = tables_of(model.statement).get("drives", {})
    drives = {name: declared[name] | {"table": f"{label}.csv", "csv": text} for name, (label, text) in tables}
    return model.replace(drives=drives, initial={"t": start} if start else {})
