"""The model: one statement, as a Python object and as a TOML file."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from xdynamics.expressions import Name, Node, derivative, derivatives, expand, free_names
from xdynamics.expressions.calculus import ONE, multiply, negative
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model import toml
from xdynamics.model.consistency import check, check_made, check_written
from xdynamics.model.csv_sheet import normal
from xdynamics.model.element_shapes import check_shapes, declared_shapes, dimensions_of
from xdynamics.model.element_values import following, gathered, in_units_of, of_elements
from xdynamics.model.elements import Elements
from xdynamics.model.elementwise import Elementwise, always
from xdynamics.model.file_access import ACCESSES, ANYWHERE, BELOW, EMBEDDED, FileAccess
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.parts import (
    Contact,
    Coordinate,
    Drive,
    Event,
    Fitted,
    Force,
    Friction,
    Function,
    Observable,
    Parameter,
    Pictured,
    Regime,
    State,
    Validation,
)
from xdynamics.model.python import Functions
from xdynamics.model.reading import derived, read
from xdynamics.model.replacement import changes_numbers_alone, replaced
from xdynamics.model.statement import Statement
from xdynamics.model.text_limits import parsed
from xdynamics.model.uncertainty import Discrepancy
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.runtime.files import asked, check_no_address, decoded, read_bounded
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes, written
from xdynamics.units import Dimension, Quantity, Unit

_OF_TREES = ("form", "force_components", "rates", "units")  # what does not change with the numbers of a model
LARGEST_FILE = 20_000_000  # bytes, its tables included where they are in it


def _named_inside(entries: Any) -> Any:
    """Return entries with elements as they are named inside."""
    return {written(str(name)): entry for name, entry in entries.items()} if isinstance(entries, Mapping) else entries


class Model:
    """A mechanical initial-value problem with units: M(q, t) a = sum of forces, and first-order states.

    Parameters
    ----------
    **statement
        The sections of a model file by name (`name`, `description`, `coordinates`, `parameters`, `mass`, `definitions`,
        `forces`, `drives`, `states`, `lagrangian`, `initial`, `events`, `contacts`, `frictions`, `regimes`,
        `observables`, `validation`, `correlations`, `discrepancy`, `run`), each a mapping with the keys of the file. A
        force component may also be a numba-compilable Python function whose arguments are declared names; it takes and
        returns SI floats.

    Raises
    ------
    ModelError
        With every fault of the statement at once.

    Notes
    -----
    The mass matrix multiplies the acceleration only: terms that arise from its change, like the centrifugal terms of a
    double pendulum, are forces and are written as such.

    Examples
    --------
    >>> model = Model(
    ...     name="spring", coordinates={"x": {"unit": "m"}}, parameters={"m": "1 kg", "k": "4 N m-1"},
    ...     mass={"x": "m"}, forces={"spring": {"potential": "k*x**2/2"}}, initial={"x": "1 m", "v_x": "0 m s-1"},
    ... )
    >>> Model.from_text(model.to_toml()) == model
    True
    """

    statement: Statement
    name: str
    description: str
    coordinates: dict[str, Coordinate]
    parameters: dict[str, Parameter]
    mass: Sequence[tuple[Node, ...]]
    definitions: dict[str, Node]
    forces: dict[str, Force]
    drives: dict[str, Drive]
    states: dict[str, State]
    initial: dict[str, Quantity]
    starts: dict[str, Parameter]
    events: dict[str, Event]
    contacts: dict[str, Contact]
    frictions: dict[str, Friction]
    assemblies: dict[str, Contact]
    regimes: dict[str, Regime]
    regime: str
    observables: dict[str, Node]
    observed: dict[str, Observable]
    run: dict[str, Any]
    validation: dict[str, Validation]
    correlations: dict[tuple[str, str], float]
    discrepancy: dict[str, Discrepancy]
    time_unit: Unit
    pictured: Pictured
    fit: Fitted | None
    lagrangian: Lagrangian | None
    dimensions: dict[str, Dimension]
    shapes: Shapes
    file: Path | None = None  # that it was read from

    def __init__(self, **statement: Any) -> None:
        self._fill(statement, Path(), {}, FileAccess(Path(), ANYWHERE))

    @classmethod
    def from_toml(
        cls,
        path: str | Path,
        *,
        functions: Mapping[str, Callable[..., float]] | None = None,
        tables: str = BELOW,
    ) -> Model:
        """Read a model file; drive tables are looked for next to it.

        Parameters
        ----------
        path : str or Path
        functions : mapping of str to callable, optional
            The Python functions that the file's forces name.
        tables : {"below", "anywhere"}
            Where the file may take its tables from: its own folder and below, without links out of it; or any file.

        Raises
        ------
        ModelError
            If the file cannot be read, or with every fault of its statement.
        InputError
            If `tables` is neither word.
        """
        try:
            check_no_address(path)
        except InputError as error:
            raise ModelError(f"the model cannot be read: {error}") from None
        path = Path(path)
        if tables not in ACCESSES:
            raise InputError(f"tables is {tables!r}; there are {', '.join(ACCESSES)}")
        if asked(path, Path.is_dir):
            raise ModelError(f"model file '{path}' is a directory; name the .toml file in it")
        try:
            text = decoded(read_bounded(path, LARGEST_FILE))
        except OSError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error.strerror or error}") from None
        except InputError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error}") from None
        except ValueError:
            raise ModelError(
                f"model file '{path}' cannot be read: it is no text in UTF-8; archives are shown by `xdynamics show`"
            ) from None
        model = cls._parsed(text, path, functions, FileAccess(path.parent, tables))
        model.file = path.absolute()
        return model

    @classmethod
    def from_text(cls, text: str, *, functions: Mapping[str, Callable[..., float]] | None = None) -> Model:
        """Read a model from TOML text that includes its tables, like the `model_toml` of an archive; see `from_toml`.

        Raises
        ------
        ModelError
            If the text cannot be read, or with every fault of its statement.
        """
        return cls._parsed(text, Path("model.toml"), functions, FileAccess(Path(), EMBEDDED))

    @classmethod
    def from_sympy(cls, equations: Any, **sections: Any) -> Model:
        """Make a model from equations of motion derived by sympy.

        Parameters
        ----------
        equations : LagrangesMethod or KanesMethod; or sympy expressions
            Of `sympy.physics.mechanics`, its equations formed; generalised speeds are derivatives of coordinates. Or the
            potential energy, beside ``mass=…``; or the kinetic and the potential energy. In these, what is indexed has
            dimensions: ``Sum(k*(u[i + 1] - u[i])**2/2, (i, 0, 8))`` with ``dimensions={"site": 10}`` and
            ``coordinates={"u": {"unit": "m", "dims": ["site"]}}``; the velocity of `u` is `v_u`.
        **sections
            As of a model: `name`, `coordinates` with the unit of each, `parameters` for every other symbol, `initial`,
            further `forces`, `events` …

        Raises
        ------
        InputError
            If sympy is not installed, or the equations contain something the language of expressions does not have.
        ModelError
            If units do not match.

        Notes
        -----
        sympy's trees are converted node by node. The order of their terms is sympy's, so another version of it may give
        a different model, which the digest shows; the model itself is archived.

        Examples
        --------
        >>> from sympy import Symbol, cos
        >>> from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols
        >>> q, m, l, g = dynamicsymbols("q"), *map(Symbol, "mlg")
        >>> method = LagrangesMethod(m*l**2*q.diff()**2/2 + m*g*l*cos(q), [q])
        >>> _ = method.form_lagranges_equations()
        >>> model = Model.from_sympy(
        ...     method, coordinates={"q": "rad"}, parameters={"m": "1 kg", "l": "1 m", "g": "9.81 m s-2"}, initial={"q": 0.1}
        ... )
        >>> model.force_components["motion"]["q"] is not None
        True
        """
        from xdynamics.model.indexed_symbols import are_energies, sections_of_energies
        from xdynamics.model.symbolic import sections_of

        read = sections_of_energies if are_energies(equations) else sections_of
        return cls(**read(equations, sections))

    def to_toml(self) -> str:
        """Return the whole model as TOML, measured tables included."""
        return self._toml

    @cached_property
    def _toml(self) -> str:
        return toml.write(self.shaped)

    @cached_property
    def shaped(self) -> Statement:
        """The statement with dimensions; without any it is `statement`, of which it has the numbers in any case."""
        return self.statement if self._declared is None else gathered(self._declared, self.statement, self.shapes)

    @property
    def _written(self) -> Statement:
        """The statement as it was written, perhaps with other numbers."""
        return self.statement if self._declared is None else self._declared

    @classmethod
    def of_elements(cls, statement: Statement, dimensions: dict[str, Dimension]) -> Model:
        """Return the model of a statement of single numbers that is known to be sound."""
        model = object.__new__(cls)
        model._hold(statement, dimensions, Shapes(), None)
        return model

    def replace(self, **sections: Mapping[str, Any]) -> Model:
        """Return a model with some entries of some sections replaced.

        A bare number takes the unit of the entry: ``model.replace(parameters={"c": 2e-3})``.

        Raises
        ------
        ModelError
            If an entry does not exist or the new model is faulty.
        """
        model = object.__new__(Model)
        model.file = self.file
        if (
            self._declared is not None
            and of_elements(sections)
            and (others := sections.keys() - {"parameters", "initial"})
        ):
            numbers = {title: entries for title, entries in sections.items() if title not in others}
            return self.replace(**numbers).replace(**{title: sections[title] for title in others})
        if self._declared is None or of_elements(sections):
            named = {title: _named_inside(entries) for title, entries in sections.items()}
            return self.with_statement(replaced(self.statement, named, self.functions))
        model._state(replaced(self.shaped, sections, self.functions))
        return model

    def with_statement(self, statement: Statement) -> Model:
        """Return the model of another statement, checked unless numbers alone changed; a faulty one is a `ModelError`."""
        model = object.__new__(Model)
        model.file = self.file
        if self._declared is not None:
            statement = in_units_of(statement, self.statement)
        if changes_numbers_alone(self.statement, statement):  # trees are those of this model
            if self._declared is not None:
                statement = following(self._declared, statement, self.statement, self.shapes)
            model._hold(statement, self.dimensions, self.shapes, self._declared)
            model.__dict__.update({name: value for name, value in vars(self).items() if name in _OF_TREES})
        elif self._declared is not None:
            model._state(gathered(self._declared, statement, self.shapes))
        else:
            statement = derived(statement)
            model._hold(statement, check(statement), Shapes(), None)
        return model

    @property
    def functions(self) -> dict[str, Callable[..., float]]:
        """The Python functions that are available, by name."""
        return {function.name: function.callable for function in self.python_functions if function.callable is not None}

    def require_functions(self) -> None:
        """Refuse to march without the Python functions that forces and events call.

        Raises
        ------
        ModelError
            Naming those that are not available.
        """
        missing = [function.name for function in self.python_functions if function.callable is None]
        if missing:
            raise ModelError(
                f"the model calls the Python functions {', '.join(missing)}; hand them over as functions={{name:"
                " function}"
            )

    @property
    def python_functions(self) -> list[Function]:
        """Everything written in Python: force components and event functions."""
        return list({function.name: function for function in self._written.functions}.values())

    @property
    def python_forces(self) -> list[Function]:
        """Every force component written in Python."""
        components = [component for force in self._written.forces.values() for component in force.components.values()]
        return list({component.name: component for component in components if isinstance(component, Function)}.values())

    @cached_property
    def read_at_start(self) -> frozenset[str]:
        """The parameters that expressions of values at the start read."""
        return frozenset() if self._declared is None else Elements(self.shaped, self.shapes).read_at_start()

    def started(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values at the start that follow arrays of parameters, in SI units, by name; see `march_many`."""
        if not self.read_at_start & parameters.keys():
            return {}
        known = {name: part.quantity.si for name, part in self.parameters.items()}
        return Elements(self.shaped, self.shapes).varied(parameters, known)

    @cached_property
    def digest(self) -> str:
        """sha256 of the model as TOML."""
        return hashlib.sha256(self.to_toml().encode()).hexdigest()

    @cached_property
    def form(self) -> str:
        """The model as TOML without the numbers of parameters, tables and the start: what programs are compiled from."""
        written = self._written
        parameters = {
            name: replace(entry, quantity=Quantity(0.0, entry.quantity.unit), spread=None)
            for name, entry in written.parameters.items()
        }
        initial = {name: Quantity(0.0, entry.unit) for name, entry in written.initial.items()}
        drives = {
            name: replace(drive, table=drive.table.form, description="") for name, drive in written.drives.items()
        }
        stripped = replace(
            written,
            name="",
            description="",
            parameters=parameters,
            drives=drives,
            arrays={name: values.form for name, values in written.arrays.items()},
            initial=initial,
            starting={},
            starts={},
            observed={name: Observable(tree) for name, tree in written.observables.items()},
            run={},
            validation={},
            correlations={},
            discrepancy={},
            pictured=Pictured(),
            fit=None,
            at_rest=(),
        )
        return toml.write(stripped)

    @cached_property
    def units(self) -> dict[str, Unit]:
        """The unit of every coordinate, velocity and first-order state: as declared; of a velocity, that per time."""
        written = self._written
        coordinate_units = {name: part.unit for name, part in written.coordinates.items()}
        velocity_units = {velocity(name): unit.per(self.time_unit) for name, unit in coordinate_units.items()}
        units = coordinate_units | velocity_units | {name: part.unit for name, part in written.states.items()}
        return (
            Elementwise(self.shapes, {name: always(unit) for name, unit in units.items()})
            if self.shapes.dims
            else units
        )

    @cached_property
    def force_components(self) -> dict[str, Mapping[str, Node | Function]]:
        """The components of every force term; those of a potential are derived: -dV/dq."""
        return {term: self._components(force) for term, force in self.forces.items()}

    @cached_property
    def uncertain(self) -> dict[str, Parameter]:
        """The inputs with an uncertainty: parameters, then values at the start."""
        return {
            name: parameter for name, parameter in (self.parameters | self.starts).items() if parameter.uncertainty > 0
        }

    @property
    def mass_is_full(self) -> bool:
        """Whether an entry off the diagonal is not a literal zero."""
        return self.statement.mass_is_full

    def expanded(self, node: Node) -> Node:
        """Return an expression with every definition substituted."""
        return expand(node, self.definitions)

    def reads(self, node: Node | Function) -> set[str]:
        """Return the names that an expression depends on, also through definitions and drives."""
        names = set(node.arguments) if isinstance(node, Function) else free_names(self.expanded(node))
        drive_arguments = {self.drives[name].argument for name in names if name in self.drives}
        in_definitions = {
            name for definition in names if definition in self.definitions for name in self.reads(Name(definition))
        }
        return names | drive_arguments | in_definitions

    def rate_of(self, node: Node) -> Node:
        """Return an expression's time derivative along the motion, with `a_q`, `rate_x` and `_slope_d` as names."""
        return derivative(self.expanded(node), self.rates)

    @cached_property
    def rates(self) -> dict[str, Node]:
        """The time derivative along the motion of every name that varies."""
        rates: dict[str, Node] = {"t": ONE}
        for name in self.coordinates:
            rates |= {name: Name(velocity(name)), velocity(name): Name(acceleration(name))}
        rates |= {name: Name(rate(name)) for name in self.states}
        for name, drive in self.drives.items():
            rates[name] = multiply(Name(f"_slope_{name}"), rates[drive.argument])
        return rates

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Model) and self.digest == other.digest)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        along = {name: f"({', '.join(dims)})" for name, dims in self.shapes.dims.items()}
        variables = ", ".join(name + along.get(name, "") for name in (*self.shaped.coordinates, *self.shaped.states))
        return f"<xdynamics.Model {self.name!r}: {variables}; forces {', '.join(self.shaped.forces) or 'none'}>"

    @classmethod
    def _parsed(cls, text: str, path: Path, functions: Functions | None, access: FileAccess) -> Model:
        if len(text) > LARGEST_FILE:
            raise ModelError(f"model file '{path}' has {len(text)} characters, over the limit of {LARGEST_FILE}")
        text = normal(text)
        try:
            statement = parsed(text)
        except InputError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error}") from None
        except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
            raise ModelError(f"model file '{path}' is no TOML: {error}") from None
        model = object.__new__(cls)
        model._fill(statement, path, functions or {}, access)
        return model

    def _fill(self, statement: Mapping[str, Any], path: Path, functions: Functions, access: FileAccess) -> None:
        self._state(read(statement, path, functions, access))

    def _state(self, whole: Statement) -> None:
        """Take a statement that was read, perhaps with dimensions."""
        if not (whole.extents or whole.starting):
            statement = derived(whole)
            self._hold(statement, check(statement), Shapes(), None)
            return
        ledger = Ledger(f"model '{whole.name}'", ModelError)
        shapes = declared_shapes(whole, ledger)
        ledger.raise_faults()
        units = check_written(whole)
        check_shapes(whole, shapes, ledger)
        ledger.raise_faults()
        statement, dimensions = derived(Elements(whole, shapes).whole()), dimensions_of(units, shapes)
        check_made(statement, dimensions, motion=whole.lagrangian is not None)
        self._hold(statement, dimensions, shapes, whole)

    def _hold(
        self, statement: Statement, dimensions: dict[str, Dimension], shapes: Shapes, declared: Statement | None
    ) -> None:
        self.statement, self.shapes, self._declared = statement, shapes, declared
        self.__dict__.update(vars(statement), dimensions=dimensions)

    def _components(self, force: Force) -> Mapping[str, Node | Function]:
        if force.components or force.potential is None:
            return force.components
        rates: dict[str, dict[str, Node]] = {name: {name: ONE} for name in self.coordinates}
        gradient = derivatives(self.expanded(force.potential), rates)
        return {name: negative(gradient[name]) for name in self.coordinates if name in gradient}
