"""The model: one statement, as a Python object and as a TOML file."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace as with_parts
from os import PathLike
from pathlib import Path
from typing import Any

from xdynamics.expressions import free_names
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model import toml
from xdynamics.model.body_consistency import check_bodies_made
from xdynamics.model.consistency import check_made, check_statement, check_written
from xdynamics.model.csv_sheet import normalise_newlines
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.element_numbers import (
    ElementNumbers,
    converted_like,
    explicit_values,
    follow_parameters,
    gather_elements,
    replaces_elements,
)
from xdynamics.model.elements import Elements, check_link_tables, check_shapes, declared_shapes, dimensions_of
from xdynamics.model.end_forces import check_end_forces
from xdynamics.model.file_access import ACCESSES, ANYWHERE, BELOW, EMBEDDED, FileAccess, parse_model_text
from xdynamics.model.kinds import Functions
from xdynamics.model.model_trees import BY_NAME, ModelTrees
from xdynamics.model.name_consistency import check_names_of_today
from xdynamics.model.parts import NOBODY, Authorship
from xdynamics.model.reading import derive_motion, read_statement
from xdynamics.model.replacement import changes_numbers_alone, replace_entries
from xdynamics.model.statement import Statement
from xdynamics.runtime.files import ask_path, check_no_address, decoded, read_bounded, reason
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Shapes, internal_text
from xdynamics.units import Dimension

_OF_TREES = (
    "form",
    "force_components",
    "looked_up_at",
    "rates",
    "units",
)  # what does not change with the numbers of a model
LARGEST_FILE = 20_000_000  # bytes
_IN_TABLES = "; keep its numbers in tables beside it; what to_toml wrote is read by Model.from_record"


def _named_inside(entries: Any) -> Any:
    """Return entries with elements as they are named inside."""
    return (
        {internal_text(str(name)): entry for name, entry in entries.items()}
        if isinstance(entries, Mapping)
        else entries
    )


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
        return toml.model_toml(self.shaped)

    @cached_property
    def shaped(self) -> Statement:
        """The statement with dimensions; without any it is `statement`, of which it has the numbers in any case."""
        return (
            self.statement if self._declared is None else gather_elements(self._declared, self.statement, self.shapes)
        )

    @cached_property
    def elements(self) -> Model:
        """The model of its elements, each a quantity of its own without dimensions, like ``r·Jupiter·x``."""
        if self._declared is None:
            return self
        model = Model.of_elements(self.statement, self.dimensions)
        # the text of all elements would be as long as they are many
        model.__dict__.update(digest=f"elements of {self.digest}", form=f"elements of {self.form}", file=self.file)
        return model

    def written_out(self) -> dict[str, Any]:
        """Return the sections of its file with a number for each element, be they given one by one or by an expression."""
        return toml.section_tables(explicit_values(self.shaped, self.shapes))

    @classmethod
    def of_elements(cls, statement: Statement, dimensions: dict[str, Dimension]) -> Model:
        """Return the model of a statement of single numbers that is known to be sound."""
        model = object.__new__(cls)
        model._hold_statement(statement, dimensions, Shapes(), None)
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
        model = object.__new__(Model)
        model.file = self.file
        sections = self._with_labels(sections)
        if (
            self._declared is not None
            and replaces_elements(sections)
            and (further_titles := sections.keys() - {"parameters", "initial"})
        ):
            numbers = {title: entries for title, entries in sections.items() if title not in further_titles}
            return self.replace(**numbers).replace(**{title: sections[title] for title in further_titles})
        if self._declared is None or replaces_elements(sections):
            internal_sections = {title: _named_inside(entries) for title, entries in sections.items()}
            return self.with_statement(replace_entries(self.statement, internal_sections, self.functions))
        model._take_statement(replace_entries(self.shaped, sections, self.functions))
        if "forces" in sections:
            check_end_forces(model.shaped, model.shapes)
        return model

    def _with_labels(self, sections: dict[str, Any]) -> dict[str, Any]:
        """Return sections with elements of quantities that are given by number named by their labels."""
        if self._declared is None:
            return sections
        element_sections = {title: entries for title, entries in sections.items() if title in ("parameters", "initial")}
        try:
            return sections | {
                title: self.shapes.with_internal_names(
                    {str(name): entry for name, entry in entries.items()}, f"[{title}] names"
                )
                for title, entries in element_sections.items()
                if isinstance(entries, Mapping)
            }
        except InputError as error:
            raise ModelError(f"model '{self.shaped.name}': {error}") from None

    def with_statement(self, statement: Statement) -> Model:
        """Return the model of another statement, checked unless numbers alone changed; a faulty one is a `ModelError`."""
        model = object.__new__(Model)
        model.file = self.file
        if self._declared is not None:
            statement = converted_like(statement, self.statement)
        if changes_numbers_alone(self.statement, statement):  # trees are those of this model
            if self._declared is not None:
                statement = follow_parameters(self._declared, statement, self.statement, self.shapes)
            model._hold_statement(statement, self.dimensions, self.shapes, self._declared)
            vars(statement).setdefault("calendar", self.statement.calendar)  # of its trees alone
            model.__dict__.update({name: value for name, value in vars(self).items() if name in _OF_TREES})
        elif self._declared is not None:
            model._take_statement(gather_elements(self._declared, statement, self.shapes))
        else:
            statement = derive_motion(statement)
            model._hold_statement(statement, check_statement(statement), Shapes(), None)
        return model

    @cached_property
    def read_at_start(self) -> frozenset[str]:
        """The parameters that expressions of values at the start read."""
        return frozenset() if self._declared is None else ElementNumbers(self.shaped, self.shapes).read_at_start()

    def slopes_at_start(self, parameters: Iterable[str]) -> dict[tuple[str, str], float]:
        """Return the derivatives of values at the start by parameters that they follow, by both names, in SI units."""
        if not self.read_at_start.intersection(parameters):
            return {}
        return ElementNumbers(self.shaped, self.shapes).start_slopes(self.statement.parameters, parameters)

    def started(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values at the start that follow arrays of parameters, in SI units, by name; see `march_many`."""
        if not self.read_at_start & parameters.keys():
            return {}
        si_values = {name: part.quantity.si for name, part in self.statement.parameters.items()}
        return ElementNumbers(self.shaped, self.shapes).varied_starts(parameters, si_values)

    @cached_property
    def read_by_points(self) -> frozenset[str]:
        """The parameters on which it depends when the points of tables are passed: of arguments that are linear in t."""
        timed = [self.expanded(part.argument) for name, part in self.drives.items() if self.looked_up_at[name] == CLOCK]
        return frozenset(name for tree in timed for name in free_names(tree) if name in self.statement.parameters)

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
            name + dims_text.get(name, "") for name in (*self.shaped.coordinates, *self.shaped.states)
        )
        return f"<xdynamics.Model {self.name!r}: {variables}; forces {', '.join(self.shaped.forces) or 'none'}>"

    @classmethod
    def _from_parsed_text(
        cls, text: str, path: Path, functions: Functions | None, access: FileAccess, *, recorded: bool = False
    ) -> Model:
        try:
            statement = parse_model_text(normalise_newlines(text), recorded=recorded)
        except InputError as error:
            raise ModelError(f"model file '{path}' cannot be read: {error}") from None
        except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
            raise ModelError(f"model file '{path}' is no TOML: {error}") from None
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
            check_names_of_today(self.shaped)
        if self._declared is not None and not recorded:
            check_end_forces(self._declared, self.shapes)

    def _take_statement(self, declared_statement: Statement) -> None:
        """Check a statement, perhaps with dimensions, and make it the model's own."""
        if not (declared_statement.extents or declared_statement.starting):
            statement = derive_motion(declared_statement)
            self._hold_statement(statement, check_statement(statement), Shapes(), None)
            return
        ledger = Ledger(f"model '{declared_statement.name}'", ModelError)
        check_link_tables(declared_statement, ledger)
        shapes = declared_shapes(declared_statement, ledger)
        ledger.raise_faults()
        units = check_written(declared_statement)
        check_shapes(declared_statement, shapes, ledger)
        ledger.raise_faults()
        statement, dimensions = (
            derive_motion(Elements(declared_statement, shapes).element_statement()),
            dimensions_of(units, shapes),
        )
        check_made(statement, dimensions, motion=declared_statement.lagrangian is not None)
        check_bodies_made(statement, shapes, ledger)
        ledger.raise_faults()
        self._hold_statement(statement, dimensions, shapes, declared_statement)

    def _hold_statement(
        self, statement: Statement, dimensions: dict[str, Dimension], shapes: Shapes, declared: Statement | None
    ) -> None:
        self.statement, self.shapes, self._declared = statement, shapes, declared
        parts = {name: part for name, part in vars(statement).items() if name not in BY_NAME}
        self.__dict__.update(parts, dimensions=dimensions)


def check_model(model: Any) -> None:
    """Refuse an argument that is no Model, such as the name of a file.

    Raises
    ------
    InputError
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
