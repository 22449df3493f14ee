"""The sets of elementary functions by name: a run uses one set, and records its name.

Each function is one sequence of operations, for floats, arrays and written programs alike, and at most 1 ulp from the
true value. In place of a branch both results are computed and one is chosen; work that few arguments need is skipped by
`usually`. Reduction and polynomials are those of fdlibm (Ng 1993), tables as Tang proposed (1989,
doi:10.1145/63522.214389), and rounding errors are kept as a second number (Dekker 1971, doi:10.1007/BF01397083).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.elementary import first_set
from xdynamics.elementary.circular import acos, asin, atan, atan2, cos, sin, sin_cos, tan
from xdynamics.elementary.exponential import cosh, exp, hypot, log, power, sinh, tanh
from xdynamics.elementary.numbers import Number

NAME = "xdynamics 2"  # of this set: a different order of operations is a different set; `sets` keeps the older ones

PAIRS = {"sin": ("sin_cos", 0), "cos": ("sin_cos", 1)}  # functions that are cheaper when computed together
TOGETHER: dict[str, Callable[[Number], tuple[Number, ...]]] = {"sin_cos": sin_cos}
FUNCTIONS: dict[str, Callable[..., Number]] = {
    "sin": sin, "cos": cos, "tan": tan, "asin": asin, "acos": acos, "atan": atan, "atan2": atan2, "sinh": sinh,
    "cosh": cosh, "tanh": tanh, "exp": exp, "log": log, "power": power, "hypot": hypot,
}  # fmt: skip


SETS: Mapping[str, Mapping[str, Callable[..., Number]]] = {
    "xdynamics 1": FUNCTIONS | {"tan": first_set.tan, "atan2": first_set.atan2},
    NAME: FUNCTIONS,
}


def kept_set(name: str | None) -> str:
    """Return the set that a record names; the newest if that name is unknown, as for archives with `libm`.

    Examples
    --------
    >>> kept_set("xdynamics 1"), kept_set("libm")
    ('xdynamics 1', 'xdynamics 2')
    """
    return name if name is not None and name in SETS else NAME
