"""The settings of a march: one table for `simulate`, the `[run]` section of a model file, and the command line.

Each entry has one name, which is the keyword of `simulate`, the key of `[run]`, and with dashes the option of
`xdynamics run` and of every other verb that marches. The way back from a record is the attribute named here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, signature
from math import inf
from typing import TYPE_CHECKING, Any

from xdynamics.faults import InputError, internal_text

if TYPE_CHECKING:
    from xdynamics.units import Unit

# what belongs together, in the order of the help
MARCH, CONTROL, EVENTS, ARITHMETIC, RECORD = "Integration", "Step control", "Events", "Arithmetic", "Record"

# how a value is written; the last five are read with the model, by `march.configuration`
WORD, TIME, NUMBER, WHOLE, PAIR, TRUTH = "word", "time", "number", "whole number", "pair of numbers", "true | false"
STEP, TOLERANCES, SCALES, TIMES, COLUMNS = "step", "tolerances", "scales", "times", "columns"


@dataclass(frozen=True)
class Keyword:
    """One setting of a march.

    Attributes
    ----------
    name : str
    group : str
        What it belongs to.
    kind : str
        How a value is written.
    about : str
        What it sets.
    default : str
        What holds if it is not given.
    example : str
        A value in TOML; empty if a model file cannot set it.
    takes : str
        How a value is written in a model file, if the kind alone does not show it.
    attribute : str
        The record's attribute from which it is read back; empty if there is more than one.
    option : str
        The option on the command line, if that is not its name with dashes.
    metavar : str
        The placeholder after the option in the help.
    """

    name: str
    group: str
    kind: str
    about: str
    default: str
    example: str = ""
    takes: str = ""
    attribute: str = ""
    option: str = ""
    metavar: str = ""

    @property
    def flag(self) -> str:
        """The option of the command line."""
        return self.option or "--" + self.name.replace("_", "-")

    @property
    def value_form(self) -> str:
        """How a value is written in a model file."""
        return self.takes or self.kind

    def read(self, value: Any, time: Unit) -> Any:
        """Return a value as a march takes it; times in SI units, or pure numbers where time is one.

        Raises
        ------
        InputError
            If it is of another kind, naming the setting, the value and what is needed.
        """
        return _READERS[self.kind](value, self.name, time) if self.kind in _READERS else value


KEYWORDS = {
    keyword.name: keyword
    for keyword in (
        Keyword("method", MARCH, WORD, "integration method; `xdynamics methods` lists them", "needed here or in [run]", '"dop853"', "name of a method", "solver_method"),
        Keyword("until", MARCH, TIME, "end of the run, unless an event stops it before", "needed here or in [run]", '"9 s"', "", "solver_until"),
        Keyword("step", MARCH, STEP, "step of the grid t0 + n*h; with a tolerance, the first step to try", "needed without a tolerance", '"1 ms"', "time"),
        Keyword("nodes", MARCH, TIMES, "times to land on, besides the breakpoints of measured drives", "none", "", "", "solver_nodes", "--node", "TIME"),
        Keyword("rtol", CONTROL, NUMBER, "relative tolerance: steps are chosen by the error test", "1e-6 for a method with an error estimate and no step", "1e-8"),
        Keyword("atol", CONTROL, TOLERANCES, "absolute tolerance: 1e-9 is in every variable's own unit, y='1 um' for one", "rtol times the variable's largest value so far", '{ x = "1 um" }', 'number in every variable\'s unit, or table { y = "1 um" }', "", "", "[NAME=]VALUE"),
        Keyword("atol_floor", CONTROL, WORD, "least of what follows where no atol is given; 'none' as archives have it that do not say so", "terms that cancel", "", '"terms that cancel" | "none"'),
        Keyword("order", CONTROL, WHOLE, "order of the method taylor", "from rtol: ceil(1 - ln(rtol)/2); 8 for given steps", "8", "whole number from 2 to 60"),
        Keyword("estimator", CONTROL, WORD, "where local errors are estimated from", "embedded where there is one", '"embedded"', '"embedded" | "step_doubling" | "step_doubling_extrapolated" | "none"', "solver_estimator"),
        Keyword("safety", CONTROL, NUMBER, "factor below 1 on the step that the error estimate would allow", "0.9", "0.8", "number below 1", "solver_safety"),
        Keyword("growth_limits", CONTROL, PAIR, "least and greatest factor from one step to the next", "[0.2, 10]", "[0.2, 5]", "pair of numbers", "solver_growth_limits", "", "LEAST,GREATEST"),
        Keyword("min_step", CONTROL, TIME, "shortest step that control may take", "the spacing of t", '"1 ns"', "", "solver_min_step"),
        Keyword("max_step", CONTROL, TIME, "longest step that control may take", "the whole span", '"1 s"'),
        Keyword("max_steps", CONTROL, WHOLE, "accepted and rejected steps after which the run ends", "1000000", "100000", "", "solver_max_steps"),
        Keyword("time_tolerance", EVENTS, TIME, "how well events are located that do not say so themselves", "1 ps, below a second 1e-12 of the span", '"1 ns"', "", "solver_time_tolerance"),
        Keyword("switches", EVENTS, WORD, "what is done about kinks and jumps inside forces", "located; of tables of over 100 points landed on", '"located"', '"located" | "landed on" | "stepped over"'),
        Keyword("event_root_method", EVENTS, WORD, "how events are located; the last two for the bits of older archives", "earliest first", "", '"earliest first" | "earliest first by Hermite" | "one by one"'),
        Keyword("event_start", EVENTS, WORD, "what becomes of stops, switches and resets that stand at zero at the start, or where another acts; the second as older archives did", "judged", "", '"judged" | "waiting"', "solver_event_start"),
        Keyword("sliding", EVENTS, WORD, "what becomes of a motion that both sides drive back to a switch: it slides along it (Filippov 1988), or ends as in older archives", "Filippov", "", '"Filippov" | "ends"', "solver_sliding"),
        Keyword("scales", ARITHMETIC, SCALES, "length, time or mass scale of the nondimensional variables to compute in", "SI units", '{ length = "0.5 m" }', "table of length, time, mass", "", "--scale", "NAME=VALUE"),
        Keyword("summation", ARITHMETIC, WORD, "whether rounding is carried to the next update", "compensated for symplectic methods", '"plain"', '"compensated" | "plain"'),
        Keyword("precision", ARITHMETIC, WORD, "kind of every number: one float, or an unevaluated sum of two with 31 digits", "float64", '"double_double"', '"float64" | "double_double"'),
        Keyword("jacobian", ARITHMETIC, WORD, "where radau_iia has the derivatives of the forces from", "exact", '"exact"', '"exact" | "differences"', "solver_jacobian"),
        Keyword("math_functions", ARITHMETIC, WORD, "set of elementary functions; an older one is for the bits of an older archive", "xdynamics 2", "", '"xdynamics 2" | "xdynamics 1"'),
        Keyword("force_samples", RECORD, WORD, "whether every force evaluation is recorded", "all", '"none"', '"all" | "none"', "solver_force_samples"),
        Keyword("keep_every", RECORD, WHOLE, "rows of the grid from one that is recorded to the next, beside events, nodes and ends", "1", "10", "", "", "", "N"),
        Keyword("log", RECORD, COLUMNS, "columns that are recorded; times, steps and flags always are", "full", '["v_x", "speed_of_it"]', '"full" | "states" | list of variables', "", "", "COLUMNS"),
        Keyword("compress", RECORD, TRUTH, "whether the archive is compressed, without loss", "false", "true"),
    )
}  # fmt: skip
FULL, STATES = "full", "states"  # logs
PACING = ("safety", "growth_limits", "min_step", "max_step", "max_steps")  # limits of steps that are chosen
IN_FILES = tuple(name for name, keyword in KEYWORDS.items() if keyword.example)


def merge_settings(defaults: Mapping[str, Any], requested: Mapping[str, Any]) -> dict[str, Any]:
    """Join settings with others: a requested step takes the place of the defaults' tolerances, and these that of their step."""
    tolerant = "rtol" in requested or "atol" in requested
    replaced = ("step",) if tolerant else ("step", "rtol", "atol", *PACING) if "step" in requested else ()
    return {name: value for name, value in defaults.items() if name not in replaced} | {**requested}


# words that other libraries have for ours, and where what is asked for is said here
_OTHER_WORDS = {
    **dict.fromkeys(("dt", "h", "timestep", "time_step", "step_size"), ("step",)),
    **dict.fromkeys(("t_end", "tend", "t_final", "tmax", "t_max", "t_span", "duration", "end"), ("until",)),
    **dict.fromkeys(("solver", "integrator", "scheme"), ("method",)),
    **dict.fromkeys(("tolerance", "tol"), ("rtol",)),
    **dict.fromkeys(("impacts", "events", "occurrence"), ("occurrences",)),
    **dict.fromkeys(("state", "initial"), ("at",)),
    **dict.fromkeys(("variables", "variable", "names", "quantities"), ("observables", "only")),
}
_ELSEWHERE = {
    **dict.fromkeys(
        ("initial", "initial_conditions", "y0", "x0", "state"),
        "a start stands in the model: model.replace(initial={'x': '1 m'})",
    ),
    **dict.fromkeys(("parameters", "params"), "numbers stand in the model: model.replace(parameters={'m': '2 kg'})"),
    **dict.fromkeys(
        ("variables", "variable", "names", "quantities"), "take them from what comes back, as in result[['x', 'v_x']]"
    ),
}


def checked_keywords(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Let a verb refuse keywords that it does not have in words, with what was meant."""

    @wraps(verb)
    def checked_verb(*arguments: Any, **keywords: Any) -> Any:
        try:
            return verb(*arguments, **keywords)
        except TypeError:
            parameters = signature(verb).parameters
            if len(arguments) > _places(parameters.values()):
                raise InputError(_surplus_text(verb.__name__, parameters, arguments)) from None
            if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
                raise
            unknown = next((name for name in keywords if name not in parameters), None)
            if unknown is None:
                raise
        keyword_names = [
            name for name, parameter in parameters.items() if parameter.kind is not Parameter.POSITIONAL_ONLY
        ]
        raise InputError(f"{verb.__name__} has no '{unknown}'; {keyword_hint(unknown, keyword_names)}")

    return checked_verb


def _places(parameters: Iterable[Parameter]) -> float:
    """Return how many arguments have a place of their own; inf where any number has."""
    kinds = [parameter.kind for parameter in parameters]
    if Parameter.VAR_POSITIONAL in kinds:
        return inf
    return sum(kind in (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD) for kind in kinds)


def _surplus_text(verb: str, parameters: Mapping[str, Parameter], arguments: Sequence[Any]) -> str:
    """Say how the first argument is written that has no place."""
    places = int(_places(parameters.values()))
    named = [name for name, parameter in parameters.items() if parameter.kind is Parameter.KEYWORD_ONLY]
    first = "method" if "method" in named else next(iter(named), "name")
    return (
        f"{verb} takes {places} of its arguments by place, and all others by name, as in {first}=…; given are"
        f" {len(arguments)}, and {str(arguments[places])[:40]!r} has no name"
    )


def keyword_hint(word: str, known_names: Sequence[str]) -> str:
    """Say which of the known names a word stands for, or where what it names is said."""
    if ours := [name for name in _OTHER_WORDS.get(word, ()) if name in known_names]:
        return f"did you mean '{ours[0]}'?"
    if word in _ELSEWHERE:
        return _ELSEWHERE[word]
    close_names = get_close_matches(word, known_names, n=1)
    return f"did you mean '{close_names[0]}'?" if close_names else f"there are {', '.join(known_names)}"


def read_number(value: Any, name: str) -> float:
    """Read a number.

    Raises
    ------
    InputError
        If it is none.
    """
    if isinstance(value, bool):
        raise InputError(f"{name} is {value!r}, needs a number")
    try:
        return float(value)
    except (TypeError, ValueError):
        remedy = "; for one variable write {'y': '1 um'}" if name == "atol" else ""
        raise InputError(f"{name} is {value!r}, needs a number{remedy}") from None


def read_log_columns(requested_log: Any) -> str | tuple[str, ...]:
    """Read which columns of the log are recorded: a word for many, or their names.

    Raises
    ------
    InputError
        If it is no word for that, and no list of names.
    """
    if isinstance(requested_log, str):
        if requested_log in (FULL, STATES):
            return requested_log
        raise InputError(
            f"log is {requested_log!r}; there are '{FULL}', '{STATES}', or a list of variables, like ['{requested_log}']"
        )
    if (
        not isinstance(requested_log, list | tuple)
        or not requested_log
        or not all(isinstance(column, str) for column in requested_log)
    ):
        raise InputError(
            f"log is {requested_log!r}, needs '{FULL}', '{STATES}' or a list of variables, like ['x', 'total_energy']"
        )
    return tuple(dict.fromkeys(map(internal_text, requested_log)))


def _read_whole_number(value: Any, name: str, _: Unit) -> int:
    real = read_number(value, name)
    if not real.is_integer():
        raise InputError(f"{name} is {value!r}, needs a whole number")
    return int(real)


def _read_time(value: Any, name: str, time: Unit) -> float:
    from xdynamics.units import time_in  # here, since the command line reads this table before it needs units

    return time_in(time, value, name)


def _read_pair(value: Any, name: str, _: Unit) -> tuple[float, ...]:
    if isinstance(value, str) or not (isinstance(value, Sequence) or hasattr(value, "__array__")) or len(value) != 2:
        raise InputError(f"{name} are {value!r}, need two factors, like (0.2, 10)")
    return tuple(read_number(factor, name) for factor in value)


def _read_truth(value: Any, name: str, _: Unit) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name} is {value!r}, needs true or false")
    return value


def _read_word(value: Any, name: str, _: Unit) -> str:
    if not isinstance(value, str):
        raise InputError(f"{name} is {value!r}, needs a word")
    return value


_READERS: dict[str, Callable[[Any, str, Unit], Any]] = {
    WORD: _read_word,
    TIME: _read_time,
    NUMBER: lambda value, name, _: read_number(value, name),
    WHOLE: _read_whole_number,
    PAIR: _read_pair,
    TRUTH: _read_truth,
}
