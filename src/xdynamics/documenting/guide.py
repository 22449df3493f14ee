"""The guide of the command line: what may stand in a model file, the language of expressions, units, the record."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import chain

from xdynamics import schema
from xdynamics.documenting.manual import has_text, manual_text
from xdynamics.documenting.markdown import code, table, terminal_lines, wrapped_lines
from xdynamics.evidence.refining.convergence import MEANINGS
from xdynamics.expressions.parser import FORMS
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
MEANINGS_ALONG = {
    "sum": "the sum over one dimension, or several: sum(a, body, axis), added in ascending order",
    "mean": "the sum over the number of elements",
    "min": "the least element, if the last argument is a dimension; min(a, b) compares two values",
    "max": "the greatest element, likewise",
    "norm": "the square root of the sum of squares",
    "dot": "the sum of products",
    "cross": "the vector product along a dimension of three elements, which the result keeps",
    "first": "the value of a at the first end of each link",
    "second": "the value of a at the second end of each link",
    "shift": "the value n places earlier, as in xarray; beyond the end fill, in the unit of a, like 0*metre",
    "roll": "the value n places earlier, the dimension closed into a ring",
    "take": "the element with that number, an expression of index, size and whole numbers",
    "index": "the number of each element, from 0",
    "size": "how many elements there are",
}
SHAPED_MODEL = """\
name = "Sun and two planets"
[dimensions]
body = ["Sun", "Jupiter", "Saturn"]        # labels, or a number of elements: site = 100
axis = ["x", "y", "z"]
[relations.pair]
of = "body"                                # every two; or neighbours = 1: each with the next
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
m = { dims = ["body"], values = { Sun = "2e30 kg", Jupiter = "1.9e27 kg", Saturn = "5.7e26 kg" } }
G = "6.6743e-11 N m2 kg-2"
[mass]
r = "m"                                    # over body, the same for every axis
[forces.gravity]
over = "pair"                              # or r = "…": the force on the first of each
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]                                  # a row for each body, a column for each axis
r = { unit = "astronomical_unit", value = [[0, 0, 0], [5.2, 0, 0], [0, 9.58, 0]] }
v_r = { unit = "m s-1", value = [[0, 0, 0], [0, 13060, 0], [-9680, 0, 0]] }
[run]
method = "yoshida6"
step = "30 day"
until = "30 year"
""".splitlines()
ONE_ELEMENT = ["`r[Jupiter, x], u[-1]`", "one element, by labels or numbers, in the order of the dimensions"]
READ_TOO = ("mph", "kph", "kWh", "Wh", "Ah", "mAh", "Nm", "cP", "cSt", "rev", "lbm")
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
    ("term_<term>_fuel", "step", "every term of its rate, as it acts in the regime"),
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
PAGES = {  # by what they are for; sections of a model file have pages besides
    "Start": ("first", "figures", "accuracy", "sweeps", "scipy", "python"),
    "Models": (
        "model",
        "language",
        "units",
        "files",
        "shapes",
        "contacts",
        "bodies",
        "joints",
        "constraints",
        "delays",
    ),
    "Runs": ("running", "archives", "record", "simulation", "precision", "fits", "stores", "cluster", "json"),
    "Words": ("glossary", "changes"),
}
ALSO = {  # words that lead to a page
    "first": ("quickstart", "tutorial", "start", "intro", "introduction", "begin", "beginners", "steps"),
    "running": ("runs",),
    "simulation": ("marching",),
    "accuracy": ("evidence",),
    "sweeps": ("grids", "grid"),
    "glossary": ("words", "terms"),
    "scipy": ("solve", "solve_ivp"),
    "figures": ("tables", "pictures", "films"),
    "shapes": ("dims",),
}
STARTER = manual_text("starter.toml")
NO_VERBS: Mapping[str, Iterable[str]] = {}
MOST_LINES, SHORTEST_WORD = 3, 3  # of a page that says a word, which has so many letters


def guide(topic: str | None, verbs: Mapping[str, Iterable[str]] = NO_VERBS) -> Iterator[str]:
    """Explain a topic, or list them.

    Parameters
    ----------
    topic : str, optional
    verbs : mapping of str to iterable of str
        Those of the command line by what they are for; they have pages of their own.

    Raises
    ------
    InputError
        If there is no such topic.
    """
    pages, known_verbs = topics(), [*chain(*verbs.values())]
    if topic is None:
        return _contents(verbs)
    topic = topic_named(topic)
    topic = topic if topic in pages else next((page for page in pages if page[:-1] == topic), topic)
    if topic not in pages:
        if found := [*_pages_that_say(topic)]:
            return iter((f"no page is called '{topic}'; these say it", *found))
        raise InputError(
            f"help has no topic '{topic}'{suggestion(topic, tuple(dict.fromkeys((*pages, *known_verbs))))}"
        )
    verb_note = f"the verb of that name: xdynamics {topic} --help"
    return iter((*terminal_lines(pages[topic]()), *(["", verb_note] if topic in known_verbs else ())))


def _pages_that_say(word: str) -> Iterator[str]:
    """Yield the first lines of each page that say a word, or one that begins so: pages that explain it first."""
    said = re.compile(rf"(?<![a-z0-9_]){re.escape(word)}", re.IGNORECASE)
    found = {
        name: [line.strip() for line in terminal_lines(page()) if said.search(line)]
        for name, page in topics().items()
        if len(word) >= SHORTEST_WORD and name != "first"
    }
    for name, lines in sorted(found.items(), key=lambda item: not any(map(said.match, item[1]))):
        if lines:
            yield f"xdynamics help {name}"
            yield from (f"  {line}" for line in sorted(lines, key=lambda line: not said.match(line))[:MOST_LINES])


def _contents(verbs: Mapping[str, Iterable[str]]) -> Iterator[str]:
    """List all pages, those that are written as texts with their titles."""
    yield "Pages: xdynamics help PAGE"
    titles = described_pages()
    for group, names in PAGES.items():
        yield f"  {group}"
        yield from (f"    {name:<11} {titles[name]}" for name in names)
    yield "Sections of a model file: xdynamics help SECTION"
    yield from wrapped_lines(f"  {', '.join(SECTIONS)}", 2)
    if verbs:
        yield "Verbs: xdynamics help VERB"
        yield from (f"  {group + ':':<14}{', '.join(names)}" for group, names in verbs.items())
    yield "All of it as a site, with methods, gallery and Python: xdynamics help --html manual"


def topic_named(word: str) -> str:
    """Return a topic as it is listed: without capitals or the brackets of a section, by the name of its page."""
    name = word.strip("[]").lower()
    return next((page for page, words in ALSO.items() if name in words), name)


def topics() -> dict[str, Callable[[], str]]:
    """Return every topic with the function that returns its page, in Markdown."""
    return {name: partial(_page, name) for name in (*chain(*PAGES.values()), *SECTIONS)}


def described_pages() -> dict[str, str]:
    """Return the pages that are written as texts, each with what its title says."""
    return {name: _title(manual_text(f"{name}.md")) for name in chain(*PAGES.values())}


def _title(markdown: str) -> str:
    return markdown.partition("\n")[0].removeprefix("# ")


def _page(name: str) -> str:
    """Return a page of the manual, with the tables that are made from what they describe; of a section with its keys."""
    parts = [manual_text(f"{name}.md")] if has_text(f"{name}.md") else []
    if name in SECTIONS:
        parts.append(_section(name, first=not parts))
    if name == "delays":
        parts.append(_section("history", first=False))
    return _MADE.sub(lambda match: MADE[match[1]](), "\n\n".join(part.rstrip("\n") for part in parts))


def _section(name: str, *, first: bool) -> str:
    section = SECTIONS[name]
    header = f"[{name}] or [{name}.<{section.entry.replace(' ', '_')}>]" if section.entry else f"[{name}]"
    parts = [f"{'#' if first else '##'} {_quoted(header)}", f"{_quoted(_sentence(section.about))}."]
    if section.short:
        parts.append(
            f"{'In short, in the place of a table: ' if section.entry else ''}{_quoted(section.short if section.entry else _sentence(section.short))}."
        )
    return "\n\n".join([*parts, _key_table(section.keys), "For example", code(section.example.splitlines(), "toml")])


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _quoted(text: str) -> str:
    """Return plain text with the signs that Markdown reads escaped."""
    return re.sub(r"([\\*_<>\[\]])", r"\\\1", text)


def _key_table(keys: Iterable[Key]) -> str:
    return table([[f"`{key.name}`", _quoted(_key_text(key))] for key in keys])


def _key_text(key: Key) -> str:
    stated = key.default if key.default.startswith("needed") else f"default: {key.default}"
    return f"{key.about}  ({key.takes}{f'; {stated}' if key.default else ''})"


def _function_table() -> str:
    plain = [name for name in FUNCTIONS if name not in SAID]
    return f"`{', '.join(plain)}`\n\n" + table(
        [[f"`{name}`", _quoted(SAID[name])] for name in FUNCTIONS if name in SAID]
    )


def _unit_table() -> str:
    spelled = ", ".join(f"{name} ({PRODUCTS[name]})" for name in READ_TOO)
    prefixes = ", ".join(prefix for prefix in PREFIX.values() if prefix)
    rows = {
        "units": ", ".join(SPELLING.values()),
        "prefixes": f"{prefixes}; u is micro; UDUNITS has no R, Q, r or q: write the power of ten in the number",
        "products": f"{spelled}: in brackets as a record spells them",
        "values": "also in month (365.25/12 d), °C and °F, light_year (ly) and parsec (pc, kpc, Mpc, Gpc), hp, slug, oz,"
        " torr and eV (keV, MeV, GeV), which are kept in d, K, m, W, kg, lb, Pa and J: UDUNITS has them in other sizes;"
        " year is the Julian one, of 365.25 d, a calorie the thermochemical one, of 4.184 J",
    }
    return table([[name, _quoted(text)] for name, text in rows.items()])


def _fixed_variables() -> str:
    return table([[f"`{variable.name}`", _quoted(_variable_text(variable))] for variable in schema.FIXED])


def _dimension_table() -> str:
    names = (schema.STEPS, schema.TRIALS, schema.EVENTS, schema.SAMPLES, schema.CLOSED_LINKS, schema.BOUNDS)
    rows = [*((name, schema.DIMENSIONS[name]) for name in names), *OF_MODELS]
    return table([[f"`{name}`", _quoted(text)] for name, text in rows])


MADE: dict[str, Callable[[], str]] = {  # tables of pages, made from what they describe
    "head": lambda: _key_table(HEAD),
    "sections": lambda: table([[f"`[{name}]`", _quoted(section.about)] for name, section in SECTIONS.items()]),
    "functions": _function_table,
    "functions along": lambda: table(
        [[f"`{form}`", _quoted(MEANINGS_ALONG[name])] for name, form in FORMS.items()] + [ONE_ELEMENT]
    ),
    "constants": lambda: (
        f"`{', '.join(CONSTANTS)}`; {' and '.join(CALENDAR)} are 365.25 days and a twelfth of that, unless the model has something of that name."
    ),
    "units": _unit_table,
    "shaped model": lambda: code(SHAPED_MODEL, "toml"),
    "dimensions": _dimension_table,
    "variables by name": lambda: table(
        [[f"`{name}`", _quoted(f"{f'({dim}) ' if dim else ''}{text}")] for name, dim, text in BY_NAME]
    ),
    "fixed variables": _fixed_variables,
    "verdicts": lambda: table([[f"`{verdict}`", _quoted(meaning)] for verdict, meaning in MEANINGS.items()]),
}
_MADE = re.compile(r"^\{\{([a-z ]+)\}\}$", re.MULTILINE)


def _variable_text(variable: Variable) -> str:
    details = ", ".join([*variable.dims, *([variable.units] if variable.units != "1" else [])])
    return f"{f'({details}) ' if details else ''}{variable.long_name}"
