"""How a run can end: every way has a word, a code and a sentence."""

from __future__ import annotations

from dataclasses import dataclass

RUNNING, COMPLETED, STOPPED, NONFINITE, NONFINITE_EVENT, STEP_TOO_SMALL, INTERRUPTED, NONFINITE_OBSERVABLE = range(8)
ERROR_AT_MINIMUM, UNSOLVED, STEP_LIMIT = range(8, 11)


@dataclass(frozen=True)
class Outcome:
    """A way for a run to end.

    Attributes
    ----------
    word : str
        What stands in `run_outcome`.
    sentence : str
        What stands in `run_outcome_text`, with fields to fill.
    good : bool
        Whether the run did what was asked.
    """

    word: str
    sentence: str
    good: bool = False


OUTCOMES: dict[int, Outcome] = {
    COMPLETED: Outcome("completed", "reached t = {t} s", good=True),
    STOPPED: Outcome("stopped_by_event", "event {cause} stopped the run at t = {t} s", good=True),
    NONFINITE: Outcome("nonfinite_state", "at t = {t} s, h = {h} s: {cause}; the last finite state is kept"),
    NONFINITE_EVENT: Outcome("nonfinite_event", "at t = {t} s, h = {h} s: {cause}; the last finite state is kept"),
    NONFINITE_OBSERVABLE: Outcome("nonfinite_observable", "at t = {t} s, h = {h} s: {cause}; the last finite state is kept"),
    STEP_TOO_SMALL: Outcome("step_below_spacing", "at t = {t} s, h = {h} s: {cause}"),
    ERROR_AT_MINIMUM: Outcome("error_test_at_minimum_step", "at t = {t} s, h = {h} s: {cause}; the last accepted state is kept"),
    UNSOLVED: Outcome("equations_unsolved", "at t = {t} s, h = {h} s: {cause}; the last accepted state is kept"),
    STEP_LIMIT: Outcome("step_limit", "at t = {t} s, h = {h} s: {cause}"),
    INTERRUPTED: Outcome("interrupted", "interrupted at t = {t} s; the rows up to there are kept"),
}  # fmt: skip

# refinements of NONFINITE, told apart after the march from the state that failed
NONFINITE_FORCE = Outcome("nonfinite_force", OUTCOMES[NONFINITE].sentence)
OUTSIDE_TABLE = Outcome("outside_drive_table", OUTCOMES[NONFINITE].sentence)

WORDS = {one.word: one for one in (*OUTCOMES.values(), NONFINITE_FORCE, OUTSIDE_TABLE)}
