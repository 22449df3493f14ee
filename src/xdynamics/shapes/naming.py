"""Names of single elements: ``r·Jupiter·x`` inside, ``r[Jupiter, x]`` wherever people read and write it.

The dot is a letter of no name in a model file, and one of Python's identifiers: an element is a name like any other.
Words before a name stay before it: the velocity of ``r·Jupiter·x`` is ``v_r·Jupiter·x``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

DOT = "·"
_ELEMENT = re.compile(rf"([A-Za-z0-9_.]+){DOT}([A-Za-z0-9_]+(?:{DOT}[A-Za-z0-9_]+)*)")
_SPOKEN = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\[\s*([A-Za-z0-9_]+(?:\s*,\s*[A-Za-z0-9_]+)*)\s*\]")


def element(name: str, labels: Iterable[str]) -> str:
    """Return the name of an element from the quantity's and its labels.

    Examples
    --------
    >>> element("r", ["Jupiter", "x"]), element("g", [])
    ('r·Jupiter·x', 'g')
    """
    return DOT.join([name, *labels])


def parted(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the quantity's name and the labels of an element.

    Examples
    --------
    >>> parted("error_r·Jupiter·x"), parted("time")
    (('error_r', ('Jupiter', 'x')), ('time', ()))
    """
    whole, *labels = name.split(DOT)
    return whole, tuple(labels)


def spoken(text: str) -> str:
    """Return a text with elements as people write them.

    Examples
    --------
    >>> spoken("initial value of 'v_r·Jupiter·x' is missing")
    "initial value of 'v_r[Jupiter, x]' is missing"
    """
    return _ELEMENT.sub(lambda match: f"{match[1]}[{', '.join(match[2].split(DOT))}]", text) if DOT in text else text


def written(text: str) -> str:
    """Return a text with elements as they are named inside; the inverse of `spoken`.

    Examples
    --------
    >>> written("r[Jupiter, x]"), written("u[0]"), written("g")
    ('r·Jupiter·x', 'u·0', 'g')
    """
    return _SPOKEN.sub(lambda match: element(match[1], re.split(r"\s*,\s*", match[2])), text) if "[" in text else text
