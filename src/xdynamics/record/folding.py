"""Quantities with dimensions: one variable each in a record, and a variable for each element to whoever computes with them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.element_attributes import attributes_of_element, attributes_of_whole
from xdynamics.schema import (
    DETECTOR_DIMENSIONS,
    ELEMENT_NAME,
    ELEMENTS,
    LABEL,
    LINK,
    MODEL_DIMENSIONS,
    NOWHERE,
    at_event,
    end_of,
    flags,
    label_of,
)
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import DOT, element, spoken, written

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

FOLDED = "folded"  # entry of the encoding of an unfolded Dataset: what it was
FORCES = ("force_", "sample_force_")  # of which the elements that are not there are 0: the force does not act there
DETECTOR = "event_detector"
_SIZED = re.compile(r"(\w+)\((\d+)\)")


@dataclass(frozen=True)
class Whole:
    """A quantity with dimensions among variables that are its elements.

    Attributes
    ----------
    name : str
    dims : tuple of str
    shape : tuple of int
    members : dict of int to str
        By its number, the last dimension fastest, the name of each element that is there.
    pattern : str
        How the names of elements are made, like ``event_{}_uncertainty``; empty where labels stand at their end.
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    pattern: str = ""
    members: dict[int, str] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """How many elements it has."""
        return int(np.prod(self.shape))

    @property
    def missing(self) -> float:
        """The value of an element that is not there."""
        return 0.0 if self.name.startswith(FORCES) else np.nan

    @property
    def more(self) -> dict[str, str]:
        """Attributes that say how its elements are named, and which it has."""
        kept = {} if len(self.members) == self.size or not self.missing else {ELEMENTS: _listed(self.members.values())}
        return kept | ({ELEMENT_NAME: self.pattern} if self.pattern else {})

    def stacked(self, parts: Mapping[int, Array]) -> Array:
        """Return the values of elements as one array, its dimensions last."""
        first = next(iter(parts.values()))
        whole = np.empty((self.size, *first.shape), first.dtype)
        if len(parts) < self.size:
            whole[:] = self.missing
        for number, values in parts.items():
            whole[number] = values
        return np.moveaxis(whole, 0, -1).reshape((*first.shape, *self.shape))


def _listed(names: Iterable[str]) -> str:
    return " ".join(spoken(name).replace(" ", "") for name in names)


class Names:
    """Which names are elements of which quantity."""

    def __init__(self, shapes: Shapes) -> None:
        self.shapes = shapes
        self._known: dict[tuple[str, int], tuple[str, ...]] = {}
        self._labels = {name: frozenset(extent.labels) for name, extent in shapes.extents.items()}

    def wholes(self, names: Iterable[str]) -> dict[str, Whole]:
        """Gather names that are elements by their quantities."""
        wholes: dict[str, Whole] = {}
        for name in names:
            if DOT in name and (place := self._place(name)):
                whole, number = place
                wholes.setdefault(whole.name, whole).members[number] = name
        return wholes

    def _place(self, name: str) -> tuple[Whole, int] | None:
        """Return the quantity of an element, and its number there."""
        stem, *labels = name.split(DOT)
        dims = self._dims(stem, len(labels))
        if not dims:
            return None
        last, tail = self._cut(labels[-1], dims[-1])
        if not all(map(self._has, dims, (*labels[:-1], last))):
            return None
        numbers = [self._number(dim, label) for dim, label in zip(dims, (*labels[:-1], last), strict=True)]
        shape = self.shapes.shape(dims)
        number = 0
        for size, one in zip(shape, numbers, strict=True):
            number = number * size + one
        return Whole(stem + tail, dims, shape, f"{stem}{{}}{tail}" if tail else ""), number

    def _dims(self, stem: str, count: int) -> tuple[str, ...]:
        """Return the dimensions of a quantity: of the longest name at its end that has some."""
        if (stem, count) not in self._known:
            words = stem.split("_")
            ends = ("_".join(words[first:]) for first in range(len(words)))
            of_ends = (self.shapes.dims.get(name, ()) for name in ends)
            self._known[stem, count] = next((dims for dims in of_ends if len(dims) == count), ())
        return self._known[stem, count]

    def _cut(self, label: str, dim: str) -> tuple[str, str]:
        """Part the last label from what follows it, as in ``event_height·Jupiter_uncertainty``."""
        if self._has(dim, label):
            return label, ""
        ends = (i for i in range(len(label) - 1, 0, -1) if label[i] == "_" and self._has(dim, label[:i]))
        end = next(ends, len(label))
        return label[:end], label[end:]

    def _has(self, dim: str, label: str) -> bool:
        known = self._labels.get(dim)
        return label in known if known else label.isdigit() and int(label) < self.shapes.extent(dim).size

    def _number(self, dim: str, label: str) -> int:
        return self.shapes.extent(dim).number(label if self._labels.get(dim) else int(label))


def fold(dataset: xr.Dataset, shapes: Shapes) -> xr.Dataset:
    """Make one variable of the elements of each quantity.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of any kind, whose variables are named as elements, like ``maximum_r·Jupiter·x``; lazy ones stay lazy.
    shapes : Shapes
        Of the model.

    Returns
    -------
    xarray.Dataset
        With labels as they are in a file, ``body_label(body)``; see `labelled`. One without elements is returned as it is.
    """
    wholes = Names(shapes).wholes(map(str, dataset.variables))
    if not wholes:
        return dataset
    import xarray as xr

    of_name = {name: whole for whole in wholes.values() for name in whole.members.values()}
    variables: dict[Any, Any] = {}
    for name, variable in dataset.variables.items():
        whole = of_name.get(str(name))
        if whole is None:
            variables[name] = variable
        elif whole.name not in variables:
            variables[whole.name] = _whole_variable(whole, dataset)
    coordinates = {of_name[name].name if name in of_name else name for name in map(str, dataset.coords)}
    dims = {dim for whole in wholes.values() for dim in whole.dims}
    for name, (own, values, attributes) in about_dimensions(shapes, dims).items():
        variables[name] = xr.Variable(own, values, attributes)
        coordinates.add(name)
    folded = xr.Dataset(variables, attrs=dict(dataset.attrs) | {MODEL_DIMENSIONS: sized(shapes, dims)})
    folded.encoding = {key: entry for key, entry in dataset.encoding.items() if key != FOLDED}
    return folded.set_coords(coordinates)


def _whole_variable(whole: Whole, dataset: xr.Dataset) -> xr.Variable:
    import xarray as xr

    parts = {number: dataset.variables[name] for number, name in whole.members.items()}
    own = next(iter(parts.values())).dims
    attributes = attributes_of_whole(
        {number: (whole.members[number], part.attrs) for number, part in parts.items()}, whole.size
    )
    if any(part.chunks is not None for part in parts.values()):
        import dask.array

        da: Any = dask.array  # its functions are not typed
        blank = da.full_like(next(iter(parts.values())).data, whole.missing)
        rows = [parts[number].data if number in parts else blank for number in range(whole.size)]
        data = da.stack(rows, axis=-1).rechunk({len(own): -1}).reshape((*rows[0].shape, *whole.shape))
    else:
        data = whole.stacked({number: np.asarray(part.values) for number, part in parts.items()})
    return xr.Variable((*own, *whole.dims), data, attributes | whole.more)


def sized(shapes: Shapes, dims: set[str]) -> str:
    """Write dimensions with their sizes, in the order of a record."""
    return " ".join(f"{dim}({shapes.extent(dim).size})" for dim in shapes.ordered(dims))


def about_dimensions(shapes: Shapes, dims: set[str]) -> dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]]:
    """Return the labels of dimensions and the ends of relations: dims, values and attributes by name."""
    parts: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]] = {}
    for dim in shapes.ordered(dims):
        if dim in shapes.relations:
            relation = shapes.relations[dim]
            for end, of, numbers in (
                ("first", relation.source, relation.first),
                ("second", relation.target, relation.second),
            ):
                extent = shapes.extent(of)
                more = flags(dict(enumerate(extent.labels)), "i4") if extent.labels else {}
                long_name = f"number of the {end} {of} of a {dim}, from 0"
                parts[end_of(dim, end)] = (
                    (dim,), np.asarray(numbers, np.int32), {"units": "1", "long_name": long_name, "role": LINK} | more
                )  # fmt: skip
        elif labels := shapes.extents[dim].labels:
            attributes = {"units": "1", "long_name": f"label of the {dim}", "role": LABEL}
            parts[label_of(dim)] = ((dim,), np.array(labels), attributes)
    return parts


def model_dimensions(dataset: Any) -> dict[str, int]:
    """Return the dimensions of the model in a record with their sizes in it, in their order; most records have none."""
    text = getattr(dataset, "attrs", {}).get(MODEL_DIMENSIONS)
    return {} if text is None else {name: int(size) for name, size in _SIZED.findall(str(text))}


def labelled(dataset: xr.Dataset) -> xr.Dataset:
    """Return a record with labels of dimensions as their indexes, as people select by them."""
    for dim in model_dimensions(dataset):
        if (name := label_of(dim)) in dataset.variables and name not in dataset.dims:
            labels = dataset.variables[name]
            dataset = dataset.drop_vars(name).assign_coords({dim: (labels.dims, np.asarray(labels), labels.attrs)})
    return dataset


def unlabelled(dataset: xr.Dataset) -> xr.Dataset:
    """Return a record with labels as auxiliary coordinates, as a file has them."""
    for dim in model_dimensions(dataset):
        if dim in dataset.variables and dataset.variables[dim].attrs.get("role") == LABEL:
            labels = dataset.variables[dim]
            kept = dataset.drop_vars(dim)
            dataset = kept.assign_coords({label_of(dim): (labels.dims, np.asarray(labels).astype(str), labels.attrs)})
    return dataset


def unfold(dataset: xr.Dataset) -> xr.Dataset:
    """Make variables of the elements of each quantity: views, which are read when they are used.

    Parameters
    ----------
    dataset : xarray.Dataset
        In memory or opened, lazy or not; one without dimensions of a model is returned as it is.
    """
    dims = model_dimensions(dataset)
    if not dims:
        return dataset
    import xarray as xr

    labels = {dim: _labels(dataset, dim) for dim in dims if dim in dataset.dims}
    about = {name for dim in dims for name in (dim, label_of(dim), end_of(dim, "first"), end_of(dim, "second"))}
    variables: dict[Any, Any] = {}
    coordinates = []
    for name, variable in dataset.variables.items():
        inner = tuple(str(dim) for dim in variable.dims if dim in labels)
        if name in about:
            continue
        parts = dict(_elements(str(name), variable, inner, labels)) if inner else {name: variable}
        variables |= parts
        coordinates += [*parts] if name in dataset.coords else []
    if DETECTOR in variables:
        variables |= _detectors(variables, [*dims], labels)
    indexes = {name: index for name, index in dataset.xindexes.items() if name in variables}
    unfolded = xr.Dataset._construct_direct(  # noqa: SLF001 - the constructor takes each variable apart several times
        variables,
        set(coordinates),
        attrs=dict(dataset.attrs),
        indexes=indexes,
        close=dataset._close,  # noqa: SLF001
    )
    unfolded.attrs.pop(MODEL_DIMENSIONS)
    unfolded.encoding = dict(dataset.encoding) | {FOLDED: dataset}
    return unfolded


def as_recorded(dataset: xr.Dataset) -> xr.Dataset:
    """Return what a Dataset was before it was unfolded, as a file has it."""
    return unlabelled(dataset.encoding.get(FOLDED, dataset)) if hasattr(dataset, "encoding") else dataset


def _labels(dataset: xr.Dataset, dim: str) -> Sequence[str]:
    for name in (dim, label_of(dim)):
        if name in dataset.variables and dataset.variables[name].dims == (dim,):
            return [str(label) for label in np.asarray(dataset.variables[name]).tolist()]
    return [str(number) for number in range(dataset.sizes[dim])]


def _elements(
    name: str, variable: xr.Variable, inner: tuple[str, ...], labels: Mapping[str, Sequence[str]]
) -> Iterator[tuple[str, xr.Variable]]:
    """Yield the elements of a variable."""
    import xarray as xr

    own = tuple(dim for dim in variable.dims if dim not in inner)
    take = _taker(variable.transpose(*own, *inner) if variable.dims != (*own, *inner) else variable, len(own))
    kept = str(variable.attrs.get(ELEMENTS, "")).split()
    stem, _, tail = str(variable.attrs.get(ELEMENT_NAME, f"{name}{{}}")).partition("{}")
    places = product(*(range(len(labels[dim])) for dim in inner))
    size = int(np.prod([len(labels[dim]) for dim in inner]))
    wanted = {written(one) for one in kept}
    for number, place in enumerate(places):
        one = element(stem, (labels[dim][i] for dim, i in zip(inner, place, strict=True))) + tail
        if not wanted or one in wanted:
            attributes = attributes_of_element(variable.attrs, number, size)
            yield one, xr.Variable(own, take(place), attributes, fastpath=True)


def _taker(variable: xr.Variable, own: int) -> Callable[[tuple[int, ...]], Any]:
    """Return what gives the values of an element: a view of an array, or what is read when it is used."""
    if isinstance(variable._data, np.ndarray) or variable.chunks is not None:  # noqa: SLF001 - `.data` would read what is lazy
        data, rows = variable.data, (slice(None),) * own
        return lambda place: data[(*rows, *place)]
    from xdynamics.record.element_reading import Shared

    return Shared(variable, own).element


def _detectors(
    variables: Mapping[Any, Any], dims: Sequence[str], labels: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Return which detector of which element each event is of, as one flag."""
    import xarray as xr

    detector = variables[DETECTOR]
    along = {}
    for entry in str(detector.attrs.get(DETECTOR_DIMENSIONS, "")).split("; "):
        kind, _, of = entry.partition(": ")
        along[kind] = of.split()
    words = str(detector.attrs["flag_meanings"]).split()
    names: list[str] = []
    first = {}
    for number, word in zip(np.atleast_1d(detector.attrs["flag_values"]).tolist(), words, strict=True):
        first[number] = len(names)
        own = along.get(word, [])
        names += [element(word, place) for place in product(*(labels[dim] for dim in own))] if own else [word]
    numbers = np.asarray(detector.values)
    combined = np.array([first[number] for number in numbers.tolist()], np.int32)
    inside = np.zeros(len(combined), np.int32)
    for dim in dims:
        if (name := at_event(dim)) in variables:
            place = np.asarray(variables[name].values)
            inside = np.where(place == NOWHERE, inside, inside * len(labels.get(dim, ())) + place)
    attributes = {key: value for key, value in detector.attrs.items() if key != DETECTOR_DIMENSIONS}
    attributes |= flags(dict(enumerate(names)), "i4")
    return {DETECTOR: xr.Variable(detector.dims, (combined + inside).astype(np.int32), attributes)}
