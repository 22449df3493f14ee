"""Limits on the text of a model, checked before it is parsed: parsing a small file can take gigabytes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units.rounded import read_decimal

MOST_ENTRIES = 10_000  # keys and headers of a text, or entries of a section; a thousand bodies have some 6,000
LARGEST = 20_000_000  # characters
MOST_VALUES = 500_000  # of lists
LARGEST_RECORDED, MOST_RECORDED = 70_000_000, 2_000_000  # of the text of a record, which has its tables in it
DEEPEST_KEY = 8  # names that dots join

# strings and comments, which may contain anything; one that is not closed ends with its line or the file;
# quantifiers are possessive (`++`): a backtracking one keeps every position it might return to
_TEXTS = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5}|\Z)|\'\'\'.*?(?:\'{3,5}|\Z)|"(?:[^"\\\n]++|\\.)*+"?|\'[^\'\n]*\'?|#[^\n]*',
    re.DOTALL,
)
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST_KEY}}}")
_SIZES = "; so many numbers belong into a table"
_OF_RECORDS = "; the model_toml of a record is read by Model.from_record"


def parse_model_text(text: str, *, recorded: bool = False) -> dict[str, Any]:
    """Parse TOML, unless it exceeds the limits of a model, or of a record's.

    Raises
    ------
    InputError
        Naming the limit.
    tomllib.TOMLDecodeError, RecursionError, ValueError
        If the text is not TOML.
    """
    check_text(text, recorded=recorded)
    return tomllib.loads(text, parse_float=read_decimal)


def check_text(text: str, *, recorded: bool = False) -> None:
    """Refuse TOML text larger than any model needs.

    Raises
    ------
    InputError
        Naming the limit, with the line where that helps.
    """
    largest, most_values = (LARGEST_RECORDED, MOST_RECORDED) if recorded else (LARGEST, MOST_VALUES)
    remedy = "" if recorded else _OF_RECORDS
    if len(text) > largest:
        raise InputError(f"it has {len(text)} characters, over the limit of {largest}{_SIZES}{remedy}")
    bare = _TEXTS.sub(lambda match: "" if match[0][0] == "#" else "s" + "\n" * match[0].count("\n"), text)
    entries = bare.count("=") + bare.count("\n[")
    if entries > MOST_ENTRIES:
        raise InputError(f"it has {entries} entries, over the limit of {MOST_ENTRIES}{_SIZES}")
    values = bare.count(",")
    if values > most_values:
        raise InputError(
            f"its lists have {values} values, over the limit of {most_values}; put them into tables{remedy}"
        )
    if match := _DEEP.search(bare):
        line = bare.count("\n", 0, match.start()) + 1
        raise InputError(f"line {line}: a key has over {DEEPEST_KEY} names that dots join, the limit")


def excess(entries: Mapping[str, Any]) -> str:
    """Return the message that a section has too many entries, from a file or from Python; empty if it has not."""
    return (
        f"has {len(entries)} entries, over the limit of {MOST_ENTRIES}{_SIZES}" if len(entries) > MOST_ENTRIES else ""
    )
