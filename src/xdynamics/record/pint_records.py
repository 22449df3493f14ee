"""Records whose arrays carry their units, as pint-xarray makes them: taken and given by every verb."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from typing import TYPE_CHECKING, Any

from xdynamics.faults import InputError
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

UNITS = "units"
_POWER = re.compile(r"(?<=[A-Za-z])(-?[0-9]+)(?=\s|$)")
AS_RECORDED = "recorded_units"  # how a unit was spelled: pint puts its parts into an order of its own


def is_quantified(record: Any) -> bool:
    """Whether a Dataset has arrays of pint."""
    # not imported for this question: without pint in memory no array is one of its
    if "pint" not in sys.modules or not hasattr(record, "variables"):
        return False
    return any(_has_pint_unit(variable) for variable in record.variables.values())


def _has_pint_unit(variable: Any) -> bool:
    return type(variable._data).__module__.startswith("pint")  # noqa: SLF001 - `.data` would read what is lazy


def teach() -> None:
    """Teach pint, where pint-xarray is loaded, to read powers as records spell them: ``m s-1``.

    xarray loads pint itself where it is installed; its registry, a quarter of a second, is left to who uses it.
    """
    if "pint_xarray" not in sys.modules:
        return
    import pint

    preprocessors = pint.application_registry.preprocessors
    if _with_stars not in preprocessors:
        preprocessors.append(_with_stars)


def _with_stars(units: str) -> str:
    return _POWER.sub(r"**\1", units)


def quantified(run: xr.Dataset) -> xr.Dataset:
    """Return a record whose numbers carry their units; flags, row numbers and texts stay as they are.

    Examples
    --------
    >>> import xdynamics as xd
    >>> run = xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), method="dop853", rtol=1e-6)
    >>> str(quantified(run).v_y.pint.units)
    'meter / second'
    """
    import cf_xarray.units  # noqa: F401 - teaches pint the spelling of UDUNITS, before pint-xarray takes its registry
    import pint_xarray  # noqa: F401 - the accessor

    numbers = {
        name: variable.attrs[UNITS]
        for name, variable in run.variables.items()
        if variable.dtype.kind == "f" and UNITS in variable.attrs
    }
    result: xr.Dataset = run.pint.quantify(numbers)
    for name, text in numbers.items():
        result[name].attrs[AS_RECORDED] = text
    return result


def without_pint_units(run: xr.Dataset) -> xr.Dataset:
    """Return a record with units as attributes.

    Raises
    ------
    InputError
        If a unit has no place in a record.
    """
    import cf_xarray.units  # noqa: F401 - how units are spelled

    result = run.copy()
    for name, variable in run.variables.items():
        if not _has_pint_unit(variable):
            continue
        # a pure number is spelled as an empty text
        spelled = f"{variable.data.units:cf}" or "1"
        try:
            text = parse_unit(spelled).text
        except InputError as error:
            raise InputError(f"'{name}' is in {str(variable.data.units)!r}, which no record holds: {error}") from None
        recorded = str(variable.attrs.get(AS_RECORDED, text))
        same = (parse_unit(recorded).dimension, parse_unit(recorded).factor) == (
            parse_unit(text).dimension,
            parse_unit(text).factor,
        )
        attributes = {UNITS: recorded if same else text} | {
            key: value for key, value in variable.attrs.items() if key != AS_RECORDED
        }
        result[name] = variable.copy(data=variable.data.magnitude)
        result[name].attrs = attributes
    return result.set_coords([*run.coords])


def taking(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Let a verb take Datasets with units in their arrays, and return such a Dataset if it was given one."""

    @wraps(verb)
    def quantified_call(*arguments: Any, **keywords: Any) -> Any:
        if "pint" not in sys.modules or not any(map(is_quantified, (*arguments, *keywords.values()))):
            return verb(*arguments, **keywords)
        result = verb(
            *map(_plain_argument, arguments), **{key: _plain_argument(value) for key, value in keywords.items()}
        )
        return quantified(result) if hasattr(result, "data_vars") else result

    return quantified_call


def _plain_argument(argument: Any) -> Any:
    if isinstance(argument, Mapping) and not hasattr(argument, "variables"):
        return {key: _plain_argument(value) for key, value in argument.items()}
    return without_pint_units(argument) if is_quantified(argument) else argument
