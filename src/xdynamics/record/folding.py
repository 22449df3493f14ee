"""Quantities with dimensions as one variable each: what a record holds, from the variables of their elements."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.record.element_attributes import attributes_of_quantity
from xdynamics.record.element_names import Names, QuantityElements
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import (
    LABEL,
    LINK,
    LINK_OF,
    MODEL_DIMENSIONS,
    NOWHERE,
    at_event,
    end_of,
    flag_attributes,
    label_of,
    logged_of,
    name_of,
)
from xdynamics.shapes import Shapes

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

FOLDED = "folded"  # entry of the encoding of an unfolded Dataset: what it was
_SIZED = re.compile(r"(\w+)\((\d+)\)")


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
        With labels as they are in a file, ``body_label(body)``; see `labelled`. One without elements, none of whose
        dimensions are the model's, is returned as it is.
    """
    quantities = Names(shapes).by_quantity(map(str, dataset.variables))
    dims = {dim for quantity in quantities.values() for dim in quantity.dims} | {*shapes.relations, *shapes.extents} & {
        *dataset.dims
    }
    if not dims:
        return dataset
    import xarray as xr

    of_name = {name: quantity for quantity in quantities.values() for name in quantity.members.values()}
    variables: dict[Any, Any] = {}
    for name, variable in dataset.variables.items():
        quantity = of_name.get(str(name))
        if quantity is None:
            variables[name] = variable
        elif quantity.name not in variables:
            variables[quantity.name] = _folded_variable(quantity, dataset)
    coordinates = {of_name[name].name if name in of_name else name for name in map(str, dataset.coords)}
    for name, (variable_dims, values, attributes) in about_dimensions(shapes, dims).items():
        variables[name] = xr.Variable(variable_dims, values, attributes)
        coordinates.add(name)
    folded = xr.Dataset(variables, attrs=dict(dataset.attrs) | {MODEL_DIMENSIONS: sized(shapes, dims)})
    folded.encoding = {key: entry for key, entry in dataset.encoding.items() if key != FOLDED}
    return folded.set_coords(coordinates)


def _folded_variable(quantity: QuantityElements, dataset: xr.Dataset) -> xr.Variable:
    import xarray as xr

    parts = {number: dataset.variables[name] for number, name in quantity.members.items()}
    outer_dims = next(iter(parts.values())).dims
    attributes = attributes_of_quantity(
        {number: (quantity.members[number], part.attrs) for number, part in parts.items()}, quantity.size
    )
    if any(map(is_chunked, parts.values())):
        import dask.array

        da: Any = dask.array  # its functions are not typed
        blank = da.full_like(next(iter(parts.values())).data, quantity.missing)
        rows = [parts[number].data if number in parts else blank for number in range(quantity.size)]
        data = da.stack(rows, axis=-1).rechunk({len(outer_dims): -1}).reshape((*rows[0].shape, *quantity.shape))
    else:
        data = quantity.stacked({number: np.asarray(part.values) for number, part in parts.items()})
    if len(parts) < quantity.size and "flag_values" in attributes:  # elements that were not asked for have a word too
        words = zip(np.atleast_1d(attributes["flag_values"]).tolist(), attributes["flag_meanings"].split(), strict=True)
        attributes |= flag_attributes({NOWHERE: "none"} | dict(words))
    return xr.Variable((*outer_dims, *quantity.dims), data, attributes | quantity.more)


def sized(shapes: Shapes, dims: set[str]) -> str:
    """Write dimensions with their sizes, in the order of a record."""
    return " ".join(f"{dim}({shapes.extent(dim).size})" for dim in shapes.ordered(dims))


def about_dimensions(shapes: Shapes, dims: set[str]) -> dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]]:
    """Return the labels of dimensions and the ends of relations: dims, values and attributes by name."""
    parts: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]] = {}
    for dim in shapes.ordered(dims):
        if dim in shapes.relations:
            relation = shapes.relations[dim]
            for end, target_dim, numbers in (
                ("first", relation.source, relation.first),
                ("second", relation.target, relation.second),
            ):
                extent = shapes.extent(target_dim)
                more = flag_attributes(dict(enumerate(extent.labels)), "i4") if extent.labels else {}
                long_name = f"number of the {end} {target_dim} of a {dim}, from 0"
                about = {"units": "1", "long_name": long_name, "role": LINK, LINK_OF: target_dim}
                parts[end_of(dim, end)] = ((dim,), np.asarray(numbers, np.int32), about | more)
        elif labels := shapes.extents[dim].labels:
            numbered = all(map(str.isdecimal, labels))  # of a dimension without labels, as no label is a number
            bare_dim = dim.removeprefix(logged_of(""))
            label_words = (
                f"label of the {dim}"
                if bare_dim == dim
                else f"which {bare_dim}: its {'number' if numbered else 'label'}"
            )
            if (of_event := dim.removeprefix(at_event(""))) in shapes.extents and of_event != dim:
                label_words = f"label of the {of_event} that the event is of"
            attributes = {"units": "1", "long_name": label_words, "role": LABEL}
            parts[label_of(dim)] = ((dim,), np.array(labels).astype("i4") if numbered else np.array(labels), attributes)
    return parts


def model_dimensions(dataset: Any) -> dict[str, int]:
    """Return the dimensions of the model in a record with their sizes in it, in their order; most records have none."""
    text = getattr(dataset, "attrs", {}).get(MODEL_DIMENSIONS)
    return {} if text is None else {name: int(size) for name, size in _SIZED.findall(str(text))}


def check_elements(record: xr.Dataset, needed: Collection[str] = ()) -> None:
    """Refuse a run of which elements were left out: the motion of one depends on all.

    Parameters
    ----------
    record : xarray.Dataset
    needed : collection of str
        Dimensions that are known to be missing where they are, and not dropped with all variables that had them.

    Raises
    ------
    InputError
        Naming the dimension that was cut.
    """
    for dim, size in model_dimensions(record).items():
        now = record.sizes.get(dim)
        if now != size and (now is not None or dim in needed or dim in record.coords):
            element_count = "a single one" if now is None else now
            raise InputError(
                f"the run was cut: it has {element_count} of its {size} elements along '{dim}', and the motion of one depends on all;"
                f" give the whole run, and select elements of what comes back, like .isel({dim}=0)"
            )


def labelled(dataset: xr.Dataset) -> xr.Dataset:
    """Return a record with labels of dimensions as their indexes, as people select by them.

    Labels of a model's dimensions become the index; names of terms, parameters, runs stand in the file as in memory,
    with the index beside them: ``budget.sel(term="vt")``. Names that are still to be computed are no labels yet.
    """
    close = dataset._close  # noqa: SLF001 - a Dataset that xarray derives does not close its file
    for dim in model_dimensions(dataset):
        if (name := label_of(dim)) in dataset.variables and name not in dataset.dims:
            dataset = dataset.drop_vars(name).assign_coords(_indexed(dim, dataset.variables[name]))
    for dim in map(str, dataset.dims):
        names = dataset.variables.get(name_of(dim))
        if dim not in dataset.variables and names is not None and _are_labels(dim, names):
            dataset = dataset.assign_coords(_indexed(dim, names))
    dataset.set_close(close)
    return dataset


def _are_labels(dim: str, names: xr.Variable) -> bool:
    """Whether names are texts along a dimension, and known without computing anything."""
    return names.dims == (dim,) and names.dtype.kind in "UO" and not is_chunked(names)


def _indexed(dim: str, labels: xr.Variable) -> xr.Coordinates:
    """Return labels as the index of a dimension.

    Given an array, xarray would import dask to find out that it is not one of dask's: eight tenths of a second.
    """
    import pandas as pd
    import xarray as xr
    from xarray.indexes import PandasIndex

    values = _label_values(labels)
    index = PandasIndex(pd.Index(values), dim, coord_dtype=values.dtype)
    variable = xr.Variable(labels.dims, values, labels.attrs | {"role": LABEL}, fastpath=True)
    return xr.Coordinates._construct_direct(index.create_variables({dim: variable}), {dim: index})  # noqa: SLF001


def _label_values(labels: xr.Variable) -> Array:
    """Return labels as texts, or as the numbers of elements that have none."""
    values = np.asarray(labels)
    return values if values.dtype.kind == "i" else values.astype(str)


def is_repeated_label(name: str, dataset: xr.Dataset) -> bool:
    """Whether a variable is the index of names that stand in the Dataset as a variable of their own."""
    return name_of(name) in dataset.variables and dataset.variables[name].attrs.get("role") == LABEL


def unlabelled(dataset: xr.Dataset) -> xr.Dataset:
    """Return a record with labels as auxiliary coordinates, as a file has them."""
    import xarray as xr

    if repeated := [name for name in map(str, dataset.coords) if is_repeated_label(name, dataset)]:
        dataset = dataset.drop_vars(repeated)
    for dim in model_dimensions(dataset):
        if dim in dataset.variables and dataset.variables[dim].attrs.get("role") == LABEL:
            labels = dataset.variables[dim]
            # fastpath: as in `_indexed`
            plain = xr.Variable(labels.dims, _label_values(labels), labels.attrs, fastpath=True)
            dataset = dataset.drop_vars(dim).assign_coords({label_of(dim): plain})
    return dataset
