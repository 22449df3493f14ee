"""The manual's pages on runs, evidence, archives, fits, JSON, precision, and words.

The guide's pages treat runs and their files, events and contacts in a march, evidence, many runs, and fits.

The page `xdynamics help archives` treats runs in files, by time and many together, with xarray alone where that is
enough; `xdynamics help json` the JSON that verbs print; `xdynamics help precision` runs whose numbers have 31 digits;
`xdynamics help words` names of records and of evidence that do not explain themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from xdynamics.documenting.model_pages import wrapped_lines
from xdynamics.documenting.pages import page_text
from xdynamics.evidence.refining.convergence import MEANINGS

ARCHIVES_PAGE = page_text("archives.txt")


FITS_PAGE = page_text("fits.txt")


JSON_PAGE = page_text("json.txt")


RUNS_PAGE = page_text("runs.txt")
MARCHING_PAGE = page_text("marching.txt")
EVIDENCE_PAGE = page_text("evidence.txt")
GRIDS_PAGE = page_text("grids.txt")
STORES_PAGE = page_text("stores.txt")
CLUSTER_PAGE = page_text("cluster.txt")


PRECISION_PAGE = page_text("precision.txt")


# … stands for the name of a quantity, an event or a contact
OF_RECORDS = {
    "row": "an accepted state, along `step`; at an event there are two at one time, event_before and event_after",
    "row_kind": "how a row was reached; a node is a time to land on that was asked for, or a breakpoint of a table",
    "trial": "a step that was rejected; trial_reason says why. An event_substep is not one: the step was cut to find an event",
    "sample": "an evaluation of the forces inside a step, with the state it used; `xdynamics sample` is something else, states at times",
    "error_…": "estimated error of the one step to this row, a local error; how far the row itself is off says `diagnose`",
    "error_norm": "error of a step over what the tolerances allow; steps above 1 are rejected",
    "event_detector": "what found the event: an event of the model, a contact, a friction, or a switch hidden in a force",
    "event_time_uncertainty": "of locating the event on this run alone; the error of the integration is not in it, `refine` has both",
    "step_number": "number of a row in the whole march, from 0: it survives every selection, and what names rows has these numbers",
    "event_row_before": "step_number of the row with the state on arrival; event_row_after: of the one it goes on from",
    "event_offset_…": "shift of a coordinate at an event, by a reset or by a contact that comes to rest",
    "switch": "a kink or jump inside a force, like drag.abs or drag.abs[3]: the zero of what abs, sign, min, max or where turn at",
    "touch": "an event function that reaches zero and turns back; a jump changes sign without passing zero, a pole at infinity",
    "cluster": "several events too close in time to be told apart",
    "rest": "a contact that closes and stays closed; takeoff: it opens; stick and slip: friction comes to hold, or gives way",
    "regime": "the set of forces that act, changed by an event with action = 'switch'",
    "run_outcome": "how the run ended: completed and stopped_by_event are as asked; run_outcome_text says it with t and h",
    "run_h_omega_largest": "largest step times fastest rate of the model: how finely its fastest motion was resolved",
    "run_uncontrolled": "how many variables have an absolute tolerance that lets errors come to 3 % of their size or more",
    "solver_until": "end that was asked for; an event may have ended the run before",
    "math_functions": "whose sin, exp … were used: the package's own, the same bits on every machine",
    "end_memory": "what `extend` needs to go on with the bits of one march",
    "model_toml": "the whole model as text, tables included: the archive alone is enough to march it again; along `document`",
    "content_digest": "sha256 of every variable and attribute but circumstances (versions, dates), which volatile_digest covers",
    "origin": "in memory alone: what the record was when it was marched or read, so that `save` notices an edit",
    "selection": "a part of a run, found again by `reproduce`; derived: data made from one by anything but a march",
    "evidence": "what is made from runs to judge them: refinement, budget, comparison …",
}
OF_EVIDENCE = {
    "level": "one run of a study, by its step or tolerance; from coarse to fine. In a budget the first is the run's own",
    "at": "times that were asked for, along which at_time has them; occurrence: the first, second … meeting of an event",
    "order_…": "observed order: how fast differences fall from level to level; below 0 they grow",
    "limit_…": "where the levels lead with ever smaller steps; nan unless the order can be relied on",
    "uncertainty_…": "of the finest level's number, numerical, at about 95 %; uncertainty_rule_… says where it is from",
    "gate_…": "of a refinement: passed where interpolation is off by no more than the difference to the next level",
    "scaled_difference_…": "difference over difference_scale_…, a size of the quantity that is never zero",
    "verdict_…": "what the levels show about a number, one of the six words below; it is no grade",
    "gate_verdict": "of a certificate: passed, failed, or not_checked, where there were too few draws to tell",
    "passed": "of a gate or case: nothing speaks against the number. The gate `convergence` passes unless a number is"
    " not_converging: beside pre_asymptotic it says that the uncertainty, the wider one, may be relied on",
    "refused": "of a case of the ledger: the method is not defined for it, as velocity Verlet for drag; no failure",
    "residual": "largest difference from a closed form; bound (case_bound): the most it may be; scaled_residual: over its size",
    "term": "one reason why a number may be off: numerical (of the march) or physical (an uncertain input, or a discrepancy)",
    "bound": "of a term: what it contributes at most; numerical_bound is the sum of those of the march",
    "total_rss": "standard uncertainty by all terms: the root of their sum of squares; numerical_rss, physical_rss of a kind",
    "share": "of a term in the variance; all together 100 %, correlated terms share what they have together",
    "standard_uncertainty_doubt": "how far an uncertainty itself may be off, as of few draws; so with every …_doubt",
    "result": "the number as it is written: ± is k times the standard uncertainty, a small one with its power of ten: ± 5.3e-7;"
    " numerical part: the march's bound within; where linear_verdict is not_adequate, the interval that holds its draws",
    "linear_verdict": "whether sums of squares will do, by comparison with draws: adequate, not_adequate, not_checked (draw more)",
    "monte_carlo_shortest": "shortest interval with the coverage among draws; symmetric leaves as many on either side",
    "adequate": "of a fit: its residuals are no more than the data's uncertainty; else budgets refuse the fitted model",
    "at_bound": "1 where an estimate ended on its bound; its uncertainty means nothing then",
    "band_…": "largest minus smallest value over the rows; drift_…: at the end minus at the start",
    "believed_until": "time until which no variable is further from the solution than a tenth of its range",
    "continuity_verdict": "whether each step, recomputed from its row, leads to the next; not the last row, nor jumps at events",
    "continuity_time": "start of the step whose defect is largest by its bound; continuity_steps: how many were recomputed",
    "continuity_defect_…": "largest distance of a recorded state from the recomputed one; continuity_bound_…: what rounding explains",
    "companion": "a second run at a tighter setting, from which the error of the first follows",
    "phase_offset": "phase at the end of a cycle minus that of the reference; negative where the run lags behind",
    "maximum_…": "over the whole run; maximum_…_rule: sampled at a row, interpolated between rows, or located by an event",
    "identical": "1 where two runs agree in every bit; first_row: the first row of a variable that does not",
}
OF_FILES = {
    "verified": "every digest and the seal agree with the data; repacked: another program wrote them, and every number agrees",
    "edited": "a sound file that says something else than was archived; damaged: bytes differ from the seal, or cannot be read",
    "content": "names, dimensions, types, units, values and settings, by value; notes (history, comment, institution) are none",
    "seal": "sha256 over the bytes of a file, at its end; a signature (RUN.nc.sig) says whose it is",
    "reproduce": "marches a run again from its archive and compares every bit; recheck does so with a certificate",
    "segments": "finished parts of a run beside its archive until it is whole; --resume goes on from them, discard removes them",
    "partial": "run.partial.nc: a run that ended badly, beside the archive of one that ended well",
    "ledger": "what a method makes of problems with closed forms, case by case",
    "certificate": "one number with its budget, gates and ledger, made again by recheck; a bundle is a folder with all of it",
}


def words_page() -> Iterator[str]:
    """Yield the lines of the page: each word with its meaning."""
    yield from wrapped_lines(
        "Names that do not explain themselves; … stands for the name of a quantity or an event. All others: help record."
    )
    for title, words in (
        ("Of records", OF_RECORDS),
        ("Of evidence", OF_EVIDENCE),
        ("Verdicts on convergence (verdict_…, level_verdict)", MEANINGS),
        ("Of files and verbs", OF_FILES),
    ):
        yield title
        yield from _word_lines(words)


def _word_lines(words: Mapping[str, str]) -> Iterator[str]:
    width = max(map(len, words))
    for word, meaning in words.items():
        yield from wrapped_lines(f"  {word:{width}}  {meaning}", width + 4)
