"""The guide of the command line: what may stand in a model file, the language of expressions, units, the record."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from xdynamics import schema
from xdynamics.documenting.manual_pages import (
    ARCHIVES_PAGE,
    CLUSTER_PAGE,
    EVIDENCE_PAGE,
    FITS_PAGE,
    GRIDS_PAGE,
    JSON_PAGE,
    MARCHING_PAGE,
    PRECISION_PAGE,
    RUNS_PAGE,
    STORES_PAGE,
    words_page,
)
from xdynamics.documenting.model_pages import (
    page_before,
    shapes_page,
    wrapped_lines,
)
from xdynamics.documenting.pages import page_text
from xdynamics.expressions.tree import FUNCTIONS
from xdynamics.faults import InputError
from xdynamics.model.grammar import HEAD, SECTIONS
from xdynamics.model.section import Key
from xdynamics.model.table_keys import suggestion
from xdynamics.schema import Variable
from xdynamics.units import CALENDAR, CONSTANTS, PREFIX, PRODUCTS, SPELLING

# functions of the language that need an explanation; the others have their usual meaning
SAID = {
    "where": "where(x > 0*metre, a, b): a where the comparison holds, else b; comparisons stand nowhere else",
    "min": "of two or more",
    "max": "of two or more",
    "sign": "-1, 0 or 1",
    "atan2": "atan2(y, x), in radians",
    "hypot": "sqrt(x**2 + y**2)",
    "sqrt": "of any unit with even powers",
    "log": "natural",
    "floor": "whole number below, of pure numbers; floor, ceil, round and mod switch like sign and stay free as names",
    "ceil": "whole number above",
    "round": "nearest whole number; of two equally near ones the even one, as Python's",
    "mod": "mod(a, b): a - b*floor(a/b) in the unit of both, with the sign of b, as Python's a % b",
}
OF_MODELS = (  # dimensions of the record that are named after the model's own names
    ("<dimension>, <relation>", "those of the model, with all elements and links"),
    (
        schema.logged_of("<dimension>"),
        "elements that a log names, like log = ['u[3]', 'u[7]']; what is logged of single elements has them alone",
    ),
)
BY_NAME = (  # variables of the record that are named after the model's own names
    ("x, v_x, a_x", "step", "every coordinate, its velocity and acceleration, in their own units"),
    ("force_<term>_x", "step", "every force term, by coordinate"),
    ("fuel, rate_fuel", "step", "every first-order state and its rate"),
    ("<observable>", "step", "every declared observable, kinetic_energy, potential_energy, total_energy"),
    (
        "rest_x, rest_v_x, rest_fuel, rest_time",
        "step",
        "with 31 digits: what the float does not hold (`help precision`)",
    ),
    ("rest_event_time", "event", "the same of the time of an event"),
    ("error_norm, error_x, error_v_x", "step", "estimated local errors, where the method makes them"),
    (
        "contact_gap_<name>, contact_force_<name>, contact_state_<name>",
        "step",
        "of every contact, up to 24 over a relation; forces of least norm where more hold than need to",
    ),
    ("friction_force_<name>, friction_state_<name>", "step", "of every friction"),
    ("constraint_force_<name>", "step", "multiplier of every constraint: the force is it times the derivative"),
    ("constraint_residual_<name>, constraint_rate_<name>", "step", "how far the state is from where it holds"),
    ("constraint_rank, constraint_projection", "step", "independent constraints; how far a step was moved"),
    ("joint_force_<name>, joint_torque_<name>", "step", "what the second body of a joint does to the first, in space"),
    ("event_<observable>, event_<observable>_uncertainty", "event", "observables at the event"),
    ("event_impulse_x, event_offset_x, event_energy_lost", "event", "what an impact did"),
    ("event_<relation>, event_first, event_second", "event", "which link of a contact of many bodies was struck"),
    ("event_impulse_first_x, event_impulse_second_x", "event", "impulses on the two that met"),
    (
        "closed_step, closed_contact, closed_first, closed_second",
        "closed",
        "step_number, contact and bodies of a closed link",
    ),
    ("closed_gap, closed_force", "closed", "its gap and its normal force; a row for each link and step"),
    ("closed_friction_force", "closed", "its friction along positive slip, where a contact has any"),
    ("closed_friction_state", "closed", "what it does along it: steps go on from there, not from states alone"),
    ("closed_force_residual", "closed", "residual of the contact equations: acceleration of its gap, ideally 0"),
    ("sample_x, sample_v_x, sample_force_<term>_x, sample_<drive>", "sample", "what a force evaluation used and gave"),
    (
        ", ".join(map(schema.label_of, ("<dimension>", schema.logged_of("<dimension>")))),
        "the same dimension",
        "which element: its label, or its number; once opened, the index that sel takes",
    ),
    (
        ", ".join(schema.end_of("<relation>", end) for end in ("first", "second")),
        "<relation>",
        "the elements at the ends of each link, by number from 0",
    ),
    ("m, g, …", "", "every parameter, with its uncertainty as an attribute"),
)
PAGES_ABOUT = {  # pages that are of no section of a model file
    "first": "First steps: from nothing to a number and its error.",
    "model": "What may stand in a model file; `xdynamics new MODEL.toml` writes one to begin with.",
    "language": "Expressions: operators, functions, names of units.",
    "shapes": "Quantities along named dimensions: bodies, lattices, fields.",
    "units": "How units and uncertainties are spelled.",
    "record": "Every dimension and variable of a run.",
    "runs": "Runs and their files: writing, editing, going on after a kill, signing, exit codes.",
    "marching": "Steps, events, switches, contacts: how a march finds them, and its limits.",
    "delays": "Values of the motion as they were some time ago: delayed(x, tau).",
    "precision": "Numbers of 31 digits: what is stored, what they cost, the rounding of a run.",
    "evidence": "What a number is worth: refinement, budgets, comparison, validation, certificates.",
    "grids": "Many runs: sweeps over parameters, starts, methods; bifurcation diagrams.",
    "words": "Names that do not explain themselves, and every verdict.",
    "cluster": "Threads, processes and machines of your own.",
    "solve": "Right-hand sides as scipy's users write them.",
    "archives": "Opening archives with xarray: rows by time, many at once.",
    "files": "Tables, and files of phones, loggers, oscilloscopes as they come.",
    "fits": "Parameters from measured data, event times and several records; outliers and intervals.",
    "json": "What verbs print with --json.",
    "stores": "Addresses (S3, web servers, memory), open files, Zarr stores.",
}
STARTER = page_text("starter.toml")
FILES = page_text("files.txt")
SOLVE = page_text("solve.txt")
FIRST_STEPS = page_text("first.txt")
ALSO = {"first": ("quickstart", "tutorial", "start", "intro", "introduction", "begin", "beginners", "steps")}
MOST_LINES, SHORTEST_WORD = 3, 3  # of a page that says a word, which has so many letters


def guide(topic: str | None, verbs: Iterable[str] = ()) -> Iterator[str]:
    """Explain a topic, or list them.

    Parameters
    ----------
    topic : str, optional
    verbs : iterable of str
        Those of the command line, which have pages of their own.

    Raises
    ------
    InputError
        If there is no such topic.
    """
    pages = topics()
    if topic is None:
        return _contents(verbs)
    topic = topic_named(topic)
    topic = next((page for page, words in ALSO.items() if topic in words), topic)
    topic = topic if topic in pages else next((page for page in pages if page[:-1] == topic), topic)
    if topic not in pages:
        if found := [*_pages_that_say(topic)]:
            return iter((f"no page is called '{topic}'; these say it", *found))
        raise InputError(f"help has no topic '{topic}'{suggestion(topic, tuple(dict.fromkeys((*pages, *verbs))))}")
    verb_note = f"the verb of that name: xdynamics {topic} --help"
    return iter((*pages[topic](), *([verb_note] if topic in verbs else ())))


def _pages_that_say(word: str) -> Iterator[str]:
    """Yield the first lines of each page that say a word, or one that begins so: pages that explain it first."""
    said = re.compile(rf"(?<![a-z0-9_]){re.escape(word)}", re.IGNORECASE)
    found = {
        name: [line.strip() for line in page() if said.search(line)]
        for name, page in topics().items()
        if len(word) >= SHORTEST_WORD and name != "first"
    }
    for name, lines in sorted(found.items(), key=lambda item: not any(map(said.match, item[1]))):
        if lines:
            yield f"xdynamics help {name}"
            yield from (f"  {line}" for line in sorted(lines, key=lambda line: not said.match(line))[:MOST_LINES])


def _contents(verbs: Iterable[str]) -> Iterator[str]:
    """List all pages, those on a subject with a description."""
    yield "Pages: xdynamics help PAGE"
    yield from (f"  {name:<9} {description}" for name, description in PAGES_ABOUT.items())
    yield "Sections of a model file: xdynamics help SECTION"
    yield from wrapped_lines(f"  {', '.join(SECTIONS)}", 2)
    if verbs:
        yield "Verbs: xdynamics help VERB"
        yield from wrapped_lines(f"  {', '.join(sorted(verbs))}", 2)
    yield "All of it as a site, with methods, gallery and Python: xdynamics help --html manual"


def topic_named(word: str) -> str:
    """Return a topic as it is listed: without capitals, and without the brackets of a section."""
    return word.strip("[]").lower()


def topics() -> dict[str, Callable[[], Iterable[str]]]:
    """Return every topic with the function that prints its page."""
    return {
        "first": FIRST_STEPS.splitlines,
        "model": _model_page,
        "language": _language_page,
        "shapes": shapes_page,
        "units": _units_page,
        "record": _record_page,
        "runs": RUNS_PAGE.splitlines,
        "marching": MARCHING_PAGE.splitlines,
        "precision": PRECISION_PAGE.splitlines,
        "evidence": EVIDENCE_PAGE.splitlines,
        "grids": GRIDS_PAGE.splitlines,
        "words": words_page,
        "cluster": CLUSTER_PAGE.splitlines,
        "solve": SOLVE.splitlines,
        "archives": ARCHIVES_PAGE.splitlines,
        "files": FILES.splitlines,
        "fits": FITS_PAGE.splitlines,
        "json": JSON_PAGE.splitlines,
        "stores": STORES_PAGE.splitlines,
        **{name: partial(_section_page, name) for name in SECTIONS},
        "bodies": lambda: page_before("bodies.txt", _section_page("bodies")),
        "constraints": lambda: page_before("constraints.txt", _section_page("constraints")),
        "joints": lambda: page_before("joints.txt", _section_page("joints")),
        "delays": lambda: page_before("delays.txt", _section_page("history")),
    }


def _model_page() -> Iterator[str]:
    yield "A model file is TOML. Above its sections stand"
    yield from _key_lines(HEAD)
    yield "and its sections are"
    width = max(map(len, SECTIONS)) + 2
    for name, section in SECTIONS.items():
        yield from wrapped_lines(f"  {f'[{name}]':{width}}  {section.about}", width + 4)
    yield "`xdynamics help forces`, and so on, lists the keys of one;"
    yield "`xdynamics new MODEL.toml` writes a model to begin with."


def _section_page(name: str) -> Iterator[str]:
    section = SECTIONS[name]
    section_header = f"[{name}] or [{name}.<{section.entry.replace(' ', '_')}>]" if section.entry else f"[{name}]"
    yield from wrapped_lines(f"{section_header}: {section.about}", 2)
    if section.short:
        yield from wrapped_lines(
            f"  {'in short, in the place of a table: ' if section.entry else ''}{section.short}", 4
        )
    yield from _key_lines(section.keys)
    yield "for example"
    for line in section.example.rstrip("\n").split("\n"):
        yield f"  {line}"


def _key_lines(keys: Iterable[Key]) -> Iterator[str]:
    entries = list(keys)
    width = max(len(key.name) for key in entries)
    for key in entries:
        stated = key.default if key.default.startswith("needed") else f"default: {key.default}"
        default_note = f"; {stated}" if key.default else ""
        yield from wrapped_lines(f"  {key.name:{width}}  {key.about}  ({key.takes}{default_note})", width + 4)


def _language_page() -> Iterator[str]:
    yield "An expression has numbers, names, t, pi, + - * / ** (a constant exponent), parentheses, and"
    plain = [name for name in FUNCTIONS if name not in SAID]
    yield f"  {', '.join(plain)}"
    for name in FUNCTIONS:
        if name in SAID:
            yield from wrapped_lines(f"  {name:6}  {SAID[name]}", 10)
    yield "A number without a unit is a pure number: 2*metre is a length. Unit names in expressions are"
    yield from wrapped_lines(f"  {', '.join(CONSTANTS)}", 2)
    calendar = " and ".join(CALENDAR)
    yield from wrapped_lines(
        f"  {calendar} are 365.25 days and a twelfth of that, unless the model has something of that name", 2
    )
    yield "delayed(x, '20 ms') is a value as it was some time ago: `xdynamics help delays`."
    yield "Along dimensions and relations there are more: `xdynamics help shapes`."
    yield "Every term has to have the unit of its place; angles are pure numbers, and radian is 1."
    yield "  '-c*v_y*abs(v_y)', 'm*l**2/radian**2', 'where(x < a, k*x, k*a)', 'g*sin(theta)'"


def _units_page() -> Iterator[str]:
    yield "A quantity is a number and a unit in UDUNITS spelling: '9.81 m s-2', '5 cm', '30 degree',"
    yield "'2 kg m2 s-1', '1' for none."
    yield from wrapped_lines(f"  units     {', '.join(SPELLING.values())}", 12)
    yield f"  prefixes  {', '.join(prefix for prefix in PREFIX.values() if prefix)};"
    yield "            u is micro; UDUNITS has no R, Q, r or q: write the power of ten in the number"
    read_too = ("mph", "kph", "kWh", "Wh", "Ah", "mAh", "Nm", "cP", "cSt", "rev", "lbm")
    spelled = ", ".join(f"{name} ({PRODUCTS[name]})" for name in read_too)
    yield from wrapped_lines(f"  products  {spelled}: in brackets as a record spells them", 12)
    yield from wrapped_lines(
        "  values    also in month (365.25/12 d), °C and °F, light_year (ly) and parsec (pc, kpc, Mpc, Gpc), hp, slug, oz,"
        " torr and eV (keV, MeV, GeV), which are kept in d, K, m, W, kg, lb, Pa and J: UDUNITS has them in other sizes; year"
        " is the Julian one, of 365.25 d, a calorie the thermochemical one, of 4.184 J",
        12,
    )
    yield "  also      m/s, m s^-2, m*s**-1; with an uncertainty: 50 ± 0.5 g, or of its last digits: 50.0(5) g"


def _record_page() -> Iterator[str]:
    yield "A run is one xarray Dataset, whose coordinates are time(step) and labels of elements."
    yield "Its dimensions are"
    for name in (schema.STEPS, schema.TRIALS, schema.EVENTS, schema.SAMPLES, schema.CLOSED_LINKS, schema.BOUNDS):
        yield f"  {name:6}  {schema.DIMENSIONS[name]}"
    for name, description in OF_MODELS:
        yield from wrapped_lines(f"  {name}  {description}", 4)
    yield "An event of each of n elements has two rows of all n: see the end of `xdynamics help shapes`."
    yield "and its variables, first those that are called after the model's own names,"
    for name, dim, description in BY_NAME:
        yield from wrapped_lines(f"  {name}{f' ({dim})' if dim else ''}: {description}", 4)
    yield "then those of every run."
    for variable in schema.FIXED:
        yield from wrapped_lines(_variable_line(variable), 4)


def _variable_line(variable: Variable) -> str:
    details = ", ".join([*variable.dims, *([variable.units] if variable.units != "1" else [])])
    return f"  {variable.name}{f' ({details})' if details else ''}: {variable.long_name}"
