"""One token of the source is made wrong at a time; the tests that touch it are to find it.

    python tests/mutation.py                                      all that is listed in TOUCHED
    python tests/mutation.py units/reading.py --most 40 --seed 1  a sample of one file: of 40 in evidence, budgeting, units
                                                                  and march/events 34 are to be found
    python tests/mutation.py march/events/root_finding.py --lines 38 40        all mutants of some lines

A mutant is compiled in memory and takes the place of its module in a forked process: no file is ever changed, and the
libraries are imported once. Tests that start processes of their own do not see it. What is compiled by numba runs as
plain Python here; what prints laws prints each anew, and none is kept. Lines of a program that stand in a text, as
those of step control, are made wrong like the source's own. A mutant that makes the tests hang is found. A file's own doctests are tried before its tests. What
only guards (`strict` of a zip whose parts are equally long) or is only shown (`repr` of a field) is left as it is.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

HERE = Path(__file__).parent
SOURCE = HERE.parent / "src" / "xdynamics"
IMPORTED = (
    "pytest",
    "hypothesis",
    "numpy",
    "xarray",
    "dask.array",
    "netCDF4",
    "numba",
    "llvmlite.binding",
    "scipy.interpolate",
    "pandas",
)
AGAIN = "-Wignore::pytest.PytestAssertRewriteWarning"  # a second call of pytest finds its plugins imported
EXAMPLES = (
    "--assert=plain",
    "-opython_classes=",
    "-opython_functions=",
)  # doctests of a module, and no tests of its own
MEMORY = 8 << 30
PATIENCE = 5.0  # times what the tests take on the source as it is
LEAST = 5.0  # s of the processor that a group of tests may have in any case

# the tests that touch a file, the quickest first; each may be followed by a choice, as for -k
EVENTS = "event and not outside and not many or root or stop_at or bracket"
MANY = "test_march.py -k many_events"
ENCLOSED = "test_enclosures.py -k rows_of or hull or tight or value or waves or poles or undefined or between"
PHASES = "test_phases.py -k not hand_over"  # which is of what is compiled
CLASSES = "test_isolation.py -k walls or slab or (classes and long and not (63 or 318))"
CONTROL = "first_step or norm or keep_to or growth or own_step or near or every_ or collision or minimum or step_doubling or root"
CONTACTS = (
    "test_contacts.py -k not finite and (exact_where or plastic or speed_of_approach or law_tells or impulses or corner or rest_height or"
    " painleve or both_of_its or same_floor or lifts or no_answer or leaves_a_table or before_the_start)"
)
FRICTION = "test_friction.py -k not (turns_and or belt)"
ARCHIVE = "opened_equals or damage or changed or unsealed or flipped or foreign or is_no"
SEGMENTS = (
    "resumed_is or missing or without_room or follows or sealed or another_model or (damaged_segment and sample_)"
)
QUANTITIES = (
    "test_budget_quantities.py -k keep_the_signs and 0.5 or totals or levels or location or declared or lines_say"
)
DRAWN = "test_budget_quantities.py -k draws_are"
COMPARED_RUNS = "difference or later or locations or interpolation or energy_of or bits"
TRANSITIONS = (
    "test_transition.py",
    PHASES,
    MANY,
    "test_march.py -k observable_that or (outside and event)",
    f"test_march.py -k {EVENTS}",
    "test_actions.py -k everything or stopped or goes_on",
    "test_isolation.py -k tank or forget",
    "test_contacts.py -k plastic or impulses or no_answer or lifts or same_floor",
)
TOUCHED = {
    "units/digits.py": ("test_digits.py",),
    "keywords.py": (
        "test_keywords.py -k not (chosen or stiff)",
        "test_settings.py",
    ),
    "model/drives.py": (
        "test_drives.py",
        "test_splines.py",
        "test_march.py -k drive",
        "test_model.py -k not (python_force or cannot_be_marched)",
    ),
    "march/events/root_finding.py": (
        "test_locating.py",
        PHASES,
        MANY,
        f"test_march.py -k {EVENTS}",
        "test_position_tolerance.py -k as_near and (46 or 69)",
        "test_python_detectors.py -k jump or slopes",
        "test_root_state.py -k bogacki or dormand",
    ),
    "march/events/zero_tests.py": (
        "test_certainty.py",
        CLASSES,
        "test_python_detectors.py -k jump",
    ),
    "march/events/isolation.py": (
        "test_certainty.py",
        "test_isolation.py -k rejected",
        CLASSES,
    ),
    "march/events/switch_sides.py": (
        "test_pieces.py",
        "test_switches.py -k (relay and not midpoint) or stop or start or sliding or sides_are",
        "test_table_switches.py -k relay or starts or leaves or outside or motion_along or nothing_beyond",
        "test_nested_switches.py -k reproduced or met_in",
        "test_table_switches.py -k reset_beyond and 9 or told_of and rows0",
    ),
    "march/unlocated_switches.py": (
        "test_chattering.py",
        "test_switches.py -k told_from",
    ),
    "march/events/enclosures.py": (
        "test_silence.py",
        "test_several_events.py -k box or region and (46 or 69)",
        ENCLOSED,
        PHASES,
        "test_isolation.py -k slab",
    ),
    "march/contacts/delassus.py": (
        "test_complementarity.py",
        CONTACTS,
        FRICTION,
    ),
    "march/contacts/balance.py": ("test_balance.py -k parts",),
    "march/contacts/active_set.py": (
        CONTACTS,
        FRICTION,
    ),
    "march/contacts/impact.py": (
        CONTACTS,
        FRICTION,
    ),
    "march/contacts/dispatch.py": (
        CONTACTS,
        FRICTION,
        "test_contacts.py -k second_scheme",
    ),
    "march/tolerance_sizes.py": ("test_sizes.py -k parts",),
    "figures/curves.py": (
        "test_curves.py -k parts",
        "test_curves.py -k joined or closed_form",
    ),
    "march/control.py": (
        "test_controller.py",
        "test_phases.py",
        f"test_control.py -k {CONTROL}",
    ),
    "dynamics/shortened_steps.py": ("test_sampling.py -k not (radau or archive)",),
    "evidence/diagnosing/chaos.py": (
        "test_lyapunov.py -k is_certain or their_digits or largest_exponent",
        "test_lyapunov.py -k units_of or counts_that or without_variational",
    ),
    "evidence/evidence_dataset.py": (
        "test_evidence_parts.py -k exhibit",
        "test_scaling.py -k units",
        "test_evidence_parts.py -k matched or known",
        "test_comparison.py -k matched",
        "test_verdicts.py -k missed",
        "test_scaling.py -k expected or nothing or divides or norm or measured or units",
    ),
    "evidence/runs.py": (
        "test_evidence_parts.py -k location or study or interrupted or just_written",
        "test_signs_of_studies.py -k room or beyond",
        "test_refinement.py -k kept_in_files or interrupt",
    ),
    "evidence/observables.py": (
        "test_observing.py",
        "test_evidence_parts.py -k derived or contacts_do",
        "test_curves.py -k contact_forces",
    ),
    "evidence/refining/readings.py": (
        "test_evidence_parts.py -k defects",
        "test_refinement.py -k local_errors",
    ),
    "evidence/refining/refinement.py": (
        "test_evidence_parts.py -k next_level or needed or no_level or rows_of",
        "test_evidence_parts.py -k numbers_unit or last_level_at or why_none or refinement_in_words",
        "test_signs_of_studies.py -k gates or errors_of or behind or beyond or ended",
        "test_refinement.py -k wrong_studies or energies or added or local_errors",
        "test_verdicts.py -k names",
    ),
    "evidence/refining/levels.py": (
        "test_evidence_parts.py -k levels or finer",
        "test_refinement.py -k absolute or wrong",
        "test_smooth_switches.py -k clean or located",
    ),
    "evidence/refining/study.py": (
        "test_evidence_parts.py -k study or events_before or end_apart or occurrences or ended_before or stepped_over or count_from or once_and_a or smooth_table or never_0 or first_step",
        "test_signs_of_studies.py -k behind or ended or errors_of",
        "test_refinement.py -k energies or period",
        "test_smooth_switches.py -k before or clean or located",
    ),
    "evidence/sampling.py": (
        "test_evidence_parts.py -k the_side",
        "test_sampling.py -k other_faults or wrong_times or accepted_states",
        "test_signs.py -k global",
    ),
    "evidence/validating/impacts.py": ("test_impact_ledger.py",),
    "dynamics/tangents.py": (
        "test_lyapunov.py -k behind_the_transient or is_gone",
        "test_lyapunov.py -k saddle or power_of_time",
        "test_lyapunov.py -k noted_of or of_dop853 or part_at_a_time",
        "test_lyapunov.py -k saddle or some_of or chunks",
    ),
    "dynamics/growth.py": (
        "test_lyapunov.py -k taken_apart or noted_of or of_dop853 or units_of_each or errors_allow or the_derivatives",
        "test_lyapunov.py -k regimes or kicked and 46",
    ),
    "dynamics/path.py": (
        "test_lyapunov.py -k parts_of_the_time or know_their",
        "test_variational.py -k resets or jumps or impacts",
        "test_lyapunov.py -k kicked or piecewise",
    ),
    "dynamics/saltation.py": (
        "test_variational.py -k bounce_are or very_time",
        "test_variational.py -k resets or jumps or impact",
        "test_lyapunov.py -k table or kicked",
    ),
    "dynamics/variational.py": (
        "test_variational.py -k bounce_are or gauss",
        "test_variational.py -k resets or jumps or matrix or drives",
    ),
    "kernels/program.py": ("test_loops.py",),
    "kernels/llvm_loops.py": ("test_loops.py",),
    "kernels/llvm_program.py": (
        "test_loops.py",
        "test_intervals.py",
    ),
    "kernels/python_text.py": (
        "test_python_text.py",
        "test_loops.py",
        "test_programs.py -k grouping or stores or powers or unsound or (printed and (pendulum or kepler))",
    ),
    "kernels/formulas.py": (
        "test_step_control.py",
        "test_controller.py",
        f"test_control.py -k {CONTROL}",
    ),
    "kernels/interval_program.py": (
        "test_interval_program.py",
        "test_intervals.py",
        ENCLOSED,
    ),
    "methods/steppers.py": (
        "test_steppers.py",
        "test_coefficients.py",
    ),
    "march/settings.py": ("test_settings.py",),
    "elementary/piecewise.py": (
        "test_piecewise.py",
        "test_drives.py",
    ),
    "elementary/intervals.py": (
        "test_interval_rules.py",
        ENCLOSED,
        PHASES,
        "test_isolation.py -k slab",
    ),
    "march/events/transition.py": (*TRANSITIONS,),
    "march/events/departures.py": (*TRANSITIONS,),
    "march/events/dispatch.py": (*TRANSITIONS,),
    "evidence/refining/convergence.py": (
        "test_convergence.py -k not smooth_cases and not power",
        "test_convergence.py -k power",
    ),
    "evidence/comparing/bits.py": (
        "test_evidence_parts.py -k first_row or lengths or largest_difference",
        "test_comparison.py -k same_runs or rerun or named or schema or parameter",
    ),
    "evidence/comparing/comparison.py": (
        "test_evidence_parts.py -k first_runs_unit or left_out or so_far or first_of_what or both_reach or comparison_in_words",
        f"test_signs.py -k {COMPARED_RUNS}",
        "test_scaling.py -k units or times_of or lines",
        "test_comparison.py -k not (lazy or schema or rerun)",
    ),
    "evidence/diagnosing/conservation.py": (
        "test_cycles.py -k believed",
        "test_belief.py",
    ),
    "model/file_access.py": ("test_instruments.py -k workbook or far_below",),
    "units/reading.py": (
        "test_bare_numbers.py -k axis",
        "test_units.py -k range",
    ),
    "evidence/comparing/measured.py": (
        "test_signs.py -k measured",
        "test_scaling.py -k measured",
        "test_comparison.py -k measured or wrong_data or columns or datasets",
    ),
    "evidence/companion.py": (
        "test_evidence_parts.py -k tighter or tenth or own_error or only_one or by_the_order or the_side",
        "test_signs.py -k global or comes_late",
        "test_diagnosis.py -k companions or global or tighter or only_one or edited",
    ),
    "evidence/diagnosing/cycles.py": (
        "test_cycles.py -k millionth or first_that or by_two",
        "test_signs.py -k few_looks",
        "test_cycles.py -k every_number or level_is_chosen",
        "test_signs.py -k cycle or crossing or period or level or phases or coordinates_are",
        "test_budget_quantities.py -k periods",
    ),
    "evidence/diagnosing/diagnosis.py": (
        "test_cycles.py -k diagnosis_in_words or believed or amplitudes",
        "test_signs.py -k drift or band or amplitude or turns or behind or ahead or residual or uncertainty_of",
        "test_cycles.py -k every_number",
        "test_thinning.py -k kept_rows or missing_columns",
        "test_chunks.py -k diagnosis",
        "test_diagnosis.py -k verlet or wrong or references or residuals or observables or ellipse or saved",
    ),
    "evidence/modes.py": (
        "test_signs.py -k decay or radians",
        "test_modes.py -k not compiled_forces",
    ),
    "evidence/refining/subjects.py": (
        "test_evidence_parts.py -k family or whole_run",
        "test_signs_of_studies.py -k gates or errors_of or orders_have",
        "test_signs.py -k coarser or euler_is or true_fall",
        "test_refinement.py -k energies",
    ),
    "evidence/validating/limiting.py": (
        "test_signs.py -k distances",
        "test_ledger.py -k goes or vanishes or limits",
    ),
    "evidence/validating/manufacturing.py": (
        "test_signs.py -k manufactured",
        "test_ledger.py -k trajectories or full_masses",
    ),
    "evidence/validating/ledger.py": (
        "test_ledger.py -k at_an_event or where_they_are or accepted_times or of_two_runs or at_its_bound or do_not_claim or in_words or over_the_largest",
        "test_ledger.py -k notes_say or wrong_closed or not_met or other_units or died or own_closed",
        "test_ledger.py -k wrong_questions",
    ),
    "evidence/diagnosing/summits.py": ("test_summits.py -k not random_sweeps",),
    "evidence/diagnosing/extremes.py": ("test_extremes.py -k not (budget or certified or named or sweep)",),
    "budgeting/budget.py": (
        "test_budget_parts.py -k in_doubt or have_no_budget",
        QUANTITIES,
        "test_budget.py -k cannot_be or declared or none_are or not_smooth or warned",
    ),
    "budgeting/budget_dataset.py": (
        "test_budget_parts.py -k is_checked or are_declared or have_no_budget",
        "test_budget_choice.py",
        "test_budget_choice.py -k record_says or every_term",
        QUANTITIES,
        "test_budget_parts.py -k terms_add or slopes_keep or levels_and",
        "test_budget.py -k spelled or cancel or without_one",
    ),
    "budgeting/term.py": (
        "test_budget_choice.py",
        "test_budget_parts.py -k declared",
        QUANTITIES,
        "test_budget.py -k declared",
    ),
    "budgeting/certificate.py": (
        "test_certificate.py -k border or their_words or apart or in_words",
        "test_certificate.py -k all_that_defends or forgeries or changed or open or defended_fails or ledger",
    ),
    "budgeting/montecarlo.py": (
        "test_budget_parts.py -k is_added or doubled or well_ends",
        DRAWN,
        "test_budget_parts.py -k interval or ends",
        "test_budget_quantities.py -k few_draws or settles",
        "test_budget.py -k intervals_and",
        "test_certificate.py -k settles_it",
    ),
    "budgeting/fit_summary.py": (
        "test_budget_parts.py -k fit_in",
        "test_fitting.py -k told or warned_of",
    ),
    "budgeting/fitting.py": (
        "test_fitting.py -k models_units or in_the_order_of_time or ends_before or sizes_and or inverse_of or keeps_the_rest",
        "test_fitting.py -k straight or speak or order_of or named",
    ),
    "budgeting/fit_problem.py": (
        "test_fitting.py -k models_units or in_the_order_of_time or ends_before or sizes_and or inverse_of or keeps_the_rest",
        "test_fitting.py -k straight or speak or order_of or named",
        "test_budget_quantities.py -k residuals",
        "test_fitting.py -k runs",
    ),
    "budgeting/numerical.py": (
        "test_budget_parts.py -k rounding or tolerances or extreme",
        "test_budget_bounds.py -k allowance or rounding_tell",
        QUANTITIES,
        "test_budget.py -k undo or marching_back",
    ),
    "budgeting/physical.py": (
        "test_budget_parts.py -k spacing or known_better or rounding_is or terms_add",
        QUANTITIES,
        "test_budget.py -k slope or undo or cancel",
        "test_variational.py -k not_small or rule_says",
        "test_variational.py -k bounce_are or very or collocation_bears",
        "test_variational.py -k told or tenth or resets",
        "test_budget_parts.py -k rows",
        "test_tabulated.py -k not (columns or kept_in)",
    ),
    "budgeting/budget_summary.py": (
        "test_budget_quantities.py -k rounded",
        "test_budget_parts.py -k words",
        QUANTITIES,
        "test_tabulated.py -k says_so",
        "test_certificate.py -k open",
    ),
    "budgeting/multistart.py": (
        "test_budget_parts.py -k search or starts",
        "test_fitting.py -k straight or speak or astray",
    ),
    "budgeting/measurand.py": (
        "test_budget_parts.py -k places or extreme",
        QUANTITIES,
        "test_extremes.py -k budget or named",
        "test_budget.py -k cannot_be or without_a_unit",
    ),
    "sweeping/axes.py": (
        "test_sweep.py -k wrong or drawn or tables or settings",
        "test_sweep.py -k draws or drawn",
    ),
    "sweeping/kept_quantities.py": ("test_sweep.py -k alone and not file",),
    "sweeping/ensemble_analysis.py": ("test_surveying.py",),
    "record/run_columns.py": (
        "test_columns.py",
        "test_record.py",
        "test_scales.py",
    ),
    "record/run_dataset.py": (
        "test_record.py",
        "test_reading.py",
        "test_sampling.py -k named",
        "test_extend.py -k one_march",
        "test_archive.py -k streamed_equals",
    ),
    "record/conformity.py": ("test_conformity.py",),
    "record/provenance.py": (
        "test_march_identity.py",
        "test_provenance.py",
        "test_record.py",
        "test_sampling.py -k rules",
        "test_golden.py -k reproduced",
        "test_identity.py -k tolerances",
    ),
    "record/schemas.py": ("test_kinds.py",),
    "record/arguments.py": (
        "test_provenance.py",
        "test_record.py",
        "test_sampling.py -k rules",
        "test_golden.py -k reproduced",
        "test_identity.py -k tolerances",
    ),
    "archive/seals.py": (
        "test_seals.py",
        "test_tail.py -k hurt or cut_seal or behind or less_than_half or before_seals",
        f"test_archive.py -k {ARCHIVE}",
    ),
    "archive/integrity.py": (
        "test_origin.py",
        "test_identity.py -k (edited or rows or copy or writing or arithmetic or over or remembered) and not opened",
        "test_standing.py",
        "test_identity.py -k edited or selection",
    ),
    "archive/target.py": (
        "test_durability.py",
        "test_target.py -k not interrupt and not sigterm and not command and not killed and not any_name",
        "test_leftovers.py",
        "test_target.py -k parts or others or killed or name",
    ),
    "archive/reading.py": (
        "test_reading.py",
        f"test_archive.py -k {ARCHIVE} or all",
        "test_identity.py -k (derived and marched) or forged",
        "test_bounds.py -k more_than_there_is and small",
    ),
    "archive/writing.py": (
        "test_writer.py",
        "test_durability.py",
        f"test_archive.py -k {ARCHIVE} or dask or streamed_equals or never_writes",
        "test_tail.py -k word",
        "test_target.py -k complete_archive or bad_end",
        "test_extend.py -k streamed",
        "test_writing.py",
        f"test_archive.py -k {ARCHIVE} or dask",
        "test_target.py -k complete_archive or bad_end or models_own",
        "test_identity.py -k stay_derived or text or selection_keeps or selection_of",
    ),
    "archive/segments.py": (
        "test_segments.py",
        f"test_resume.py -k {SEGMENTS}",
        "test_segment.py",
        "test_durability.py",
        "test_resume.py -k resumed_is or damaged_segment",
        "test_streaming.py",
        "test_archive.py -k streamed_equals",
        "test_resume.py -k resumed_is or short_runs or sealed or follows or interrupted",
        "test_extend.py -k streamed",
    ),
    "archive/signatures.py": ("test_signatures.py",),
    "archive/netcdf_library.py": (
        "test_target.py -k any_name",
        "test_library.py -k words or xarrays_own or made_with or own_name or as_they or was_left or alone or waited or finaliser or fork",
        "test_archive.py -k opened_equals or truncation",
    ),
    "archive/shared_handles.py": (
        "test_lending.py",
        "test_library.py -k finaliser or few or goes_to or another",
        "test_target.py -k is_read",
        "test_bounds.py -k more_than_there_is",
    ),
    "archive/integrity_checks.py": (
        "test_examination.py",
        "test_tail.py -k added or word or hurt_seal",
        f"test_archive.py -k {ARCHIVE}",
        "test_odd_archives.py -k utf_8 or says_where",
        "test_target.py -k complete_archive or bad_end",
    ),
    "archive/store.py": (
        "test_source.py",
        "test_bounds.py -k no_file_is",
        "test_target.py -k name or links",
        "test_archive.py -k no_path or is_no",
    ),
    "archive/file_structure.py": (
        "test_bounds.py -k told or declared or disk or more_than",
        "test_tail.py -k added",
    ),
    "archive/stored_values.py": (
        "test_values.py",
        "test_archive.py -k opened_equals or dask",
        "test_library.py -k one_is_alone or few",
    ),
    **{f"units/{name}.py": ("test_units.py",) for name in ("dimension", "reading", "scales", "spelling", "unit")},
}
PLAIN = ("march/", "kernels/drive_tables", "kernels/linear", "dynamics/growth")  # what numba compiles

ORDER = {ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt)}
EQUAL = {ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,)}
WITHIN = {ast.In: (ast.NotIn,), ast.NotIn: (ast.In,)}
COMPARED: dict[type, tuple[type, ...]] = ORDER | EQUAL | WITHIN
REACHED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
REACHED |= {ast.FloorDiv: ast.Div, ast.Mod: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr}
NAMES = {"min": "max", "minimum": "maximum", "any": "all", "sorted": "list", "left": "right"}
NAMES |= {other: name for name, other in NAMES.items() if name != "sorted"}
UNTOUCHED = ("annotation", "returns", "decorator_list", "type_params", "keywords_only")
GUARDS = ("strict", "repr", "covariant")  # keywords that no value which comes out depends on


@dataclass(frozen=True)
class Mutant:
    """A module with one token changed."""

    line: int
    before: str
    after: str
    code: CodeType


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file, in the order of its text."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for parent, field, index, node in list(places(tree)):
        for other in variants(node):
            replace(parent, field, index, ast.fix_missing_locations(ast.copy_location(other, node)))
            yield Mutant(node.lineno, ast.unparse(node), ast.unparse(other), compile(tree, str(path), "exec"))
            replace(parent, field, index, node)


def places(parent: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, Any]]:
    """Yield where every statement and expression stands, what is never computed left out."""
    for field, value in ast.iter_fields(parent):
        if field in UNTOUCHED:
            continue
        for index, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                continue
            if isinstance(node, ast.keyword) and node.arg in GUARDS:
                continue
            if isinstance(node, ast.AST):
                yield parent, field, index, node
                yield from places(node)


def replace(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    """Put a node in its place."""
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def variants(node: Any) -> Iterator[ast.AST]:
    """Yield what a node may wrongly be."""
    match node:
        case ast.Compare(left, [*ops], comparators):
            for i, op in enumerate(ops):
                for other in COMPARED[type(op)]:
                    yield ast.Compare(left, [*ops[:i], other(), *ops[i + 1 :]], comparators)
        case ast.BinOp(left, op, right) if type(op) in REACHED:
            yield ast.BinOp(left, REACHED[type(op)](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.IfExp(test, body, orelse):
            yield ast.IfExp(test, orelse, body)
        case ast.Constant(value) if (other := other_value(value)) is not None:
            yield ast.Constant(other)
        case ast.Constant(str() as text):
            yield from map(ast.Constant, other_programs(text))
        case ast.Name(name) if name in NAMES:
            yield ast.Name(NAMES[name], node.ctx)
        case ast.Attribute(of, name) if name in NAMES:
            yield ast.Attribute(of, NAMES[name], node.ctx)
        case ast.stmt():
            yield from statements(node)


def other_value(value: Any) -> Any:
    """Return another value of a constant; none of a text that is no word of an interface."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return type(value)({0: 1, 1: 0}.get(value, 2 * value))
    return NAMES.get(value) if isinstance(value, str) else None


def other_programs(text: str) -> Iterator[str]:
    """Yield what the lines of a program may wrongly be; nothing of a text that has none."""
    try:
        tree = ast.parse(text.strip())
    except SyntaxError:
        return
    if tree.body and all(isinstance(line, ast.Assign) for line in tree.body):
        for parent, field, index, node in list(places(tree)):
            for other in variants(node):
                replace(parent, field, index, other)
                yield f"\n{ast.unparse(tree)}\n"
                replace(parent, field, index, node)


def statements(node: ast.stmt) -> Iterator[ast.stmt]:
    """Yield what a statement may wrongly be: nothing, most of the time."""
    match node:
        case ast.If(ast.Name() | ast.Call() | ast.Attribute() as test, body, orelse):
            yield ast.If(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.Return(ast.AST() as value) if ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))
        case ast.AugAssign(target, op, value) if type(op) in REACHED:
            yield ast.AugAssign(target, REACHED[type(op)](), value)
            yield ast.Pass()
        case ast.Raise() | ast.Break() | ast.Continue() | ast.Assign([ast.Attribute() | ast.Subscript(), *_]):
            yield ast.Pass()
        case ast.Expr(value) if not isinstance(value, ast.Constant):
            yield ast.Pass()


def passed(module: str, code: CodeType | None, tests: tuple[str, ...], timeout: float, taken: Path) -> bool:
    """Run tests in a forked process, a module replaced; tell whether all of them passed in time.

    What each group of them takes on the source as it is stands in `taken` then, and limits those on mutants.
    """
    pid = os.fork()
    if not pid:
        ended = 3
        try:
            os.setsid()
            ended = run(module, code, tests, taken)
        finally:  # never on in the parent's place
            os._exit(ended)
    end, status = time.monotonic() + timeout, None
    while status is None and time.monotonic() < end:
        done, left = os.waitpid(pid, os.WNOHANG)
        status = left if done else time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL) if status is None else None
    status = os.waitpid(pid, 0)[1] if status is None else status
    return status == 0


def run(module: str, code: CodeType | None, tests: tuple[str, ...], taken: Path) -> int:
    """Run tests in this process, to their first failure."""
    import pytest

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    if code:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
    sys.frozen = True  # type: ignore[attr-defined]  # so that archives are examined in this process, where the mutant is
    found = SourceFileLoader.get_code
    SourceFileLoader.get_code = lambda self, name: code if code and name == module else found(self, name)  # type: ignore[method-assign]
    plain = module.startswith(tuple(f"xdynamics.{one.replace('/', '.')}" for one in PLAIN))
    os.environ["NUMBA_DISABLE_JIT"] = str(int(plain))
    law_cache = import_module("xdynamics.kernels.law")  # whose keys are of the files, which are not changed
    vars(law_cache).update(read=lambda _key: None, write=lambda *_: None)
    spent: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for k, test in enumerate(tests):
            name, *choice = test.split(" ", 2)
            begun = time.process_time()
            if code:
                allowed = max(LEAST, PATIENCE * json.loads(taken.read_text())[k])
                resource.setrlimit(resource.RLIMIT_CPU, (int(begun + allowed) + 1, resource.RLIM_INFINITY))
            else:
                spent.append(0.0)
            asked = [
                str(next(HERE.rglob(name)) if name.startswith("test_") else name),
                *(choice if name.startswith("test_") else EXAMPLES),
                "-x",
                "-q",
                "-p",
                "no:cacheprovider",
                "-p",
                "no:unraisableexception",  # which collects garbage, at every end
                AGAIN,
                *(["-Wignore::RuntimeWarning"] if plain else []),  # of what numba divides by 0 without a word
                f"--basetemp={folder}/{Path(name).name}",
            ]
            if ended := int(pytest.main(asked)):
                return ended
            if not code:
                spent[k] = time.process_time() - begun
                taken.write_text(json.dumps(spent))
    return 0


def survey(name: str, most: int, seed: int, lines: list[int], taken: Path) -> None:
    """Try a sample of a file's mutants, and tell what became of each."""
    module = f"xdynamics.{name[:-3].replace('/', '.')}"
    examples = (str(SOURCE / name),) if ">>>" in (SOURCE / name).read_text(encoding="utf-8") else ()
    tests = (*examples, *TOUCHED[name])
    before = time.monotonic()
    if not passed(module, None, tests, 600.0, taken):
        raise SystemExit(f"{name}: its tests fail without a mutant: {', '.join(tests)}")
    timeout = max(10.0, PATIENCE * (time.monotonic() - before))
    known = [mutant for mutant in mutants(SOURCE / name) if not lines or mutant.line in lines]
    tried = sorted(random.Random(seed).sample(range(len(known)), min(most, len(known))))
    survivors = 0
    for one in (known[i] for i in tried):
        survived = passed(module, one.code, tests, timeout, taken)
        survivors += survived
        about = f"{name}:{one.line}: {'survived' if survived else 'found   '}  {one.before!r:.90} -> {one.after!r:.90}"
        print(about, flush=True)
    print(f"{name}: {len(tried)} of {len(known)} mutants tried, {len(tried) - survivors} found, {survivors} survived")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", default=list(TOUCHED), help="below src/xdynamics")
    parser.add_argument("--most", type=int, default=60, help="mutants of a file, drawn at random")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lines", type=int, nargs="*", default=[], help="all mutants of these")
    given = parser.parse_args()
    sys.path.insert(0, str(SOURCE.parent))
    for name in IMPORTED:
        import_module(name)
    with tempfile.TemporaryDirectory() as folder:  # what forked processes compile, one for the next
        sys.dont_write_bytecode, sys.pycache_prefix = False, folder
        for name in given.files:
            survey(name, given.most, given.seed, given.lines, Path(folder) / "taken.json")


if __name__ == "__main__":
    main()
