"""The numbers of the elements of a statement with dimensions: parameters and values at the start.

A statement with dimensions and the statement of its elements follow each other where numbers change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node, derivatives, free_names, shortened_text
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.elementwise import Elementwise, Numbers, ParameterNumbers, always, in_si
from xdynamics.model.given_values import Values, unit_of_values
from xdynamics.model.parts import Parameter
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import Spread
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, at_element, dims_of, internal_text
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.evaluation import evaluate_elements, rounding_errors
from xdynamics.shapes.naming import DOT
from xdynamics.units import Quantity, Unit, constant
from xdynamics.units.unit import decimal_text

ElementIndices = Mapping[str, int]
Part = TypeVar("Part")


class ElementNumbers:
    """The numbers of a statement with dimensions, by element."""

    def __init__(self, statement: Statement, shapes: Shapes) -> None:
        self.statement, self.shapes = statement, shapes

    def _element_names(self, name: str) -> list[str]:
        return self.shapes.elements(name)

    def _indexed_elements(self, name: str) -> Iterator[tuple[str, ElementIndices]]:
        """Yield the elements of a quantity with their places."""
        for indices in self.shapes.index_combinations(self.shapes.dims.get(name, ())):
            yield self.shapes.element_at(name, indices), indices

    def _elementwise(self, makers: Mapping[str, Callable[[ElementIndices], Part]]) -> dict[str, Part]:
        """Return a dictionary of elements whose parts `makers` make on look-up."""
        return Elementwise(self.shapes, makers)

    def _element_parameters(self) -> dict[str, Parameter]:
        makers: dict[str, Callable[[ElementIndices], Parameter]] = {
            name: always(part) for name, part in self.statement.parameters.items()
        }
        ledger = Ledger(f"model '{self.statement.name}'", ModelError)
        for name, values in self.statement.arrays.items():
            with ledger.entry(f"parameter '{name}'"):
                makers[name] = ParameterNumbers(*self.element_values(values, name), values)
        ledger.raise_faults()
        return self._elementwise(makers)

    def element_values(self, values: Values, name: str) -> tuple[Any, tuple[int, ...], Unit]:
        """Return a number for each element, with their shape and unit; no expression may read parameters.

        Raises
        ------
        ModelError
            If an expression has no number for an element, whose name it says.
        """
        shape = self.shapes.shape(values.dims)
        if values.tree is None:
            every = values.numbers * math.prod(shape) if len(values.numbers) == 1 else values.numbers
            return every, shape, unit_of_values(values)
        constants = _constant_factors(self.statement.unit_constants)
        numbers = evaluate_elements(values.tree, values.dims, constants, self.shapes).ravel()
        if (wrong := np.flatnonzero(~np.isfinite(numbers))).size:
            label = self._element_names(name)[int(wrong[0])]
            remedy = "; index counts from 0, so write index(…) + 1 for numbers from 1" if wrong[0] == 0 else ""
            raise ModelError(
                f"'{shortened_text(values.tree)}' is {numbers[wrong[0]]} at {label}, and needs finite numbers{remedy}"
            )
        return numbers, shape, unit_of_values(values)

    def _start_sections(self, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
        """Return values at the start."""
        old, ledger = self.statement, Ledger(f"model '{self.statement.name}'", ModelError)
        initial: dict[str, Callable[[ElementIndices], Quantity]] = {
            name: always(quantity) for name, quantity in old.initial.items()
        }
        starts = dict(old.starts)
        for name, values in old.starting.items():
            with ledger.entry(f"initial value of '{name}'"):
                made = initial[name] = self._start_maker(name, values, parameters)
                if values.spreads or values.description:
                    for i, (element, indices) in enumerate(self._indexed_elements(name)):
                        if (spread := values.spread(i)) or values.description:
                            starts[element] = Parameter(made(indices), spread, values.description)
        ledger.raise_faults()
        order = ["t", *(word for q in old.coordinates for word in (q, velocity(q))), *old.states]
        ranked = {name: initial[name] for name in order if name in initial}
        at_rest = Blocks.from_names("velocity", old.at_rest, self.shapes)
        return {"initial": self._elementwise(ranked | initial), "starts": starts, "at_rest": at_rest}

    def values_at_start(self, parameters: Mapping[str, Parameter]) -> dict[str, Quantity]:
        """Return every value at the start that is an array or an expression, by element."""
        return {
            element: made(indices)
            for name, values in self.statement.starting.items()
            for made in (self._start_maker(name, values, parameters),)
            for element, indices in self._indexed_elements(name)
        }

    def _start_maker(self, name: str, values: Values, parameters: Mapping[str, Parameter]) -> Numbers:
        """Return the function that makes the values of a quantity's elements at the start."""
        shape = self.shapes.shape(self.shapes.dims.get(name, ()))
        if values.tree is None:
            assert values.unit is not None  # noqa: S101 - numbers have a unit
            base_numbers = values.numbers[0] if len(values.numbers) == 1 else np.reshape(values.numbers, shape)
            return Numbers(np.broadcast_to(base_numbers, shape), values.unit, values.scale)
        unit = self._variable_units()[name]
        numbers = self._evaluate_at_start(values.tree, values.dims, self._readable_values(values.tree, parameters))
        numbers = numbers / float(unit.factor)
        # of one number for a million elements there is one
        return Numbers(numbers if dims_of(values.tree, self.shapes) else np.broadcast_to(numbers.flat[0], shape), unit)

    def rounding_at_start(self, parameters: Mapping[str, Parameter], initial: Mapping[str, Quantity]) -> dict[str, Any]:
        """Return the rounding errors of initial values that expressions give, in SI units.

        Parameters
        ----------
        parameters, initial : mapping of str
            Of the elements: numbers as they are, of which the expressions would have more digits.
        """
        errors = {}
        for name, values in self.statement.starting.items():
            if values.tree is not None:
                dims = self.shapes.dims.get(name, ())
                numbers = in_si(initial, Blocks.from_names("", [name], self.shapes)).reshape(self.shapes.shape(dims))
                readable_values = self._readable_values(values.tree, parameters)
                errors[name] = rounding_errors(values.tree, dims, readable_values, self.shapes, numbers)
        return errors

    def _readable_values(self, tree: Node, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
        """Return the values that an expression may read, in SI units: parameters and constants."""
        readable_values: dict[str, Any] = _constant_factors(self.statement.unit_constants)
        for name in free_names(tree):
            if dims := self.shapes.dims.get(name, ()):
                if name in self.statement.arrays:
                    readable_values[name] = in_si(parameters, Blocks.from_names("", [name], self.shapes)).reshape(
                        self.shapes.shape(dims)
                    )
            elif name in parameters:
                readable_values[name] = parameters[name].quantity.si
        return readable_values

    def read_at_start(self) -> frozenset[str]:
        """Return the parameters that values at the start follow."""
        trees = [values.tree for values in self.statement.starting.values() if values.tree is not None]
        if any(name in self.shapes.dims for tree in trees for name in free_names(tree)):
            trees = [tree for _, _, tree in self._expressions()]
        return frozenset(name for tree in trees for name in free_names(tree)) - {*self.statement.unit_constants, "pi"}

    def start_slopes(
        self, numbers: Mapping[str, Parameter], parameter_names: Iterable[str]
    ) -> dict[tuple[str, str], float]:
        """Return the derivatives of values at the start by parameters, where they are not zero, in SI units."""
        return {
            (element, word): evaluate(rate, self._readable_values(rate, numbers))
            for _, element, tree in self._expressions()
            for word, rate in derivatives(tree, {word: {word: ONE} for word in parameter_names}).items()
        }

    def varied_starts(self, parameters: Mapping[str, Any], si_values: Mapping[str, float]) -> dict[str, Any]:
        """Return values at the start, in SI units, for arrays of parameters that some of them follow.

        Every number has the bits that the model with those parameters has.
        """
        values: dict[str, Any] = _constant_factors(self.statement.unit_constants) | dict(si_values) | dict(parameters)
        starts = {}
        for name, element, tree in self._expressions():
            if free_names(tree) & parameters.keys():
                unit = self._variable_units()[name]
                numbers = np.broadcast_to(
                    evaluate_many(tree, values) / float(unit.factor), len(next(iter(parameters.values())))
                )
                starts[element] = unit.all_to_si(numbers)
        return starts

    def _expressions(self) -> Iterator[tuple[str, str, Node]]:
        """Yield the quantity, the element and the expression of each value at the start that is one."""
        for name, values in self.statement.starting.items():
            if values.tree is not None:
                for element, indices in self._indexed_elements(name):
                    yield name, element, at_element(values.tree, indices, self.shapes)

    def _variable_units(self) -> dict[str, Unit]:
        time, old = self.statement.time_unit, self.statement
        units = {name: part.unit for name, part in (old.coordinates | old.states).items()}
        return units | {velocity(name): part.unit.per(time) for name, part in old.coordinates.items()}

    def _evaluate_at_start(
        self, tree: Node, dims: tuple[str, ...], readable_values: Mapping[str, Any]
    ) -> NDArray[np.float64]:
        if missing := sorted(free_names(tree) - readable_values.keys()):
            raise InputError(
                f"'{shortened_text(tree)}' reads '{missing[0]}'; a value at the start is of parameters and index(…)"
            )
        return evaluate_elements(tree, dims, readable_values, self.shapes)


def _constant_factors(unit_constants: Iterable[str]) -> dict[str, float]:
    return {name: float(constant(name).factor) for name in unit_constants} | {"pi": math.pi}


def replaces_elements(sections: Mapping[str, Any]) -> bool:
    """Whether new entries of a model are those of single elements, as ``m·Sun``."""
    return any(
        DOT in internal_text(str(name))
        for entries in sections.values()
        if isinstance(entries, Mapping)
        for name in entries
    )


def follow_parameters(declared: Statement, elements: Statement, old: Statement, shapes: Shapes) -> Statement:
    """Return a statement of elements in which values at the start follow the parameters that their expressions read.

    Parameters
    ----------
    declared : Statement
        With the expressions.
    elements, old : Statement
        As it is now, and as it was: a value at the start that was changed itself stays.
    shapes : Shapes
    """
    if elements.parameters is old.parameters or not any(values.tree for values in declared.starting.values()):
        return elements
    start = ElementNumbers(gather_elements(declared, old, shapes), shapes).values_at_start(elements.parameters)
    same = {name: quantity for name, quantity in start.items() if elements.initial[name] == old.initial[name]}
    return replace(elements, initial=elements.initial | same)


def converted_like(statement: Statement, old: Statement) -> Statement:
    """Return a statement of elements in the units of another one: all elements of a quantity have one unit."""
    parameters = {
        name: replace(part, quantity=part.quantity.into(unit))
        for name, part in statement.parameters.items()
        if name in old.parameters and (unit := old.parameters[name].quantity.unit) != part.quantity.unit
    }
    initial = {
        name: quantity.into(unit)
        for name, quantity in statement.initial.items()
        if name in old.initial and (unit := old.initial[name].unit) != quantity.unit
    }
    if not (parameters or initial):
        return statement
    return replace(statement, parameters=statement.parameters | parameters, initial=statement.initial | initial)


def gather_elements(declared: Statement, elements: Statement, shapes: Shapes) -> Statement:
    """Return a statement with dimensions and the numbers of its elements."""
    arrays, starting = {}, {}
    for name, values in declared.arrays.items():
        if _is_as_read(elements.parameters, name):
            arrays[name] = values
            continue
        parts = [elements.parameters[element] for element in shapes.elements(name)]
        filled = _fill_values(values, tuple(part.quantity for part in parts), tuple(part.spread for part in parts))
        arrays[name] = values if _values_agree(filled, number_per_element(name, values, declared, shapes)) else filled
    start = (
        ElementNumbers(declared, shapes).values_at_start(elements.parameters)
        if not _is_as_read(elements.initial)
        else {}
    )
    for name, values in declared.starting.items():
        if _is_as_read(elements.initial, name) and not (start and values.tree):
            starting[name] = values
            continue
        names = shapes.elements(name)
        spreads = tuple(elements.starts[name].spread if name in elements.starts else None for name in names)
        numbers = tuple(elements.initial[name] for name in names)
        filled = _fill_values(values, numbers, spreads)
        if values.tree is None:
            same = _values_agree(filled, number_per_element(name, values, declared, shapes))
        else:
            same = all(start[name] == elements.initial[name] for name in names)
        starting[name] = values if same else filled
    return replace(
        declared,
        arrays=arrays,
        starting=starting,
        parameters={name: elements.parameters[name] for name in declared.parameters},
        initial={name: elements.initial.get(name, quantity) for name, quantity in declared.initial.items()},
        name=elements.name,
        description=elements.description,
        fit=elements.fit,
    )


def number_per_element(name: str, values: Values, statement: Statement, shapes: Shapes) -> Values:
    """Return values with a number for each element: of their expression of constants, or of the one that all have."""
    numbers, _, unit = ElementNumbers(statement, shapes).element_values(values, name)
    return replace(values, tree=None, numbers=tuple(numbers if values.tree is None else numbers.tolist()), unit=unit)


def explicit_values(statement: Statement, shapes: Shapes) -> Statement:
    """Return a statement with a number for each element, however they are given; expressions of parameters stay."""
    arrays = {name: number_per_element(name, values, statement, shapes) for name, values in statement.arrays.items()}
    starting = {
        name: values if values.tree else number_per_element(name, values, statement, shapes)
        for name, values in statement.starting.items()
    }
    return replace(statement, arrays=arrays, starting=starting)


def _is_as_read(parts: Mapping[str, Any], name: str = "") -> bool:
    """Whether no element of a quantity, or of any, has another value than the statement had it first."""
    return isinstance(parts, Elementwise) and (name not in parts.changed if name else not parts.changed)


def _values_agree(first: Values, second: Values) -> bool:
    """Whether values agree in all digits that are known of them."""
    return first == second and [*map(decimal_text, first.numbers)] == [*map(decimal_text, second.numbers)]


def _fill_values(values: Values, quantities: tuple[Quantity, ...], spreads: tuple[Spread | None, ...]) -> Values:
    """Return the values of a quantity with new numbers for its elements."""
    if values.tree is not None and values.unit is None and not values.dims:
        return replace(values, tree=None, numbers=(quantities[0].value,), unit=quantities[0].unit)
    shared_spreads = spreads[:1] if len(set(spreads)) == 1 else spreads
    numbers = tuple(quantity.value for quantity in quantities)
    return replace(
        values,
        tree=None,
        numbers=numbers,
        unit=quantities[0].unit,
        spreads=() if shared_spreads == (None,) else shared_spreads,
    )
