"""What each verdict on the convergence of a number means, in words."""

from __future__ import annotations

from xdynamics.evidence.refining.judgements import VERDICTS
from xdynamics.record.flag_words import in_prose

IN_WORDS = (
    "differences of levels fall at the method's order, so that the limit and its uncertainty follow from that order",
    "differences fall, but not yet at the method's order: none is relied on, and the uncertainty is wider for it",
    "levels differ by no more than rounding: finer ones would tell nothing more",
    "locating events, or a switch that steps went over, is as uncertain as levels are apart: the uncertainty has it",
    "the number between steps is as uncertain as levels are apart: the uncertainty has it",
    "differences do not fall, or a value is missing: finer levels are needed before anything is said of the number",
)
MEANINGS = dict(zip(VERDICTS, IN_WORDS, strict=True))


def verdict_text(verdict: str) -> str:
    """Return a verdict with its meaning.

    Examples
    --------
    >>> verdict_text("roundoff")
    'roundoff: levels differ by no more than rounding: finer ones would tell nothing more'
    """
    return f"{in_prose(verdict)}: {MEANINGS[verdict]}"
