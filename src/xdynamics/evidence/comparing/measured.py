"""A run beside what was measured: residuals, their norm, and whether they are as large as the uncertainties say."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.dynamics.inside import model_of
from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.evidence.observing import observables_of, observe
from xdynamics.evidence.scaling import scale_of, scaled
from xdynamics.faults import InputError, Ledger
from xdynamics.model.drives import GAPS, REFUSE, SKIP
from xdynamics.model.reach import ANYWHERE, Reach
from xdynamics.model.sheet import Sheet, Title, shown, title
from xdynamics.record.words import time_unit
from xdynamics.schema import AT, AT_TIME, EVIDENCE
from xdynamics.units import SECONDS, TIME, Unit, behind, parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

_UNCERTAINTY = re.compile(r"u\((?P<name>.+)\)")
TIMES = ("time", "t")


@dataclass(frozen=True)
class Measured:
    """What was measured, as columns.

    Attributes
    ----------
    name : str
        Where it is from.
    times : ndarray, shape (n,), s
    values : dict of str to (ndarray, Unit)
    uncertainties : dict of str to (ndarray, Unit)
        Standard ones.
    left_out : tuple of str
        Columns that are nothing that is known.
    """

    name: str
    times: Floats
    clock: Unit
    values: dict[str, tuple[Floats, Unit]]
    uncertainties: dict[str, tuple[Floats, Unit]]
    left_out: tuple[str, ...] = ()


def is_measured(given: Any) -> bool:
    """Tell measured data from a run record: a path, a table of pandas, a Dataset that was not marched."""
    if isinstance(given, str | Path) or hasattr(given, "columns"):
        return True
    about = getattr(given, "attrs", {})
    return "row_kind" not in getattr(given, "variables", ("row_kind",)) and EVIDENCE not in about


def measured(given: Any, known: Sequence[str] | None = None, gaps: str = REFUSE, clock: Unit = SECONDS) -> Measured:
    """Read measured data.

    Parameters
    ----------
    given : str, Path, DataFrame or Dataset
    known : sequence of str, optional
        Names that are wanted: other columns are left out, whatever stands in them.
    gaps : {"refuse", "skip"}
        What is done with rows in which a number is missing.
    clock : Unit
        Of the model's time.

    Raises
    ------
    InputError
        With every column that cannot be used.
    """
    if gaps not in GAPS:
        raise InputError(f"gaps is {gaps!r}; there are {', '.join(GAPS)}")
    if isinstance(given, str | Path):
        found = _of_file(Path(given), known, skip=gaps == SKIP)
    elif hasattr(given, "columns"):
        table = given.reset_index() if given.index.name else given
        columns = {str(name): table[name].to_numpy() for name in table.columns}
        found = _of_columns("the DataFrame", columns, known, skip=gaps == SKIP)
    else:
        found = _of_dataset(given)
    if found.clock.dimension != clock.dimension:
        needed = "a time" if clock.dimension == TIME else "a pure number, as the model's time is"
        raise InputError(f"{found.name}: the column of times is in '{found.clock.text}', needs {needed}")
    return found


def residuals(
    run: xr.Dataset, given: Any, functions: Mapping[str, Callable[..., float]] | None, gaps: str = REFUSE
) -> xr.Dataset:
    """Compare a run with measured data; see `compare`."""
    model = model_of(run, functions)
    known = [name for name in observables_of(model) if name in run.variables]
    data = measured(given, known, gaps, time_unit(run))
    ledger = Ledger(data.name)
    for name, (_, unit) in data.values.items():
        if name not in known:
            ledger.note(f"column '{name}' is nothing that the run has; there are {', '.join(known)}")
        elif unit.dimension != parse_unit(str(run[name].attrs["units"])).dimension:
            ledger.note(f"column '{name}' is in '{unit.text}', needs '{run[name].attrs['units']}' or a unit like it")
    ledger.settle()
    second = behind(time_unit(run))
    begin, end = (float(run["time"][k]) for k in (0, -1))
    outside = np.flatnonzero((data.times < begin) | (data.times > end))
    if outside.size:
        raise InputError(
            f"{data.name}, row {int(outside[0]) + 1}: t = {float(data.times[outside[0]])!r}{second} is outside the run, from {begin!r}{second} to {end!r}{second}"
        )
    names = list(data.values)
    found = observe(run, model, names, data.times)
    variables: dict[str, Any] = {
        AT_TIME: ((AT,), data.times, about(time_unit(run).text, "time of measurement", "time"))
    }
    for name in names:
        variables |= _residuals(name, str(run[name].attrs["units"]), *found[name], data)
    title = f"{run.attrs['title']}, beside {data.name}"
    return exhibit(
        "comparison",
        title,
        [archive.digest_of_run(run)],
        variables,
        {"data": data.name, "data_left_out": ", ".join(data.left_out)},
    )


def _residuals(name: str, units: str, computed: Floats, errors: Floats, data: Measured) -> dict[str, Any]:
    own = parse_unit(units)

    def converted(values: Floats, unit: Unit) -> Floats:
        return values * float(unit.factor / own.factor)

    values = converted(*data.values[name])
    apart = values - computed
    said = f"largest size of {name} as measured; where that is 0, as computed"
    found: dict[str, Any] = {
        f"measured_{name}": ((AT,), values, about(units, f"{name} as measured", "measured")),
        name: ((AT,), computed, about(units, f"{name} as computed", "computed")),
        f"difference_{name}": ((AT,), apart, about(units, f"{name}, measured minus computed", "difference")),
        f"interpolation_error_{name}": ((AT,), errors, about(units, f"what {name} may be off between accepted states", "error")),
        f"rms_difference_{name}": ((), np.sqrt(np.mean(apart**2)), about(units, f"root of the mean square of difference_{name}", "residual")),
        **scaled("difference", name, apart, scale_of(values, computed), (AT,), units, said, ("rms",)),
    }  # fmt: skip
    if name in data.uncertainties:
        doubt = converted(*data.uncertainties[name])
        square = np.mean((apart / doubt) ** 2)
        found |= {
            f"measured_uncertainty_{name}": ((AT,), doubt, about(units, f"standard uncertainty of {name} as measured", "uncertainty")),
            f"reduced_chi_square_{name}": ((), square, about("1", f"mean square of difference_{name} over its uncertainty; nothing was fitted, so all values are degrees of freedom", "residual") | {"degrees_of_freedom": apart.size}),
        }  # fmt: skip
    return found


def _of_file(path: Path, known: Sequence[str] | None, *, skip: bool) -> Measured:
    """Read the columns of a CSV file."""
    sheet = Sheet.of(path.name, Reach(path.parent, ANYWHERE).text_of(path.name))
    titles, left_out = _titles(f"'{path.name}' ({sheet.found})", sheet.header, known)
    rows = sheet.numbers([*titles], skip=skip)
    if not rows:
        raise InputError(f"'{path}' has no rows; it needs a header like 'time [s],y [m]' and numbers below")
    columns = np.array([row for _, row in rows]).T
    read = {one.name: (column, one.unit) for one, column in zip(titles.values(), columns, strict=True)}
    return _sorted_out(f"'{path.name}'", read, left_out)


def _of_columns(name: str, columns: Mapping[str, Any], known: Sequence[str] | None, *, skip: bool) -> Measured:
    """Read columns by their headers, ``y [mm]`` and ``u(y) [mm]``."""
    titles, left_out = _titles(name, tuple(columns), known)
    cells = [np.asarray(one) for one in columns.values()]
    if skip:
        whole = ~np.any([np.isnan(cells[k]) for k in titles if cells[k].dtype.kind == "f"], axis=0)
        cells = [one[whole] for one in cells]
    ledger, read = Ledger(name), {}
    for k, one in titles.items():
        with ledger.entry(f"column {shown([*columns][k])}"):
            read[one.name] = _numbers(cells[k]), one.unit
    ledger.settle()
    return _sorted_out(name, read, left_out)


def _titles(name: str, header: Sequence[str], known: Sequence[str] | None) -> tuple[dict[int, Title], tuple[str, ...]]:
    """Return the columns that are wanted, by their place, and those that are left out."""
    ledger, left_out = Ledger(name), []
    found: dict[int, Title] = {}
    words = [re.split(r"[\[/]", cell)[0].strip() for cell in header]
    bares = [word.removeprefix("u(").split("(")[0].removesuffix(")").strip() for word in words]
    for k, (cell, word, bare) in enumerate(zip(header, words, bares, strict=True)):
        if word.startswith("u(") and bares.count(bare) < 2:
            ledger.note(f"u({bare}) is the uncertainty of a column that is not there")
        elif known is not None and bare not in known and bare.lower() not in TIMES:
            left_out.append(cell.strip())
            continue
        with ledger.entry(f"column {shown(cell)}"):
            one = title(cell)
            if one.name in {each.name for each in found.values()}:
                raise InputError(f"'{one.name}' stands there twice")
            found[k] = one
    ledger.settle()
    if known is not None and left_out and not any(one.name in known for one in found.values()):
        raise InputError(f"{name}: column '{left_out[0]}' is nothing that is known; there are {', '.join(known)}")
    return found, tuple(left_out)


def _of_dataset(given: Any) -> Measured:
    """Read variables along one dimension by their units."""
    ledger = Ledger("the Dataset")
    read: dict[str, tuple[Floats, Unit]] = {}
    for name, one in given.variables.items():
        said = str(name).removesuffix("_time") if name == AT_TIME else str(name)
        with ledger.entry(f"variable '{name}'"):
            if "units" not in one.attrs:
                raise InputError("has no units; set its attribute 'units'")
            if len(one.dims) != 1:
                raise InputError(f"has the dims {one.dims}, needs one, along which it was measured")
            key = f"u({said[2:]})" if said.startswith("u_") else "time" if name == AT_TIME else said
            read[key] = _numbers(one.values), parse_unit(str(one.attrs["units"]))
    sizes = {name: len(numbers) for name, (numbers, _) in read.items()}
    if len({*sizes.values()}) > 1:
        ledger.note(
            f"variables have {', '.join(f'{size} ({name})' for name, size in sizes.items())} rows, need one dimension for all"
        )
    ledger.settle()
    return _sorted_out("the Dataset", read)


def _numbers(cells: Any) -> Floats:
    """Read numbers; a gap is none."""
    kind = np.asarray(cells).dtype.kind
    if kind in "mMcb":
        what = {"m": "time differences", "M": "dates", "c": "complex numbers", "b": "truths"}[kind]
        raise InputError(
            f"holds {what}, needs plain numbers"
            + ("; divide by np.timedelta64(1, 's') for seconds" if kind == "m" else "")
        )
    try:
        values = np.asarray(cells, float)
    except (TypeError, ValueError):
        wrong = next(k for k, cell in enumerate(cells) if not _is_number(cell))
        raise InputError(f"row {wrong + 1} is {str(cells[wrong])[:24]!r}, needs a number") from None
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values))[0])
        raise InputError(f"row {row + 1} is {values[row]}, needs a number; leave out rows with gaps")
    return values


def _is_number(cell: Any) -> bool:
    try:
        return isfinite(float(cell))
    except (TypeError, ValueError):
        return False


def _sorted_out(name: str, read: dict[str, tuple[Floats, Unit]], left_out: tuple[str, ...] = ()) -> Measured:
    """Tell times, values and uncertainties apart."""
    said: Hashable = next((one for one in read if one.lower() in TIMES), None)
    if said is None:
        raise InputError(f"{name} has no column of times, like 'time [s]'; there are {', '.join(read) or 'none'}")
    times, unit = read.pop(str(said))
    doubts = {match["name"]: one for key, one in read.items() if (match := _UNCERTAINTY.fullmatch(key))}
    values = {key: one for key, one in read.items() if not _UNCERTAINTY.fullmatch(key)}
    ledger = Ledger(name)
    for key, (numbers, own) in doubts.items():
        if key not in values:
            ledger.note(f"u({key}) is the uncertainty of a column that is not there")
        elif own.dimension != values[key][1].dimension:
            ledger.note(f"u({key}) is in '{own.text}', needs a unit like '{values[key][1].text}'")
        elif not (numbers > 0.0).all():
            ledger.note(
                f"u({key}) is {float(numbers.min())!r} in row {int(np.argmin(numbers)) + 1}, needs a positive number"
            )
    if not values or not times.size:
        ledger.note("has no column beside the times" if times.size else "has no rows")
    ledger.settle()
    return Measured(name, times * float(unit.factor), unit, values, doubts, left_out)
