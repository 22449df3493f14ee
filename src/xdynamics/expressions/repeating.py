"""Whether a function that was written down as expressions gives the same again: written once more, and with numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import Node, text_of
from xdynamics.faults import InputError

CLOSE = 1e-6  # of a value: more than sums in another order and last digits of elementary functions come to
NEGLIGIBLE = 1e-9  # of a state, or of a state over the span: a difference that does not count
BEFORE, BEHIND = 24, 40  # characters that are shown around a difference
REMEDY = (
    "what is marched is one expression, so a random draw, a counter, a clock or anything else that changes would be"
    " frozen at its first value: make such numbers before, and hand them over in args"
)


def check_repeats(called: str, words: Sequence[str], first: Sequence[Node], second: Sequence[Node]) -> None:
    """Refuse a function that was called twice with the same names and wrote down two things.

    Parameters
    ----------
    called : str
        What it is called.
    words : sequence of str
        What each of its values is.
    first, second : sequence of Node
        What it wrote down.

    Raises
    ------
    InputError
        With both, where they part.
    """
    if len(first) != len(second):
        raise InputError(f"{called} returns {len(first)} values and, called again, {len(second)}; {REMEDY}")
    for word, node, repeated in zip(words, first, second, strict=True):
        if node != repeated:
            texts = _parting(text_of(node), text_of(repeated))
            raise InputError(f"{called} gives {word} as '{texts[0]}' and, called again, as '{texts[1]}'; {REMEDY}")


def check_numbers(
    called: str,
    words: Sequence[str],
    nodes: Sequence[Node],
    function: Callable[[], Any],
    values: Mapping[str, float],
    least: float,
) -> None:
    """Refuse a function that, called with numbers, gives others than the expressions that it wrote down.

    Where it raises, or either is not finite, nothing is said: the state may be outside its domain.

    Parameters
    ----------
    called, words, nodes
        As for `check_repeats`.
    function : callable
        Calls it with the numbers.
    values : mapping of str to float
        The numbers by their names.
    least : float
        A difference that does not count.

    Raises
    ------
    InputError
        With both numbers, and where.
    """
    with np.errstate(all="ignore"):
        try:
            computed = np.asarray(function(), float).ravel()
            expected = np.array([evaluate(node, values) for node in nodes])
        except Exception:  # noqa: BLE001 - somebody else's code, at a state that it need not bear
            return
    if computed.shape != expected.shape:
        raise InputError(f"{called} returns {len(nodes)} values for names and {computed.size} for numbers; {REMEDY}")
    with np.errstate(invalid="ignore"):
        apart = np.abs(computed - expected) > CLOSE * np.maximum(np.abs(computed), np.abs(expected)) + least
    for i in np.flatnonzero(apart & np.isfinite(computed) & np.isfinite(expected)).tolist():
        raise InputError(
            f"{called} gives {float(computed[i])!r} for {words[i]} at t = {values['t']:.6g} s, and the expression that it"
            f" wrote down, '{_parting(text_of(nodes[i]), '')[0]}', gives {float(expected[i])!r} there; {REMEDY}"
        )


def _parting(first: str, second: str) -> tuple[str, str]:
    """Return two texts around the place from which they differ."""
    same = next((i for i, pair in enumerate(zip(first, second, strict=False)) if pair[0] != pair[1]), min(len(first), len(second)))  # fmt: skip
    start = max(0, same - BEFORE)
    return _shortened(first, start, same), _shortened(second, start, same)


def _shortened(text: str, start: int, same: int) -> str:
    end = same + BEHIND
    return f"{'…' if start else ''}{text[start:end]}{'…' if end < len(text) else ''}"
