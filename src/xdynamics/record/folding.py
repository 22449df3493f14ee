"""Folding of element variables into quantities with dimensions, with names and attributes, and the reverse.

Names of variables are matched with the quantities of which they are elements; attributes of a quantity follow from
those of its elements. Variables that dask has still to compute stay lazy.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.faults import InputError
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import DOT, display_text, split_element_name

if TYPE_CHECKING:
    import xarray as xr


def is_chunked(variable: xr.Variable) -> bool:
    """Return whether a variable is in chunks.

    xarray looks through all that an array of chunks must have, 0.2 ms for each variable; an array in memory is none.
    """
    return not isinstance(variable._data, np.ndarray) and variable.chunks is not None  # noqa: SLF001 - `.data` would read what is lazy


_LABELS = re.compile(rf"(?<=\w)(?:{DOT}(?:[0-9]+(?![0-9])|\w+))+")  # a number ends before what follows: after_hit·3_u


def quantity_of(text: str) -> str:
    """Return a text about an element as one about the quantity.

    Examples
    --------
    >>> quantity_of("velocity of r·Jupiter·x")
    'velocity of r'
    >>> quantity_of("uncertainty of after_hit·3_u")
    'uncertainty of after_hit_u'
    """
    return _LABELS.sub("", text) if DOT in text else text


def quantity_names(names: Iterable[str]) -> tuple[str, ...]:
    """Replace names of elements by the names of their quantities, without repetition."""
    return tuple(dict.fromkeys(map(quantity_of, names)))


def elements_of(name: str, known_names: Iterable[str]) -> str:
    """Return how the elements of an unknown name are named, if it is a quantity with dimensions; else an empty text."""
    members = [
        display_text(entry)
        for entry in known_names
        if split_element_name(entry)[1] and quantity_of(entry) == quantity_of(name)
    ]
    if not members:
        return ""
    few = ", ".join(members[:3]) + (f", … {members[-1]}" if len(members) > 3 else "")
    return f"; '{quantity_of(name)}' has the elements {few}: name one"


def attributes_of_quantity(elements: Mapping[int, tuple[str, Mapping[Any, Any]]], size: int) -> dict[str, Any]:
    """Return the attributes that elements share, and those that differ as one number for each element.

    Parameters
    ----------
    elements : mapping of int to (str, mapping)
        By the number of each element its name and its attributes.
    size : int
        How many elements the quantity has.
    """
    every = {number: attributes for number, (_, attributes) in elements.items()}
    shared: dict[str, Any] = {}
    for key in dict.fromkeys(key for attributes in every.values() for key in attributes):
        values = {number: attributes[key] for number, attributes in every.items() if key in attributes}
        first = next(iter(values.values()))
        if key in schema.OF_ELEMENTS:
            numbers = np.full(size, np.nan)
            numbers[[*values]] = [float(value) for value in values.values()]
            all_equal = len(values) == len(every) and len(set(values.values())) == 1
            shared[key] = float(first) if all_equal else numbers
        elif key == schema.ATOL_RULE and len(values) < len(every):
            following = np.zeros(size, np.int8)
            following[[*values]] = 1
            shared[schema.ATOL_FOLLOWING] = following
        elif isinstance(first, str):
            texts = dict.fromkeys(quantity_of(str(value)) for value in values.values())
            shared[key] = "; ".join(texts)
        else:
            shared[key] = first
    return shared


def attributes_of_element(attributes: Mapping[Any, Any], number: int, size: int) -> dict[str, Any]:
    """Return the attributes of one element."""
    element_attributes = {
        key: value for key, value in attributes.items() if key not in (schema.ELEMENTS, schema.ELEMENT_NAME)
    }
    for key in schema.OF_ELEMENTS:
        value = element_attributes.get(key)
        if value is None or np.shape(value) != (size,) or size == 1:
            continue
        element_attributes[key] = float(value[number])
        if np.isnan(element_attributes[key]):
            del element_attributes[key]
    if element_attributes.pop(schema.ATOL_FOLLOWING, 0):
        element_attributes[schema.ATOL_RULE] = schema.ATOL_FOLLOWS
    return element_attributes


Array = NDArray[Any]

FORCES = ("force_", "sample_force_")  # of which the elements that are not there are 0: the force does not act there


SIDE = schema.side_of("")


@dataclass(frozen=True)
class QuantityElements:
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
        listed_elements = (
            {}
            if len(self.members) == self.size or not self.missing
            else {schema.ELEMENTS: names_as_words(self.members.values())}
        )
        return listed_elements | ({schema.ELEMENT_NAME: self.pattern} if self.pattern else {})

    def stacked(self, parts: Mapping[int, Array]) -> Array:
        """Return the values of elements as one array, its dimensions last."""
        first = next(iter(parts.values()))
        # elements first, so that each is written to contiguous memory; what is returned is a view of it
        stack = np.empty((self.size, *first.shape), first.dtype)
        if len(parts) < self.size:
            # where an element has no switch, its side is elsewhere
            stack[:] = self.missing if first.dtype.kind == "f" else 0 if self.name.startswith(SIDE) else schema.NOWHERE
        for number, values in parts.items():
            stack[number] = values
        return np.moveaxis(stack, 0, -1).reshape((*first.shape, *self.shape))


def names_as_words(names: Iterable[str]) -> str:
    """Write names as words of one text, elements as people write them."""
    return " ".join(display_text(name).replace(" ", "") for name in names)


def expand_quantities(names: Iterable[str], known_names: Iterable[str], shapes: Shapes) -> tuple[str, ...]:
    """Replace each quantity with dimensions by its known elements."""
    quantities = Names(shapes).by_quantity(known_names) if shapes.dims else {}
    return tuple(
        member for name in names for member in (quantities[name].members.values() if name in quantities else (name,))
    )


class Names:
    """The elements of each quantity among some names."""

    def __init__(self, shapes: Shapes) -> None:
        self.shapes = shapes
        self._known: dict[tuple[str, int], tuple[str, ...]] = {}
        self._labels = {name: frozenset(extent.labels) for name, extent in shapes.extents.items()}

    def by_quantity(self, names: Iterable[str]) -> dict[str, QuantityElements]:
        """Gather names that are elements by their quantities."""
        quantities: dict[str, QuantityElements] = {}
        for name in names:
            if DOT in name and (position := self._element_position(name)):
                quantity, number = position
                quantities.setdefault(quantity.name, quantity).members[number] = name
        return quantities

    def _element_position(self, name: str) -> tuple[QuantityElements, int] | None:
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
        for size, index in zip(shape, numbers, strict=True):
            number = number * size + index
        return QuantityElements(stem + tail, dims, shape, f"{stem}{{}}{tail}" if tail else ""), number

    def _dims(self, stem: str, count: int) -> tuple[str, ...]:
        """Return the dimensions of a quantity: of the longest name at its end that has some."""
        if (stem, count) not in self._known:
            self._known[stem, count] = self.shapes.dims_at_end(stem, count)
        return self._known[stem, count]

    def _cut(self, label: str, dim: str) -> tuple[str, str]:
        """Split the last label from its suffix, as in ``event_height·Jupiter_uncertainty``."""
        if self._has(dim, label):
            return label, ""
        # the longest label first: labels may have underscores of their own
        ends = (i for i in range(len(label) - 1, 0, -1) if label[i] == "_" and self._has(dim, label[:i]))
        end = next(ends, len(label))
        return label[:end], label[end:]

    def _has(self, dim: str, label: str) -> bool:
        known_labels = self._labels.get(dim)
        return label in known_labels if known_labels else label.isdigit() and int(label) < self.shapes.extent(dim).size

    def _number(self, dim: str, label: str) -> int:
        return self.shapes.extent(dim).number(label if self._labels.get(dim) else int(label))


FOLDED = "folded"  # entry of the encoding of an unfolded Dataset: what it was
_SIZED = re.compile(r"(\w+)\((\d+)\)")


def fold(dataset: xr.Dataset, shapes: Shapes) -> xr.Dataset:
    """Fold the variables of each quantity's elements into one variable with dimensions.

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
    folded = xr.Dataset(variables, attrs=dict(dataset.attrs) | {schema.MODEL_DIMENSIONS: sized(shapes, dims)})
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
        attributes |= schema.flag_attributes({schema.NOWHERE: "none"} | dict(words))
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
                more = schema.flag_attributes(dict(enumerate(extent.labels)), "i4") if extent.labels else {}
                long_name = f"number of the {end} {target_dim} of a {dim}, from 0"
                about = {"units": "1", "long_name": long_name, "role": schema.LINK, schema.LINK_OF: target_dim}
                parts[schema.end_of(dim, end)] = ((dim,), np.asarray(numbers, np.int32), about | more)
        elif labels := shapes.extents[dim].labels:
            numbered = all(map(str.isdecimal, labels))  # of a dimension without labels, as no label is a number
            bare_dim = dim.removeprefix(schema.logged_of(""))
            label_words = (
                f"label of the {dim}"
                if bare_dim == dim
                else f"which {bare_dim}: its {'number' if numbered else 'label'}"
            )
            if (of_event := dim.removeprefix(schema.at_event(""))) in shapes.extents and of_event != dim:
                label_words = f"label of the {of_event} that the event is of"
            attributes = {"units": "1", "long_name": label_words, "role": schema.LABEL}
            parts[schema.label_of(dim)] = (
                (dim,),
                np.array(labels).astype("i4") if numbered else np.array(labels),
                attributes,
            )
    return parts


def model_dimensions(dataset: Any) -> dict[str, int]:
    """Return the dimensions of the model in a record with their sizes in it, in their order; most records have none."""
    text = getattr(dataset, "attrs", {}).get(schema.MODEL_DIMENSIONS)
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
        if (name := schema.label_of(dim)) in dataset.variables and name not in dataset.dims:
            dataset = dataset.drop_vars(name).assign_coords(_indexed(dim, dataset.variables[name]))
    for dim in map(str, dataset.dims):
        names = dataset.variables.get(schema.name_of(dim))
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
    variable = xr.Variable(labels.dims, values, labels.attrs | {"role": schema.LABEL}, fastpath=True)
    return xr.Coordinates._construct_direct(index.create_variables({dim: variable}), {dim: index})  # noqa: SLF001


def _label_values(labels: xr.Variable) -> Array:
    """Return labels as texts, or as the numbers of elements that have none."""
    values = np.asarray(labels)
    return values if values.dtype.kind == "i" else values.astype(str)


def is_repeated_label(name: str, dataset: xr.Dataset) -> bool:
    """Whether a variable is the index of names that stand in the Dataset as a variable of their own."""
    return schema.name_of(name) in dataset.variables and dataset.variables[name].attrs.get("role") == schema.LABEL


def unlabelled(dataset: xr.Dataset) -> xr.Dataset:
    """Return a record with labels as auxiliary coordinates, as a file has them."""
    import xarray as xr

    if repeated := [name for name in map(str, dataset.coords) if is_repeated_label(name, dataset)]:
        dataset = dataset.drop_vars(repeated)
    for dim in model_dimensions(dataset):
        if dim in dataset.variables and dataset.variables[dim].attrs.get("role") == schema.LABEL:
            labels = dataset.variables[dim]
            # fastpath: as in `_indexed`
            plain = xr.Variable(labels.dims, _label_values(labels), labels.attrs, fastpath=True)
            dataset = dataset.drop_vars(dim).assign_coords({schema.label_of(dim): plain})
    return dataset
