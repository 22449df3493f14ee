"""Records of the former schema in the words of today, and back: what is archived stays as it was written.

In `xdynamics-1` what names rows of ``step`` has their places among the rows that are kept, texts have no dimension, and
rows no numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from xdynamics.record.partial_records import is_selection, rows_apart
from xdynamics.schema import (
    CONVENTIONS,
    DOCUMENT,
    EVENT_BOUNDS,
    EVIDENCE,
    NAMES_ROWS,
    SCHEMA_OF_LAW,
    SCHEMA_VERSION,
    STEP_NUMBER,
    STEPS,
    SWEEP,
    TEXT_NAMES,
    is_coordinate,
    is_former,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import xarray as xr
    from numpy.typing import NDArray

    from xdynamics.schema import Variable

MADE = "made"  # in the encoding of the numbers of rows that what names rows has: whether the file has none


def modern(run: xr.Dataset) -> xr.Dataset:
    """Return an opened record in the words of today; what describes a run is a coordinate.

    Whether it is of the former schema is said by its attributes, as before.
    """
    of_run = EVIDENCE not in run.attrs
    if is_former(run.attrs):
        if run.attrs.get(EVIDENCE) != SWEEP and not has_document(run):
            run = _with_texts(run, along_document)
        if STEPS in run.dims and of_run:
            run = _numbered(run)
    names = {name for name in TEXT_NAMES if name in run.variables}
    if of_run:
        roles = {str(name): variable.attrs.get("role") for name, variable in run.variables.items()}
        names |= {name for name, role in roles.items() if is_coordinate(name, role)}
    modern_run = run.set_coords(names - {*run.coords})
    for (
        variable
    ) in modern_run.variables.values():  # xarray would write the names of coordinates that were dropped since
        variable.encoding.pop("coordinates", None)
    if EVENT_BOUNDS in modern_run.variables:
        modern_run.variables[EVENT_BOUNDS].encoding["_FillValue"] = None
    modern_run.set_close(run._close)  # noqa: SLF001 - a Dataset that xarray derives does not close its file
    return modern_run


def as_written(run: xr.Dataset, numbers: NDArray[np.int64] | None = None) -> xr.Dataset:
    """Return a record in the words of its schema; the reverse of `modern`.

    Parameters
    ----------
    run : xarray.Dataset
    numbers : ndarray of int, optional
        The numbers of all rows of the record that this is a part of, among which what names rows has its places; by
        default its own.
    """
    if not is_former(run.attrs) or are_rows_places(run):
        return run
    run = _with_texts(run, lambda text: text.isel({DOCUMENT: 0}) if text.dims == (DOCUMENT,) else text)
    if is_selection(run.attrs):  # whose names of rows were never converted
        return run
    if (row_numbers := run.variables.get(STEP_NUMBER.name)) is not None:
        if row_numbers.encoding.get(MADE):
            return run.drop_vars(STEP_NUMBER.name)
        numbers = np.asarray(row_numbers.values) if numbers is None else numbers
        run = with_variables(run, {STEP_NUMBER.name: _marked(row_numbers, None)})
    return run if numbers is None else by_places(run, numbers)


def by_places(run: xr.Dataset, numbers: NDArray[np.int64]) -> xr.Dataset:
    """Return a record in which what names rows has their places among rows of given numbers."""
    return _with_changed_rows(run, lambda named_numbers: np.searchsorted(numbers, named_numbers))


def in_own_words(run: xr.Dataset) -> xr.Dataset:
    """Return a record of the former schema, opened here once and written by another program, in the words of its file."""
    if (
        is_former(run.attrs)
        and not are_rows_places(run)
        and rows_apart(run.attrs) == 1
        and (numbers := run.variables.get(STEP_NUMBER.name)) is not None
        and np.array_equal(numbers.values, np.arange(numbers.size))
    ):
        numbers.encoding[MADE] = True
    return as_written(run)


def are_rows_places(run: xr.Dataset) -> bool:
    """Whether what names rows of a record has their places, as in the files of the former schema."""
    numbers = run.variables.get(STEP_NUMBER.name)
    return (
        is_former(run.attrs)
        and not (numbers is not None and MADE in numbers.encoding)
        and not any(run.variables[name].dims for name in TEXT_NAMES if name in run.variables)
    )


def _marked(numbers: xr.Variable, made: bool | None) -> xr.Variable:  # noqa: FBT001
    """Return numbers of rows with a mark that what names rows has them, and whether a file has not; None for no mark."""
    marked = numbers.copy(deep=False)
    marked.encoding = {key: entry for key, entry in numbers.encoding.items() if key != MADE}
    marked.encoding |= {} if made is None else {MADE: made}
    return marked


def has_document(run: xr.Dataset) -> bool:
    """Whether something of an old model has the name of the dimension of texts, which have none then."""
    return DOCUMENT in run.variables or run.sizes.get(DOCUMENT, 1) > 1


def along_document(text: xr.Variable) -> xr.Variable:
    """Return a text along the dimension that texts have."""
    return text if text.dims else cast("xr.Variable", text.expand_dims(DOCUMENT))


def _with_texts(run: xr.Dataset, change: Callable[[xr.Variable], xr.Variable]) -> xr.Dataset:
    texts = {name: change(run.variables[name]) for name in TEXT_NAMES if name in run.variables}
    return with_variables(run, texts)


def _with_changed_rows(run: xr.Dataset, change: Callable[[NDArray[np.int64]], NDArray[Any]]) -> xr.Dataset:
    changed = {}
    for name in NAMES_ROWS:
        if name in run.variables:
            row_variable = run.variables[name]
            changed[name] = row_variable.copy(data=change(np.asarray(row_variable.values)).astype(row_variable.dtype))
    return with_variables(run, changed)


def with_variables(run: xr.Dataset, variables: dict[str, xr.Variable]) -> xr.Dataset:
    """Return a record with other variables in place of some, which stay coordinates if they are."""
    import xarray as xr

    if not variables:
        return run
    all_variables: dict[Any, xr.Variable] = {**run.variables, **variables}
    return xr.Dataset._construct_direct(  # noqa: SLF001 - `assign` would align what cannot be apart
        all_variables,
        {*run.coords},
        attrs=dict(run.attrs),
        indexes=dict(run.xindexes),
        close=run._close,  # noqa: SLF001
        encoding=run.encoding,
    )


def _numbered(run: xr.Dataset) -> xr.Dataset:
    """Give rows their numbers, and name rows by them."""
    import xarray as xr

    if STEP_NUMBER.name not in run.variables:
        if is_selection(run.attrs):
            return run  # its rows have no numbers any more
        made = xr.Variable((STEPS,), np.arange(run.sizes[STEPS]), STEP_NUMBER.attributes, fastpath=True)
        return with_variables(run, {STEP_NUMBER.name: _marked(made, True)})  # noqa: FBT003
    if rows_apart(run.attrs) == 1 or is_selection(run.attrs):
        return run
    row_numbers = run.variables[STEP_NUMBER.name]
    numbers = np.asarray(row_numbers.values)
    run = with_variables(run, {STEP_NUMBER.name: _marked(row_numbers, False)})  # noqa: FBT003
    return _with_changed_rows(run, lambda places: numbers[places])


def in_words_of(variables: Sequence[Variable], run: xr.Dataset) -> list[Variable]:
    """Return what a schema asks of every record, as that of a record has it, in its file or opened."""
    expected_variables, texts = [*variables], dict[str, tuple[str, ...]]()
    if is_former(run.attrs) or has_document(run):
        texts = {name: (DOCUMENT,) if run.variables[name].dims else () for name in TEXT_NAMES if name in run.variables}
    if is_former(run.attrs):
        expected_variables = [
            expected
            for expected in expected_variables
            if expected.name != STEP_NUMBER.name or expected.name in run.variables
        ]
    return [replace(variable, dims=texts.get(variable.name, variable.dims)) for variable in expected_variables]


def in_words_of_today(attributes: dict[str, Any]) -> dict[str, Any]:
    """Return attributes of a part of a run, which is written as runs are today, and says in which words its law is."""
    return attributes | {
        "Conventions": CONVENTIONS,
        "schema_version": SCHEMA_VERSION,
        SCHEMA_OF_LAW: attributes["schema_version"],
    }
