"""Variables of a run by their roles."""

from __future__ import annotations

import xarray as xr


def with_role(run: xr.Dataset, *roles: str) -> list[str]:
    """Name the variables of a run that have one of some roles.

    They are looked at without coordinates, and in one mapping: a ``DataArray`` of each takes xarray a millisecond where a
    run has a thousand elements, and ``run.variables`` wraps them anew each time that it is asked.
    """
    coordinates = {*run.coords}
    return [
        str(name)
        for name, variable in run.variables.items()
        if variable.attrs.get("role") in roles and name not in coordinates
    ]
