"""A grid of runs: a model, what varies along its axes, what all members share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.cached import cached_property
from xdynamics.elementary import NAME
from xdynamics.faults import InputError
from xdynamics.march import Settings
from xdynamics.march.asking import RECORDING, settings_for, unthinned_settings_for
from xdynamics.march.settings import EARLIEST_FIRST
from xdynamics.model import Model
from xdynamics.sweeping.axes import INITIAL, NUMBERS, OF_MODEL, PARAMETER, RTOL, START, STEP, TABLE, Axis, Column

Places = NDArray[np.int64]
At = Sequence[int] | Places
Arrays = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Members that differ in numbers alone, so that one call of the engine marches them.

    Attributes
    ----------
    model : Model
    settings : Settings
    places : ndarray of int, shape (n,)
        Which members of the block they are.
    arrays : dict
        Of `parameters`, `initial`, `steps` and `rtols` for `march_many` those that vary, SI.
    """

    model: Model
    settings: Settings
    places: Places
    arrays: Arrays

    def without(self, known: NDArray[np.bool_]) -> Group:
        """Leave out members of the block."""
        left = ~known[self.places]
        return self if left.all() else replace(self, places=self.places[left], arrays=self.part(left))

    def part(self, which: slice | NDArray[np.bool_]) -> Arrays:
        """Return the numbers of some of them."""
        return {key: {name: values[which] for name, values in one.items()} if isinstance(one, dict) else one[which] for key, one in self.arrays.items()}  # fmt: skip


@dataclass(frozen=True)
class Grid:
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
        return Grid, (self.model, self.axes, self.asked)

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimensions, in order."""
        return tuple(one.dim for one in self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """How many values there are along each."""
        return tuple(one.size for one in self.axes)

    @property
    def size(self) -> int:
        """How many members there are."""
        return prod(self.shape)

    @cached_property
    def columns(self) -> tuple[tuple[int, Column], ...]:
        """Everything that varies, each with the number of its axis."""
        return tuple((k, one) for k, axis in enumerate(self.axes) for one in axis.columns)

    @cached_property
    def words(self) -> tuple[int, ...]:
        """Axes along which other things vary than numbers: a block holds one value of each."""
        return tuple({k: None for k, one in self.columns if one.kind not in NUMBERS})

    def check(self) -> None:
        """Refuse what no member could be marched with: all combinations of words, with the first of all numbers.

        Raises
        ------
        InputError
            Naming the member.
        """
        sizes = [size if k in self.words else 1 for k, size in enumerate(self.shape)]
        for at in np.ndindex(*sizes):
            try:
                self.recorded_settings_of(at) if self.recording else self.settings_of(at)
            except InputError as error:
                if not self.words:
                    raise
                raise InputError(f"member {self.said(at)}: {error}", error.faults) from None

    def said(self, at: At) -> str:
        """Name a member by its values."""
        return ", ".join(f"{one.label} = {_shown(one, at[k])}" for k, one in self.columns)

    def model_of(self, at: At) -> Model:
        """Return a member's own model."""
        sections: dict[str, dict[str, Any]] = {}
        for k, one in self.columns:
            if one.kind in OF_MODEL:
                sections.setdefault(OF_MODEL[one.kind], {})[one.name] = one.quantity(at[k])
        model = self._common(at)
        return model.replace(**sections) if sections else model

    def asked_of(self, at: At) -> dict[str, Any]:
        """Return a member's own arguments of `simulate`, but for what says how whole runs are recorded."""
        own = {one.name: one.quantity(at[k]) for k, one in self.columns if one.kind not in (*OF_MODEL, TABLE)}
        return {name: one for name, one in self.asked.items() if name not in RECORDING} | own

    def settings_of(self, at: At) -> Settings:
        """Return a member's settings; what its model file leaves out of records is kept."""
        return unthinned_settings_for(self._common(at), **self.asked_of(at))

    @property
    def recording(self) -> dict[str, Any]:
        """What was asked for of the records of whole runs."""
        return {name: one for name, one in self.asked.items() if name in RECORDING}

    def recorded_settings_of(self, at: At) -> Settings:
        """Return the settings of a member's whole run, with what is asked for of its record."""
        return settings_for(self._common(at), **self.asked_of(at), **(RECORDING | self.recording))

    @property
    def unrecorded(self) -> Grid:
        """The same members, of which no whole runs are recorded."""
        return replace(self, asked={name: one for name, one in self.asked.items() if name not in RECORDING})

    @property
    def math_functions(self) -> str:
        """The set of elementary functions of all members."""
        return str(self.asked.get("math_functions") or NAME)

    @property
    def event_root_method(self) -> str:
        """How events of all members are located."""
        return str(self.asked.get("event_root_method") or EARLIEST_FIRST)

    def shape_of(self, block: Sequence[slice]) -> tuple[int, ...]:
        """Return how many members a block has along each axis."""
        return tuple(len(range(*one.indices(size))) for one, size in zip(block, self.shape, strict=True))

    def places(self, block: Sequence[slice]) -> Places:
        """Return where the members of a block stand along the axes, shape (n, axes)."""
        ranges = [np.arange(*one.indices(size)) for one, size in zip(block, self.shape, strict=True)]
        return np.stack([one.ravel() for one in np.meshgrid(*ranges, indexing="ij")], axis=1)

    def groups(self, block: Sequence[slice]) -> Iterator[Group]:
        """Take a block of the grid apart into members that differ in numbers alone."""
        at = self.places(block)
        keys = at[:, list(self.words)]
        for key in np.unique(keys, axis=0) if self.words else np.zeros((1, 0), np.int64):
            places = np.flatnonzero((keys == key).all(axis=1))
            mine = at[places]
            settings = replace(self.settings_of(mine[0]), samples=False)
            yield Group(self._common(mine[0]), settings, places, self._arrays(mine))

    def _arrays(self, at: Places) -> Arrays:
        """Return the numbers of members, SI."""
        found: Arrays = {}
        for k, one in self.columns:
            if one.kind in (PARAMETER, INITIAL):
                found.setdefault(OF_MODEL[one.kind], {})[one.name] = one.si[at[:, k]]
            elif one.kind in NUMBERS:
                found[{STEP: "steps", RTOL: "rtols"}[one.kind]] = one.si[at[:, k]]
        if not found:  # words alone vary
            name = next(iter(self.model.units))
            found["initial"] = {name: np.full(len(at), self.model.initial[name].si)}
        return found

    def _common(self, at: At) -> Model:
        """Return the model with a member's tables and start; its numbers are those that all share."""
        drives = {one.name: (str(one.values[at[k]]), one.tables[at[k]]) for k, one in self.columns if one.kind == TABLE}
        start = next((one.quantity(at[k]) for k, one in self.columns if one.kind == START), "")
        return _with(self.model, tuple(drives.items()), start) if drives or start else self.model


def _shown(column: Column, i: int) -> str:
    value = column.values[i]
    return str(value) if column.values.dtype == object else f"{float(value)!r} {column.unit.text}"


@lru_cache(maxsize=256)
def _with(model: Model, tables: tuple[tuple[str, tuple[str, str]], ...], start: str) -> Model:
    """Give drives other tables, whose text goes into the model, and the motion another beginning."""
    import tomllib

    said = tomllib.loads(model.to_toml()).get("drives", {})
    drives = {name: said[name] | {"table": f"{label}.csv", "csv": text} for name, (label, text) in tables}
    return model.replace(drives=drives, initial={"t": start} if start else {})
