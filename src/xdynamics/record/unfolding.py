"""Single elements of a record's quantities with dimensions, as the variables that every verb computes with.

Detectors of events are named together with their elements. Where a variable is lazy, the array behind its elements is
read once for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from itertools import compress, product
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from xarray import Variable
from xarray.backends import BackendArray
from xarray.core import indexing

from xdynamics import schema
from xdynamics.faults import InputError
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.folding import (
    FOLDED,
    attributes_of_element,
    check_elements,
    fold,
    labelled,
    model_dimensions,
    names_as_words,
    unlabelled,
)
from xdynamics.record.schemas import as_written
from xdynamics.shapes import NO_SHAPES, Extent, Relation, Shapes
from xdynamics.shapes.extents import indices_of_element
from xdynamics.shapes.naming import DOT, display_text, join_element_name, split_element_name
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

DETECTOR = "event_detector"


def element_labels(dataset: xr.Dataset, dim: str) -> Sequence[str]:
    """Return the labels of the elements along a dimension of the model, or their numbers."""
    return _written_labels(dataset, dim) or [str(number) for number in range(dataset.sizes[dim])]


def has_labels(dataset: xr.Dataset, dim: str) -> bool:
    """Whether the elements along a dimension of the model have labels."""
    return bool(_written_labels(dataset, dim))


def _written_labels(dataset: xr.Dataset, dim: str) -> tuple[str, ...]:
    for name in (dim, schema.label_of(dim)):
        if name in dataset.variables and dataset.variables[name].dims == (dim,):
            return tuple(str(label) for label in np.asarray(dataset.variables[name]).tolist())
    return ()


def dims_of_detectors(attributes: Mapping[Any, Any]) -> dict[str, tuple[str, ...]]:
    """Return the dimensions of each detector that has some, from the attributes of `event_detector`."""
    entries = [entry.partition(": ") for entry in str(attributes.get(schema.DETECTOR_DIMENSIONS, "")).split("; ")]
    return {kind: tuple(dims_text.split()) for kind, _, dims_text in entries if kind}


def find_column(dataset: xr.Dataset, name: str) -> xr.Variable | None:
    """Return a variable of a Dataset by its name, or one element of a quantity by the element's; None if there is none.

    Parameters
    ----------
    dataset : xarray.Dataset
        A record or evidence, with quantities as one variable each or unfolded.
    name : str
        ``u``, or an element as it is named inside, ``u·3``.
    """
    if name in dataset.variables:
        full_variable: xr.Variable = dataset.variables[name]
        return full_variable
    if DOT not in name or (quantity := split_element_name(name)[0]) not in dataset.variables:
        return None
    variable, model_dims = dataset.variables[quantity], model_dimensions(dataset)
    dims = tuple(str(dim) for dim in variable.dims if dim in model_dims)
    extents = tuple(Extent(dim, dataset.sizes[dim], _written_labels(dataset, dim)) for dim in dims)
    if (element_index := indices_of_element(name, extents)) is None:
        return None
    shape = tuple(extent.size for extent in extents)
    element_variable = variable.isel(dict(zip(dims, element_index, strict=True)))
    number, size = (int(np.ravel_multi_index(element_index, shape)), int(np.prod(shape))) if shape else (0, 1)
    element_variable.attrs = attributes_of_element(variable.attrs, number, size)
    return element_variable


def element_array(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """Return `get_column` as an array with its coordinates, lazy where the Dataset is.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    import xarray as xr

    variable = get_column(dataset, name)
    return xr.DataArray(
        variable, {key: dataset.coords[key] for key in dataset.coords if {*dataset[key].dims} <= {*variable.dims}}
    )


def get_column(dataset: xr.Dataset, name: str) -> xr.Variable:
    """Return a variable of a Dataset, or one element of a quantity; see `find_column`.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if (variable := find_column(dataset, name)) is None:
        raise KeyError(name)
    return variable


def column_in_si(dataset: xr.Dataset, name: str) -> NDArray[np.float64]:
    """Return the numbers of a variable, or of one element of a quantity, in SI units; see `get_column`.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    variable = get_column(dataset, name)
    return np.asarray(variable.values, float) * float(parse_unit(str(variable.attrs["units"])).factor)


def detectors_of(run: xr.Dataset) -> list[str]:
    """Return everything that events of a record are located by: of a detector with dimensions each of its elements."""
    attributes = run[DETECTOR].attrs
    dims_by_detector = dims_of_detectors(attributes)
    labels = {
        dim: element_labels(run, dim) if dim in run.dims else ()
        for detector_dims in dims_by_detector.values()
        for dim in detector_dims
    }
    names: list[str] = []
    for word in str(attributes["flag_meanings"]).split():
        detector_dims = dims_by_detector.get(word, ())
        names += (
            [
                join_element_name(word, label_combination)
                for label_combination in product(*(labels[dim] for dim in detector_dims))
            ]
            if detector_dims
            else [word]
        )
    return names


def event_words(run: xr.Dataset) -> list[str]:
    """Return the detector of each event of a record, by an element's name where the detector has dimensions."""
    words = words_of_flag(run[DETECTOR])
    dims_by_detector = dims_of_detectors(run[DETECTOR].attrs)
    dims = {dim for detector_dims in dims_by_detector.values() for dim in detector_dims}
    numbers = {dim: np.asarray(run[schema.at_event(dim)].values).tolist() for dim in dims}
    labels = {dim: _written_labels(run, dim) for dim in dims}

    def element_label(dim: str, event: int) -> str:
        number = numbers[dim][event]
        return labels[dim][number] if labels[dim] else str(number)

    return [
        join_element_name(word, [element_label(dim, event) for dim in dims_by_detector[word]])
        if word in dims_by_detector
        else word
        for event, word in enumerate(words)
    ]


Array = NDArray[Any]

MOST_READ = 4  # selections of rows that are kept: elements are asked for the same ones, one after the other


class SharedElements:
    """A variable whose elements are read together.

    Parameters
    ----------
    variable : xarray.Variable
        With the dimensions of the model last.
    outer_count : int
        How many other dimensions it has.
    """

    def __init__(self, variable: Variable, outer_count: int) -> None:
        self.variable, self.outer_count = variable, outer_count
        self._read: dict[Any, Array] = {}

    def element(self, element_index: tuple[int, ...]) -> Any:
        """Return the values of an element, to be read when they are used."""
        return indexing.LazilyIndexedArray(ElementArray(self, element_index))

    def rows_of_all(self, key: tuple[Any, ...]) -> Array:
        """Return the values of all elements in some rows."""
        if all(isinstance(part, slice) and part == slice(None) for part in key):
            return np.asarray(self.variable.values)
        word = tuple(part.tobytes() if isinstance(part, np.ndarray) else str(part) for part in key)
        values = self._read.get(word)
        if values is None:
            values = np.asarray(self.variable[key].values)
            for oldest in [*self._read][: len(self._read) + 1 - MOST_READ]:
                # None: another thread may have dropped it meanwhile
                self._read.pop(oldest, None)
            self._read[word] = values
        return values


class ElementArray(BackendArray):
    """The values of one element."""

    def __init__(self, shared: SharedElements, element_index: tuple[int, ...]) -> None:
        self.shared, self.element_index = shared, element_index
        self.shape, self.dtype = shared.variable.shape[: shared.outer_count], shared.variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._element_values)

    def _element_values(self, key: tuple[Any, ...]) -> Any:
        index_of_all: Any = (..., *self.element_index)
        return self.shared.rows_of_all(key)[index_of_all]


Given = ParamSpec("Given")
Result = TypeVar("Result")


def unfold(dataset: xr.Dataset) -> xr.Dataset:
    """Unfold each quantity with dimensions into variables of its elements: views, read when they are used.

    Parameters
    ----------
    dataset : xarray.Dataset
        In memory or opened, lazy or not; one without dimensions of a model is returned as it is.
    """
    dims = model_dimensions(dataset)
    if not dims:
        return dataset
    import xarray as xr

    labels = {dim: element_labels(dataset, dim) for dim in dims if dim in dataset.dims}
    about = {
        name
        for dim in dims
        for name in (dim, schema.label_of(dim), schema.end_of(dim, "first"), schema.end_of(dim, "second"))
    }
    variables: dict[Any, Any] = {}
    coordinates = []
    for name, variable in dataset.variables.items():
        inner = tuple(str(dim) for dim in variable.dims if dim in labels)
        if name in about:
            continue
        parts = dict(_split_elements(str(name), variable, inner, labels)) if inner else {name: variable}
        variables |= parts
        coordinates += [*parts] if name in dataset.coords else []
    if DETECTOR in variables:
        variables |= _element_detectors(dataset, variables, [*dims], labels)
    indexes = {name: index for name, index in dataset.xindexes.items() if name in variables}
    unfolded = xr.Dataset._construct_direct(  # noqa: SLF001 - the constructor takes each variable apart several times
        variables,
        set(coordinates),
        attrs=dict(dataset.attrs),
        indexes=indexes,
        close=dataset._close,  # noqa: SLF001
    )
    unfolded.attrs.pop(schema.MODEL_DIMENSIONS)
    unfolded.encoding = dict(dataset.encoding) | {FOLDED: dataset}
    return unfolded


def whole_of(dataset: xr.Dataset) -> xr.Dataset:
    """Return the Dataset as it was before it was unfolded."""
    folded_dataset: xr.Dataset = getattr(dataset, "encoding", {}).get(FOLDED, dataset)
    return folded_dataset


def as_recorded(dataset: xr.Dataset, numbers: NDArray[np.int64] | None = None) -> xr.Dataset:
    """Return the Dataset as a file has it, before it was unfolded; `numbers` as `as_written` has them."""
    return as_written(unlabelled(whole_of(dataset)), numbers)


def _split_elements(
    name: str, variable: xr.Variable, inner: tuple[str, ...], labels: Mapping[str, Sequence[str]]
) -> Iterator[tuple[str, xr.Variable]]:
    """Yield the elements of a variable."""
    import xarray as xr

    outer = tuple(dim for dim in variable.dims if dim not in inner)
    take = _element_taker(
        variable.transpose(*outer, *inner) if variable.dims != (*outer, *inner) else variable, len(outer)
    )
    listed_elements = str(variable.attrs.get(schema.ELEMENTS, "")).split()
    stem, _, tail = str(variable.attrs.get(schema.ELEMENT_NAME, f"{name}{{}}")).partition("{}")
    places = product(*(range(len(labels[dim])) for dim in inner))
    size = int(np.prod([len(labels[dim]) for dim in inner]))
    elements_named = {*listed_elements}
    is_named_by = [
        dim not in map(schema.at_event, labels) for dim in inner
    ]  # those of events are told for each element that is kept
    for number, element_index in enumerate(places):
        labels_of_element = [labels[dim][i] for dim, i in zip(inner, element_index, strict=True)]
        element_name = join_element_name(stem, labels_of_element) + tail
        if (
            not elements_named
            or names_as_words([join_element_name(stem, compress(labels_of_element, is_named_by)) + tail])
            in elements_named
        ):
            attributes = attributes_of_element(variable.attrs, number, size)
            yield element_name, xr.Variable(outer, take(element_index), attributes, fastpath=True)


def _element_taker(variable: xr.Variable, outer_count: int) -> Callable[[tuple[int, ...]], Any]:
    """Return a function from an index to an element's values: a view of an array, or a lazy array."""
    if isinstance(variable._data, np.ndarray) or variable.chunks is not None:  # noqa: SLF001 - `.data` would read what is lazy
        data, rows = variable.data, (slice(None),) * outer_count
        return lambda element_index: data[(*rows, *element_index)]

    return SharedElements(variable, outer_count).element


def _element_detectors(
    dataset: xr.Dataset, variables: Mapping[Any, Any], dims: Sequence[str], labels: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Return which detector of which element each event is of, as one flag."""
    import xarray as xr

    detector = variables[DETECTOR]
    dims_by_detector = dims_of_detectors(detector.attrs)
    if dims_by_detector:
        check_elements(dataset)
    words = str(detector.attrs["flag_meanings"]).split()
    first, names = {}, 0
    for number, word in zip(np.atleast_1d(detector.attrs["flag_values"]).tolist(), words, strict=True):
        first[number] = names
        names += math.prod(len(labels[dim]) for dim in dims_by_detector.get(word, ()))
    numbers = np.asarray(detector.values)
    if (wrong := np.flatnonzero(~np.isin(numbers, [*first]))).size:
        raise InputError(
            f"'{DETECTOR}' is {numbers[wrong[0]]} at event {wrong[0]}, and its flag_values are {', '.join(map(str, first))}:"
            " the record was edited; take what simulate or open_run gives"
        )
    combined = np.array([first[number] for number in numbers.tolist()], np.int32)
    number_in_detector = np.zeros(len(combined), np.int32)
    for dim in dims:
        if (name := schema.at_event(dim)) in variables:
            dim_numbers = np.asarray(variables[name].values)
            # Horner's scheme over the dimensions that the event's own detector has, the last one fastest
            number_in_detector = np.where(
                dim_numbers == schema.NOWHERE,
                number_in_detector,
                number_in_detector * len(labels.get(dim, ())) + dim_numbers,
            )
    single = [number for number, word in zip(first, words, strict=True) if word not in dims_by_detector]
    number_in_detector[np.isin(numbers, single)] = 0  # impacts of many links are of one detector
    attributes = {key: value for key, value in detector.attrs.items() if key != schema.DETECTOR_DIMENSIONS}
    attributes |= schema.flag_attributes(dict(enumerate(detectors_of(dataset))), "i4")
    # fastpath: xarray would import dask to find out that the numbers are not one of its arrays
    return {
        DETECTOR: xr.Variable(
            detector.dims, (combined + number_in_detector).astype(np.int32), attributes, fastpath=True
        )
    }


def shapes_of(dataset: Any) -> Shapes:
    """Return the dimensions of a record, folded or unfolded, and of its variables."""
    dataset = whole_of(dataset)
    sizes = model_dimensions(dataset)
    if not sizes:
        return NO_SHAPES
    relations = {dim: _relation(dataset, dim) for dim in sizes if schema.end_of(dim, "first") in dataset.variables}
    extents = {
        dim: Extent(dim, size, tuple(element_labels(dataset, dim)) if has_labels(dataset, dim) else ())
        for dim, size in sizes.items()
        if dim not in relations
    }
    dims = {
        str(name): tuple(str(dim) for dim in variable.dims if dim in sizes)
        for name, variable in dataset.variables.items()
    }
    if DETECTOR in dataset.variables:
        dims |= dims_of_detectors(dataset.variables[DETECTOR].attrs)
    return Shapes(extents, relations, {name: variable_dims for name, variable_dims in dims.items() if variable_dims})


def _relation(dataset: xr.Dataset, name: str) -> Relation:
    first, second = (dataset.variables[schema.end_of(name, end)] for end in ("first", "second"))
    return Relation(
        name,
        first.attrs[schema.LINK_OF],
        second.attrs[schema.LINK_OF],
        np.asarray(first.values),
        np.asarray(second.values),
    )


def of_elements(verb: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let a verb that computes with elements take records of quantities with dimensions, and give one where it was given one."""

    @wraps(verb)
    def element_call(*arguments: Given.args, **keywords: Given.kwargs) -> Result:
        records = [value for value in (*arguments, *keywords.values()) if model_dimensions(value)]
        if not records:
            return verb(*arguments, **keywords)
        result: Any = verb(
            *map(_unfolded_argument, arguments), **{key: _unfolded_argument(value) for key, value in keywords.items()}
        )
        if isinstance(result, list):  # lines for people
            return [display_text(line) if isinstance(line, str) else line for line in result]  # type: ignore[return-value]
        if not hasattr(result, "data_vars"):
            return result  # type: ignore[no-any-return]
        return labelled(fold(result, shapes_of(records[0])))  # type: ignore[return-value]

    return element_call


def _unfolded_argument(argument: Any) -> Any:
    return unfold(argument) if model_dimensions(argument) else argument
