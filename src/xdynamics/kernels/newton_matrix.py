"""The matrix of Newton's method for the equations of a step: its entries, its column groups and its band.

Columns that share no row are one group: the derivative along their sum has the entries of all of them (Curtis, Powell,
Reid 1974, J. Inst. Maths Applics 13, 117, doi:10.1093/imamat/13.1.117). An order of the unknowns is sought in which the
Jacobian is a narrow band.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Name, Node, Number, derivative, expand
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import has_loops
from xdynamics.methods.lines import Solve
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import motion, motion_shapes, state_quantities
from xdynamics.schema import rate
from xdynamics.shapes import Shapes
from xdynamics.shapes.dependence import Dependence

DIRECT = -1  # in place of a derivative: a coefficient that is multiplied by none


@dataclass(frozen=True)
class NewtonSystem:
    """The parts of one `solve` for Newton's method, as indices of the working memory `w` and the state `y`.

    Attributes
    ----------
    evaluations : int
        Force evaluations of one iteration.
    residuals : int
        Place of the first residual; the others follow.
    unknowns : tuple of (int, int, int, int)
        For each vector: places of its first number in `w`, and in `y` of value and slope at the start of the step, which
        give its size; how many numbers it has.
    entries : tuple of (int, int, int, int)
        What is subtracted from the unit matrix: row, column, place of a coefficient, place of a derivative or `DIRECT`.
    state : int
        Place of the state at which derivatives are found group by group (`kernels.newton_matrix`), -1 if they are not.
    weights : int
        Place of the coefficients of all entries then: see `Coupling.weights`.
    derivatives : int
        Place of those derivatives, of the direction that they are found along, and of the time.
    """

    evaluations: int
    residuals: int
    unknowns: tuple[tuple[int, int, int, int], ...]
    entries: tuple[tuple[int, int, int, int], ...] = ()
    state: int = -1
    weights: int = -1
    derivatives: int = -1


class Coupling:
    """The matrix of Newton's method: direct dependence in the lines, and dependence through the forces.

    Parameters
    ----------
    layout : Layout
    line : Solve
    slopes : list of int
        Where the derivatives of each force evaluation begin.
    coefficient : callable
        Computes a number that all components share; returns its place.
    """

    def __init__(self, layout: Layout, line: Solve, slopes: list[int], coefficient: Callable[..., int]) -> None:
        self._layout, self._line, self._slopes, self._coefficient = layout, line, slopes, coefficient
        self._inner: Mapping[str, Node] = {statement.target: statement.expression for statement in line.definitions}
        self._outer = {statement.target: expand(statement.expression, self._inner) for statement in line.equations}
        self._jacobian = {pair: i for i, pair in enumerate(layout.jacobian)}
        self._places: dict[tuple[str, ...], int | None] = {}

    def entries(
        self, row: int, column: int, target: tuple[str, int], unknown: tuple[str, int]
    ) -> list[tuple[int, int, int, int]]:
        """Return the terms subtracted from one entry of the unit matrix, in the order written."""
        (name, i), (variable, k) = target, unknown
        of_state, by_state = name[0] == "x", variable[0] == "x"
        entries = []
        if i == k and of_state == by_state and (slot := self._direct_slot(name, variable)) is not None:
            entries.append((row, column, slot, DIRECT))
        layout = self._layout
        dependent = rate(layout.states[i]) if of_state else layout.coordinates[i]
        for number, evaluation in enumerate(self._line.evaluations):
            for vector in (evaluation.state,) if by_state else (evaluation.position, evaluation.velocity):
                owner = layout.states[k] if by_state else layout.coordinates[k]
                slope = self._jacobian.get((dependent, layout.argument(vector[0], owner)))
                slot = (
                    None
                    if slope is None
                    else self._force_slot(
                        name, evaluation.rate if of_state else evaluation.acceleration, vector, variable
                    )
                )
                if slope is not None and slot is not None:
                    entries.append((row, column, slot, self._slopes[number] + slope))
        return entries

    def weights(self) -> int:
        """Compute the coefficients of one vector of velocities and one of states; return the first's index.

        Eight: of velocities and of states by themselves, of accelerations by coordinates, velocities and states, of rates.
        """
        (evaluation,) = self._line.evaluations
        velocity, state = self._line.unknowns
        terms = [derivative(self._outer[name], {name: Number(1.0)}) for name in (velocity, state)]
        insides: list[Node | None] = [None, None]
        for name, slope in ((velocity, evaluation.acceleration), (state, evaluation.rate)):
            for vector, unknown in (
                (evaluation.position, velocity),
                (evaluation.velocity, velocity),
                (evaluation.state, state),
            ):
                terms.append(derivative(self._outer[name], {slope: Number(1.0)}))
                insides.append(derivative(expand(Name(vector), self._inner), {unknown: Number(1.0)}))
        first, *_ = [self._coefficient(*pair) for pair in zip(terms, insides, strict=True)]
        return first

    def _direct_slot(self, name: str, unknown: str) -> int | None:
        return self._coefficient_slot((name, unknown), derivative(self._outer[name], {unknown: Number(1.0)}))

    def _force_slot(self, name: str, slope: str, vector: str, unknown: str) -> int | None:
        weight = derivative(self._outer[name], {slope: Number(1.0)})
        inner_derivative = derivative(expand(Name(vector), self._inner), {unknown: Number(1.0)})
        return (
            None
            if inner_derivative == Number(0.0)
            else self._coefficient_slot((name, slope, vector, unknown), weight, inner_derivative)
        )

    def _coefficient_slot(self, key: tuple[str, ...], weight: Node, inner_derivative: Node | None = None) -> int | None:
        """Return the slot of a coefficient; None if it is zero."""
        if key not in self._places:
            zero = weight == Number(0.0)
            self._places[key] = None if zero else self._coefficient(weight, inner_derivative)
        return self._places[key]


WRITTEN_OUT = 5  # velocities and states up to which derivatives are those of elements: the most that lanes factorise
WIDE = 64  # numbers in a row of a band from which on another order is looked for
LEAST_BANDED = 64  # single numbers from which on their band is looked for
TRIED = 32  # numbers of groups that are tried with columns dealt out in turn

IntArray = NDArray[Any]  # of numbers, most of 32 bits: large models have millions of entries
SHORT = np.int32


class Band(NamedTuple):
    """An order of unknowns in which a matrix has entries near its diagonal alone.

    Attributes
    ----------
    order : ndarray of int32, shape (unknowns,)
        The place of each unknown.
    lower, upper : int
        Entries below and above the diagonal in a column and a row.
    """

    order: IntArray
    lower: int
    upper: int

    @property
    def height(self) -> int:
        """Numbers of a column while it is factorised: row exchanges move entries up by `lower`."""
        return 2 * self.lower + self.upper + 1


class Pattern(NamedTuple):
    """The entries of a Jacobian: derivatives of accelerations and rates by all that a force evaluation uses.

    Attributes
    ----------
    entries : ndarray of int32, shape (entries, 2)
        The row among accelerations and rates, the column among coordinates, velocities and states; group by group.
    groups : ndarray of int64, shape (groups + 1,)
        Where the entries of each group begin, and where the last one's end.
    band : Band, optional
        Of a matrix of accelerations and rates, with the coordinates eliminated; None where it is as well kept whole.
    """

    entries: IntArray
    groups: IntArray
    band: Band | None


def is_compressed(layout: Layout) -> bool:
    """Whether derivatives of the forces are computed by column groups; else each is an expression of elements."""
    by_motion = any(argument != CLOCK for argument in layout.model.elements.looked_up_at.values())
    return has_loops(layout.model) and not by_motion and layout.used.size - layout.coordinates.size > WRITTEN_OUT


@lru_cache(maxsize=16)
def pattern_of(layout: Layout) -> Pattern:
    """Return the pattern of a model with dimensions, from its expressions."""
    shapes, used = motion_shapes(layout.model), layout.used
    first = {name: used.offset_of(shapes.first(name)) for name in state_quantities(layout.model)}
    dependence, entry_parts = Dependence(shapes, first, used.size), []
    begin, rows = 0, {*moving_quantities(layout.model)}
    for item in motion(layout.model):
        elements, numbers = dependence.pairs(item.tree, item.dims, item.name)
        if item.name in rows:
            entry_parts.append((begin + elements, numbers))
            begin += math.prod(shapes.shape(item.dims))
    every_row, every_column = (np.concatenate(parts) for parts in zip(*entry_parts, strict=True))
    del dependence, entry_parts
    band, group = _group_columns(layout, every_row, every_column)
    # group, column and row as one number: sorted in place, without the index arrays of a lexsort
    keys = group.astype(np.int64)
    for part, count in ((every_column, used.size), (every_row, band.order.size)):
        keys *= count
        keys += part
    groups = np.concatenate([[0], np.cumsum(np.bincount(group))])
    del group
    keys.sort()
    np.remainder(keys, band.order.size, out=every_row, casting="unsafe")
    keys //= band.order.size
    np.remainder(keys, used.size, out=every_column, casting="unsafe")
    del keys
    narrow = band if band.height < band.order.size else None
    return Pattern(np.stack([every_row, every_column], axis=1), groups, narrow)


def _group_columns(layout: Layout, rows: IntArray, columns: IntArray) -> tuple[Band, IntArray]:
    """Return the band of entries with the coordinates eliminated, and the group of each entry."""
    model, n = layout.model, layout.coordinates.size
    unknown = np.where(columns < n, columns, columns - SHORT(n)) if n else columns  # q is eliminated by v
    shapes = motion_shapes(model)
    band = best_band(shapes, [shapes.dims.get(name, ()) for name in moving_quantities(model)], rows, unknown)
    # a coordinate stands beside its velocity, which has the same place in the band
    places = band.order[unknown]
    places *= 2
    places += columns >= n
    return band, column_groups(rows, places)


def moving_quantities(model: Model) -> list[str]:
    """Return accelerations and rates as quantities."""
    return [*map(schema.acceleration, model.statement.coordinates), *map(schema.rate, model.statement.states)]


# ---------------------------------------------------------------------------------------------------------------- groups


def column_groups(rows: IntArray, places: IntArray) -> IntArray:
    """Return for every entry the group of its column; columns of a group share no row."""
    present = np.bincount(places) > 0
    columns = int(np.count_nonzero(present))
    ranks = (np.cumsum(present, dtype=SHORT) - SHORT(1))[places]
    # a lower bound: the entries of one row are all in different groups
    fullest = int(np.bincount(rows).max(initial=1))
    for count in range(fullest, min(fullest + TRIED, columns)):
        dealt = ranks % SHORT(count)
        row_group_keys = np.multiply(rows, count, dtype=np.int64)
        row_group_keys += dealt
        if np.bincount(row_group_keys).max() <= 1:
            return dealt
    if fullest >= columns:
        return ranks
    group: IntArray = np.array(_greedy_groups(rows, ranks, columns), SHORT)[ranks]
    return group


def _greedy_groups(rows: IntArray, ranks: IntArray, count: int) -> list[int]:
    """Return the group of each column: the first that has none of its rows."""
    order = np.argsort(ranks, kind="stable")
    ends = np.cumsum(np.bincount(ranks, minlength=count)).tolist()
    by_column = rows[order].tolist()
    occupied_groups = [0] * (int(rows.max()) + 1)  # bits of the groups that have a row
    groups = []
    for begin, end in zip([0, *ends[:-1]], ends, strict=True):
        *_, bits = accumulate((occupied_groups[row] for row in by_column[begin:end]), int.__or__)
        # the lowest bit that is not set
        free = ~bits & (bits + 1)
        groups.append(free.bit_length() - 1)
        for row in by_column[begin:end]:
            occupied_groups[row] |= free
    return groups


# ------------------------------------------------------------------------------------------------------------------ band


def best_band(shapes: Shapes, unknowns: Sequence[tuple[str, ...]], rows: IntArray, columns: IntArray) -> Band:
    """Return the order of unknowns with the narrowest band among the orders that are tried.

    Parameters
    ----------
    shapes : Shapes
    unknowns : sequence of tuple of str
        The dimensions of each quantity, whose elements follow one another.
    rows, columns : ndarray of int
        The entries off the diagonal, among the unknowns, perhaps several times over.
    """
    best = min((_banded(order, rows, columns) for order in _candidate_orders(shapes, unknowns)), key=_band_height)
    count = best.order.size
    if best.height > min(WIDE, count):
        best = min(best, _banded(_levelled(rows, columns, count), rows, columns), key=_band_height)
    return best


def band_as_written(entries: IntArray, coordinates: int, size: int) -> Band | None:
    """Return the band of a model of single numbers in their given order; None where a full matrix is as good.

    Elimination then takes the same sums in the same order: what it leaves out are zeros, and the numbers are the same.
    """
    if size < LEAST_BANDED:
        return None
    rows, columns = entries.T
    band = _banded(np.arange(size, dtype=SHORT), rows, np.where(columns < coordinates, columns, columns - coordinates))
    return band if 2 * band.height <= size else None


def _band_height(band: Band) -> int:
    return band.height


def _banded(order: IntArray, rows: IntArray, columns: IntArray) -> Band:
    far = order[rows]
    far -= order[columns]
    return Band(order, int(far.max(initial=0)), int(-far.min(initial=0)))


def _candidate_orders(shapes: Shapes, unknowns: Sequence[tuple[str, ...]]) -> Iterator[IntArray]:
    """Yield orders: as given, and by index along each dimension, with all unknowns of an index adjacent.

    A dimension is run through from its beginning, or from both ends in turn, which keeps a ring together.
    """
    yield np.arange(sum(math.prod(shapes.shape(dims)) for dims in unknowns), dtype=SHORT)
    for dim in shapes.extents:
        size = shapes.extent(dim).size
        element_numbers = np.concatenate([_numbers_along(dim, dims, shapes) for dims in unknowns])
        for sort_keys in (element_numbers, np.minimum(2 * element_numbers, 2 * (size - element_numbers) - 1)):
            yield _ranks(np.argsort(sort_keys, kind="stable"))


def _numbers_along(dim: str, dims: tuple[str, ...], shapes: Shapes) -> IntArray:
    """Return the number of each element along a dimension; elements without it come last."""
    shape = shapes.shape(dims)
    if dim not in dims:
        return np.full(math.prod(shape), shapes.extent(dim).size, SHORT)
    element_numbers: IntArray = np.indices(shape, SHORT)[dims.index(dim)].ravel()
    return element_numbers


def _levelled(rows: IntArray, columns: IntArray, count: int) -> IntArray:
    """Return the order of Cuthill and McKee, reversed, for links that follow no numbers."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    ends = np.concatenate([rows, columns]), np.concatenate([columns, rows])
    graph = csr_array((np.ones(2 * rows.size), ends), shape=(count, count))
    return _ranks(reverse_cuthill_mckee(graph, symmetric_mode=True))


def _ranks(sequence: IntArray) -> IntArray:
    """Return the rank of each number in a sequence."""
    ranks = np.empty(sequence.size, SHORT)
    ranks[sequence] = np.arange(sequence.size, dtype=SHORT)
    return ranks
