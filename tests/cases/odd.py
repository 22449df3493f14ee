"""Archives that nobody marched: changed, and sealed again with right digests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import xarray as xr

from xdynamics.archive.seals import seal_file, stored_digest
from xdynamics.archive.text_encoding import text_form
from xdynamics.archive.writing import Writer
from xdynamics.record.flag_words import own_attributes


def changed(source: Path, target: Path, change: Callable[[xr.Dataset], xr.Dataset | None]) -> Path:
    """Write a copy of an archive with a change that its digests and its seal agree with."""
    with xr.open_dataset(source, engine="netcdf4", decode_times=False, mask_and_scale=False) as kept:
        run = kept.load().drop_encoding()
    for name, one in list(run.variables.items()):
        one.attrs.pop("sha256", None)
        form = text_form(one.attrs, one.dtype, tuple(map(str, one.dims)), one.shape)
        if form is not None:
            run[name] = (one.dims[: one.ndim - form.further], form.texts(one.values), own_attributes(one.attrs))
    run = change(run) or run
    with netCDF4.Dataset(target, "w", format="NETCDF4") as file:
        writer = Writer(file)
        for name, variable in run.variables.items():
            sizes = {str(dim): size for dim, size in zip(variable.dims, variable.shape, strict=True) if size}
            writer.define(str(name), tuple(map(str, variable.dims)), variable.dtype, dict(variable.attrs), sizes)
        for name, one in run.variables.items():
            writer.append(str(name), one.values)
        writer.finish(dict(run.attrs))
    seal_file(target)
    return target


def with_attributes(**attributes: Any) -> Callable[[xr.Dataset], None]:
    """Return a change of global attributes; None takes one away."""

    def change(run: xr.Dataset) -> None:
        for name, value in attributes.items():
            run.attrs.pop(name, None)
            if value is not None:
                run.attrs[name] = value

    return change


def restate(file: netCDF4.Dataset, name: str) -> None:
    """Let an open file state the digest that a variable of it has now."""
    digests = dict(line.split() for line in file.variable_digests.splitlines())
    file.variable_digests = "\n".join(map(" ".join, (digests | {name: stored_digest(file.variables[name])}).items()))
