"""Errors of wrong input: one error names every fault found."""

from __future__ import annotations

import contextlib
import inspect
import re
import unicodedata
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

_OURS = (str(Path(__file__).parent), contextlib.__file__)  # the latter is between a context manager and its caller
MOST_LISTED = 20  # faults that a message shows; an error holds them all
MOST_NAMED = 10  # names that a sentence lists
MOST_SHOWN = 120  # characters of a value
MOST_SOUGHT = 200  # faults of one input, after which it is given up
# controls, marks of direction and other characters without a shape, halves of pairs, ends of lines and paragraphs
UNSEEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


DOT = "·"  # in names of elements of quantities with dimensions
# both begin where a word does: from each letter of a long word they would look for its end again
_SPOKEN = re.compile(r"(?<![A-Za-z0-9_])([A-Za-z_][A-Za-z0-9_]*)\[\s*([A-Za-z0-9_]+(?:\s*,\s*[A-Za-z0-9_]+)*)\s*\]")
_LABEL = "[A-Za-z0-9_]+?"  # what a record says of an extreme follows the last label: the whole is `maximum_r_time`
_ELEMENT = re.compile(
    rf"(?<![A-Za-z0-9_.])([A-Za-z0-9_.]+){DOT}({_LABEL}(?:{DOT}{_LABEL})*)(_time|_rule|_uncertainty|)(?![A-Za-z0-9_{DOT}])"
)
_NUMBER = re.compile(r"\d[\d.e+-]*")
_ENDLESS = re.compile(r"(?<!\S)(\S{100})\S{900,}")  # a word of a file that no terminal shows


def display_text(text: str) -> str:
    """Return a text with elements as people write them.

    Examples
    --------
    >>> display_text("initial value of 'v_r·Jupiter·x' is missing")
    "initial value of 'v_r[Jupiter, x]' is missing"
    >>> display_text("maximum_r·0·x_time = 4.63 s")
    'maximum_r_time[0, x] = 4.63 s'
    """
    return (
        _ELEMENT.sub(lambda match: f"{match[1]}{match[3]}[{', '.join(match[2].split(DOT))}]", text)
        if DOT in text
        else text
    )


def internal_text(text: str) -> str:
    """Return a text with elements as they are named inside; the inverse of `display_text`.

    Examples
    --------
    >>> internal_text("r[Jupiter, x]"), internal_text("u[0]"), internal_text("g")
    ('r·Jupiter·x', 'u·0', 'g')
    """
    return (
        _SPOKEN.sub(lambda match: DOT.join([match[1], *re.split(r"\s*,\s*", match[2])]), text) if "[" in text else text
    )


def escaped(text: str, *, lines: bool = False) -> str:
    r"""Escape a text for a terminal: invisible and control characters are written out.

    Parameters
    ----------
    text : str
    lines : bool
        Whether newlines and tabs are meant, as in a description or in equations.

    Examples
    --------
    >>> print(escaped("ball\x1b[2J\nverified"))
    ball\x1b[2J\nverified
    """
    if text.isascii() and text.isprintable():
        return text
    meant = "\n\t" if lines else ""
    return "".join(
        (
            character
            if character in meant or unicodedata.category(character) not in UNSEEN
            else character.encode("unicode_escape").decode()
        )
        for character in text
    )


class InputError(ValueError):
    """Something handed over is wrong; nothing was computed or written.

    Parameters
    ----------
    message : str
        What is wrong, its value, what was needed and the remedy. Its lines are those of `numbered_lines`, and one that may
        follow them; whatever else names and values of a file would do to a terminal is written out.
    faults : tuple of str
        The single faults, when several were found in one input.
    """

    def __init__(self, message: str, faults: tuple[str, ...] = ()) -> None:
        fault_lines = numbered_lines(faults)
        leading_text, matched_lines, trailing_text = (
            message.partition(fault_lines) if fault_lines else (message, "", "")
        )
        line = "\n" if matched_lines and trailing_text.startswith("\n") else ""
        text = display_text(escaped(leading_text) + matched_lines + line + escaped(trailing_text.removeprefix(line)))
        super().__init__(text)
        self.faults = tuple(display_text(escaped(fault)) for fault in faults) or (text,)


class StabilityWarning(UserWarning):
    """A fixed step is beyond the method's stability limit for the model at its start."""


class AccuracyWarning(UserWarning):
    """The numbers of a run may be worth less than they look; its outcome says the same."""


class ResumeWarning(UserWarning):
    """A run that was to be resumed goes on from farther back than one would expect, or could not be resumed later."""


class KindWarning(UserWarning):
    """An archive is whole, and is no run but a selection of one or derived data."""


class EditedWarning(UserWarning):
    """What an archive holds was changed since it was archived, and is no longer what was marched."""


class SignatureWarning(UserWarning):
    """A signature is valid, but covers less than the whole file."""


class PartialRunWarning(UserWarning):
    """A run that ended badly was written beside the archive of a complete one, which stays."""


class ModelError(InputError):
    """A model statement cannot be marched as it stands."""


class ArchiveError(InputError):
    """A file is damaged or was edited, is no run archive, or cannot be written.

    Parameters
    ----------
    message, faults
        As of `InputError`.
    verdict : str
        ``edited`` or ``damaged`` where digests say so, else empty.
    """

    def __init__(self, message: str, faults: tuple[str, ...] = (), verdict: str = "") -> None:
        super().__init__(message, faults)
        self.verdict = verdict


def warn(message: str, category: type[Warning]) -> None:
    """Warn at the line of the caller's that led into this package."""
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_code.co_filename.startswith(_OURS):
        level, frame = level + 1, frame.f_back
    warnings.warn(display_text(message), category, stacklevel=level)


def first_names(names: Iterable[str]) -> str:
    """List the first ten names and count the others."""
    all_names = [*names]
    further_count = len(all_names) - MOST_NAMED
    return ", ".join(all_names[:MOST_NAMED]) + (f" and {further_count} more" if further_count > 0 else "")


def brief_repr(value: object) -> str:
    """Write a value as Python does, in one line, cut short where it is long.

    Examples
    --------
    >>> brief_repr([1, 2]), brief_repr("a" * 200)
    ('[1, 2]', "'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa …")
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN // 2]} …"


def numbered_lines(faults: Iterable[str]) -> str:
    """Print faults as numbered lines, to follow a colon."""
    lines = [f"\n  {n}. {escaped(fault)}" for n, fault in enumerate(faults, 1)]
    further_count = len(lines) - MOST_LISTED
    return "".join(lines if further_count <= 1 else [*lines[:MOST_LISTED], f"\n  … and {further_count} more"])


def merge_similar_faults(faults: Iterable[str]) -> list[str]:
    """Return faults with one in the place of those that differ in the element, and in numbers, alone.

    Examples
    --------
    >>> merge_similar_faults(["mass of 'u·0' is -1", "mass of 'u·1' is -2", "time runs back"])
    ["mass of 'u·0' is -1; likewise for 1 more", 'time runs back']
    """
    similar_faults: dict[str, list[str]] = {}
    for fault in faults:
        internal_fault = internal_text(fault)
        similar_faults.setdefault(
            _NUMBER.sub("", _ELEMENT.sub(r"\1", internal_fault)) if DOT in internal_fault else fault, []
        ).append(fault)
    return [
        first + (f"; likewise for {len(further_faults)} more" if further_faults else "")
        for first, *further_faults in similar_faults.values()
    ]


class Ledger:
    """Gathers the faults of one input, to raise them together.

    Examples
    --------
    >>> ledger = Ledger("model 'ball'", ModelError)
    >>> with ledger.entry("parameter 'm'"):
    ...     raise InputError("value 'x' is no number")
    >>> ledger.raise_faults()
    Traceback (most recent call last):
    xdynamics.faults.ModelError: model 'ball': parameter 'm': value 'x' is no number
    """

    def __init__(self, subject: str, error: type[InputError] = InputError) -> None:
        self.subject = subject
        self.error = error
        self.faults: list[str] = []

    def note(self, fault: str) -> None:
        """Write down one fault; no more are looked for where there are very many."""
        self.faults.append(_ENDLESS.sub(r"\1…", fault))
        if len(self.faults) >= MOST_SOUGHT:
            self.raise_faults()

    @contextlib.contextmanager
    def entry(self, entry_subject: str) -> Iterator[None]:
        """Turn an `InputError` raised inside into faults of `entry_subject`."""
        try:
            yield
        except InputError as error:
            self.faults.extend(_ENDLESS.sub(r"\1…", f"{entry_subject}: {fault}") for fault in error.faults)
            if len(self.faults) >= MOST_SOUGHT:
                self.raise_faults()

    def raise_faults(self) -> None:
        """Raise the gathered faults as one error, if there are any.

        Raises
        ------
        InputError
            Of the ledger's class, with every fault.
        """
        if not self.faults:
            return
        different = merge_similar_faults(self.faults)
        if len(different) == 1:
            raise self.error(f"{self.subject}: {different[0]}", tuple(self.faults))
        raise self.error(f"{self.subject} has {len(different)} faults:{numbered_lines(different)}", tuple(self.faults))
