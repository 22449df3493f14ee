"""The texts of the manual, which stand beside the package's rooms as Markdown."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parents[1] / "manual"


def manual_text(file: str) -> str:
    """Return a text of the manual.

    Parameters
    ----------
    file : str
        Its name in the folder, like ``scipy.md``.

    Examples
    --------
    >>> manual_text("scipy.md").splitlines()[0]
    '# Coming from scipy: functions as for solve_ivp'
    """
    return (FOLDER / file).read_text(encoding="utf-8")


def has_text(file: str) -> bool:
    """Whether the manual has a text of that name."""
    return (FOLDER / file).is_file()
