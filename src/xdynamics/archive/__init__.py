"""Runs in files: written whole or not at all, with a digest for everything, checked on opening."""

from xdynamics.archive.file import check_source, check_target, open_run, save, stream, verify
from xdynamics.archive.seals import content_digest

__all__ = ["check_source", "check_target", "content_digest", "open_run", "save", "stream", "verify"]
