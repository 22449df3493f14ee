"""The digest that an archive of a Dataset would have, without an archive."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.record.flag_words import own_attributes
from xdynamics.record.run_dataset import check_dataset
from xdynamics.record.unfolding import as_recorded

if TYPE_CHECKING:
    import xarray as xr


from xdynamics.archive.seals import Seal, root_digest, stored_slabs


def content_digest(run: xr.Dataset) -> str:
    """Return the content digest that an archive of a Dataset would have.

    Raises
    ------
    InputError
        If it is no Dataset.
    """
    check_dataset(run)
    run, digests = as_recorded(run), {}
    for name, variable in run.variables.items():
        seal = Seal(str(name), tuple(map(str, variable.dims)), variable.dtype)
        for slab in stored_slabs(variable):
            seal.update(slab)
        digests[str(name)] = seal.hexdigest()
    attributes = {str(name): own_attributes(array.attrs) for name, array in run.variables.items()}
    return root_digest(digests, attributes, run.attrs)
