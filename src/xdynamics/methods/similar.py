"""The methods that a name may have meant: by spelling, by synonyms, by what other programs call them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

MOST = 3  # methods that a message names
# what other programs call a method, or one that serves in its place
ELSEWHERE = {
    "radau_iia": (
        "bdf",
        "lsoda",
        "vode",
        "cvode",
        "ode15s",
        "ode23s",
        "rosenbrock",
        "implicit_euler",
        "backward_euler",
    ),
    "dormand_prince": ("rkf45", "tsit5", "rkdp", "runge_kutta_fehlberg"),
    "bogacki_shampine": ("rk23", "ode23"),
    "dop853": ("ode113", "rk8", "adams", "dopri8"),
    "midpoint": ("rk2",),
    "heun": ("rk2", "trapezoid"),
    "rk4": ("runge_kutta",),
    "velocity_verlet": ("stormer", "newmark", "symplectic"),
    "forest_ruth": ("yoshida4", "symplectic4"),
}


def similar(name: str, synonyms_by_method: Mapping[str, Sequence[str]]) -> str:
    """Return the question whether one of some methods was meant, as a part of a message; empty if none is like it.

    Parameters
    ----------
    name : str
        That is the name of none of them.
    synonyms_by_method : mapping of str to sequence of str
        The methods that may be taken, with their synonyms.

    Examples
    --------
    >>> similar("RK4", {"rk4": ()}), similar("ode15s", {"rk4": (), "radau_iia": ()})
    ("did you mean 'rk4'? ", "did you mean 'radau_iia'? ")
    """
    word = _letters_and_digits(name)
    synonyms = {
        key: [*map(_letters_and_digits, (*also, *ELSEWHERE.get(key, ())))] for key, also in synonyms_by_method.items()
    }
    candidate_lists = (
        [key for key in synonyms_by_method if word in (_letters_and_digits(key), *synonyms[key])],
        [key for key in synonyms_by_method if word in _letters_and_digits(key)],
        [key for key in synonyms_by_method if any(word in synonym for synonym in synonyms[key])],
        get_close_matches(name.lower(), [*synonyms_by_method], n=1),
    )
    meant = next(filter(None, candidate_lists), []) if len(word) > 1 else []
    return f"did you mean {' or '.join(repr(key) for key in meant[:MOST])}? " if meant else ""


def _letters_and_digits(name: str) -> str:
    """Return a name without capitals and signs."""
    return re.sub("[^a-z0-9]", "", name.lower())
