"""Single elements of a record's quantities by their names, and the detectors of its events with theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.element_attributes import attributes_of_element
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.folding import model_dimensions
from xdynamics.schema import DETECTOR_DIMENSIONS, at_event, label_of
from xdynamics.shapes import Extent
from xdynamics.shapes.extents import indices_of_element
from xdynamics.shapes.naming import DOT, join_element_name, split_element_name
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

DETECTOR = "event_detector"


def element_labels(dataset: xr.Dataset, dim: str) -> Sequence[str]:
    """Return what the elements along a dimension of the model are called: their labels, or their numbers."""
    return _written_labels(dataset, dim) or [str(number) for number in range(dataset.sizes[dim])]


def has_labels(dataset: xr.Dataset, dim: str) -> bool:
    """Whether the elements along a dimension of the model have labels."""
    return bool(_written_labels(dataset, dim))


def _written_labels(dataset: xr.Dataset, dim: str) -> tuple[str, ...]:
    for name in (dim, label_of(dim)):
        if name in dataset.variables and dataset.variables[name].dims == (dim,):
            return tuple(str(label) for label in np.asarray(dataset.variables[name]).tolist())
    return ()


def dims_of_detectors(attributes: Mapping[Any, Any]) -> dict[str, tuple[str, ...]]:
    """Return the dimensions of each detector that has some, from the attributes of `event_detector`."""
    entries = [entry.partition(": ") for entry in str(attributes.get(DETECTOR_DIMENSIONS, "")).split("; ")]
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
    """Return what each event of a record was located by: an element's name where the detector has dimensions."""
    words = words_of_flag(run[DETECTOR])
    dims_by_detector = dims_of_detectors(run[DETECTOR].attrs)
    dims = {dim for detector_dims in dims_by_detector.values() for dim in detector_dims}
    numbers = {dim: np.asarray(run[at_event(dim)].values).tolist() for dim in dims}
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
