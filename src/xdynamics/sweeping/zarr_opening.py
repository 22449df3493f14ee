"""A sweep in a Zarr store, opened lazily as what it was before it was stored: flags and bytes are words and digests again."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.archive.reading import check_schema
from xdynamics.faults import ArchiveError
from xdynamics.record.folding import labelled
from xdynamics.schema import EVIDENCE, ROOT_DIGEST, SWEEP
from xdynamics.sweeping.collection import with_axes
from xdynamics.sweeping.kept_quantities import OUTCOME, STOPPED_BY
from xdynamics.sweeping.zarr_blocks import HEXADECIMAL, MEANINGS, TOML
from xdynamics.sweeping.zarr_digests import MEMBER_ARRAYS, METADATA, facts_of, sweep_content_digest, zarr_package

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[Any]


def open_zarr_sweep(folder: Place) -> xr.Dataset:
    """Open a sweep lazily: chunks are read when they are used; `verified` compares them with their digests.

    Raises
    ------
    ArchiveError
        If the folder holds no sweep, or one of a newer schema.
    """
    import xarray as xr

    zarr_package()
    facts = facts_of(folder)
    stored = xr.open_zarr(str(folder), consolidated=True, mask_and_scale=False, decode_times=False)
    check_schema(stored.attrs, folder, "xarray.open_zarr")
    sweep = stored.assign(
        {name: _as_texts(stored[name]) for name in (OUTCOME, STOPPED_BY, *HEXADECIMAL) if name in stored}
    )
    words = {name: entry for name, entry in sweep.variables.items() if entry.dtype.kind not in "biufU"}
    sweep = sweep.assign(
        {name: (entry.dims, np.array(entry.values.tolist(), str), entry.attrs) for name, entry in words.items()}
    )
    sweep[TOML] = ((), str(stored.attrs[TOML]), {"units": "1", "long_name": "the model that members share, as TOML"})
    sweep.attrs = {name: value for name, value in stored.attrs.items() if name not in (TOML, MEMBER_ARRAYS)}
    sweep.attrs[ROOT_DIGEST] = sweep_content_digest(facts)
    if sweep.attrs.get(EVIDENCE) != SWEEP:
        raise ArchiveError(f"'{folder}' is no sweep")
    sweep = with_axes(labelled(sweep))
    sweep.encoding["source"] = str(folder.absolute() / METADATA)
    return sweep


def _as_texts(numbers: xr.DataArray) -> xr.Variable:
    """Return flags and bytes as texts, lazily."""
    import xarray as xr

    attributes = {
        name: value for name, value in numbers.attrs.items() if name not in ("flag_values", MEANINGS, "encoded")
    }
    data: Any = numbers.data
    if MEANINGS in numbers.attrs:
        words = np.array([*str(numbers.attrs[MEANINGS]).split(), ""])
        return xr.Variable(numbers.dims, data.map_blocks(words.__getitem__, dtype=words.dtype), attributes)
    prefix, suffix = HEXADECIMAL[str(numbers.name)]
    dtype = f"U{2 * numbers.shape[-1] + len(prefix) + len(suffix)}"
    texts = data.map_blocks(
        partial(_hexadecimal, prefix=prefix, suffix=suffix), dtype=dtype, drop_axis=numbers.ndim - 1
    )
    return xr.Variable(numbers.dims[:-1], texts, attributes)


def _hexadecimal(numbers: Values, prefix: str, suffix: str) -> Values:
    """Return bytes as texts, with what stands around them; empty ones where all are zero."""
    width = 2 * numbers.shape[-1]
    letters = np.frombuffer(np.ascontiguousarray(numbers).tobytes().hex().encode(), f"S{width}")
    texts = letters.reshape(numbers.shape[:-1]).astype(f"U{width}")
    texts = np.char.add(np.char.add(prefix, texts), suffix) if prefix else texts
    return np.where(numbers.any(axis=-1), texts, "")
