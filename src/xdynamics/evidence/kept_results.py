"""Results of tasks in a folder, by which evidence from many marches goes on where it was interrupted.

A result is a file that is named as its task, so by a digest of all that it depends on; it is written whole or not at all,
with a digest of its own. One of another version, or a damaged one, is made again.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.folder_store import made_folder, store_of, taking_name
from xdynamics.archive.store import Place, TakenError, location_of
from xdynamics.evidence.cluster import environment
from xdynamics.evidence.stage_tasks import REMEMBERED, Task
from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.lazy_imports import cached_property

if TYPE_CHECKING:
    import xarray as xr

SUFFIX = ".json"
MOST = 100_000_000  # bytes of a result
_WRITTEN: set[Place] = set()  # by this process


@dataclass(frozen=True)
class ResultForm:
    """How results of a kind are encoded as lists, texts and numbers, and decoded."""

    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]


NUMBERS = ResultForm(np.ndarray.tolist, partial(np.array, dtype=float))


class Keep:
    """A folder of results.

    Parameters
    ----------
    folder : Path or Address
    """

    def __init__(self, folder: Place) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:  # what is there is looked up anew in another process
        return Keep, (self.folder,)

    @cached_property
    def present(self) -> set[str]:
        """The names of the results that were there when it was first looked."""
        return {location.name for location in store_of(self.folder).names(self.folder)}

    @classmethod
    def of(cls, keep: str | Path | None) -> Keep | None:
        """Return the folder that a user names, made if it does not exist; None for none.

        Raises
        ------
        InputError
            If it cannot be a folder.
        """
        return None if keep is None else cls(folder_named(keep))

    def task(self, task: Task, form: ResultForm) -> Task:
        """Return a task whose result is stored in the folder; a stored result is read, and nothing is marched."""
        location = self.folder / f"{task.name}{SUFFIX}"
        if location.name in self.present:
            with suppress(ArchiveError, InputError, OSError, ValueError, KeyError, TypeError, RecursionError):
                return replace(
                    task, call=partial(_unchanged_result, form.decode(_read_result(location))), needs=(), steps=0.0
                )
        return replace(task, call=partial(_keep_result, task.call, form, location), lasting=False)

    def blocks(self, numbers: xr.DataArray) -> xr.DataArray:
        """Return lazy numbers along one dimension, with every block stored in the folder."""
        import dask.array

        da: Any = dask.array  # its functions are not typed
        data, parts = numbers.data, []
        for k in range(data.numblocks[0]):
            name = f"block-{sha256(f'{data.name} {k}'.encode()).hexdigest()[:32]}"
            task = self.task(Task(name, _unchanged_result), NUMBERS)
            if isinstance(task.call, partial) and task.call.func is _unchanged_result:
                parts.append(da.from_array(task.call(), chunks=-1, name=f"{name}-kept"))
            else:
                location = self.folder / f"{name}{SUFFIX}"
                keeping = partial(_keep_result, _unchanged_result, NUMBERS, location)
                # with a meta of its own dask does not try it on an empty block, which would be kept
                parts.append(data.blocks[k].map_blocks(keeping, dtype=data.dtype, meta=np.zeros(0, data.dtype)))
        return numbers.copy(data=da.concatenate(parts))


def folder_named(keep: Any) -> Any:
    """Return a folder to keep results or runs in, made if it does not exist.

    Raises
    ------
    InputError
        If it cannot be a folder.
    """
    if not isinstance(keep, str | Path) or not str(keep):
        raise InputError(f"keep is {keep!r}, needs the name of a folder, like 'kept' or 's3://bucket/kept'")
    return made_folder(location_of(keep))


def _unchanged_result(result: Any) -> Any:
    return result


def _keep_result(call: Callable[..., Any], form: ResultForm, location: Place, *needs: Any) -> Any:
    """Return a result, remember it and write it to its file; two processes with one task write equal files."""
    result = REMEMBERED.result(location.stem, partial(call, *needs))
    if location not in _WRITTEN or store_of(location).kind(location) is not None:
        content = json.dumps(form.encode(result))
        with suppress(TakenError), taking_name(location) as new:
            new.part.write_text(
                json.dumps({"made_by": _made_by(), "digest": _content_digest(content), "result": content})
            )
        _WRITTEN.add(location)
    return result


def _read_result(location: Place) -> Any:
    """Return the result in a file, refused if it is of another version or damaged.

    Raises
    ------
    ValueError
        If it is damaged, or of another version.
    """
    document = json.loads(store_of(location).content(location, MOST))
    if document["made_by"] != _made_by() or document["digest"] != _content_digest(document["result"]):
        raise ValueError(f"'{location}' is of another version, or damaged")
    return json.loads(document["result"])


def _content_digest(content: str) -> str:
    return sha256(content.encode()).hexdigest()


@lru_cache(maxsize=1)
def _made_by() -> dict[str, str]:
    return environment()
