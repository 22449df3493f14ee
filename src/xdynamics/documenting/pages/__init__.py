"""The texts of the guide's pages, as they are printed: one file for each.

No line is wider than a window usually is.
"""

from __future__ import annotations

from pathlib import Path


def page_text(file: str) -> str:
    """Return the text of a page.

    Parameters
    ----------
    file : str
        Its name in this folder, like ``solve.txt``.

    Examples
    --------
    >>> page_text("solve.txt").splitlines()[1]
    'returns a run.'
    """
    return (Path(__file__).parent / file).read_text(encoding="utf-8")
