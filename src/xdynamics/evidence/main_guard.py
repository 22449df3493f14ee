"""Whether the processes that a script starts would run the script again."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import FrameType

from xdynamics.faults import InputError

GUARD = 'if __name__ == "__main__":'


def check_main_guard() -> None:
    """Check that processes may be started here: each imports the script first, all but what stands below its guard.

    Without one, each would start processes of its own, is refused, and is started anew, for ever.

    Raises
    ------
    InputError
    """
    path = getattr(sys.modules.get("__main__"), "__file__", None)
    if path is None:  # a session, which no process imports
        return
    frame: FrameType | None = sys._getframe()  # noqa: SLF001 - as `inspect` reads it, which is dear to import
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") in ("__main__", "__mp_main__"):
            if frame.f_code.co_filename == path and not _is_guarded(path, frame.f_lineno):
                raise InputError(
                    f"'{Path(path).name}' starts the processes of a cluster in line {frame.f_lineno}, and each of them imports"
                    f" the script first and would start them again; put what it does below the line {GUARD}"
                )
            return
        frame = frame.f_back


def _is_guarded(path: str, line: int) -> bool:
    """Whether a statement of a script stands in, or behind, one that asks for `__name__`; so where it cannot be read."""
    try:
        statements = ast.parse(Path(path).read_bytes()).body
    except (OSError, SyntaxError, ValueError):
        return True
    guards = [statement for statement in statements if isinstance(statement, ast.If) and statement.lineno <= line]
    return any(
        isinstance(node, ast.Name) and node.id == "__name__"
        for statement in guards
        for node in ast.walk(statement.test)
    )
