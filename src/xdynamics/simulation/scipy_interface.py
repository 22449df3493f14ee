"""A counterpart of `scipy.integrate.solve_ivp`: a right-hand side in, a run record out."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np

from xdynamics.expressions import text_of
from xdynamics.expressions.memory import Remembered
from xdynamics.expressions.repeating import NEGLIGIBLE, check_numbers, check_unwritten
from xdynamics.expressions.substitution import Substitution, table_values
from xdynamics.expressions.traced_arrays import array_of
from xdynamics.expressions.tracing import Traced, TracedComplex, node_of, parts, traced_name
from xdynamics.faults import InputError
from xdynamics.keywords import keyword_hint
from xdynamics.march.configuration import DEFAULT_RTOL, settings_for
from xdynamics.methods import METHODS, unknown_method
from xdynamics.model import Model
from xdynamics.schema import IMAGINARY_PART, REAL_PART, SAMPLED
from xdynamics.simulation.array_models import (
    Floats,
    RightSide,
    WrittenFunction,
    array_sections,
    call_with_numbers,
    check_order,
    check_span,
    event_functions,
    event_sections,
    function_name,
    interpolated_drive,
    read_starts,
    start_numbers,
    write_twice,
    write_with_arguments,
)
from xdynamics.simulation.single_run import simulate
from xdynamics.simulation.unmarched_runs import add_events, sampled_states, times_within
from xdynamics.units import parse_time

if TYPE_CHECKING:
    import xarray as xr

# scipy's names of methods
SAME = {"RK45": "dormand_prince", "RK23": "bogacki_shampine", "DOP853": "dop853", "Radau": "radau_iia"}
NEAR = {"LSODA": "radau_iia", "BDF": "radau_iia"}
# scipy's options that change nothing: states between steps are in any record, derivatives are those of the expressions
WITHOUT_EFFECT = ("vectorized", "jac", "jac_sparsity", "lband", "uband")
MOST_NAMED = 10  # numbers that get a name each, where their function is written with arrays


def solve(
    fun: RightSide,
    t_span: Sequence[float | str],
    y0: Sequence[float | str] | Any,
    method: str = "dormand_prince",
    t_eval: Any = None,
    *,
    events: RightSide | Sequence[RightSide] | None = None,
    args: Sequence[Any] = (),
    names: Sequence[str] | str | None = None,
    units: Sequence[str] | str | None = None,
    path: str | Path | None = None,
    **settings: Any,
) -> xr.Dataset:
    """Solve y' = fun(t, y) as `scipy.integrate.solve_ivp` does, and return a run record.

    Parameters
    ----------
    fun : callable
        ``fun(t, y, *args)``, which returns as many rates as there are numbers in y, by arithmetic and numpy's elementary
        functions, arrays that it fills (`numpy.zeros`), and tables that it reads at t (`numpy.interp`, interp1d, CubicSpline,
        PchipInterpolator, make_interp_spline), which become drives. It is called with names for numbers, and written down as expressions: these
        are what is marched, differentiated and archived. Branches, by `if`, are followed both ways, and
        become choices, as `numpy.where` writes them. What is random, counts its calls or reads a clock
        is refused: it is called twice with names, and with numbers at two states.
    t_span : pair of float, s, or str
        First and last time.
    y0 : array_like of float, complex or str, shape (n,)
        Initial values, in `units`; or quantities like ``"20 m s-1"``. Of complex numbers real and imaginary parts are
        states of their own, ``y0_real`` and ``y0_imag``, and those of ``solution`` are complex again.
    method : str
        Any of xdynamics, or scipy's RK45, RK23, DOP853, Radau; for BDF and LSODA radau_iia is taken, with a warning.
    t_eval : array_like of float or str, optional
        Return the states at these times, as `sample` gives them, in the place of the record; beside them along `event`
        the `event_time`, `event_detector` and, as `after_<name>`, the state after each event.
    events : callable or sequence of callable, optional
        ``event(t, y, *args)``, whose zeros are located; with scipy's attributes `terminal` and `direction`.
    args : sequence
        Further arguments; single numbers become parameters of the model, called as in the signature.
    names : str or sequence of str, optional
        Of the numbers in y; else y0, y1, …. With one name, as with more than ten numbers and none, a function that is
        written with arrays (slices, `numpy.roll`, ``A @ y``, sums …), with one name also one that returns a list, stays
        one expression, of a state ``y(step, y_index)``; where its arrays cannot be told as rows of neighbours, up to 300
        elements have one each.
    units : str or sequence of str, optional
        Of the numbers in y, in which `fun` has them; ``1`` by default. Time is in s.
    path, **settings
        Of `simulate`: rtol, atol, step, max_step …; of scipy's, dense_output, vectorized, jac, jac_sparsity, lband and
        uband change nothing here, as first_step = None and max_step = inf.

    Returns
    -------
    xarray.Dataset
        Of `simulate`; ``run.dynamics.solution`` has t, y, sol, t_events, y_events, status and message of scipy's.

    Raises
    ------
    InputError
        If `fun` or an event cannot be written down, gives something else when it is called again, or writes into y, or
        something has another shape or unit.

    Examples
    --------
    >>> def lorenz(t, y, sigma, rho, beta):
    ...     return [sigma*(y[1] - y[0]), y[0]*(rho - y[2]) - y[1], y[0]*y[1] - beta*y[2]]
    >>> run = solve(lorenz, (0, 1), [1.0, 1.0, 1.0], args=(10.0, 28.0, 8/3), names=["x", "y", "z"], rtol=1e-9)
    >>> run.attrs["run_outcome"], float(run.rho), round(float(run.x[-1]), 4)
    ('completed', 28.0, -9.3786)
    """
    # beside t_eval alone it has an effect: a run has states between its rows
    between = bool(settings.pop("dense_output", False))
    settings = {option: value for option, value in settings.items() if option not in WITHOUT_EFFECT}
    known = [*inspect.signature(simulate).parameters, "first_step"]
    if unknown := next((option for option in settings if option not in known), ""):
        raise InputError(
            f"solve has no '{unknown}'; {keyword_hint(unknown, [*known, 'dense_output', *WITHOUT_EFFECT])}"
        )
    if settings.get("max_step") == np.inf:
        del settings["max_step"]
    if (first := settings.pop("first_step", None)) is not None:
        settings["step"] = first
    if (first is not None or "max_step" in settings) and not {"rtol", "atol"} & {*settings}:
        settings["rtol"] = DEFAULT_RTOL  # scipy's solvers choose their steps, whatever the first is
    model = model_of_function(fun, t_span, y0, () if args is None else args, events, names, units)
    if not isinstance(settings.get("atol", 0.0), str | int | float | Mapping) and settings["atol"] is not None:
        states, tolerances = [*model.elements.statement.states], [float(number) for number in settings["atol"]]
        if np.iscomplexobj(y0):
            tolerances *= 2  # of real and imaginary parts alike
        if len(tolerances) != len(states):
            given, needed = np.size(settings["atol"]), np.size(y0)
            raise InputError(f"atol has {given} numbers, and y0 {needed}; give one, or one for each")
        settings["atol"] = dict(zip(states, tolerances, strict=True))
    settings |= {"method": _method_name(method), "until": t_span[1] if isinstance(t_span[1], str) else float(t_span[1])}
    if t_eval is None or not (model.events or between):
        return simulate(model, times=t_eval, path=path, **settings)
    sample_times = times_within(
        t_eval, model.time_unit, model.statement.initial["t"].si, settings_for(model, **settings).until
    )
    run = simulate(model, path=path, **settings)
    sampled = add_events(sampled_states(run, sample_times, model), run)
    sampled.encoding[SAMPLED] = run
    return sampled


def model_of_function(fun: RightSide, t_span: Any, y0: Any, args: Any, events: Any, names: Any, units: Any) -> Model:
    """Write a right-hand side down as a model.

    Raises
    ------
    InputError
        If `fun` is no function, or something has another shape or unit.
    """
    if not callable(fun):
        raise InputError(f"fun is {repr(fun)[:40]}, needs a function of t and y")
    if len(tuple(t_span)) != 2:
        raise InputError(f"t_span has {len(tuple(t_span))} times, needs two, the first and the last")
    check_span(t_span)
    check_order(fun)
    functions = [fun, *event_functions(events)]
    if np.iscomplexobj(y0):
        functions = [_rates_of_parts(fun), *map(_of_parts, functions[1:])]
        starts, unit_texts = read_starts(np.atleast_1d(np.real(y0)), units)
        names = [word + part for part in (REAL_PART, IMAGINARY_PART) for word in _checked_names(names, len(starts))]
        starts, unit_texts = starts + read_starts(np.atleast_1d(np.imag(y0)), units)[0], 2 * unit_texts
    else:
        starts, unit_texts = read_starts(y0, units)
    memory = Remembered((functions, args))  # which calls with numbers may change
    try:
        sections = _sections_of(functions, names, starts, unit_texts, t_span, args)
    finally:
        memory.recall()
    sections["initial"]["t"] = t_span[0] if isinstance(t_span[0], str) else f"{float(t_span[0])!r} s"
    return Model(name=function_name(fun), description=(inspect.getdoc(fun) or "").split("\n")[0], **sections)


def _sections_of(
    functions: list[RightSide], names: Any, starts: list[str], unit_texts: list[str], t_span: Any, args: Any
) -> dict[str, Any]:
    """Return the sections of a model, of which every number has a name, or all have one."""
    sections = None
    if isinstance(names, str) or (names is None and len(starts) > MOST_NAMED):
        sections = array_sections(functions, names, starts, unit_texts, t_span, args)
        names = None
    if sections is None:
        sections = named_sections(functions, names, starts, unit_texts, t_span, args)
    return sections


def _checked_names(names: Sequence[str] | str | None, count: int) -> list[str]:
    """Return the names of the numbers in y; y0, y1, … where none are given."""
    words = [f"y{i}" for i in range(count)] if names is None else [names] if isinstance(names, str) else [*names]
    if len(words) != count:
        raise InputError(f"names are {len(words)}, and y0 has {count} numbers")
    return words


def _of_parts(function: RightSide) -> RightSide:
    """Return a function of complex numbers as one of their real and then their imaginary parts."""

    @wraps(function)
    def of_parts(t: Any, y: Any, *arguments: Any) -> Any:
        real_parts, imaginary_parts = np.split(y, 2)
        if y.dtype == object:
            z = array_of([*map(TracedComplex, real_parts, imaginary_parts)])
        else:
            z = real_parts + 1j * imaginary_parts
        before = z.copy()
        result = function(t, z, *arguments)
        check_unwritten(function_name(function), before, z)
        return result

    return of_parts


def _rates_of_parts(function: RightSide) -> RightSide:
    """Return a right-hand side of complex numbers as one of their real and then their imaginary parts."""
    rates = _of_parts(function)

    @wraps(function)
    def rates_of_parts(t: Any, y: Any, *arguments: Any) -> Any:
        pairs = [*map(parts, np.asarray(rates(t, y, *arguments), object).flat)]
        if 2 * len(pairs) != len(y):
            raise InputError(f"{function_name(function)} returns {len(pairs)} rates, and y0 has {len(y) // 2} numbers")
        return [pair[k] for k in (0, 1) for pair in pairs]

    return rates_of_parts


def named_sections(
    functions: list[RightSide],
    names: Sequence[str] | None,
    starts: list[str],
    unit_texts: list[str],
    t_span: Any,
    args: Any,
) -> dict[str, Any]:
    """Return the sections of a model in which every number has a name.

    Raises
    ------
    InputError
        If there are more or fewer names than numbers.
    """
    words = _checked_names(names, len(starts))
    scales = {word: f"unit_{word}" for word, unit in zip(words, unit_texts, strict=True) if unit != "1"}
    sizes = {scales[word]: f"1 {unit}" for word, unit in zip(words, unit_texts, strict=True) if word in scales}
    y = array_of(
        [traced_name(label) / traced_name(scales[label]) if label in scales else traced_name(label) for label in words]
    )
    tables = Substitution()

    def write_named(arguments: list[Any]) -> list[WrittenFunction]:
        return write_twice(functions, tables, words, y, arguments)

    written_functions, single_arguments, parameters = write_with_arguments(write_named, functions[0], args, words)
    _check_named_numbers(
        written_functions, words, scales, t_span, start_numbers(starts, unit_texts), single_arguments, args, tables
    )
    states = {}
    for word, unit, rate in zip(words, unit_texts, written_functions[0].values, strict=True):
        scaled_rate = (traced_name(scales[word]) if word in scales else 1.0) * rate / traced_name("second")
        states[word] = {"unit": unit, "rate": text_of(node_of(scaled_rate))}
    return {
        "states": states,
        "parameters": parameters | sizes,
        "initial": dict(zip(words, starts, strict=True)),
        "events": event_sections(written_functions[1:]),
        "drives": {word: interpolated_drive(word, points) for word, points in tables.tables.items()},
    }


def _check_named_numbers(
    written_functions: list[WrittenFunction],
    words: list[str],
    scales: Mapping[str, str],
    t_span: Any,
    y0: Floats,
    arguments: list[Any],
    args: Any,
    tables: Substitution,
) -> None:
    """Call functions with numbers, at the start and at a state near it, and compare the results with their expressions."""
    begin, end = (parse_time(end, "t_span") for end in t_span)
    row = [*args] if isinstance(args, list | tuple) else [args]
    constants = {
        text_of(entry.node): float(value)
        for entry, value in zip(arguments, row, strict=True)
        if isinstance(entry, Traced)
    }
    constants |= {"second": 1.0, "pi": np.pi} | dict.fromkeys(scales.values(), 1.0)
    for t, y in ((begin, y0), (begin + (end - begin) / 3.0, y0 + 0.125 * np.where(y0 == 0.0, 1.0, y0))):
        values = constants | {"t": t} | dict(zip(words, y.tolist(), strict=True))
        values |= table_values(tables.tables, t)
        negligible = NEGLIGIBLE * float(np.max(np.abs(y), initial=0.0))
        for i, part in enumerate(written_functions):
            time_span = abs(end - begin) if i == 0 and end != begin else 1.0
            call = partial(call_with_numbers, part.function, t, y, row)
            check_numbers(function_name(part.function), part.words, part.nodes, call, values, negligible / time_span)


def _method_name(method: Any) -> str:
    if method in NEAR:
        warn(f"{method} is not here, and {NEAR[method]} is taken in its place, for stiff equations too", stacklevel=3)
        return NEAR[str(method)]
    if method not in SAME and method not in METHODS:
        suggestion = unknown_method(str(method), METHODS)
        raise InputError(f"{suggestion}there are {', '.join(METHODS)}, and scipy's {', '.join(SAME)}")
    return SAME.get(str(method), str(method))
