"""Records as tables with units in their headers: a row a step, event, level, case, term, member or parameter."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.archive import without_stale_units
from xdynamics.archive.folder_store import is_folder, taking_name
from xdynamics.archive.store import Place
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL
from xdynamics.evidence.grid_axes import AXES, is_sweep, sweep_axis_names, sweep_of
from xdynamics.evidence.refining.readings import DEFECT
from xdynamics.evidence.sampling import sample
from xdynamics.faults import ArchiveError, InputError
from xdynamics.interchange.tree import NODES, tree_nodes
from xdynamics.record import of_elements
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.folding import is_repeated_label, model_dimensions
from xdynamics.record.unfolding import unfold
from xdynamics.runtime.files import file_above
from xdynamics.schema import error
from xdynamics.shapes.naming import display_text
from xdynamics.units.digits import digits, scientific

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MEMBERS, PARAMETERS = "members", "parameters"
ROWS = {
    "steps": schema.STEPS,
    "trials": schema.TRIALS,
    "events": schema.EVENTS,
    "samples": schema.SAMPLES,
    "closed": schema.CLOSED_LINKS,
    "cases": schema.CASE,
    "terms": "term",
    "levels": schema.LEVEL,
    "runs": "run",
    "times": schema.AT,
}
OF_LEVEL = ("", "difference_", "order_", "verdict_")  # of each observable, in this order
FIRST = (
    "event_detector",
    "event_kind",
    "event_direction",
    "event_time",
    *(f"{schema.EVENT_BOUNDS}_{end}" for end in ("lower", "upper")),
    "event_time_uncertainty",
    "event_residual",
)
AHEAD = {"axis": 0, "time": 1}  # roles of what a row begins with
HIDDEN = ("run_digest", "run_seal", "case_run", "model_digest", "content_digest")  # digests, on a terminal
MOST_COLUMNS = 16_384  # of a sheet of a workbook
MOST_SHOWN = 24  # rows on a terminal
TIME, VALUE, DOUBT, ORDER = ".15g", ".10g", ".3g", ".2f"  # forms of numbers there: times as they are
BRIEFLY = ("difference_", "uncertainty_", "interpolation_error_", "scaled_", DEFECT), ("_uncertainty", "_doubt")
BRIEF = ("residual", "bound", "event_residual", "uncertainty")
MOST_OBSERVED = 12  # observables on a board
WIDEST = 44  # letters of a cell there
ENDINGS = (".csv", ".xlsx", ".parquet", ".md", ".tex")
PACKAGES = {".xlsx": "openpyxl", ".parquet": "pyarrow"}


@dataclass(frozen=True)
class TableColumn:
    """One column of a table.

    Attributes
    ----------
    name : str
    values : ndarray
        Numbers, or texts.
    units : str
        Empty of texts, flags and counts.
    variable : str
        Of which it is.
    """

    name: str
    values: NDArray[Any]
    units: str
    variable: str


def kinds_of(data: xr.Dataset) -> list[str]:
    """Return the kinds of tables of a Dataset, the most wanted first."""
    if data.attrs.get(schema.EVIDENCE) == schema.SWEEP:
        return [MEMBERS, PARAMETERS]
    if AXES in data.attrs:  # of two sweeps
        return [MEMBERS]
    record_dims = {*model_dimensions(data), schema.BOUNDS, schema.DOCUMENT, "memory"}
    kinds = [kind for kind, dim in ROWS.items() if dim in data.dims]
    kinds += [dim for dim in map(str, data.dims) if dim not in ROWS.values() and dim not in record_dims]
    return [*kinds, *([PARAMETERS] if any(_is_parameter(variable) for variable in data.variables.values()) else [])]


def table(data: xr.Dataset, of: str | None = None, *, rounded: bool = False) -> pd.DataFrame:
    """Return a table of a run or of evidence.

    Parameters
    ----------
    data : xarray.Dataset
        Anything that this package makes.
    of : str, optional
        What a row is of: ``steps``, ``trials``, ``events``, ``samples``, ``closed`` links, ``levels`` of a refinement,
        ``cases`` of a ledger, ``terms`` of a budget, ``times``, ``members`` of a sweep, ``parameters``, or another
        dimension by its name; by default the first of these that there are.
    rounded : bool
        Whether to round each number to the digits that the uncertainty beside it supports.

    Returns
    -------
    pandas.DataFrame
        Headers like ``y [m]``; their units are in ``attrs["units"]`` too. Flags as their words. Of events: detector, kind,
        direction, time, bracket, uncertainty, residual, then each quantity before and after. Of levels: of each observable
        its value, the difference to the next finer level, the observed order and the verdict.

    Raises
    ------
    InputError
        If there is no such table.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/bouncing_ball.toml")
    >>> run = xd.simulate(model, until=1.0)
    >>> table(run, "events").columns[[3, 8, 9]].tolist()
    ['event_time [s]', 'before_y [m]', 'after_y [m]']
    """
    import pandas as pd

    kinds = kinds_of(data)
    if not kinds:
        raise InputError("this has no table: it has neither rows nor parameters")
    kind = _table_kind(kinds[0] if of is None else of, kinds)
    columns = [*_table_columns(data, kind)]
    if rounded:
        columns = _rounded_columns(columns, data)
    columns_by_header = {_header(column): column for column in columns}
    made = pd.DataFrame({name: column.values for name, column in columns_by_header.items()})
    made.attrs["units"] = {name: column.units or "1" for name, column in columns_by_header.items()}
    return made


def frame(data: xr.Dataset, dim: str) -> pd.DataFrame:
    """Return everything along one dimension, with columns named as the variables; see `Dynamics.frame`.

    Raises
    ------
    InputError
        If the record has no such dimension.
    """
    import pandas as pd

    dimensions = [
        str(dimension) for dimension in data.dims if str(dimension) not in (schema.BOUNDS, *model_dimensions(data))
    ]
    if dim not in dimensions:
        raise InputError(f"the record has no dimension {dim!r}; there are {', '.join(dimensions)}")
    columns = [*_columns_along(_plain_dataset(data), (dim,))]
    ahead = ("time", schema.AT_TIME, f"{dim}_time")
    columns.sort(key=lambda column: ahead.index(column.name) if column.name in ahead else len(ahead))
    made = pd.DataFrame({column.name: column.values for column in columns})
    made.index.name = dim
    made.attrs["units"] = {column.name: column.units or "1" for column in columns}
    return made


def _table_kind(kind_word: str, kinds: Sequence[str]) -> str:
    """Return the table that a word names, in singular or plural: ``event`` and ``events``."""
    by_word = {word: kind for kind in kinds for word in (kind, ROWS.get(kind, kind), kind[:-1])}
    if kind_word not in by_word:
        raise InputError(f"there is no table of {kind_word!r} here; there are {', '.join(kinds)}")
    return by_word[kind_word]


def _is_parameter(variable: xr.Variable) -> bool:
    return bool(variable.attrs.get("role") == "parameter")


def _plain_dataset(data: xr.Dataset) -> xr.Dataset:
    """Return a record with a variable an element, and no unit that does not hold."""
    data = sweep_of(data) if is_sweep(data) else data
    if schema.EVIDENCE in data.attrs:
        data = data.compute()  # at once: of what is lazy each variable would march anew
    data = without_stale_units(data)
    return unfold(data) if model_dimensions(data) else data


def _table_columns(data: xr.Dataset, kind: str) -> Iterator[TableColumn]:
    if kind == PARAMETERS:
        return _parameter_columns(_plain_dataset(data))
    plain = _plain_dataset(data)
    if kind == MEMBERS:
        return _columns_along(plain, tuple(dim for dim in sweep_axis_names(plain) if dim in plain.dims))
    dim = ROWS.get(kind, kind)
    if dim == schema.EVENTS and schema.EVIDENCE not in data.attrs:
        columns = {column.name: column for column in _columns_along(tree_nodes(plain)["events"].to_dataset(), (dim,))}
        sides = [(f"before_{name}", f"after_{name}") for name in map(str, plain.variables)]
        ordered = [*FIRST, *(name for pair in sides for name in pair)]
        return (columns[name] for name in dict.fromkeys([*ordered, *columns]) if name in columns)
    if dim in NODES and schema.EVIDENCE not in data.attrs:
        plain = tree_nodes(plain)[NODES[dim]].to_dataset()
    if dim == schema.LEVEL and data.attrs.get(schema.EVIDENCE) == "refinement":
        return _level_columns(plain)
    if data.attrs.get(schema.EVIDENCE) == OF_SEVERAL:  # a row a run tells no times
        run_names = [str(name) for name, variable in plain.variables.items() if variable.dims == (dim,)]
        return _columns_along(
            plain, (dim,), sorted(run_names, key=lambda name: _column_rank(name, plain.variables[name]))
        )
    return _columns_along(plain, (dim,))


def _column_rank(name: str, variable: xr.Variable) -> int:
    """Return the rank of a column in its table: axis values, times, names and kinds, numbers, sentences."""
    role = str(variable.attrs.get("role"))
    if role in AHEAD:
        return AHEAD[role]
    if name.endswith(("_name", "term_kind")):
        return len(AHEAD) + (0 if name.endswith("_name") else 1)
    return len(AHEAD) + (3 if name.endswith(("_rule", "_text")) else 2)


def _level_columns(study: xr.Dataset) -> Iterator[TableColumn]:
    """Yield the columns of a convergence record: the varied quantity, then the numbers of each observable."""
    numbers = [name for name in map(str, study.variables) if f"difference_{name}" in study]
    number_names = [f"{prefix}{name}" for name in numbers for prefix in OF_LEVEL]
    further_names = [name for name in map(str, study.variables) if name.startswith(("event_count_", DEFECT))]
    names = [str(study.attrs["varied"]), *number_names, *further_names, "run_outcome"]
    return _columns_along(study, (schema.LEVEL,), [name for name in names if name in study])


def _columns_along(
    data: xr.Dataset, rows: tuple[str, ...], names: Sequence[str] | None = None
) -> Iterator[TableColumn]:
    """Yield a column for each number that a row has; without `names` of all variables that lie along the rows."""
    if names is None:
        names_along = [str(name) for name, variable in data.variables.items() if {*rows} & {*variable.dims}]
        column_names = [name for name in names_along if not is_repeated_label(name, data)]
        if not rows:  # one member of a sweep
            column_names = [
                str(name)
                for name, candidate in data.variables.items()
                if not (_is_parameter(candidate) or name in schema.TEXT_NAMES)
            ]
        names = sorted(column_names, key=lambda name: _column_rank(name, data.variables[name]))
    shape = tuple(data.sizes[dim] for dim in rows)
    for name in names:
        variable = data.variables[name]
        further_dims = [str(dim) for dim in variable.dims if dim not in rows]
        ordered_variable = variable.transpose(*(dim for dim in rows if dim in variable.dims), *further_dims)
        values = _cell_values(ordered_variable)
        row_shape = tuple(data.sizes[dim] if dim in variable.dims else 1 for dim in rows)
        beyond = values.shape[values.ndim - len(further_dims) :]
        spread = np.broadcast_to(values.reshape((*row_shape, *beyond)), (*shape, *beyond))
        flat = spread.reshape(int(np.prod(shape)), int(np.prod(beyond)))
        for number, index in enumerate(product(*(range(data.sizes[dim]) for dim in further_dims))):
            where = "".join(_index_words(data, dim, k) for dim, k in zip(further_dims, index, strict=True))
            units = str((data["event_time"] if name == schema.EVENT_BOUNDS else variable).attrs.get("units", ""))
            yield TableColumn(
                f"{display_text(name)}{where}", flat[:, number], _shown_units(units, values, variable), name
            )


def _cell_values(variable: xr.Variable) -> NDArray[Any]:
    if "flag_meanings" in variable.attrs:
        return np.array(words_of_flag(variable), object).reshape(variable.shape)
    return np.asarray(variable.values)


def _shown_units(units: str, values: NDArray[Any], variable: xr.Variable) -> str:
    """Return the unit of a column; that of counts, orders and texts is not said."""
    pure = units == "1" and variable.attrs.get("role") not in (*schema.KINEMATIC, "observable", "parameter", "time")
    return units if values.dtype.kind == "f" and not pure else ""


def _index_words(data: xr.Dataset, dim: str, k: int) -> str:
    """Return which of several numbers along a further dimension a column has, in words."""
    if dim == schema.AT:
        unit = str(data.variables[schema.AT_TIME].attrs.get("units", "1"))
        time_words = f" at t = {float(np.atleast_1d(data.variables[schema.AT_TIME].values)[k])!r}{'' if unit == '1' else f' {unit}'}"
        return time_words if data.sizes[schema.AT] > 1 else ""
    if dim == schema.BOUNDS:
        return ("_lower", "_upper")[k]
    if dim == schema.OCCURRENCE:
        return f"[{k + 1}]"
    labels = data.variables.get(dim, data.variables.get(f"{dim}_name"))
    return f"[{k if labels is None else labels.values[k]}]"


def _parameter_columns(data: xr.Dataset) -> Iterator[TableColumn]:
    """Yield the columns of a table of parameters."""
    parameters = [
        (str(name), variable)
        for name, variable in data.variables.items()
        if _is_parameter(variable) and not variable.ndim
    ]
    about_each: dict[str, Callable[[str, xr.Variable], Any]] = {
        "parameter": lambda name, _: display_text(name),
        "value": lambda _, variable: float(variable.values),
        "units": lambda _, variable: str(variable.attrs.get("units", "1")),
        "uncertainty": lambda _, variable: float(variable.attrs.get("uncertainty", np.nan)),
        "uncertainty_kind": lambda _, variable: str(variable.attrs.get("uncertainty_kind", "")),
        "description": lambda _, variable: str(variable.attrs.get("long_name", "")),
    }
    for word, take in about_each.items():
        values = [take(name, variable) for name, variable in parameters]
        # entry == entry: not a nan, which stands for an uncertainty that is not given
        if word in ("parameter", "value", "units", "description") or any(entry == entry and entry for entry in values):
            yield TableColumn(word, np.array(values, float if word in ("value", "uncertainty") else object), "", word)


def _rounded_columns(columns: Sequence[TableColumn], data: xr.Dataset) -> list[TableColumn]:
    """Round numbers to the digits that the uncertainty beside them, in the table or of the finest level, supports."""
    values_by_name = {column.name: column.values for column in columns}
    made = []
    for column in columns:
        doubt = _column_doubt(column, values_by_name, data)
        if doubt is None or column.values.dtype.kind != "f":
            made.append(column)
            continue
        pairs = zip(column.values.tolist(), np.asarray(doubt, float).tolist(), strict=True)
        made.append(replace(column, values=np.array([_to_digits(*pair) for pair in pairs])))
    return made


def _column_doubt(
    column: TableColumn, values_by_name: Mapping[str, NDArray[Any]], data: xr.Dataset
) -> NDArray[Any] | None:
    """Return the uncertainty of every number of a column; None if nothing tells it."""
    words = [f"uncertainty_{column.name}", f"{column.name}_uncertainty"]
    for word in (*words, *(["uncertainty"] if column.name == "value" else [])):
        if word in values_by_name:
            return values_by_name[word]
    if (uncertainty := data.variables.get(f"uncertainty_{column.variable}")) is None:
        return None
    return np.full(len(column.values), np.abs(np.asarray(uncertainty.values, float)).max(initial=0.0))


def _to_digits(value: float, doubt: float) -> float:
    is_known = isfinite(value) and isfinite(doubt) and doubt > 0.0
    return float(scientific(value, digits(value, uncertainty=doubt) - 1)) if is_known else value


def table_lines(made: pd.DataFrame, width: int) -> Iterator[str]:
    """Yield a table as lines for people: columns that do not fit stand below, each part with the first column again.

    Times have all their digits, other numbers ten at most, differences and uncertainties three; of a long table the
    first rows and the last are shown.
    """
    names = [str(name) for name in made.columns if name not in HIDDEN]
    return _laid_out([[(name, _number_form(name), made[name].to_numpy())] for name in names], width)


def _number_form(header: str) -> str:
    """Return the form of the numbers below a header; whatever a model may call its own keeps its digits."""
    name = header.partition(" ")[0]
    if name in BRIEF or name.startswith(BRIEFLY[0]) or name.endswith(BRIEFLY[1]):
        return DOUBT
    return TIME if name.startswith("event_time") or f"_{name}".endswith("_time") else VALUE


def board_of(data: xr.Dataset, width: int) -> list[str]:
    """Return the table that one would write on the board, of a refinement, a ledger or modes; of other records no line.

    Of a refinement a row a level: the step, and of each observable its value, the difference to the next finer level and
    the observed order. Of a ledger a row a case.
    """
    kind = data.attrs.get(schema.EVIDENCE)
    if kind not in _BOARDS or any(variable.chunks is not None for variable in data.variables.values()):
        return []
    groups = _BOARDS[kind](_plain_dataset(data))
    return [*_laid_out(groups, width)] if groups else []


Shown = tuple[str, str, NDArray[Any]]  # a header, the form of numbers, cells


_LATER = re.compile(r"\[(?!1\b)[0-9]+")  # in a name, of an occurrence


def _is_later(study: xr.Dataset, column: TableColumn) -> bool:
    """Whether a column is of a later occurrence of an event: a board has the first, and the summary the next ones."""
    return schema.OCCURRENCE in study[column.variable].dims and bool(_LATER.search(column.name))


def _board_of_levels(study: xr.Dataset) -> list[list[Shown]]:
    by_name = {column.name: column for column in _level_columns(study)}
    observed = [column for column in by_name.values() if f"difference_{column.variable}" in study]
    observed = [column for column in observed if not _is_later(study, column)]
    first = next(iter(by_name.values()))
    groups = [[_shown_as(first)]]
    for column in observed[:MOST_OBSERVED]:
        level_names = [
            (word, form, f"{word}_{column.name}") for word, form in (("difference", DOUBT), ("order", ORDER))
        ]
        level_columns = [(word, form, by_name[name].values) for word, form, name in level_names if name in by_name]
        groups.append([_shown_as(column), *level_columns])
    defects = [column for column in by_name.values() if column.variable.startswith(DEFECT)]
    groups += [
        [(f"local error of {_header(column).removeprefix(DEFECT)}", DOUBT, column.values)]
        for column in defects[:MOST_OBSERVED]
    ]
    return groups


def _board_of_cases(ledger: xr.Dataset) -> list[list[Shown]]:
    headers_by_name = {
        "case_name": "case",
        "verdict": "verdict",
        "residual": "residual",
        "bound": "bound",
        "case_units": "unit",
        "case_observable": "observable",
        "case_method": "method",
    }
    columns = {column.name: column.values for column in _columns_along(ledger, (schema.CASE,))}
    if len({*columns["case_method"]}) == 1:
        del headers_by_name["case_method"]
    return [[(header, DOUBT, columns[name])] for name, header in headers_by_name.items()]


def _board_of_modes(modes: xr.Dataset) -> list[list[Shown]]:
    columns = [*_columns_along(modes, ("mode",))][:MOST_OBSERVED]
    return [[_shown_as(column)] for column in columns] if modes.sizes.get("mode") else []


def _board_of_runs(comparison: xr.Dataset) -> list[list[Shown]]:
    """Return a row a run, with the largest difference of each quantity from the reference."""
    head = "largest_difference_"
    names = [str(name) for name in comparison.data_vars if str(name).startswith(head)][:MOST_OBSERVED]
    columns = [
        replace(column, name=column.name.removeprefix(head)) for column in _columns_along(comparison, ("run",), names)
    ]
    runs = comparison["run_name"].values.astype(object)
    return [[("largest difference of", "", runs)], *([(_header(column), DOUBT, column.values)] for column in columns)]


_BOARDS: dict[str, Callable[[Any], list[list[Shown]]]] = {
    "refinement": _board_of_levels,
    "ledger": _board_of_cases,
    "modes": _board_of_modes,
    OF_SEVERAL: _board_of_runs,
}


def _shown_as(column: TableColumn) -> Shown:
    header = _header(column)
    return header, _number_form(header), column.values


def _header(column: TableColumn) -> str:
    return f"{column.name} [{column.units}]" if column.units else column.name


def _laid_out(groups: Sequence[Sequence[Shown]], width: int) -> Iterator[str]:
    """Yield lines of columns: groups that do not fit stand below, behind the first column."""
    count = len(groups[0][0][2])
    rows = [*range(count)]
    if count > MOST_SHOWN:
        rows = [*rows[: MOST_SHOWN // 2], *rows[-MOST_SHOWN // 2 :]]
    texts = [[_cell_texts(header, form, values[rows]) for header, form, values in group] for group in groups]
    key, parts = texts[0], [[*texts[0]]]
    for group in texts[1:]:
        if _text_width(parts[-1]) + 2 + _text_width(group) > width and parts[-1] != key:
            parts.append([*key])
        parts[-1] += group
    for number, part in enumerate(parts):
        if number:
            yield ""
        for k in range(len(rows) + 1):
            if k == MOST_SHOWN // 2 + 1 and count > MOST_SHOWN:
                yield f"… {count - MOST_SHOWN} rows more"
            yield "  ".join(column[k] for column in part).rstrip()


def _text_width(columns: Sequence[Sequence[str]]) -> int:
    return sum(len(column[0]) + 2 for column in columns) - 2


def _cell_texts(header: str, form: str, values: NDArray[Any]) -> list[str]:
    """Return a header and cells of one width: numbers to the right, words to the left."""
    if values.dtype.kind == "f":
        cells = ["" if np.isnan(value) else f"{value:{form}}" for value in values.tolist()]
    else:
        texts = (" ".join(str(value).split()) for value in values.tolist())
        cells = [text if len(text) <= WIDEST else f"{text[: WIDEST - 1]}…" for text in texts]
    size = max(map(len, [header, *cells]))
    side = ">" if values.dtype.kind in "iuf" else "<"
    return [f"{cell:{side}{size}}" for cell in (header, *cells)]


def check_table_target(path: Place, endings: Sequence[str] = ENDINGS) -> Place:
    """Check that a table can be written to a path.

    Raises
    ------
    InputError
        Naming it, or the package that its kind needs.
    """
    ending = path.suffix.lower()
    if is_folder(path):
        raise InputError(f"table '{path}' is a directory; name a file")
    if ending not in endings:
        raise InputError(f"table '{path}' has the ending '{path.suffix}'; there are {', '.join(endings)}")
    if isinstance(path, Path) and not path.parent.is_dir():
        why = file_above(path) or f"there is no folder '{path.parent}'"
        raise InputError(f"table '{path}' cannot be written: {why}")
    if ending in PACKAGES:
        _check_package(ending)
    return path


def _check_package(ending: str) -> None:
    from importlib.util import find_spec

    if find_spec(PACKAGES[ending]) is None:
        raise InputError(
            f"{ending} needs {PACKAGES[ending]}, which is not installed: pip install 'xdynamics[tables]'; .csv, .md and"
            " .tex need nothing"
        )


def write_table(made: pd.DataFrame, path: Place) -> str:
    """Write a table in the format of the file's suffix; return a line that describes it.

    Raises
    ------
    InputError
        If the table is wider than a sheet of a workbook.
    ArchiveError
        If it cannot be written.
    """
    write_content(_WRITERS[path.suffix.lower()](made), path)
    return f"table     {path}: {len(made)} rows, {len(made.columns)} columns"


def write_content(content: bytes, path: Place) -> None:
    """Write a file completely or not at all.

    Raises
    ------
    ArchiveError
        If it cannot be written.
    """
    try:
        with taking_name(path) as new:
            new.part.write_bytes(content)
    except ArchiveError as error:
        raise ArchiveError(f"table {error}") from None


def _csv_content(made: pd.DataFrame) -> bytes:
    return str(made.to_csv(index=False, lineterminator="\n")).encode()


def _workbook(made: pd.DataFrame) -> bytes:
    if len(made.columns) > MOST_COLUMNS:
        raise InputError(
            f"the table has {len(made.columns)} columns, and a workbook {MOST_COLUMNS} at most; write .csv"
        )
    import pandas as pd
    from openpyxl.cell.cell import TYPE_FORMULA, TYPE_STRING

    content = io.BytesIO()
    with pd.ExcelWriter(content, engine="openpyxl") as writer:
        made.to_excel(writer, index=False)
        for sheet in writer.sheets.values():
            for cell in (cell for row in sheet.iter_rows() for cell in row if cell.data_type == TYPE_FORMULA):
                cell.data_type = TYPE_STRING  # a text that begins with = is no formula
    return content.getvalue()


def _parquet(made: pd.DataFrame) -> bytes:
    content = io.BytesIO()
    made.to_parquet(content, index=False, engine="pyarrow")
    return content.getvalue()


def _markdown(made: pd.DataFrame) -> bytes:
    rows = [[*map(str, made.columns)], ["---" if made[name].dtype.kind == "O" else "---:" for name in made.columns]]
    rows += [[*map(_cell, row)] for row in made.itertuples(index=False)]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |\n" for row in rows).encode()


def _latex(made: pd.DataFrame) -> bytes:
    sides = "".join("l" if made[name].dtype.kind == "O" else "r" for name in made.columns)
    rows = [[*map(str, made.columns)], *([*map(_cell, row)] for row in made.itertuples(index=False))]
    lines = [" & ".join(map(_escaped, row)) + r" \\" for row in rows]
    body = [rf"\begin{{tabular}}{{{sides}}}", r"\hline", lines[0], r"\hline", *lines[1:], r"\hline", r"\end{tabular}"]
    return ("\n".join(body) + "\n").encode()


def _cell(value: Any) -> str:
    # nan alone differs from itself
    return "" if value != value else repr(value) if isinstance(value, float) else " ".join(str(value).split())


def _escaped(text: str) -> str:
    """Return a text as LaTeX prints it."""
    latex_commands = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    return "".join(latex_commands.get(letter, "\\" + letter if letter in "&%$#_{}" else letter) for letter in text)


_WRITERS: dict[str, Callable[[Any], bytes]] = {
    ".csv": _csv_content,
    ".xlsx": _workbook,
    ".parquet": _parquet,
    ".md": _markdown,
    ".tex": _latex,
}


Floats = NDArray[np.float64]

TEXT_ENDINGS = (".csv", ".txt")


def check_text_target(path: Place) -> Place:
    """Check that a table of text can be written to a path; see `check_table_target`."""
    return check_table_target(path, TEXT_ENDINGS)


@of_elements
def states_as_csv(states: xr.Dataset) -> str:
    """Return states at some times, as `sample` gives them: CSV with units in its header, numbers to the last bit."""
    names = [str(name) for name in states.data_vars if states[name].dims == (schema.AT,) and error(str(name)) in states]
    columns = {f"time [{states[schema.AT_TIME].attrs['units']}]": states[schema.AT_TIME].values}
    columns |= {f"{display_text(name)} [{states[name].attrs['units']}]": states[name].values for name in names}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(columns)
    # repr of a float is the shortest text that reads back to the same bits
    rows.writerows(map(repr, row) for row in zip(*(values.tolist() for values in columns.values()), strict=True))
    return text.getvalue()


@of_elements
def write_states_table(run: xr.Dataset, requested_times: Floats, path: Place) -> str:
    """Write a table into a file, as far as the run came; return a line that describes it."""
    reached = requested_times[requested_times <= float(run["time"][-1])]
    if not reached.size:
        return "table     none: the run ended before the first of the times"
    return write_text_table(states_as_csv(sample(run, reached)), path)


def write_text_table(text: str, path: Place) -> str:
    """Write a table into a file; return a line that describes it."""
    write_content(text.encode(), path)
    return f"table     {path}: {text.count(chr(10)) - 1} rows"
