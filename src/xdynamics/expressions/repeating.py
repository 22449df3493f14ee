"""Checks of a traced function: it repeats its result, traced and with numbers, and leaves its argument alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tracing import real
from xdynamics.expressions.tree import Node, text_of
from xdynamics.faults import InputError

CLOSE = 1e-6  # of a value: more than another order of sums and the last digits of elementary functions amount to
NEGLIGIBLE = 1e-9  # of a state, or of a state over the span: a difference that does not count
BEFORE, BEHIND = 24, 40  # characters that are shown around a difference
REMEDY = (
    "what is computed is one expression, so a random draw, a counter, a clock or anything else that changes would be"
    " frozen at its first value: make such numbers before, and hand them over in args"
)
OF_MEMORY = (
    "it remembers what it did, and a right-hand side is of t and y alone: a switch, a stage or a largest value is a regime"
    " or a state of a Model, which events change (`xdynamics help scipy`, what a function remembers);"
    " make numbers that are drawn or counted before, and hand them over in args"
)


class WrittenArgumentError(InputError):
    """A function writes into the state that it is given."""


def check_unwritten(function_name: str, argument_before: Any, argument_after: Any) -> None:
    """Refuse a function that writes into its argument.

    scipy hands over its own arrays: what is written into that of an accepted step stays in the solution, and what is
    written into that of a stage does not.

    Parameters
    ----------
    function_name : str
        The name of the function in messages.
    argument_before, argument_after : array or row
        The argument before the call and after it, traced or of numbers.

    Raises
    ------
    WrittenArgumentError
        With the first number that is another, and the remedy.
    """
    if isinstance(argument_before, np.ndarray):
        pairs = zip(argument_before.ravel().tolist(), argument_after.ravel().tolist(), strict=True)
        changed = [
            i
            for i, (element_before, element_after) in enumerate(pairs)
            if element_before is not element_after and not _are_equal_floats(element_before, element_after)
        ]
        index_words = f"[{changed[0]}]" if changed else ""
    else:
        changed, index_words = [0] if argument_after.value is not argument_before.value else [], ""
    if changed:
        raise WrittenArgumentError(
            f"{function_name} writes into its argument, y{index_words}; solve_ivp would keep that in the solution where a step ends and"
            " nowhere else; begin it with y = np.array(y), and only the rates have what it writes"
        )


def _are_equal_floats(first: Any, second: Any) -> bool:
    """Whether two numbers, complex ones perhaps, are equal, or none is a number."""
    plain = isinstance(first, float | complex) and isinstance(second, float | complex)
    return plain and (first == second or first != first)


def check_repeats(
    function_name: str, words: Sequence[str], first: Sequence[Node], second: Sequence[Node], remedy: str = REMEDY
) -> None:
    """Refuse a function whose two traces with equal names differ.

    Parameters
    ----------
    function_name : str
        The name of the function in messages.
    words : sequence of str
        What each of its values is called.
    first, second : sequence of Node
        The expressions of both traces.
    remedy : str
        What to do, for the message.

    Raises
    ------
    InputError
        With both expressions, from where they differ.
    """
    if len(first) != len(second):
        raise InputError(f"{function_name} returns {len(first)} values and, called again, {len(second)}; {remedy}")
    for word, node, repeated in zip(words, first, second, strict=True):
        if node != repeated:
            texts = _excerpts_at_difference(text_of(node), text_of(repeated))
            raise InputError(
                f"{function_name} gives {word} as '{texts[0]}' and, called again, as '{texts[1]}'; {remedy}"
            )


def check_numbers(
    function_name: str,
    words: Sequence[str],
    nodes: Sequence[Node],
    function: Callable[[], Any],
    values: Mapping[str, float],
    negligible: float,
) -> None:
    """Refuse a function that, called with numbers, gives values other than those of its traced expressions.

    If it raises, or a value is not finite, the function is not refused: the state may be outside its domain.

    Parameters
    ----------
    function_name, words, nodes
        As for `check_repeats`.
    function : callable
        Calls it with the numbers.
    values : mapping of str to float
        The numbers by name.
    negligible : float
        A difference that does not count.

    Raises
    ------
    InputError
        With both numbers, and the time; or if the function writes into its argument.
    """
    with np.errstate(all="ignore"):
        try:
            result = function()
            # made floats here, complex numbers would lose their imaginary parts with a warning; `real` refuses them
            direct = np.asarray(result, None if np.iscomplexobj(result) else float).ravel()
            expected = np.array([evaluate(node, values) for node in nodes])
        except WrittenArgumentError:
            raise
        except Exception:  # noqa: BLE001 - somebody else's code, at a state where it may fail
            return
    direct = real(direct)
    if direct.shape != expected.shape:
        raise InputError(
            f"{function_name} returns {len(nodes)} values for names and {direct.size} for numbers; {REMEDY}"
        )
    with np.errstate(invalid="ignore"):
        is_different = np.abs(direct - expected) > CLOSE * np.maximum(np.abs(direct), np.abs(expected)) + negligible
    for i in np.flatnonzero(is_different & np.isfinite(direct) & np.isfinite(expected)).tolist():
        raise InputError(
            f"{function_name} gives {float(direct[i])!r} for {words[i]} at t = {values['t']:.6g} s, and the expression that it"
            f" wrote down, '{_excerpts_at_difference(text_of(nodes[i]), '')[0]}', gives {float(expected[i])!r} there; {REMEDY}"
        )


def _excerpts_at_difference(first: str, second: str) -> tuple[str, str]:
    """Return excerpts of two texts around the first difference."""
    same = next(
        (i for i, pair in enumerate(zip(first, second, strict=False)) if pair[0] != pair[1]),
        min(len(first), len(second)),
    )
    start = max(0, same - BEFORE)
    return _excerpt(first, start, same), _excerpt(second, start, same)


def _excerpt(text: str, start: int, same: int) -> str:
    end = same + BEHIND
    return f"{'…' if start else ''}{text[start:end]}{'…' if end < len(text) else ''}"
