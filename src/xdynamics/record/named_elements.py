"""Single elements of a record's quantities by their names, and the detectors of its events with theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.element_attributes import attributes_of_element
from xdynamics.record.flag_words import words_of
from xdynamics.record.folding import model_dimensions
from xdynamics.schema import DETECTOR_DIMENSIONS, at_event, label_of
from xdynamics.shapes import Extent
from xdynamics.shapes.extents import place_of_element
from xdynamics.shapes.naming import DOT, element, parted
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

DETECTOR = "event_detector"


def labels_of(dataset: xr.Dataset, dim: str) -> Sequence[str]:
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
    return {kind: tuple(of.split()) for kind, _, of in entries if kind}


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
        found: xr.Variable = dataset.variables[name]
        return found
    if DOT not in name or (whole := parted(name)[0]) not in dataset.variables:
        return None
    variable, known = dataset.variables[whole], model_dimensions(dataset)
    dims = tuple(str(dim) for dim in variable.dims if dim in known)
    extents = tuple(Extent(dim, dataset.sizes[dim], _written_labels(dataset, dim)) for dim in dims)
    if (place := place_of_element(name, extents)) is None:
        return None
    shape = tuple(extent.size for extent in extents)
    taken = variable.isel(dict(zip(dims, place, strict=True)))
    number, size = (int(np.ravel_multi_index(place, shape)), int(np.prod(shape))) if shape else (0, 1)
    taken.attrs = attributes_of_element(variable.attrs, number, size)
    return taken


def element_array(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """Return `column` as an array with its coordinates, lazy where the Dataset is.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    import xarray as xr

    own = column(dataset, name)
    return xr.DataArray(
        own, {key: dataset.coords[key] for key in dataset.coords if {*dataset[key].dims} <= {*own.dims}}
    )


def column(dataset: xr.Dataset, name: str) -> xr.Variable:
    """Return a variable of a Dataset, or one element of a quantity; see `find_column`.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if (found := find_column(dataset, name)) is None:
        raise KeyError(name)
    return found


def column_in_si(dataset: xr.Dataset, name: str) -> NDArray[np.float64]:
    """Return the numbers of a variable, or of one element of a quantity, in SI units; see `column`.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    variable = column(dataset, name)
    return np.asarray(variable.values, float) * float(parse_unit(str(variable.attrs["units"])).factor)


def detectors_of(run: xr.Dataset) -> list[str]:
    """Return everything that events of a record are located by: of a detector with dimensions each of its elements."""
    attributes = run[DETECTOR].attrs
    along = dims_of_detectors(attributes)
    labels = {dim: labels_of(run, dim) if dim in run.dims else () for own in along.values() for dim in own}
    names: list[str] = []
    for word in str(attributes["flag_meanings"]).split():
        own = along.get(word, ())
        names += [element(word, place) for place in product(*(labels[dim] for dim in own))] if own else [word]
    return names


def event_words(run: xr.Dataset) -> list[str]:
    """Return what each event of a record was located by: an element's name where the detector has dimensions."""
    words = words_of(run[DETECTOR])
    along = dims_of_detectors(run[DETECTOR].attrs)
    dims = {dim for own in along.values() for dim in own}
    numbers = {dim: np.asarray(run[at_event(dim)].values).tolist() for dim in dims}
    labels = {dim: _written_labels(run, dim) for dim in dims}

    def label(dim: str, event: int) -> str:
        number = numbers[dim][event]
        return labels[dim][number] if labels[dim] else str(number)

    return [
        element(word, [label(dim, event) for dim in along[word]]) if word in along else word
        for event, word in enumerate(words)
    ]
