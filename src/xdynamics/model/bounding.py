"""What the text of a model may hold at most, looked at before it is parsed: a small file can take gigabytes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError

MOST_ENTRIES = 10_000  # keys and headers of a text, or entries of a section; a thousand bodies have some 6,000
MOST_VALUES = 500_000  # of lists
DEEPEST_KEY = 8  # names that dots join

# texts and comments, in which everything else may stand; one that is not closed ends where its line or the file does;
# nothing is given back (`++`): where each letter may be, all their places are kept
_TEXTS = re.compile(r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5}|\Z)|\'\'\'.*?(?:\'{3,5}|\Z)|"(?:[^"\\\n]++|\\.)*+"?|\'[^\'\n]*\'?|#[^\n]*', re.DOTALL)  # fmt: skip
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST_KEY}}}")
_SIZES = "; so many numbers belong into a table"


def parsed(text: str) -> dict[str, Any]:
    """Return what TOML says, unless it is more than any model does.

    Raises
    ------
    InputError
        Naming the limit.
    tomllib.TOMLDecodeError, RecursionError, ValueError
        If it is no TOML.
    """
    check_text(text)
    return tomllib.loads(text)


def check_text(text: str) -> None:
    """Refuse TOML with more in it than any model has.

    Raises
    ------
    InputError
        Naming the limit, with the line where that helps.
    """
    bare = _TEXTS.sub(lambda found: "" if found[0][0] == "#" else "s" + "\n" * found[0].count("\n"), text)
    if found := _DEEP.search(bare):
        line = bare.count("\n", 0, found.start()) + 1
        raise InputError(f"line {line}: a key has over {DEEPEST_KEY} names that dots join, the limit")
    entries = bare.count("=") + bare.count("\n[")
    if entries > MOST_ENTRIES:
        raise InputError(f"it has {entries} entries, over the limit of {MOST_ENTRIES}{_SIZES}")
    values = bare.count(",")
    if values > MOST_VALUES:
        raise InputError(f"its lists have {values} values, over the limit of {MOST_VALUES}; put them into tables")


def excess(entries: Mapping[str, Any]) -> str:
    """Say that a section has more entries than any model has, however they were given; nothing where it has not."""
    return (
        f"has {len(entries)} entries, over the limit of {MOST_ENTRIES}{_SIZES}" if len(entries) > MOST_ENTRIES else ""
    )
