"""Runs in files: written whole or not at all, with a digest for everything, checked on opening."""

from xdynamics.archive.origin import marched
from xdynamics.archive.reading import open_run, verify
from xdynamics.archive.seals import content_digest
from xdynamics.archive.segments import discard, has_segments
from xdynamics.archive.source import check_source
from xdynamics.archive.standing import check_unchanged, selected_like
from xdynamics.archive.streaming import stream
from xdynamics.archive.target import check_target
from xdynamics.archive.writing import save

__all__ = [
    "check_source",
    "check_target",
    "check_unchanged",
    "content_digest",
    "discard",
    "has_segments",
    "marched",
    "open_run",
    "save",
    "selected_like",
    "stream",
    "verify",
]
