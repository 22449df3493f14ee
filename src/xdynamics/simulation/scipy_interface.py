"""A counterpart of `scipy.integrate.solve_ivp`: a right-hand side in, a run record out."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node, text_of
from xdynamics.expressions.repeating import NEGLIGIBLE, check_numbers, check_repeats
from xdynamics.expressions.substitution import Substitution, values_of
from xdynamics.expressions.traced_arrays import array_of
from xdynamics.expressions.tracing import Traced, WholeNumberError, name, node_of, traced
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.model.consistency import RESERVED
from xdynamics.simulation.single_run import simulate
from xdynamics.units import parse_quantity, parse_time, parse_unit

if TYPE_CHECKING:
    import xarray as xr

# scipy's names of methods
SAME = {"RK45": "dormand_prince", "RK23": "bogacki_shampine", "DOP853": "dop853", "Radau": "radau_iia"}
NEAR = {"LSODA": "radau_iia", "BDF": "radau_iia"}
DIRECTIONS = {0: "either", 1: "rising", -1: "falling"}

# scipy's options that change nothing: states between steps are in any record, derivatives are those of the expressions
WITHOUT_EFFECT = ("dense_output", "vectorized", "jac", "jac_sparsity", "lband", "uband")
TIMES = ("t", "time", "tau", "_t", "times")  # what functions call it
RightSide = Callable[..., Any]
Floats = NDArray[np.float64]


def solve(
    fun: RightSide,
    t_span: Sequence[float | str],
    y0: Sequence[float | str] | Any,
    method: str = "dormand_prince",
    *,
    t_eval: Any = None,
    events: RightSide | Sequence[RightSide] | None = None,
    args: Sequence[Any] = (),
    names: Sequence[str] | None = None,
    units: Sequence[str] | str | None = None,
    path: str | Path | None = None,
    **settings: Any,
) -> xr.Dataset:
    """Solve y' = fun(t, y) as `scipy.integrate.solve_ivp` does, and return a run record.

    Parameters
    ----------
    fun : callable
        ``fun(t, y, *args)``, which returns as many rates as there are numbers in y, by arithmetic and numpy's elementary
        functions, arrays that it fills (`numpy.zeros`), and tables that it reads at t (`numpy.interp`),
        which become drives. It is called with names for numbers, and written down as expressions: these
        are what is marched, differentiated and archived. A branch is written `numpy.where`. What is random, counts its calls or reads a clock
        is refused: it is called twice with names, and with numbers at two states.
    t_span : pair of float, s, or str
        First and last time.
    y0 : array_like of float or str, shape (n,)
        Initial values, in `units`; or quantities like ``"20 m s-1"``.
    method : str
        Any of xdynamics, or scipy's RK45, RK23, DOP853, Radau.
    t_eval : array_like of float or str, optional
        Return the states at these times, as `sample` gives them, in the place of the record.
    events : callable or sequence of callable, optional
        ``event(t, y, *args)``, whose zeros are located; with scipy's attributes `terminal` and `direction`.
    args : sequence
        Further arguments; single numbers become parameters of the model, called as in the signature.
    names : sequence of str, optional
        Of the numbers in y; else y0, y1, …
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
        If `fun` or an event cannot be written down, or gives something else when it is called again, or something has
        another shape or unit.

    Examples
    --------
    >>> def lorenz(t, y, sigma, rho, beta):
    ...     return [sigma*(y[1] - y[0]), y[0]*(rho - y[2]) - y[1], y[0]*y[1] - beta*y[2]]
    >>> run = solve(lorenz, (0, 1), [1.0, 1.0, 1.0], args=(10.0, 28.0, 8/3), names=["x", "y", "z"], rtol=1e-9)
    >>> run.attrs["run_outcome"], float(run.rho), round(float(run.x[-1]), 4)
    ('completed', 28.0, -9.3786)
    """
    settings = {option: value for option, value in settings.items() if option not in WITHOUT_EFFECT}
    if (first := settings.pop("first_step", None)) is not None:
        settings["step"] = first
    if settings.get("max_step") == np.inf:
        del settings["max_step"]
    model = model_of(fun, t_span, y0, args, events, names, units)
    if not isinstance(settings.get("atol", 0.0), str | int | float | Mapping) and settings["atol"] is not None:
        settings["atol"] = dict(zip(model.states, map(float, settings["atol"]), strict=False))
    end = t_span[1] if isinstance(t_span[1], str) else float(t_span[1])
    return simulate(model, method=_method(method), until=end, times=t_eval, path=path, **settings)


def model_of(fun: RightSide, t_span: Any, y0: Any, args: Any, events: Any, names: Any, units: Any) -> Model:
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
    _check_span(t_span)
    starts, own = _starts(y0, units)
    words = [f"y{i}" for i in range(len(starts))] if names is None else [*names]
    if len(words) != len(starts):
        raise InputError(f"names are {len(words)}, and y0 has {len(starts)} numbers")
    scales = {word: f"unit_{word}" for word, unit in zip(words, own, strict=True) if unit != "1"}
    sizes = {scales[word]: f"1 {unit}" for word, unit in zip(words, own, strict=True) if word in scales}
    t = name("t") / name("second")
    y = array_of([name(label) / name(scales[label]) if label in scales else name(label) for label in words])
    functions, tables = [fun, *_listed(events)], Substitution()
    _check_order(fun)
    try:
        given, parameters = _arguments(fun, args, words, float)
        written = _written(functions, tables, words, t, y, given)
    except WholeNumberError:  # an argument is how many there are of something, or an index
        given, parameters = _arguments(fun, args, words, int)
        written = _written(functions, tables, words, t, y, given)
    numbers = _numbers(starts, own)
    _check_numbers(written, words, scales, t_span, numbers, given, args, tables)
    states = {}
    for word, unit, rate in zip(words, own, written[0].values, strict=True):
        scaled_rate = (name(scales[word]) if word in scales else 1.0) * rate / name("second")
        states[word] = {"unit": unit, "rate": text_of(node_of(scaled_rate))}
    return Model(
        name=_called(fun),
        description=(inspect.getdoc(fun) or "").split("\n")[0],
        states=states,
        parameters=parameters | sizes,
        initial={"t": t_span[0] if isinstance(t_span[0], str) else f"{float(t_span[0])!r} s"}
        | dict(zip(words, starts, strict=True)),
        events=_events(written[1:]),
        drives={word: _drive(word, *points) for word, points in tables.tables.items()},
    )


def _drive(word: str, times: Any, values: Any) -> dict[str, Any]:
    """Return a table that a function read by `numpy.interp`."""
    table = {"t [s]": np.array(times), f"{word} [1]": np.array(values)}
    return {"table": table, "interpolation": "linear", "outside": "hold"}


def _check_order(fun: RightSide) -> None:
    """Refuse a function of y and t, as odeint takes it.

    Raises
    ------
    InputError
        If its arguments are named so.
    """
    named = _argument_names(fun)
    if len(named) > 1 and named[1] in TIMES and named[0] not in TIMES:
        label = "fun" if _called(fun) == "right_side" else _called(fun)
        raise InputError(
            f"{label} is {label}({', '.join(named)}), y before t, as odeint takes it; here t comes first, as in solve_ivp:"
            f" write xd.solve(lambda t, y, *args: {label}(y, t, *args), …)"
        )


def _argument_names(fun: RightSide) -> list[str]:
    try:
        return [argument.name for argument in inspect.signature(fun).parameters.values()]
    except (TypeError, ValueError):
        return []


def _check_span(t_span: Any) -> None:
    begin, end = (parse_time(one, "t_span") for one in t_span)
    if end < begin:
        raise InputError(
            f"t_span goes back, from {begin:g} to {end:g} s, and until has to lie after the start; integrate -f over the"
            f" mirrored span: xd.solve(lambda t, y: -np.asarray(fun(-t, y)), ({0 - begin:g}, {0 - end:g}), y0)"
        )


def _starts(y0: Any, units: Any) -> tuple[list[str], list[str]]:
    """Return initial values with their units, and the units."""
    row = [y0] if isinstance(y0, str | int | float) else list(y0)
    declared = [units] * len(row) if isinstance(units, str) else None if units is None else [*units]
    if declared is not None and len(declared) != len(row):
        raise InputError(f"units are {len(declared)}, and y0 has {len(row)} numbers")
    quantities, own = [], []
    for i, start in enumerate(row):
        if isinstance(start, complex) or np.ndim(start):
            raise InputError(f"y0[{i}] is {start!r}, needs a real number; write real and imaginary parts apart")
        quantity = parse_quantity(start if isinstance(start, str) else float(start))
        unit = parse_unit(declared[i]) if declared is not None else quantity.unit
        bare = not isinstance(start, str)
        if not bare and quantity.unit.dimension != unit.dimension:
            raise InputError(f"y0[{i}] is {start!r}, and its unit '{unit.text}'")
        quantities.append(f"{quantity.value!r} {unit.text if bare else quantity.unit.text}")
        own.append(unit.text)
    return quantities, own


def _arguments(fun: RightSide, args: Any, taken: list[str], left: type) -> tuple[list[Any], dict[str, str]]:
    """Return the arguments of `fun` after t and y: single numbers by name, as parameters, but whole ones if `left` is int."""
    row = [*args] if isinstance(args, list | tuple) else [args]
    words = _argument_names(fun)[2:]
    words = [words[i] if i < len(words) and words[i].isidentifier() else f"arg{i}" for i in range(len(row))]
    words = [f"{word}_" if word in (*RESERVED, *taken) else word for word in words]
    arguments: list[Any] = []
    parameters = {}
    for word, argument in zip(words, row, strict=True):
        number = _is_number(argument) and not (left is int and isinstance(argument, int | np.integer))
        arguments.append(name(word) if number else argument)
        if number:
            parameters[word] = f"{float(argument)!r} 1"
    return arguments, parameters


def _is_number(argument: Any) -> bool:
    return isinstance(argument, int | float | np.number) and not isinstance(argument, bool)


def _as_many(fun: RightSide, rates: Any, n: int) -> list[Any]:
    if rates is None:
        raise InputError(f"{_called(fun)} returns nothing; it has to return {n} rates")
    row = [rates] if isinstance(rates, Traced | int | float) else list(np.asarray(rates, object).ravel())
    if len(row) != n:
        raise InputError(f"{_called(fun)} returns {len(row)} rates, and y0 has {n} numbers")
    return row


def _listed(events: Any) -> list[RightSide]:
    """Return events as functions."""
    row = [] if events is None else [events] if callable(events) else list(events)
    for i, event in enumerate(row):
        if not callable(event):
            raise InputError(f"events[{i}] is {repr(event)[:40]}, needs a function of t and y")
    return row


@dataclass(frozen=True)
class Written:
    """A function of t and y, what each of its values is, and the values that it returned for names."""

    function: RightSide
    words: tuple[str, ...]
    values: tuple[Any, ...]

    @property
    def nodes(self) -> list[Node]:
        """The values as expressions."""
        return [node_of(value) for value in self.values]


def _written(
    functions: list[RightSide], tables: Substitution, words: list[str], t: Traced, y: Any, arguments: list[Any]
) -> list[Written]:
    """Write the right-hand side and the events down, all of them once more, and refuse what differs."""
    first, second = ([*_each_written(functions, tables, words, t, y, arguments)] for _ in range(2))
    for written, again in zip(first, second, strict=True):
        check_repeats(_called(written.function), written.words, written.nodes, again.nodes)
    return first


def _each_written(
    functions: list[RightSide], tables: Substitution, words: list[str], t: Traced, y: Any, arguments: list[Any]
) -> Iterator[Written]:
    fun, *events = functions
    rates = _as_many(fun, traced(tables.of(fun), t, y.copy(), *arguments), len(words))
    yield Written(fun, tuple(f"the rate of '{word}'" for word in words), tuple(rates))
    for event in events:
        yield Written(event, ("its value",), (traced(tables.of(event), t, y.copy(), *arguments),))


def _numbers(starts: list[str], own: list[str]) -> Floats:
    """Return initial values as numbers of their units."""
    return np.array(
        [parse_quantity(start).si / float(parse_unit(unit).factor) for start, unit in zip(starts, own, strict=True)]
    )


def _check_numbers(
    written: list[Written],
    words: list[str],
    scales: Mapping[str, str],
    t_span: Any,
    y0: Floats,
    given: list[Any],
    args: Any,
    tables: Substitution,
) -> None:
    """Call functions with numbers, at the start and at a state near it, and compare the results with their expressions."""
    begin, end = (parse_time(one, "t_span") for one in t_span)
    row = [*args] if isinstance(args, list | tuple) else [args]
    constants = {
        text_of(one.node): float(value) for one, value in zip(given, row, strict=True) if isinstance(one, Traced)
    }
    constants |= {"second": 1.0, "pi": np.pi} | dict.fromkeys(scales.values(), 1.0)
    for t, y in ((begin, y0), (begin + (end - begin) / 3.0, y0 + 0.125 * np.where(y0 == 0.0, 1.0, y0))):
        values = constants | {"t": t} | dict(zip(words, y.tolist(), strict=True))
        values |= values_of(tables.tables, t)
        least = NEGLIGIBLE * float(np.max(np.abs(y), initial=0.0))
        for i, one in enumerate(written):
            of_rates = abs(end - begin) if i == 0 and end != begin else 1.0
            call = partial(one.function, t, y.copy(), *row)
            check_numbers(_called(one.function), one.words, one.nodes, call, values, least / of_rates)


def _events(written: list[Written]) -> dict[str, dict[str, Any]]:
    """Return events as a model has them, with scipy's attributes."""
    events: dict[str, dict[str, Any]] = {}
    for i, event in enumerate(written):
        label = _called(event.function) if _called(event.function) not in events else f"{_called(event.function)}_{i}"
        terminal, direction = (
            getattr(event.function, "terminal", False),
            int(np.sign(getattr(event.function, "direction", 0))),
        )
        entry: dict[str, Any] = {"function": text_of(event.nodes[0])}
        entry |= {"direction": DIRECTIONS[direction], "action": "stop" if terminal else "record"}
        if terminal and int(terminal) > 1:
            entry["count"] = int(terminal)
        events[label] = entry
    return events


def _called(fun: RightSide) -> str:
    word = str(getattr(fun, "__name__", "right_side"))
    return word if word.isidentifier() else "right_side"


def _method(method: Any) -> str:
    if method in NEAR:
        raise InputError(f"method '{method}' is not here; for stiff equations there is '{NEAR[method]}'")
    if method not in SAME and method not in METHODS:
        raise InputError(f"method is {method!r}; there are {', '.join(METHODS)}, and scipy's {', '.join(SAME)}")
    return SAME.get(str(method), str(method))
