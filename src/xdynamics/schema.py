"""The words of the record: dimensions, variables, flags, attributes. They are written here and nowhere else."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from xdynamics.units import SECONDS, Unit

# archives of another one are compared by the variables and settings that they have
SCHEMA_VERSION = "2"
# the words of a record: of `xdynamics-1`, pointers are places among its rows, and texts have no dimension; see `record.schemas`
CONVENTIONS = "CF-1.11 ACDD-1.3 xdynamics-2"
FORMER, FORMER_SCHEMAS = "xdynamics-1", 3  # and the latest of the schemas that had those words

STEPS, TRIALS, EVENTS, SAMPLES, BOUNDS = "step", "trial", "event", "sample", "bound"
HELD = "held"  # the role of what controllers hold between ticks
INTEGRATED = ("coordinate", "velocity", "state")  # roles of what steps integrate
OF_MOTION = (*INTEGRATED, HELD)  # and of what a march goes on from: controllers hold values between ticks
KINEMATIC = (*OF_MOTION, "acceleration")  # and of what states between rows are computed from
DOCUMENT = "document"  # of size 1: texts along it are dragged along by no number
CLOSED_LINKS = "closed"  # links of contacts of many bodies that are closed at an accepted state
# of evidence: wanted times, levels of a refinement, which of the events of one name, periods, cases of a ledger, directions of growth
AT, LEVEL, OCCURRENCE, CYCLE, CASE, EXPONENT = "at", "level", "occurrence", "cycle", "case", "exponent"
# of a diagnosis: growth in the limit of long times, and over the time of a run
LYAPUNOVS, LYAPUNOV_UNCERTAINTY = "lyapunov_exponents", "lyapunov_uncertainty"
LYAPUNOV, LYAPUNOV_TIME, FINITE_TIME_GROWTH = "lyapunov_exponent", "lyapunov_time", "finite_time_growth"
CONTINUITY = "continuity"  # role, and first word: whether steps, recomputed, lead to the rows that follow
CONTINUITY_STEPS, CONTINUITY_TIME, CONTINUITY_VERDICT = "continuity_steps", "continuity_time", "continuity_verdict"
DESCRIBED = "step_size"  # the variable that names scalar coordinates
TEXT_NAMES = ("model_toml", "force_source")
NAMES_ROWS = ("event_row_before", "event_row_after", "trial_step", "sample_step", "closed_step")  # by step_number
AT_TIME, EVENT_TIME, TRIAL_TIME, SAMPLE_TIME, CLOSED_TIME = (
    "at_time",
    "event_time",
    "trial_time",
    "sample_time",
    "closed_time",
)
DIMENSIONS = {
    STEPS: "accepted states, the initial one first",
    TRIALS: "rejected trials",
    EVENTS: "located events, in order",
    SAMPLES: "force evaluations of the accepted steps",
    CLOSED_LINKS: "closed links of contacts of many bodies at the accepted states, in order",
    BOUNDS: "left and right end of a bracket",
    DOCUMENT: "one: the texts of a record",
    "given": "steps of a given grid",
    "memory": "numbers that a march goes on from",
    "smooth_switch": "switches in forces that are declared smooth",
}

TIME_OF = {
    STEPS: "time",
    AT: AT_TIME,
    EVENTS: EVENT_TIME,
    TRIALS: TRIAL_TIME,
    SAMPLES: SAMPLE_TIME,
    CLOSED_LINKS: CLOSED_TIME,
}
ROW_KINDS = ("initial", "step", "node", "event_before", "event_after")
INITIAL, STEP, NODE, EVENT_BEFORE, EVENT_AFTER = range(5)
TRIAL_REASONS = (
    "error_test", "nonfinite_force", "domain", "contact_solve", "event_substep", "newton_solve", "nonfinite_event",
)  # fmt: skip
REASON_ERROR, REASON_NONFINITE, REASON_DOMAIN, REASON_CONTACT, REASON_EVENT, REASON_NEWTON, REASON_EVENT_FUNCTION = (
    range(7)
)
EVENT_BOUNDS = "event_time_bounds"  # without attributes: CF's bounds have those of what they bound
EVENT_KINDS = ("crossing", "touch", "jump", "impact", "regime_switch", "pole", "cluster", "rest", "takeoff", "stick", "slip", "reset")  # fmt: skip
KINDS_OF_SLIDING = ("slide", "leave")  # of models that may slide along switches
CROSSING, TOUCH, JUMP, IMPACT, REGIME_SWITCH, POLE, CLUSTER, REST, TAKEOFF, STICK, SLIP, RESET_KIND, SLIDE, LEAVE = range(len(EVENT_KINDS + KINDS_OF_SLIDING))  # fmt: skip
KINDS_IN_WORDS = (
    "crossing: changes sign; touch: reaches zero and turns; jump: changes sign at a jump; pole: at infinity;"
    " cluster: several that could not be told apart; impact: velocities change by an impulse; rest: a contact closes"
    " and stays; takeoff: it opens; stick, slip: friction comes to hold, or begins to slip or reverses;"
    " regime_switch: other forces act, or another side of one; reset: the state was set"
)
SLIDING_IN_WORDS = "; slide: the motion goes on along the switch; leave: away from it, to a side"
EVENT_POSITIONS = ("not_asked", "met", "not_met")  # whether an event is within its position tolerance
UNASKED, NEAR, FAR = range(len(EVENT_POSITIONS))
EVENT_DIRECTIONS = {-1: "falling", 1: "rising"}
ONLY_REGIME = "motion"
CONTACT_STATES = ("open", "settling", "closed")
OPEN, SETTLING, CLOSED = range(len(CONTACT_STATES))
FRICTION_STATES = ("open", "sticking", "slipping_forward", "slipping_backward")
LOOSE, STICKING, FORWARD, BACKWARD = range(len(FRICTION_STATES))
LINK_STATES = ("frictionless", *FRICTION_STATES[1:])  # of a closed link of many, along its slip

ENERGIES = {
    "kinetic_energy": "kinetic energy v.M.v/2",
    "potential_energy": "potential energy of the forces that have one",
    "total_energy": "kinetic and potential energy",
}

COMPRESSION_WORDS = "zlib of level 1, bytes shuffled: without loss"
COMPRESSION = "archive_compression"  # how an archive is compressed, or a record is to be
# facts about when and where a run was made: in the archive, out of every digest but the one of their own
VOLATILE = ("date_created", "history", "python_version", "numpy_version", "numba_version", "llvmlite_version", "engine_origin",
            "xarray_version", "cpu_name", "cpu_features", "wall_time", "xdynamics_version", "archive_seal", COMPRESSION,
            "volatile_digest", "variable_digests",
            # by a library's eigenvalues, whose last bits may carry over into the digits that are kept
            "run_slowest_period", "run_slowest_periods")  # fmt: skip
# what ACDD says of a data set beside what this package writes, what tools add, and what anybody notes: outside the content
NOTES = frozenset(
    (
        "id",
        "naming_authority",
        "keywords",
        "keywords_vocabulary",
        "comment",
        "acknowledgement",
        "acknowledgment",
        "license",
        "standard_name_vocabulary",
        "creator_name",
        "creator_email",
        "creator_url",
        "creator_type",
        "creator_institution",
        "institution",
        "project",
        "program",
        "platform",
        "instrument",
        "contributor_name",
        "contributor_role",
        "publisher_name",
        "publisher_email",
        "publisher_url",
        "publisher_type",
        "publisher_institution",
        "date_modified",
        "date_issued",
        "date_metadata_modified",
        "product_version",
        "processing_level",
        "references",
        "metadata_link",
        "NCO",
        "nco_openmp_thread_number",
        "CDO",
        "CDI",
        "coordinates",
    )
)
# with these begin the names of attributes by which readers here take a record for what it is
OF_RECORD = (
    *("Conventions", "schema_version", "evidence", "proven", "runs", "selection", "derived"),
    *("solver_", "run_", "sweep_", "model_", "force_", "initial_", "atol_", "math_"),
)
RUN_SEAL, CIRCUMSTANCE = "run_seal", "circumstance"  # a variable that is one, the digest of a file's bytes; its role
COUNTS = ("run_force_evaluations", "run_jacobian_evaluations", "run_factorisations", "run_accepted_steps",
          "run_rejected_trials")  # fmt: skip
REQUIRED_ATTRIBUTES = (
    "Conventions", "title", "summary", "source", "history", "date_created", "xdynamics_version", "schema_version",
    "solver_method", "solver_order", "solver_update_equations", "solver_update_order", "solver_interpolation",
    "solver_event_root_method", "solver_step_control", "solver_until", "solver_estimator", "solver_force_samples",
    "precision", "math_functions", "run_outcome", "run_outcome_text", "run_force_evaluations", "model_digest",
    "force_digest",
)  # fmt: skip
# what the record of a run by each kind of step control needs besides
BY_STEP_CONTROL = {
    "fixed": ("solver_step",),
    "given": (),
    "adaptive": ("solver_rtol", "solver_first_step", "solver_first_step_choice", "solver_safety", "solver_growth_limits",
                 "solver_min_step", "solver_max_step", "solver_max_steps"),
}  # fmt: skip
# of a record without all columns: which, and where they were chosen one by one, their names
LOG, LOGGED, CHOSEN = "solver_log", "solver_log_variables", "chosen"
SCHEMA_OF_LAW = "force_schema_version"  # of a part of an older record: in the words of which schema its law is
ORDER_CHOICE = "solver_order_choice"  # of a method that has many orders: given, or by which rule
SERIES_ARITHMETIC = "solver_series_arithmetic"  # of Taylor series: how their coefficients are rounded
CONTACT_ARITHMETIC = "solver_contact_arithmetic"  # of contacts: how forces or impulses are chosen that are not unique
KEEP_EVERY = "solver_keep_every"  # of a record whose rows are not all that were marched
NUMBERS = (
    "solver_order", "solver_until", "solver_step", "solver_rtol", "solver_first_step", "solver_safety",
    "solver_min_step", "solver_max_step", "solver_max_steps", "solver_length_scale", "solver_time_scale",
    "solver_mass_scale", "solver_interpolation_order", "solver_time_tolerance", KEEP_EVERY, *COUNTS,
)  # fmt: skip
PAIRS = ("solver_growth_limits",)
ROOT_DIGEST, VOLATILE_DIGEST = "content_digest", "volatile_digest"
# of a file: the digest of every variable, `name digest` line by line; until `xdynamics-2` each stood on its variable
DIGESTS, DIGEST = "variable_digests", "sha256"
# of a variable in a file whose numbers stand for texts, as which they are read; the attributes that say which
TEXT_FORM = "text_form"
FLAG_ATTRIBUTES = ("flag_values", "flag_meanings")
# what a record in memory was before anybody could edit it; not in files
ORIGIN = "origin"
SAMPLED = "sampled"  # entry of the encoding of states at chosen times: the run that they are of
STAGE = "stage"  # entry of the encoding of what is not computed yet: how it is made
# of what is no run: a text that says how it was made, and of a part of a run which part; content digests of the run
DERIVED, DERIVED_FROM, SELECTION, SELECTION_OF, LEFT_OUT_ATOL = (
    "derived", "derived_from", "selection", "selection_of", "selection_atol_si",
)  # fmt: skip
# of a variable whose absolute tolerance was not given; what stands as its `atol` is what was used in the last step
ATOL_RULE, ATOL_FOLLOWS = (
    "atol_rule",
    "follows the size of the variable so far, see solver_atol_rule; this is its last value",
)
ATOL_FLOOR_RULE = "atol_floor_rule"  # of a run: what such tolerances are never less than; absent in older archives
# the effect of given absolute tolerances along a run, or why it was not examined; absent if none is given
ATOL_EFFECT = "run_atol_effect"
AT_REST = "initial_velocities_not_given"  # names of velocities that were not given, and are 0
# of what was made from runs to judge them by: a word for what it is, and the content digests of the runs, coarse to fine
EVIDENCE, RUNS = "evidence", "runs"
ENCLOSURE, PROVEN = "enclosure", "proven"  # the evidence that is proven bounds, and its attribute that says so
SWEEP = "sweep"  # the evidence that is many runs
# the evidence that is all rows of many runs, one run after the other: its dimensions, how many rows each run has, and the
# attribute by which CF knows it
RAGGED, RUN, ROW, ROW_SIZE, SAMPLE_DIMENSION = "ragged sweep", "run", "row", "row_size", "sample_dimension"
# of what has dimensions: their names and sizes, as `body(6) axis(3)`, in the order in which variables have them
MODEL_DIMENSIONS = "model_dimensions"
# of a variable with dimensions: the elements that it has values of, where not of all; how elements are named, where not at the end
ELEMENTS, ELEMENT_NAME = "elements", "element_name"
# attributes that have a number for each element, where these differ; which absolute tolerances follow their variables
ATOL_FOLLOWING = "atol_follows"
OF_ELEMENTS = (
    *("atol", "atol_si", ATOL_FOLLOWING),
    *("uncertainty", "uncertainty_half_width", "uncertainty_degrees_of_freedom"),
)
DETECTOR_DIMENSIONS = "detector_dimensions"  # of `event_detector`: along which dimensions a detector has elements
LINK_OF = "of"  # of the ends of links: the dimension whose elements they are
LABEL, LINK = "label", "link"  # roles of labels and of ends of links
NOWHERE = -1  # the element of an event whose detector has none along a dimension
SEALED = "archive_seal"  # of files only: that the seal must be there
SEAL_WORDS = "the file ends with a seal, a sha256 of every byte before it"


@dataclass(frozen=True)
class Variable:
    """One variable of a record.

    Attributes
    ----------
    name : str
    dims : tuple of str
    dtype : str
        numpy's short name: ``f8``, ``i1``, ``i8``, ``U`` for text.
    units : str
        UDUNITS spelling.
    long_name : str
    role : str
        What it is to the model: ``coordinate``, ``velocity``, ``force`` …
    more : dict
        Further attributes.
    """

    name: str
    dims: tuple[str, ...]
    dtype: str
    units: str
    long_name: str
    role: str
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attributes(self) -> dict[str, Any]:
        """The variable's attributes in a record."""
        if self.name == EVENT_BOUNDS:
            return {}
        return {"units": self.units, "long_name": self.long_name, "role": self.role} | dict(self.more)


def flag_attributes(words: Mapping[int, str], dtype: str = "i1") -> dict[str, Any]:
    """Return the CF attributes of a flag variable of a type."""
    import numpy as np

    return dict(zip(FLAG_ATTRIBUTES, (np.array(list(words), dtype), " ".join(words.values())), strict=True))


def coordinates_of(name: str, about: Mapping[str, tuple[Sequence[str], Any]], *, former: bool = False) -> str | None:
    """Return the `coordinates` attribute of a variable in a file: times along its first dimension that has some, and labels.

    One variable along `step` names what describes the whole run besides, so that any reader of CF knows it.

    Parameters
    ----------
    name : str
    about : mapping of str to (dims, role)
        Of all variables of the file.
    former : bool
        Whether the file is of the former schema.
    """
    dims = about[name][0]
    times = {dim: TIME_OF[dim] for dim in (STEPS, AT)} if former else TIME_OF
    times = times | ({ROW: "time"} if ROW_SIZE in about else {})
    time_names = [times[dim] for dim in dims if dim in times and (former or times[dim] in about)]
    coordinate_names = [time for time in time_names if time != name][:1]
    coordinate_names += [label for label in map(label_of, dims) if label in about and label != name]
    if not former and name == DESCRIBED:
        coordinate_names += [
            STEP_NUMBER.name,
            *(
                further_name
                for further_name, (variable_dims, role) in about.items()
                if role == "parameter" and not variable_dims
            ),
        ]
    if not former and name in TEXT_NAMES and DOCUMENT in dims:
        coordinate_names += [
            further_name for further_name in TEXT_NAMES if further_name != name and further_name in about
        ]
    return " ".join(coordinate_names) or None


def is_former(attributes: Mapping[Any, Any]) -> bool:
    """Whether the attributes of a record say that it is of the former schema."""
    return FORMER in str(attributes.get("Conventions", "")).split()


def content_of(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes of a record that belong to its content: neither circumstances nor notes."""
    of_sweep = is_former(attributes) and attributes.get(EVIDENCE) == SWEEP  # these had a comment of ours in it
    left_out_names = {*VOLATILE, ROOT_DIGEST, ORIGIN, *(NOTES - {"comment"} if of_sweep else NOTES)}
    return {str(name): value for name, value in attributes.items() if name not in left_out_names}


def is_coordinate(name: str, role: Any) -> bool:
    """Whether a variable describes a run, and is no result of it."""
    describing_names = (*TIME_OF.values(), STEP_NUMBER.name, GIVEN_STEP.name, END_MEMORY.name, *TEXT_NAMES)
    return name in describing_names or role in ("parameter", LABEL)


def name_without_clash(added: Collection[str], name: str) -> str:
    """Return what a model's quantity is called in a result that adds names: as in the model, or with a trailing ``_``.

    New models have none of these names; those of schema 1 may.
    """
    return f"{name}_" if name in added else name


def label_of(dim: str) -> str:
    """Name the labels of a dimension, as they are in a file; in memory they are its index."""
    return f"{dim}_label"


def name_of(dim: str) -> str:
    """Name the names of what lies along a dimension of evidence, terms, parameters, runs; in memory they are its index.

    Not of the cases of a ledger: which impacts a run has is known by marching alone, and a lazy one would have no index.
    """
    return f"{dim}_name" if dim != CASE else ""


def logged_of(dim: str) -> str:
    """Name the dimension of those elements along another one that a log names."""
    return f"logged_{dim}"


def end_of(relation: str, end: str) -> str:
    """Name the elements at the `first` or `second` end of every link of a relation."""
    return f"{relation}_{end}"


def at_closed(name: str) -> str:
    """Name what is recorded of closed links."""
    return f"closed_{name}"


def at_event(dim: str) -> str:
    """Name the element along a dimension, or the end of a link, at which an event was."""
    return f"event_{dim}"


def velocity(name: str) -> str:
    """Name the velocity of a coordinate."""
    return f"v_{name}"


def acceleration(name: str) -> str:
    """Name the acceleration of a coordinate."""
    return f"a_{name}"


def force(term: str, coordinate: str) -> str:
    """Name a force term's component."""
    return f"force_{term}_{coordinate}"


def rate(name: str) -> str:
    """Name the rate of a first-order state."""
    return f"rate_{name}"


def rate_term(term: str, state: str) -> str:
    """Name a term of the rate of a first-order state."""
    return f"term_{term}_{state}"


def rest_name(name: str) -> str:
    """Name the rest of a number beside the nearest float."""
    return f"rest_{name}"


def bounds_of(name: str) -> tuple[str, str]:
    """Name the proven lower and upper bound of a quantity."""
    return f"lower_{name}", f"upper_{name}"


def error(name: str) -> str:
    """Name the local error estimate of a coordinate, velocity or state."""
    return f"error_{name}"


def continuity_defect(name: str) -> tuple[str, str]:
    """Name how far a step, recomputed, is from its row, and what rounding explains of it."""
    return f"continuity_defect_{name}", f"continuity_bound_{name}"


SCALED_RESIDUAL, RESIDUAL_SCALE = "scaled_residual", "residual_scale"  # of a ledger, along `case`


def scaled_name(name: str) -> str:
    """Name a residual, or another difference, over its scale."""
    return f"scaled_{name}"


def scale_name(kind: str, name: str) -> str:
    """Name the scale of a residual of a quantity."""
    return f"{kind}_scale_{name}"


def side_of(name: str) -> str:
    """Name the variable for the side of a switch; switches are named like ``drag.abs``."""
    return f"side_{name.replace('.', '_')}"


def share_of(name: str) -> str:
    """Name the variable for the share of a switch that the motion slides along."""
    return f"switch_share_{name.replace('.', '_')}"


def sample_name(name: str) -> str:
    """Name a quantity that a force evaluation used or gave."""
    return f"sample_{name}"


# by which tools find the axis of time, Unidata's word: CF's own, `axis`, stands for dates since an epoch alone
AXIS = {"_CoordinateAxisType": "Time"}
SHOWN_IN = "shown_in"  # attribute of times: the unit that people read them in, where the model says one
FIXED_STEPS = (
    Variable("time", (STEPS,), "f8", SECONDS.text, "time of the accepted state", "time", AXIS),
    Variable("step_size", (STEPS,), "f8", SECONDS.text, "step used to reach the state; 0 for the initial one and after an event", "step_size"),
    Variable("row_kind", (STEPS,), "i1", "1", "how the state was reached", "flag", flag_attributes(dict(enumerate(ROW_KINDS)))),
)  # fmt: skip
# of records whose numbers are sums of two floats
LEFT_OVER = "rest"  # their role
REST_TIME = Variable(
    "rest_time",
    (STEPS,),
    "f8",
    SECONDS.text,
    "what a float does not hold of the time: it is time + rest_time",
    LEFT_OVER,
)
REST_EVENT_TIME = Variable(
    "rest_event_time",
    (EVENTS,),
    "f8",
    SECONDS.text,
    "what a float does not hold of the time of the zero: it is event_time + rest_event_time",
    LEFT_OVER,
)
CLOSED_AT = Variable(
    CLOSED_TIME, (CLOSED_LINKS,), "f8", SECONDS.text, "time of the row in which the link is closed", "contact"
)
STEP_NUMBER = Variable(
    "step_number",
    (STEPS,),
    "i8",
    "1",
    "number of the row in the whole march, from 0: what names rows has these numbers",
    "index",
)
FIXED_TRIALS = (
    Variable("trial_time", (TRIALS,), "f8", SECONDS.text, "time that the rejected trial started from", "trial"),
    Variable("trial_step", (TRIALS,), "i8", "1", "step_number of the row that the rejected trial started from", "trial"),
    Variable("trial_step_size", (TRIALS,), "f8", SECONDS.text, "step of the rejected trial", "trial"),
    Variable("trial_error_norm", (TRIALS,), "f8", "1", "scaled local error norm of the rejected trial; nan where there is no estimate", "trial"),
    Variable("trial_reason", (TRIALS,), "i1", "1", "why the trial was rejected", "flag", flag_attributes(dict(enumerate(TRIAL_REASONS)))),
)  # fmt: skip
FIXED_EVENTS = (
    Variable("event_time", (EVENTS,), "f8", SECONDS.text, "accepted time of the event: the right end of its bracket, whose ends are its bounds", "event", {"ancillary_variables": "event_time_uncertainty", "bounds": EVENT_BOUNDS}),
    Variable(EVENT_BOUNDS, (EVENTS, BOUNDS), "f8", SECONDS.text, "final bracket of the event time", "event"),
    Variable("event_time_uncertainty", (EVENTS,), "f8", SECONDS.text, "uncertainty of locating the event: the sum of its parts, at least half a spacing of t; the error of the integration is not in it", "event"),
    Variable("event_row_before", (EVENTS,), "i8", "1", "step_number of the row with the state before the event", "event"),
    Variable("event_row_after", (EVENTS,), "i8", "1", "step_number of the row with the state after the event", "event"),
    Variable("event_kind", (EVENTS,), "i1", "1", "kind of the event", "flag", flag_attributes(dict(enumerate(EVENT_KINDS))) | {"kinds": KINDS_IN_WORDS}),
    Variable("event_direction", (EVENTS,), "i1", "1", "direction in which the event function passed zero", "flag", flag_attributes(EVENT_DIRECTIONS)),
)  # fmt: skip
EVENT_UNCERTAINTIES = (
    Variable("event_time_uncertainty_bracket", (EVENTS,), "f8", SECONDS.text, "part of event_time_uncertainty: width of the final bracket", "event"),
    Variable("event_time_uncertainty_residual", (EVENTS,), "f8", SECONDS.text, "part of event_time_uncertainty: residual over the event function's time derivative", "event"),
    Variable("event_time_uncertainty_interpolation", (EVENTS,), "f8", SECONDS.text, "part of event_time_uncertainty: error of the interpolant; 0 where substeps are re-integrated", "event"),
)  # fmt: skip
FIXED_SAMPLES = (
    Variable("sample_time", (SAMPLES,), "f8", SECONDS.text, "time at which the force was evaluated", "sample"),
    Variable("sample_step", (SAMPLES,), "i8", "1", "step_number of the row that the evaluation led to", "sample"),
    Variable("sample_stage", (SAMPLES,), "i1", "1", "evaluation within the step, from 1; 0 at the start and behind a node of a drive", "sample"),
)  # fmt: skip
TEXTS = (
    Variable("model_toml", (DOCUMENT,), "U", "1", "the whole model as TOML", "model"),
    Variable("force_source", (DOCUMENT,), "U", "1", "generated source of the compiled march, and the source of Python forces", "model"),
)  # fmt: skip
REAL_PART, IMAGINARY_PART = "_real", "_imag"  # ends of the names of a complex number's parts
GIVEN, MEMORY, SMOOTH_SWITCH = "given", "memory", "smooth_switch"
GIVEN_STEP = Variable(
    "given_step_size", (GIVEN,), "f8", SECONDS.text, "steps that the march was told to make", "step_size"
)
END_MEMORY = Variable(
    "end_memory",
    (MEMORY,),
    "f8",
    "1",
    "state of the march at its end, from which `extend` continues it, in its own units",
    "memory",
)
ERRORS = "errors"  # of the steps to the rows before these, where given absolute tolerances are judged by them
WITNESSES = "witnesses"  # the last of these in a record without all rows: some of the whole march, column by column
PASSED = Variable(
    "smooth_switches_passed", (SMOOTH_SWITCH,), "i8", "1", "how often a switch that was declared smooth was passed by a step, and not located", "switch"
)  # fmt: skip
FIRST_PASSED = Variable(
    "smooth_switches_first_passed", (SMOOTH_SWITCH,), "f8", SECONDS.text, "time of the first accepted state behind the switch; nan where it was not passed", "switch"
)  # fmt: skip
SIDES = {-1: "negative", 0: "elsewhere", 1: "positive"}
SLIDES = 2  # beside them, of a switch that the motion may slide along
_ERROR_NORM = "scaled local error norm of the step to this state; 1 is what the tolerances allow"
ERROR_NORM = Variable("error_norm", (STEPS,), "f8", "1", _ERROR_NORM, "error")
NEWTON = Variable("newton_iterations", (STEPS,), "i4", "1", "Newton iterations of the step to this state", "effort")
_OFF = "largest deviation from 1 of the length of a quaternion after the step, before it is brought back to 1"
DEVIATION = Variable("attitude_deviation", (STEPS,), "f8", "1", _OFF, "error")


def with_kinds_of_sliding(variable: Variable) -> Variable:
    """Return the kinds of events with those of models that may slide along switches; another variable as it is."""
    if variable.name != "event_kind":
        return variable
    kinds = flag_attributes(dict(enumerate(EVENT_KINDS + KINDS_OF_SLIDING)))
    return replace(variable, more=kinds | {"kinds": KINDS_IN_WORDS + SLIDING_IN_WORDS})


FIXED = (*FIXED_STEPS, STEP_NUMBER, *FIXED_TRIALS, *FIXED_EVENTS, *FIXED_SAMPLES, *TEXTS)
TIMES = {
    variable.name
    for variable in (*FIXED, *EVENT_UNCERTAINTIES, GIVEN_STEP, FIRST_PASSED, REST_TIME, REST_EVENT_TIME)
    if variable.units == SECONDS.text
}


def with_time_unit(variable: Variable, unit: Unit) -> Variable:
    """Return a variable with its model's unit of time, if it is a time."""
    return replace(variable, units=unit.text) if variable.name in TIMES else variable
