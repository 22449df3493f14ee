"""One member of a sweep as its whole run: from its archive, or marched again from the catalogue alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive
from xdynamics.evidence.marching import march
from xdynamics.faults import ArchiveError, InputError
from xdynamics.schema import ROOT_DIGEST
from xdynamics.sweeping.axes import numbers_of
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.grid import Grid
from xdynamics.sweeping.members import DIGEST, FILE, OUTCOME, digest_of_end

if TYPE_CHECKING:
    import xarray as xr

ALIKE = 1e-12  # relative, of values that are written down in other units


def member(
    sweep: xr.Dataset, *, functions: Mapping[str, Callable[..., float]] | None = None, **labels: Any
) -> xr.Dataset:
    """Return one member of a sweep as its whole run, bit for bit.

    Parameters
    ----------
    sweep : xarray.Dataset
        What `sweep` or `open_sweep` returned, or a part of it.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    **labels
        A value of every axis: ``k="1 N m-1"``, ``k=1.0`` in the axis' unit, ``method="heun"``; of an axis along which
        several things vary the number of the member.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    InputError
        If an axis has no such value; it names the nearest.
    ArchiveError
        If the run that is marched does not come to what the sweep says.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = xd.sweep(model, {"v_y": "10:30:3 m s-1"}, rtol=1e-6, method="heun")
    >>> run = member(found, v_y="20 m s-1")
    >>> float(run.y[-1]) == float(found.end_y.sel(v_y=20))
    True
    """
    plan = plan_of(sweep, functions)
    grid = plan.grid
    at = _place(grid, labels)
    where = {dim: k for dim, k in zip(grid.dims, at, strict=True) if dim in sweep.dims}
    said = sweep[[one for one in (DIGEST, OUTCOME, FILE) if one in sweep]].isel(where).compute()
    if FILE in said and (folder := _folder_of(sweep)):
        return _opened(folder / str(said[FILE].values), str(said[DIGEST].values))
    run = march(grid.model_of(at), **grid.asked_of(at))
    digest = archive.digest_of_run(run) if FILE in said else digest_of_end(run, list(grid.model.units))
    came_to = {DIGEST: digest, OUTCOME: run.attrs[OUTCOME]}
    apart = [f"{name} is {one}, in the sweep {value}" for name, one in came_to.items() if name in said and (value := str(said[name].values)) != one]  # fmt: skip
    if apart:
        raise ArchiveError(f"member {grid.said(at)}, marched again, comes to something else: {'; '.join(apart)}")
    return run


def _folder_of(sweep: xr.Dataset) -> Path | None:
    """Return the folder that a sweep was opened from."""
    source = sweep.encoding.get("source")
    return Path(source).parent if source else None


def _opened(file: Path, digest: str) -> xr.Dataset:
    """Open a member's archive, which is to hold the run that the catalogue says."""
    run = archive.open_run(file)
    if run.attrs[ROOT_DIGEST] != digest:
        run.close()
        raise ArchiveError(f"'{file}' has the content digest {run.attrs[ROOT_DIGEST]}, in the catalogue {digest}")
    return run


def _place(grid: Grid, labels: Mapping[str, Any]) -> list[int]:
    """Find the values that are asked for."""
    unknown = [name for name in labels if name not in grid.dims]
    if unknown:
        raise InputError(f"the sweep has no axis '{unknown[0]}'; there are {', '.join(grid.dims)}")
    found = []
    for axis in grid.axes:
        if axis.size == 1 and axis.dim not in labels:
            found.append(0)
        elif axis.dim not in labels:
            raise InputError(f"a member needs a value of every axis, and of '{axis.dim}' there is none")
        elif own := [one for one in axis.columns if one.label == axis.dim]:
            found.append(_nearest(own[0], labels[axis.dim]))
        else:
            found.append(_number(axis.dim, axis.size, labels[axis.dim]))
    return found


def _nearest(column: Any, label: Any) -> int:
    if column.values.dtype == object:
        words = [str(one) for one in column.values]
        if str(label) not in words:
            raise InputError(f"axis '{column.label}' has no {str(label)!r}; there are {', '.join(words)}")
        return words.index(str(label))
    values, unit = numbers_of(label, column.unit)
    if len(values) != 1:
        raise InputError(f"{column.label} is {label!r}, needs one value")
    wanted, known = unit.to_si(float(values[0])), column.si
    i = int(np.argmin(np.abs(known - wanted)))
    if abs(known[i] - wanted) > ALIKE * max(abs(known[i]), abs(wanted)):
        raise InputError(f"axis '{column.label}' has no {label!r}; the nearest is {float(column.values[i])!r} {column.unit.text}")  # fmt: skip
    return i


def _number(dim: str, size: int, label: Any) -> int:
    if isinstance(label, bool) or not isinstance(label, int | np.integer) or not 0 <= label < size:
        raise InputError(f"{dim} is {label!r}, needs the number of a member, from 0 to {size - 1}")
    return int(label)
