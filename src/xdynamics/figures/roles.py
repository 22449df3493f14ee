"""Variables of a run by their roles."""

from __future__ import annotations

import xarray as xr


def with_role(run: xr.Dataset, *roles: str) -> list[str]:
    """Name the variables of a run that have one of some roles.

    They are looked at without coordinates, and in one mapping: a ``DataArray`` of each takes xarray a millisecond where a
    run has a thousand elements, and ``run.variables`` wraps them anew each time that it is asked.
    """
    variables = run.variables
    return [str(name) for name in run.data_vars if variables[name].attrs.get("role") in roles]
