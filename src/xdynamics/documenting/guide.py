"""The guide of the command line: what may stand in a model file, the language of expressions, units, the record."""

from __future__ import annotations

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
    bodies_page,
    constraints_page,
    delays_page,
    joints_page,
    shapes_page,
    wrapped_lines,
)
from xdynamics.expressions.tree import FUNCTIONS
from xdynamics.faults import InputError
from xdynamics.model.grammar import HEAD, SECTIONS
from xdynamics.model.section import Key
from xdynamics.model.table_keys import suggestion
from xdynamics.schema import Variable
from xdynamics.units import CALENDAR, CONSTANTS, PREFIX, SPELLING

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
        "of every contact; over a relation, where up to 24 act",
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
    "stores": "Objects of S3, and Zarr stores.",
}
STARTER = """\
# A driven pendulum. `xdynamics help model` lists all sections, `xdynamics help forces` every key of one.
name = "Driven pendulum"
description = "A pendulum with friction in its bearing, and a torque that swings"

[coordinates]                 # what moves; the velocity of theta is v_theta
theta = { unit = "rad", description = "angle from the vertical" }

[parameters]                  # numbers with units; an uncertainty makes a term of an error budget
m = "0.2 kg"
l = { value = "0.5 m", uncertainty = "1 mm", description = "from the pivot to the bob" }
g = "9.80665 m s-2"
b = { value = "2e-3 kg m2 s-1", description = "of the bearing" }
torque = "0.1 N m"
w = "3 s-1"

[mass]                        # what multiplies the acceleration: of an angle a moment of inertia
theta = "m*l**2/radian**2"

[forces.gravity]              # of a potential, the force is its negative gradient
potential = "-m*g*l*cos(theta)"

[forces.bearing]              # else a component for each coordinate: of an angle a torque
theta = "-b*v_theta/radian**2"

[forces.drive]
theta = "torque*sin(w*t)/radian"

# [drives.push]               # measured data: use `push` in an expression
# table = "push.csv"          # header: t [s],push [N m]

[events.turn]                 # a function whose zeros are located; action: record, stop, switch, reset, impact
function = "v_theta"

[observables]                 # what else is recorded
height = { expression = "-l*cos(theta)", unit = "cm", description = "of the bob over the pivot" }

[initial]                     # where it starts; a velocity that is not there is 0
theta = "30 degree"

[figure]                      # what pictures show: where the bob is, a dot in each period of the torque
plane = ["l*sin(theta)", "-l*cos(theta)"]
section = "2*pi/w"
wrap = ["theta"]

[run]                         # defaults of `xdynamics run`
method = "dop853"
rtol = 1e-9
until = "20 s"
"""
FILES = """\
A drive, `compare` and `fit` read tables: a header with names and units, rows of numbers; commas,
semicolons, tabs.
  time [ms],x [mm],u(x) [mm]
  also  time (ms);x (mm)  and  time/ms, with decimal commas where cells are not split by commas.
  u(x) is the standard uncertainty of x row by row, u_common(x) one that all rows share. Columns
  nobody asks for may be anything.
Files of instruments are read as they come:
  phyphox      exports of the phone (CSV or Excel): column = "Acceleration x"
  Vernier      "Data Set 1:Position(m)" or "Latest: Position (m)": column = "Position"; the first
               data set is taken
  Tracker      a line with the track's name, then t, x, y without units:
               units = { t = "s", x = "m" }
  oscilloscope Tektronix (TDS, MDO, MSO, DPO), Siglent, Rigol, PicoScope: column = "CH1"
  RASP         *.eng, thrust of a rocket motor; its first point (0, 0) is added, its last is 0 N
  Excel        *.xlsx, the first sheet with two rows or more (pip install 'xdynamics[excel]')
  netCDF       a file, or a Dataset or DataArray of xarray, with `units`; u_x for the uncertainty of
               x; dates count from the first
What a file does not say is said by keys of the drive, by reading={...} in Python, by options of
compare and fit:
  skip       --skip 3                      lines before the header
  header     --header "t [s],x [mm]"       titles, one for each column, in the place of the file's
  columns    --column x=Position           a column's name where it is not the model's (compare and
                                           fit; a drive has `column`)
  units      --units t=s --units x=mm      of columns whose titles have none
  time_zero  --time-zero 2.5s | first      what times are counted from
  decimal    --decimal ,                   where it cannot be found
  gaps       --gaps skip                   leaves out rows in which a number that is needed is
                                           missing
What was read is kept in the model and its archives as a plain table, whose first line says what it
was made of.
A table may have 50 MB, some million rows; a model file 20 MB and 500,000 numbers in lists, so that
more of them belong into tables. The text of a record, or of to_toml, has the tables in it, and may
have 70 MB and 2,000,000 numbers: Model.from_record reads it.
Units are spelled as they are found: m/s², m/s^2, µm, °/s, kΩ. Of values in °C 273.15 K is added; of
uncertainties not.
"""
SOLVE = """\
xd.solve(fun, t_span, y0, method="RK45", ...) takes what scipy.integrate.solve_ivp takes, and
returns a run.
  run = xd.solve(lambda t, y, m: [y[1], m*(1 - y[0]**2)*y[1] - y[0]], (0, 20), [2, 0], args=(1.5,))
  run.dynamics.solution           t, y, sol(t), t_events, y_events, status, message, as scipy has
                                  them
fun is called once, with symbols, and what it does to them is written down as expressions. So it may
use
  + - * / ** % abs min max, math.sin or np.sin and the like, np.where, np.clip, np.heaviside,
  np.interp, np.sum, np.dot, @, np.linalg.solve, np.zeros(n) and assignment to its elements, slices,
  np.roll, loops over range, functions of yours.
Arrays of any number of axes, u = y.reshape(n, m), are traced number by number, and numbers whose
expressions are alike become one expression of the element's number, however many they are: windows
u[1:-1, 1:-1], d[1:] += …, np.roll, np.diff, np.gradient, np.pad, np.where, np.hstack, u.T. Sums,
means and extremes go in loops, along an axis too, as do bodies by pairs, x[None, :, :] - x[:, None,
:], and products of matrices: @, np.einsum, np.outer, np.tensordot, np.trace. Spreads are np.std,
np.var, np.ptp, and functions have their methods: np.add.at(d, i, f), np.subtract.outer(y, y),
np.maximum.reduce(y). With names="u" a function that returns a list has one state u(u_index), too. A
pair costs some 0.1 ms once: of over a few hundred bodies, or some ten thousand numbers, write the
model with [dimensions] (`xdynamics help shapes`), which is read at once.
It may not branch on the state (`if y[0] > 0`): write np.where(y[0] > 0, a, b), an event, or a
contact. Comparisons are joined by &, |, ~ or np.logical_and, and count as 1 and 0 in arithmetic;
np.interp takes left, right and period.
What it cannot is refused in words with the remedy: f(y, t) of odeint, spans backward in time,
integer powers that vary, and what scipy computes from the state at every step: quad, fsolve,
brentq, interpolators, erf and the like.
Limits, beyond which the message names what to write in its place:
  200000     operations that one function may write down
  30000      numbers of y0; of more, write the model with [dimensions]
  300        numbers that follow no rule in common, as where they are picked by a list at random
  64         families of numbers with rules of their own, such as ends, edges and corners
  10         numbers that get a name each; of more, an array whose rule is the same along it becomes
             one quantity with a dimension
  40         points of np.interp at an expression of the state; over t a table of any length is a
             drive
  6          unknowns of np.linalg.solve
"""


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
    if topic not in pages:
        raise InputError(f"help has no topic '{topic}'{suggestion(topic, tuple(dict.fromkeys((*pages, *verbs))))}")
    verb_note = f"the verb of that name: xdynamics {topic} --help"
    return iter((*pages[topic](), *([verb_note] if topic in verbs else ())))


def _contents(verbs: Iterable[str]) -> Iterator[str]:
    """List all pages: those on a subject with what they are about."""
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
    """Return every topic with what prints its page."""
    return {
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
        "bodies": lambda: bodies_page(_section_page("bodies")),
        "constraints": lambda: constraints_page(_section_page("constraints")),
        "joints": lambda: joints_page(_section_page("joints")),
        "delays": lambda: delays_page(_section_page("history")),
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
    yield "  values    also in month (365.25/12 d), °C and °F, light_year (ly) and parsec (pc, kpc, Mpc, Gpc),"
    yield "            which are kept in d, K and m; year is the Julian one, of 365.25 d"
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
