"""Reasons for rejected trials and outcomes of runs: one vocabulary, from the loop to the record."""

from __future__ import annotations

from dataclasses import dataclass

from xdynamics import schema

SOUND, RUNNING = -1, -1
# ends of a run without a rejected trial; numbered after the reasons of trials
(
    COMPLETED,
    STOPPED,
    STEP_TOO_SMALL,
    STEP_LIMIT,
    NONFINITE_OBSERVABLE,
    INTERRUPTED,
    EVENT_AT_ZERO,
    CONTACT_PENETRATED,
    SLIDING_MODE,
    CONTACT_INCONSISTENT,
    CONSTRAINT_VIOLATED,
    EVENT_ACCUMULATION,
    CONTACT_VIOLATED,
    AT_SWITCH,  # no end: the march waits for the forces with which it goes on along a switch, or leaves it
) = range(len(schema.TRIAL_REASONS), len(schema.TRIAL_REASONS) + 14)


@dataclass(frozen=True)
class Outcome:
    """A way for a run to end.

    Attributes
    ----------
    word : str
        Value of `run_outcome`.
    sentence : str
        Template of `run_outcome_text`.
    good : bool
        Whether the run did what was requested.
    """

    word: str
    sentence: str
    good: bool = False


_FINITE = "at t = {t}, h = {h}: {cause}; the last finite state is kept"
_ACCEPTED = "at t = {t}, h = {h}: {cause}; the last accepted state is kept"
NONFINITE = Outcome("nonfinite_state", _FINITE)

# by what ended the run: the reason of a trial that could not be repeated, or one of the numbers above
OUTCOMES: dict[int, Outcome] = {
    schema.REASON_ERROR: Outcome("error_test_at_minimum_step", _ACCEPTED),
    schema.REASON_NONFINITE: NONFINITE,
    schema.REASON_DOMAIN: NONFINITE,
    schema.REASON_NEWTON: Outcome("equations_unsolved", _ACCEPTED),
    schema.REASON_EVENT_FUNCTION: Outcome("nonfinite_event", _FINITE),
    COMPLETED: Outcome("completed", "reached t = {t}", good=True),
    STOPPED: Outcome("stopped_by_event", "event {cause} stopped the run at t = {t}", good=True),
    STEP_TOO_SMALL: Outcome("step_below_spacing", "at t = {t}, h = {h}: {cause}"),
    STEP_LIMIT: Outcome("step_limit", "at t = {t}, h = {h}: {cause}"),
    NONFINITE_OBSERVABLE: Outcome("nonfinite_observable", _FINITE),
    EVENT_AT_ZERO: Outcome(
        "event_at_zero", "reached t = {t}, and {cause} from the start throughout: it tells of nothing"
    ),
    schema.REASON_CONTACT: Outcome("contact_undetermined", _ACCEPTED),
    CONTACT_PENETRATED: Outcome("contact_penetrated", "at t = {t}: {cause}"),
    CONTACT_INCONSISTENT: Outcome("contact_inconsistent", _ACCEPTED),
    CONSTRAINT_VIOLATED: Outcome("constraint_violated", "at t = {t}: {cause}"),
    SLIDING_MODE: Outcome("sliding_mode", "at t = {t}: {cause}"),
    AT_SWITCH: Outcome("sliding_mode", "at t = {t}: {cause}"),
    EVENT_ACCUMULATION: Outcome("event_accumulation", "at t = {t}: {cause}"),
    CONTACT_VIOLATED: Outcome("contact_violated", "at t = {t}: {cause}"),
    INTERRUPTED: Outcome("interrupted", "interrupted at t = {t}; the rows up to there are kept"),
}

# refinements of a state that is not finite, distinguished after the march from the failed step
NONFINITE_FORCE = Outcome("nonfinite_force", _FINITE)
OUTSIDE_TABLE = Outcome("outside_drive_table", _FINITE)

WORDS = {outcome.word: outcome for outcome in (*OUTCOMES.values(), NONFINITE_FORCE, OUTSIDE_TABLE)}
GOOD = frozenset(word for word, outcome in WORDS.items() if outcome.good)
