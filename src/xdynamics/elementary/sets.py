"""The sets of elementary functions by name: a run uses one set, and records its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.elementary import first_set
from xdynamics.elementary.functions import FUNCTIONS, NAME
from xdynamics.elementary.numbers import Number

SETS: Mapping[str, Mapping[str, Callable[..., Number]]] = {
    "xdynamics 1": FUNCTIONS | {"tan": first_set.tan, "atan2": first_set.atan2},
    NAME: FUNCTIONS,
}


def kept_set(name: str | None) -> str:
    """Return the set that a record names; the newest if there is none of that name, as for archives with `libm`.

    Examples
    --------
    >>> kept_set("xdynamics 1"), kept_set("libm")
    ('xdynamics 1', 'xdynamics 2')
    """
    return name if name is not None and name in SETS else NAME
