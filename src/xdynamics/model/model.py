"""The model: one statement, as a Python object and as a TOML file."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace as with_parts
from os import PathLike
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, free_names
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model import toml
from xdynamics.model.body_consistency import check_bodies_made
from xdynamics.model.consistency import check_made, check_statement, check_written
from xdynamics.model.controllers import with_pending
from xdynamics.model.csv_sheet import normalise_newlines
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.element_numbers import (
    ElementNumbers,
    explicit_values,
    with_element_starts,
    with_parameters,
)
from xdynamics.model.elements import (
    Elements,
    check_link_tables,
    check_shapes,
    declared_shapes,
    dimensions_of,
    with_element_numbers,
)
from xdynamics.model.elementwise import Elementwise, always
from xdynamics.model.end_forces import check_end_forces
from xdynamics.model.file_access import ACCESSES, ANYWHERE, BELOW, EMBEDDED, FileAccess, parse_model_text
from xdynamics.model.kinds import Functions
from xdynamics.model.model_trees import BY_NAME, ModelTrees
from xdynamics.model.name_consistency import check_names_of_today
from xdynamics.model.parts import NOBODY, Authorship, Function, Parameter
from xdynamics.model.reading import derive_motion, read_statement
from xdynamics.model.replacement import changes_numbers_alone, read_parts, replace_entries
from xdynamics.model.statement import Statement
from xdynamics.runtime.files import ask_path, check_no_address, decoded, read_bounded, reason
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Shapes, internal_text
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import Dimension

_OF_TREES = (
    "form",
    "force_components",
    "looked_up_at",
    "rates",
    "units",
)  # what does not change with the numbers of a model
LARGEST_FILE = 20_000_000  # bytes
_OF_ELEMENTS = ("parameters", "initial")  # sections with entries of single elements
_IN_TABLES = "; keep its numbers in tables beside it; what to_toml wrote is read by Model.from_record"


class Model(ModelTrees):
    """A mechanical initial-value problem with units: M(q, t) a = sum of forces, and first-order states.

    Parameters
    ----------
    **statement
        The sections of a model file by name (`name`, `description`, `bodies`, `joints`, `coordinates`, `parameters`, `mass`,
        `definitions`, `forces`, `drives`, `states`, `lagrangian`, `initial`, `events`, `contacts`, `frictions`, `regimes`,
        `observables`, `validation`, `correlations`, `discrepancy`, `run`), each a mapping with the keys of the file. A
        force component may also be a numba-compilable Python function whose arguments are declared names; it takes and
        returns SI floats; values of elements may be arrays of numpy, or DataArrays with the attribute `units`.

    Attributes
    ----------
    statement : Statement
        The sections as they were written. A quantity along dimensions stands there once, with its expressions.
    elements : Model
        The same model of single numbers: each element is a quantity of its own, like ``r·Jupiter·x``, with the trees
        that follow from the expressions of its quantity. Without dimensions it is the model itself.
    shapes : Shapes
        What has which dimensions.
    dimensions : dict of str to Dimension
        The physical dimension of every name that expressions may use; in `elements` those of the elements.

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
    >>> model.initial
    <initial: t = 0.0 s, x = 1.0 m, v_x = 0.0 m s-1>
    """

    file: Path | None = None  # that it was read from
    _element_trees: Mapping[str, Any] = {}  # of the model of its elements, where they are known already

    def __init__(self, **statement: Any) -> None:
        self._fill_from_sections(statement, Path(), {}, FileAccess(Path(), ANYWHERE))

    @classmethod
    def from_toml(
        cls, path: str | Path, *, functions: Mapping[str, Callable[..., float]] | None = None, tables: str = BELOW
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
        if not isinstance(path, str | PathLike):
            raise ModelError(
                f"the model cannot be read: {type(path).__name__} is no name of a file; give a text or a Path"
            )
        try:
            check_no_address(path)
        except InputError as error:
            raise ModelError(f"the model cannot be read: {error}") from None
        if "\n" in str(path):
            raise ModelError(
                "the model cannot be read: this is the text of a model, no name of a file; Model.from_text reads it"
            )
        path = Path(path)
        if tables not in ACCESSES:
            raise InputError(f"tables is {tables!r}; there are {', '.join(ACCESSES)}")
        if ask_path(path, Path.is_dir):
            raise ModelError(f"model file '{path}' is a directory; name the .toml file in it")
        try:
            text = decoded(read_bounded(path, LARGEST_FILE, _IN_TABLES))
        except OSError as error:
            raise ModelError(f"model file '{path}' cannot be read: {reason(error, path)}") from None
        except InputError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error}") from None
        except ValueError:
            raise ModelError(
                f"model file '{path}' cannot be read: it is no text in UTF-8; archives are shown by `xdynamics show`"
            ) from None
        model = cls._from_parsed_text(text, path, functions, FileAccess(path.parent, tables))
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
        return cls._from_parsed_text(text, Path("model.toml"), functions, FileAccess(Path(), EMBEDDED))

    @classmethod
    def from_record(
        cls, text: Any, *, functions: Mapping[str, Callable[..., float]] | None = None, about: Authorship = NOBODY
    ) -> Model:
        """Read a model from a run, or its `model_toml`, or `to_toml`, which may be as long as tables of 10^6 rows are.

        Parameters
        ----------
        text : str, or xarray.Dataset
            Of a Dataset the model has the settings that the run was marched with as its `[run]`.
        functions : mapping of str to callable, optional
            The Python functions that its forces call.
        about : Authorship, optional
            Who stands for it, which is no part of the text.

        Raises
        ------
        ModelError
            If the text cannot be read, or with every fault of its statement.
        """
        if not isinstance(text, str):
            if not hasattr(text, "dynamics"):
                raise ModelError(
                    f"a record is {str(text)[:40]!r}, needs a run, as open_run returns one, or its model_toml"
                )
            of_run: Model = text.dynamics.model(functions)  # of the floor above, which knows records
            return of_run
        model = cls._from_parsed_text(text, Path("model.toml"), functions, FileAccess(Path(), EMBEDDED), recorded=True)
        return model if about == model.about else model.with_statement(with_parts(model.statement, about=about))

    @classmethod
    def from_sympy(cls, equations: Any, **sections: Any) -> Model:
        """Make a model from equations of motion derived by sympy.

        Parameters
        ----------
        equations : LagrangesMethod or KanesMethod; or sympy expressions
            Of `sympy.physics.mechanics`, its equations formed; generalised speeds are derivatives of coordinates. Or the
            potential energy, beside ``mass=…``; or the kinetic and the potential energy. In these, what is indexed has
            dimensions: ``Sum(k*(u[i + 1] - u[i])**2/2, (i, 0, 8))`` with ``dimensions={"site": 10}`` and
            ``coordinates={"u": {"unit": "m", "dims": ["site"]}}``; the velocity of `u` is `v_u`. A sum over
            two indices, ``(j, i + 1, 9), (i, 0, 8)`` or both from 0 to 9, is one over pairs, ``u[Mod(i + 1, 10)]`` a ring,
            and a MatrixSymbol has the dimensions of its rows and columns, a column those of its rows.
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
        from xdynamics.model.symbolic import are_energies, sections_of, sections_of_energies

        read = sections_of_energies if are_energies(equations) else sections_of
        return cls(**read(equations, sections))

    def to_toml(self) -> str:
        """Return the complete model as TOML, measured tables included."""
        return self._toml

    @cached_property
    def _toml(self) -> str:
        return toml.model_toml(self.statement)

    @cached_property
    def elements(self) -> Model:
        """The model of its elements, each a quantity of its own without dimensions, like ``r·Jupiter·x``."""
        if self._element_statement is self.statement:
            return self
        # asked of the elements they would make the trees of all
        same_parts = {name: getattr(self.statement, name) for name in ("calendar", "functions")}
        vars(self._element_statement).update(same_parts if self.statement.delayed else same_parts | {"delayed": ()})
        model = Model.of_numbers(self._element_statement, self._element_dimensions)
        # the text of all elements would be as long as they are many
        model.__dict__.update(digest=f"elements of {self.digest}", form=f"elements of {self.form}", file=self.file)
        units = Elementwise(self.shapes, {name: always(unit) for name, unit in self.units.items()})
        model.__dict__.update({"units": units, **self._element_trees})
        return model

    def written_out(self) -> dict[str, Any]:
        """Return the sections of its file with a number for each element, be they given one by one or by an expression."""
        return toml.section_tables(explicit_values(self.statement, self.shapes))

    @classmethod
    def of_numbers(cls, statement: Statement, dimensions: dict[str, Dimension]) -> Model:
        """Return the model of a statement of single numbers that is known to be sound."""
        model = object.__new__(cls)
        model._hold_statement(statement, dimensions, Shapes(), statement, dimensions)
        return model

    def replace(self, **sections: Mapping[str, Any] | str) -> Model:
        """Return a model with some entries of some sections replaced, added, or taken away.

        A bare number takes the unit of the entry: ``model.replace(parameters={"c": 2e-3})``. A value without an uncertainty
        keeps that of the entry; ``"35 ± 2 m s-1"`` has another, ``"35 ± 0 m s-1"`` none. An entry that is None goes:
        ``model.replace(events={"apex": None})``. New ones may be forces, events, contacts and so on, not parameters or
        values at the start, of which an unknown name is a misspelt one. ``run={"step": "1 ms"}`` takes the place of
        tolerances in `[run]`; ``name="another"`` and `description` are texts.

        Raises
        ------
        ModelError
            If there is no such section or entry, or the new model is faulty.
        """
        sections = self._with_internal_names(sections)
        elements = {
            title: self._element_entries(entries) for title, entries in sections.items() if title in _OF_ELEMENTS
        }
        quantities = {
            title: {name: entry for name, entry in entries.items() if name not in elements.get(title, {})}
            if isinstance(entries, Mapping)
            else entries
            for title, entries in sections.items()
        }
        model: Model = self
        if any(quantities.values()) or not any(elements.values()):
            model = self.with_statement(replace_entries(self.statement, quantities, self.functions))
            if "forces" in sections and self.shapes.dims:
                check_end_forces(model.statement, model.shapes)
        if any(elements.values()):
            parts = read_parts(model.elements.statement, elements, model.functions)
            return model.with_statement(model.renumbered(parts["parameters"], parts["initial"]))
        return model

    def _with_internal_names(self, sections: dict[str, Any]) -> dict[str, Any]:
        """Return sections whose entries have the names that they have inside, elements those by their labels."""
        internal_sections = dict(sections)
        try:
            for title, entries in sections.items():
                if isinstance(entries, Mapping):
                    texts = {str(name): entry for name, entry in entries.items()}
                    internal_sections[title] = (
                        self.shapes.with_internal_names(texts, f"[{title}] names")
                        if title in _OF_ELEMENTS
                        else {internal_text(name): entry for name, entry in texts.items()}
                    )
        except InputError as error:
            raise ModelError(f"model '{self.name}': {error}") from None
        return internal_sections

    def _element_entries(self, entries: Any) -> dict[str, Any]:
        """Return the entries of single elements of quantities with dimensions."""
        return (
            {name: entry for name, entry in entries.items() if split_element_name(name)[0] != name}
            if isinstance(entries, Mapping) and self.shapes.dims
            else {}
        )

    def renumbered(self, parameters: Mapping[str, Parameter], starts: Mapping[str, Parameter]) -> Statement:
        """Return the statement with other parameters and values at the start, by the names of elements."""
        statement, elements = self.statement, self._element_statement
        statement = with_parameters(statement, elements, self.shapes, parameters)
        if not starts:
            return statement
        if elements is not self.statement:  # where expressions at the start follow the new parameters
            elements = with_element_numbers(elements, statement, self.shapes)
        return with_element_starts(statement, elements, self.shapes, starts)

    def with_statement(self, statement: Statement) -> Model:
        """Return the model of another statement, checked unless numbers alone changed; a faulty one is a `ModelError`."""
        model = object.__new__(Model)
        model.file = self.file
        if not changes_numbers_alone(self.statement, statement):
            model._take_statement(statement)
            return model
        # trees are those of this model
        element_statement = statement
        if self._element_statement is not self.statement:
            element_statement = with_element_numbers(self._element_statement, statement, self.shapes)
        vars(statement).setdefault("calendar", self.statement.calendar)
        model._hold_statement(statement, self.dimensions, self.shapes, element_statement, self._element_dimensions)
        model.__dict__.update({name: value for name, value in vars(self).items() if name in _OF_TREES})
        if "elements" in vars(self):
            trees = {name: value for name, value in vars(self.elements).items() if name in _OF_TREES}
            model._element_trees = trees
        return model

    @cached_property
    def force_components(self) -> Mapping[str, Mapping[str, Node | Function]]:
        """The components of every force term; those of a potential are derived: -dV/dq."""
        if not self.shapes.dims:
            return super().force_components
        elements = Elements(self.statement, self.shapes)
        return {term: elements.force_by_coordinate(force) for term, force in self.forces.items()}

    @cached_property
    def read_at_start(self) -> frozenset[str]:
        """The parameters that expressions of values at the start read."""
        return ElementNumbers(self.statement, self.shapes).read_at_start()

    def slopes_at_start(self, parameters: Iterable[str]) -> dict[tuple[str, str], float]:
        """Return the derivatives of values at the start by parameters that they follow, by both names, in SI units."""
        if not self.read_at_start.intersection(parameters):
            return {}
        numbers = ElementNumbers(self.statement, self.shapes)
        return numbers.start_slopes(self._element_statement.parameters, parameters)

    def started(self, parameters: Mapping[str, Any], initial: Mapping[str, Any]) -> dict[str, Any]:
        """Return arrays of values at the start, with those that follow them and arrays of parameters; see `march_many`.

        All are in SI units, by the names of elements.
        """
        starts: dict[str, Any] = {}
        if self.read_at_start & parameters.keys():
            si_values = {name: part.quantity.si for name, part in self._element_statement.parameters.items()}
            starts = ElementNumbers(self.statement, self.shapes).varied_starts(parameters, si_values)
        return with_pending(starts | dict(initial), self.statement.controllers)

    @cached_property
    def read_by_points(self) -> frozenset[str]:
        """The parameters on which it depends when the points of tables are passed: of arguments that are linear in t."""
        model = self.elements
        drives = ((name, part) for name, part in model.drives.items() if model.looked_up_at[name] == CLOCK)
        timed = [model.expanded(part.argument) for name, part in drives]
        return frozenset(name for tree in timed for name in free_names(tree) if name in model.statement.parameters)

    @cached_property
    def digest(self) -> str:
        """sha256 of the model as TOML."""
        return hashlib.sha256(self.to_toml().encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Model) and self.digest == other.digest)

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        dims_text = {name: f"({', '.join(dims)})" for name, dims in self.shapes.dims.items()}
        variables = ", ".join(
            name + dims_text.get(name, "") for name in (*self.statement.coordinates, *self.statement.states)
        )
        return f"<xdynamics.Model {self.name!r}: {variables}; forces {', '.join(self.statement.forces) or 'none'}>"

    @classmethod
    def _from_parsed_text(
        cls, text: str, path: Path, functions: Functions | None, access: FileAccess, *, recorded: bool = False
    ) -> Model:
        try:
            statement = parse_model_text(normalise_newlines(text), recorded=recorded)
        except InputError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error}") from None
        except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
            twice = (
                "; a key or a section stands there twice" if "overwrite" in str(error) or "twice" in str(error) else ""
            )
            raise ModelError(f"model file '{path}' is no TOML: {error}{twice}") from None
        model = object.__new__(cls)
        model._fill_from_sections(statement, path, functions or {}, access, recorded=recorded)
        return model

    def _fill_from_sections(
        self,
        statement: Mapping[str, Any],
        path: Path,
        functions: Functions,
        access: FileAccess,
        *,
        recorded: bool = False,
    ) -> None:
        self._take_statement(read_statement(statement, path, functions, access))
        if not recorded:
            check_names_of_today(self.statement)
            check_end_forces(self.statement, self.shapes)

    def _take_statement(self, statement: Statement) -> None:
        """Check a statement, perhaps with dimensions, and make it the model's own."""
        if not statement.extents:
            statement = derive_motion(statement)
        if not (statement.extents or statement.starting):
            dimensions = check_statement(statement)
            self._hold_statement(statement, dimensions, Shapes(), statement, dimensions)
            return
        ledger = Ledger(f"model '{statement.name}'", ModelError)
        check_link_tables(statement, ledger)
        shapes = declared_shapes(statement, ledger)
        ledger.raise_faults()
        dimensions = check_written(statement)
        check_shapes(statement, shapes, ledger)
        ledger.raise_faults()
        elements = Elements(statement, shapes).element_statement()
        derived = bool(statement.extents) and statement.lagrangian is not None
        elements = derive_motion(elements) if derived else elements
        element_dimensions = dimensions_of(dimensions, shapes)
        check_made(elements, element_dimensions, motion=derived)
        check_bodies_made(elements, shapes, ledger)
        ledger.raise_faults()
        self._hold_statement(statement, dimensions, shapes, elements, element_dimensions)

    def _hold_statement(
        self,
        statement: Statement,
        dimensions: dict[str, Dimension],
        shapes: Shapes,
        element_statement: Statement,
        element_dimensions: dict[str, Dimension],
    ) -> None:
        self.statement, self.shapes = statement, shapes
        self._element_statement, self._element_dimensions = element_statement, element_dimensions
        parts = {name: part for name, part in vars(statement).items() if name not in BY_NAME}
        self.__dict__.update(parts, dimensions=dimensions, assemblies=element_statement.assemblies)


def check_model(model: Any) -> None:
    """Refuse an argument that is no Model, such as the name of a file.

    Raises
    ------
    InputError
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
