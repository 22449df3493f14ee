"""The numbers of the elements of a statement with dimensions: parameters and values at the start."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node, derivatives, free_names, shortened_text
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.controllers import with_pending
from xdynamics.model.elementwise import Elementwise, Numbers, ParameterNumbers, always, in_si
from xdynamics.model.given_values import Values, uniform_spreads, unit_of_values
from xdynamics.model.parts import Parameter
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, at_element, dims_of
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.evaluation import evaluate_elements, rounding_errors
from xdynamics.shapes.naming import split_element_name
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

    def element_parameters(self) -> dict[str, Parameter]:
        """Return the parameters, each made on first look-up.

        Raises
        ------
        ModelError
            With every parameter whose expression has no number for an element.
        """
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

    def start_sections(self, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
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


def with_parameters(
    statement: Statement, elements: Statement, shapes: Shapes, parameters: Mapping[str, Parameter]
) -> Statement:
    """Return a statement with other parameters; the expression of a changed quantity gives way to numbers.

    Parameters
    ----------
    statement : Statement
    elements : Statement
        The same of single numbers.
    shapes : Shapes
    parameters : mapping of str to Parameter
        By the names of elements, in any unit.
    """
    arrays = dict(statement.arrays)
    for name, parts in _parts_by_quantity(parameters, statement.parameters).items():
        old = {element: elements.parameters[element] for element in shapes.elements(name)}
        arrays[name] = _with_element_parts(arrays[name], old, parts)
    single = {name: part for name, part in parameters.items() if name in statement.parameters}
    return replace(statement, arrays=arrays, parameters=statement.parameters | single)


def with_element_starts(
    statement: Statement, elements: Statement, shapes: Shapes, starts: Mapping[str, Parameter]
) -> Statement:
    """Return a statement with other values at the start; arguments as of `with_parameters`."""
    starting, initial = dict(statement.starting), dict(statement.initial)
    for name, parts in _parts_by_quantity(starts, initial.keys() - shapes.dims.keys()).items():
        old = {
            element: elements.starts.get(element, Parameter(elements.initial[element]))
            for element in shapes.elements(name)
        }
        at_rest = Values(shapes.dims.get(name, ()))
        values = _with_element_parts(starting.get(name, at_rest), old, parts)
        if values is not at_rest:
            starting[name] = values
            initial.pop(name, None)  # the zero of all elements
    at_rest_names = tuple(name for name in statement.at_rest if name in initial)
    restarted = replace(statement, starting=starting, initial=initial, at_rest=at_rest_names)
    return with_starts(restarted, {name: part for name, part in starts.items() if name in initial})


def with_starts(statement: Statement, parts: Mapping[str, Parameter]) -> Statement:
    """Return a statement with other values at the start of what has no dimensions."""
    starts = {name: statement.starts.get(name, Parameter(quantity)) for name, quantity in statement.initial.items()}
    starts |= parts
    changed = with_pending({name: part.quantity for name, part in parts.items()}, statement.controllers)
    return replace(
        statement,
        initial={name: start.quantity for name, start in starts.items()} | changed,
        starts={name: start for name, start in starts.items() if start.spread or start.description},
        at_rest=tuple(name for name in statement.at_rest if name not in parts),
    )


def _parts_by_quantity(
    parts: Mapping[str, Parameter], single_names: Collection[str]
) -> dict[str, dict[str, Parameter]]:
    """Return parts of elements by their quantities, without those that stand by themselves."""
    by_quantity: dict[str, dict[str, Parameter]] = {}
    for name, part in parts.items():
        if name not in single_names:
            by_quantity.setdefault(split_element_name(name)[0], {})[name] = part
    return by_quantity


def _with_element_parts(values: Values, old: Mapping[str, Parameter], parts: Mapping[str, Parameter]) -> Values:
    """Return the values of a quantity with other parts of some elements, in the unit that they have."""
    if all(_parts_agree(old[name], part) for name, part in parts.items()):
        return values
    unit = next(iter(old.values())).quantity.unit
    filled = [parts.get(name, part) for name, part in old.items()]
    return replace(
        values,
        tree=None,
        numbers=tuple(part.quantity.into(unit).value for part in filled),
        unit=unit,
        spreads=uniform_spreads([part.spread for part in filled], unit),
    )


def _parts_agree(first: Parameter, second: Parameter) -> bool:
    """Whether parts agree in all digits that are known of them."""
    numbers = [decimal_text(part.quantity.value) for part in (first, second)]
    return first.quantity == second.quantity and first.spread == second.spread and numbers[0] == numbers[1]


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
