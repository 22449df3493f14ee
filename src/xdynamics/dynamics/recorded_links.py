"""Closed links of many that a record lists by row: what its steps go on with, which states alone do not tell.

A march knows where slips began, and how fast links met: where friction wedges, forces exist for more than one choice of
links that hold and slide, and which one it took depends on that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.faults import InputError
from xdynamics.march.dense_output import ListedLinks
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.record.closed_link_columns import FRICTION_STATE, link_names
from xdynamics.record.named_rows import places_among
from xdynamics.schema import at_closed

if TYPE_CHECKING:
    import xarray as xr

IntArray = NDArray[np.int64]
STEP, CONTACT = at_closed("step"), at_closed("contact")
NUMBER = schema.STEP_NUMBER.name


@dataclass(frozen=True)
class RowLinks:
    """The closed links of rows.

    Attributes
    ----------
    rows : ndarray of int, shape (c,)
        Ascending.
    link_states : ndarray of int, shape (2, c)
        Number of each link among those of all contacts, and what it does along its slip.
    """

    rows: IntArray
    link_states: IntArray

    def links_at(self, rows: Any) -> ListedLinks:
        """Return those of some rows."""
        first, last = (np.searchsorted(self.rows, rows, side=side) for side in ("left", "right"))
        return ListedLinks(np.stack([first, last - first]).astype(float), self.link_states)


def links_read(run: xr.Dataset, model: Model) -> dict[str, Any]:
    """Return what closed links are found from, as it is stored; nothing where the record does not list them."""
    names = link_names(model)
    column_names = [*names, NUMBER]
    if not names or not all(name in run.variables for name in column_names):
        return {}
    return {name: run.variables[name].data for name in column_names}


def row_links(model: Model, read: Mapping[str, Any]) -> RowLinks | None:
    """Return the closed links of a record's rows; None where it does not list them, or not of these rows.

    Raises
    ------
    InputError
        If they are not in the order of rows, or one is no link of the model: compiled code reads them as they are.
    """
    columns = {name: np.asarray(column) for name, column in read.items()}
    if not columns:
        return None
    steps, contacts, listing = columns[STEP], columns[CONTACT], assemblies(model)
    _refuse_links(STEP, steps, steps[1:] < steps[:-1], "rows ascend")
    _refuse_links(CONTACT, contacts, ~np.isin(contacts, range(len(listing))), _numbers_below(len(listing)))
    numbers, begin = np.zeros(steps.size, np.int64), 0
    for c, contact in enumerate(listing):
        is_contact, shape = contacts == c, model.shapes.shape(contact.dims)
        element_indices = []
        for dim, length in zip(contact.dims, shape, strict=True):
            element_index = columns[at_closed(dim)]
            _refuse_links(
                at_closed(dim),
                element_index,
                is_contact & ~np.isin(element_index, range(length)),
                _numbers_below(length),
            )
            element_indices.append(element_index[is_contact].astype(np.int64))
        numbers[is_contact] = begin + (np.ravel_multi_index(element_indices, shape) if shape else 0)
        begin += contact.links
    _refuse_links(
        STEP, steps, (steps[1:] == steps[:-1]) & (numbers[1:] <= numbers[:-1]), "links of a row ascend, each once"
    )
    does, states = columns.get(at_closed(FRICTION_STATE), np.zeros(steps.size, np.int64)), len(schema.LINK_STATES)
    _refuse_links(at_closed(FRICTION_STATE), does, ~np.isin(does, range(states)), _numbers_below(states))
    rows = places_among(columns[NUMBER], steps)
    is_recorded = rows >= 0
    return RowLinks(rows[is_recorded], np.stack([numbers[is_recorded], does[is_recorded]]).astype(np.int64))


def _numbers_below(count: int) -> str:
    return f"there are 0 to {count - 1}"


def _refuse_links(name: str, values: Any, wrong: Any, needed: str) -> None:
    """Refuse closed links as no march lists them, naming the first; of order `wrong` is told of all but the first."""
    if not wrong.any():
        return
    in_order = values.size - wrong.size
    link_index = int(np.flatnonzero(wrong)[0]) + in_order
    previous_words = f" after {values[link_index - 1]}" if in_order else ""
    raise InputError(
        f"'{name}' is {values[link_index]}{previous_words} at place {link_index} along '{schema.CLOSED_LINKS}', and {needed}: the record was"
        " edited; take what simulate or open_run gives, or drop its closed_... variables, and links are found from states"
    )


def links_of_rows(run: xr.Dataset, numbers: IntArray) -> dict[str, Any]:
    """Return the closed links of a record's rows of given numbers, read."""
    if STEP not in run.variables:
        return {}
    link_indices = np.flatnonzero(np.isin(np.asarray(run.variables[STEP].values), numbers))
    return {
        str(name): variable.isel({schema.CLOSED_LINKS: link_indices}).load()
        for name, variable in run.variables.items()
        if schema.CLOSED_LINKS in variable.dims
    }
