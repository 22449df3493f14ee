"""Lines of help no wider than a window usually is."""

from __future__ import annotations

from textwrap import wrap

WIDTH = 100  # of a line


def wrapped_lines(text: str, hang: int = 0) -> list[str]:
    """Return lines of at most `WIDTH` characters, those after the first indented by `hang`; words stay whole.

    Examples
    --------
    >>> wrapped_lines("  name  " + "many " * 20, 8)
    ['  name  many many many many many many many many many many many many many many many many many many', '        many many']
    """
    return wrap(text, WIDTH, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False)
