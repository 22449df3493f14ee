"""Runs in files: written whole or not at all, with a digest for everything, checked on opening."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.runtime.lazy_imports import entrance

if TYPE_CHECKING:
    from xdynamics.archive.content import content_digest
    from xdynamics.archive.folder_store import check_archive, check_target
    from xdynamics.archive.integrity import (
        check_states,
        check_unchanged,
        digest_of_run,
        evaluated,
        marched,
        selected_like,
        without_stale_units,
    )
    from xdynamics.archive.reading import open_run, verify
    from xdynamics.archive.segments import clear_rest, discard, has_segments, stream
    from xdynamics.archive.store import check_source
    from xdynamics.archive.writing import save, save_many

# name -> its room, entered when the name is first used: who only reads, like the examining process, loads no engine
_ROOMS = {
    "check_source": "store",
    "clear_rest": "segments",
    "check_archive": "folder_store",
    "check_states": "integrity",
    "check_target": "folder_store",
    "check_unchanged": "integrity",
    "content_digest": "content",
    "digest_of_run": "integrity",
    "discard": "segments",
    "evaluated": "integrity",
    "has_segments": "segments",
    "marched": "integrity",
    "open_run": "reading",
    "save": "writing",
    "save_many": "writing",
    "selected_like": "integrity",
    "stream": "segments",
    "verify": "reading",
    "without_stale_units": "integrity",
}

__all__ = [
    "check_archive",
    "check_source",
    "check_states",
    "check_target",
    "check_unchanged",
    "clear_rest",
    "content_digest",
    "digest_of_run",
    "discard",
    "evaluated",
    "has_segments",
    "marched",
    "open_run",
    "save",
    "save_many",
    "selected_like",
    "stream",
    "verify",
    "without_stale_units",
]

__getattr__ = entrance(__name__, _ROOMS)
