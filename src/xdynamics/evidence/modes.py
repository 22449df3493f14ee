"""Normal modes, time scales and stable steps of a model about one of its states.

The model is linearised about its initial state, or about a row of a run.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive, record, schema
from xdynamics.evidence.evidence_dataset import evidence_dataset
from xdynamics.evidence.stage_tasks import Task, setting_words
from xdynamics.evidence.stages import Stage, is_lazy, task_of_runs
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.model.linearisation import (
    Linearisation,
    initial_state,
)
from xdynamics.model.motion import variables
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.folding import model_dimensions
from xdynamics.record.schemas import log_description
from xdynamics.record.unfolding import unfold
from xdynamics.runtime.fork_safety import one_blas_thread
from xdynamics.schema import STEPS, Variable
from xdynamics.stability.spectrum import Spectrum, StepLimits, checked_linearisation, methods_by_step
from xdynamics.units import NONE, NUMBERS, Unit, parse_unit, spell, unit_suffix


def operating_point(subject: Any, row: int | None) -> tuple[Model, dict[str, float], list[str]]:
    """Return the requested model and state, and the digest of the run that they are of.

    Raises
    ------
    InputError
        If it is neither a model nor a run record, or has no such row.
    """
    if isinstance(subject, Model):
        if row is not None:
            raise InputError(f"row is {row!r}, but a model has no rows; give a run record, or the state with at=…")
        return subject, initial_state(subject), []
    if not isinstance(subject, xr.Dataset):
        raise InputError(f"modes needs a Model or a run record, got {str(subject)[:60]!r}")
    run = unfold(subject) if model_dimensions(subject) else subject
    record.check(run, values=not is_lazy(run))
    model, row_index = model_and_row(run, row)
    state = {name: _recorded_number(run, name, row_index) for name in ("t", *variables(model))}
    return model, state, [archive.digest_of_run(run)]


def _unread_point(run: xr.Dataset, row: int | None) -> tuple[Model, dict[str, float], list[str]]:
    """Return the model of a run that is read, or marched, later, and a state of unknown numbers."""
    model, _ = model_and_row(run, row)
    return model, dict.fromkeys(("t", *variables(model)), np.nan), []


def model_and_row(run: xr.Dataset, row: int | None) -> tuple[Model, int]:
    """Return the model of a record and the requested row's index, without reading a row.

    Raises
    ------
    InputError
        If the Dataset is not a run record, or has no such row.
    """
    record.check_kind(run)
    rows = run.sizes[STEPS]
    row_index = 0 if row is None else row
    if not isinstance(row_index, int | np.integer) or not -rows <= row_index < rows:
        raise InputError(
            f"row {row_index!r} is not among the run's {rows}; needs 0 to {rows - 1}, or {-rows} to -1 from the end"
        )
    return Model.from_record(run["model_toml"].values.item()), int(row_index)


def _recorded_number(run: xr.Dataset, name: str, row: int) -> float:
    """Return one number of a record in SI units."""
    name = "time" if name == "t" else name
    if name not in run.variables:
        raise InputError(
            f"run record has no variable '{name}', which its model needs;"
            f" {log_description(run.attrs) or 'give the whole record'}"
        )
    variable = run.variables[name]
    return parse_unit(str(variable.attrs["units"])).to_si(float(variable[row].values))


def replacements(model: Model, replaced_values: Mapping[str, Any] | None) -> dict[str, float]:
    """Return the values that replace some of the state's, in SI units.

    Raises
    ------
    InputError
        If one has a wrong name or unit.
    """
    replaced = model.replace(initial=replaced_values) if replaced_values else model
    return {
        name: replaced.elements.statement.initial[name].si
        for name in map(model.shapes.internal_name, replaced_values or ())
    }


Floats = NDArray[np.float64]

MODES, EIGENVALUES, BY_METHOD = "mode", "eigenvalue", "method"
SUGGESTION = (
    "the lesser of T/20 and half the largest step with which no mode grows by more than a hundredth in T, where T is"
    " the shortest 2 pi/|eigenvalue| of those that oscillate or grow, and of decays alone the longest; a start for a"
    " refinement, not a bound of the error; nan where the method refuses the model"
)


def modes(
    subject: Model | xr.Dataset, *, row: int | None = None, at: Mapping[str, Any] | None = None, compute: bool = True
) -> xr.Dataset:
    """Linearise a model about a state: its modes, its eigenvalues, and the steps that are stable by each method there.

    Parameters
    ----------
    subject : Model or xarray.Dataset
        A model, about its initial state, or a run record, about one of its rows.
    row : int, optional
        Row of the record, from 0, or from the end if negative; the first if not given.
    at : mapping, optional
        Values that replace some of the state's: ``{"theta": "0 rad"}``; a bare number has the unit of the model's
        initial value.
    compute : bool
        Whether to linearise at once; if False, the Dataset has dask arrays. Of a record its one row is read then; one that
        `simulate` described and that is still to be marched is marched first.

    Returns
    -------
    xarray.Dataset
        Along `mode`, of K u = w**2 M u: `frequency` w (rad s-1; 0 of a rigid motion, nan where w**2 is not a number
        >= 0: no oscillation), `period` and `shape_<q>`, a displacement in SI units whose largest number is 1. Along
        `eigenvalue`, of the whole Jacobian: `eigenvalue_real`, `eigenvalue_imag`. Constraints leave fewer of both. Along `method`: `method_name` (a
        flag), `oscillator_limit`, `decay_limit`, `largest_stable_step`, `suggested_step`. Without a dimension:
        `fastest_time_scale`, and the state in SI units.

    Raises
    ------
    InputError
        If the Dataset is not a run record, there is no such row, `at` has a wrong name or unit, a force is written in
        Python, or a derivative is not finite at the state.

    Notes
    -----
    Goldstein, Classical Mechanics, 3rd ed., chapter 6; Hairer and Wanner, Solving Ordinary Differential Equations II,
    section IV.2. Away from an equilibrium the modes hold for the moment only, along the directions that constraints leave
    then, and K includes the part from the change of the mass matrix and of what constraints hold.

    Examples
    --------
    >>> model = Model.from_toml("data/models/coupled_masses.toml")
    >>> modes(model).frequency.values.round(12).tolist()
    [2.0, 3.0]
    """
    unread = subject if not compute and isinstance(subject, xr.Dataset) and is_lazy(subject) else None
    model, state, runs = operating_point(subject, row) if unread is None else _unread_point(unread, row)
    replaced = replacements(model, at)
    state |= replaced
    if unread is not None:
        title, known_names = f"row {row or 0} of {unread.attrs['title']}", list[str]()
        task = task_of_runs("modes", partial(modes, row=row, at=at), (unread,), row, setting_words(replaced))
    else:
        title, known_names = f"the state at t = {state['t']!r}{unit_suffix(model.time_unit)}", ["time", *state]
        linearised = partial(_linearised_modes, model, state, title, runs)
        task = Task.of("modes", linearised, (), model.digest, setting_words(state), runs)
    blank = Spectrum.blank(model), StepLimits.blank()
    stage = Stage(task, lambda: _modes_dataset(model, state, title, *blank, runs), known_names)
    return stage.result(compute=compute)


@one_blas_thread()
def _linearised_modes(model: Model, state: Mapping[str, float], title: str, runs: Sequence[str]) -> xr.Dataset:
    linearisation = checked_linearisation(model, state)
    spectrum = Spectrum.of(model, linearisation)
    if not _is_equilibrium(linearisation, state):
        title = f"{title}, which is no equilibrium: unless the law is linear, the modes hold for the moment"
    return _modes_dataset(model, state, title, spectrum, StepLimits.of(model, spectrum), runs)


def _is_equilibrium(linearisation: Linearisation, state: Mapping[str, float]) -> bool:
    """Whether nothing accelerates, beside what the state's own size would make of the slopes."""
    slopes, size = np.abs(linearisation.jacobian), np.abs([state[name] for name in linearisation.names])
    return bool(np.abs(linearisation.acceleration).max(initial=0.0) <= AT_REST * (slopes @ size).max(initial=0.0))


def _modes_dataset(
    model: Model,
    state: Mapping[str, float],
    title: str,
    spectrum: Spectrum,
    limits: StepLimits,
    runs: Sequence[str],
) -> xr.Dataset:
    filled = [
        *_state_variables(model, state),
        *_undamped(model, spectrum),
        *_eigenvalues(model, spectrum),
        *_stability_limits(model, limits),
    ]
    attributes = {
        "summary": f"Linearisation about {title}",
        "source": "linearisation by xdynamics, exact derivatives",
        "model_digest": model.digest,
    }
    variables = {variable.name: (variable.dims, values, variable.attributes) for variable, values in filled}
    return evidence_dataset("modes", f"Modes of {model.name}", runs, variables, attributes, shapes=model.shapes)


def _state_variables(model: Model, state: Mapping[str, float]) -> list[tuple[Variable, Any]]:
    """Return the state that the model is linearised about."""
    roles = (
        {"t": "time"}
        | dict.fromkeys(model.elements.statement.coordinates, "coordinate")
        | dict.fromkeys(model.elements.statement.states, "state")
    )
    return [
        (
            Variable(
                "time" if name == "t" else name,
                (),
                "f8",
                model.time_unit.text if name == "t" else _si_unit(model, name).text,
                f"{'time' if name == 't' else name} at which the model is linearised",
                roles.get(name, "velocity"),
            ),
            value,
        )
        for name, value in state.items()
    ]


def _undamped(model: Model, spectrum: Spectrum) -> list[tuple[Variable, Any]]:
    """Return frequencies, periods and shapes, the lowest frequency first."""
    comment = {"comment": "undamped; 0 of a rigid motion, nan where the square is negative or complex"}
    frequency_variable = Variable(
        "frequency",
        (MODES,),
        "f8",
        Unit("rad", NONE).per(model.time_unit).text,
        "natural angular frequency",
        "frequency",
        comment,
    )
    result: list[tuple[Variable, Any]] = [
        (frequency_variable, spectrum.frequency),
        (Variable("period", (MODES,), "f8", model.time_unit.text, "natural period", "period"), spectrum.period),
    ]
    scaling = {"comment": "a displacement, scaled so that the largest number of the mode in SI units is 1"}
    for i, name in enumerate(model.elements.statement.coordinates):
        unit, label = _si_unit(model, name).text, f"mode shape along {name}"
        result.append(
            (Variable(f"shape_{name}", (MODES,), "f8", unit, label, "mode_shape", scaling), spectrum.shapes[i])
        )
    return result


def _eigenvalues(model: Model, spectrum: Spectrum) -> list[tuple[Variable, Any]]:
    """Return the eigenvalues of the Jacobian, the slowest first, and the time scale of the fastest."""
    comment = {"comment": "negative decays, positive grows"}
    rate = NUMBERS.per(model.time_unit).text
    real = Variable(
        "eigenvalue_real",
        (EIGENVALUES,),
        "f8",
        rate,
        "rate of growth of an eigenmode of the motion",
        "eigenvalue",
        comment,
    )
    imag = Variable(
        "eigenvalue_imag", (EIGENVALUES,), "f8", rate, "angular frequency of an eigenmode of the motion", "eigenvalue"
    )
    scale = Variable(
        "fastest_time_scale", (), "f8", model.time_unit.text, "one over the largest eigenvalue", "time_scale"
    )
    return [(real, spectrum.eigenvalues.real), (imag, spectrum.eigenvalues.imag), (scale, spectrum.fastest)]


def _stability_limits(model: Model, limits: StepLimits) -> list[tuple[Variable, Any]]:
    """Return the stability limits of each method: in general, and at this state."""
    names = schema.flag_attributes(dict(enumerate(METHODS)))

    def method_variable(name: str, units: str, long_name: str, comment: str) -> Variable:
        return Variable(name, (BY_METHOD,), "f8", units, long_name, "stability", {"comment": comment})

    return [
        (
            Variable("method_name", (BY_METHOD,), "i1", "1", "time-stepping method", "flag", names),
            np.arange(len(METHODS), dtype=np.int8),
        ),
        (
            method_variable(
                "oscillator_limit",
                "1",
                "largest stable step over 1/w of an undamped oscillation",
                "0: every step makes it grow; inf: none does",
            ),
            limits.oscillator,
        ),
        (
            method_variable(
                "decay_limit",
                "1",
                "largest stable step over the time of a decay",
                "inf: every step is stable; nan: the method refuses such a term",
            ),
            limits.decay,
        ),
        (
            method_variable(
                "largest_stable_step",
                model.time_unit.text,
                "largest step with which no mode grows that does not grow in the model",
                "0: none; inf: every step; nan: the method refuses the model; an estimate for over 128 coordinates whose damping joins"
                " modes: of the 128 modes nearest to growth",
            ),
            limits.stable,
        ),
        (method_variable("suggested_step", model.time_unit.text, "suggested step", SUGGESTION), limits.suggested),
    ]


def _si_unit(model: Model, name: str) -> Unit:
    """Return the SI unit of a coordinate, velocity or state, an angle in rad."""
    elements = model.elements
    if name not in elements.statement.coordinates and name not in elements.statement.states:
        return _si_unit(model, name.removeprefix(schema.velocity(""))).per(model.time_unit)
    unit = (
        elements.statement.coordinates[name].unit
        if name in elements.statement.coordinates
        else elements.statement.states[name].unit
    )
    if unit.dimension == NONE and unit.text not in ("1", "percent"):
        return Unit("rad", NONE)
    return spell(unit.dimension)


AT_REST = 1e-9  # of an acceleration over what slopes and state come to
MOST_TOLD = 4  # of the slowest modes
WIDTH = 120
ROUNDING = 1e-6  # of the largest eigenvalue: a triple eigenvalue of 0 is found within the cube root of a rounding


def modes_lines(modes: xr.Dataset) -> Iterator[str]:
    """Describe frequencies, growth, the shortest time scale, and the step suggested for each method."""
    yield f"about     {modes.attrs['summary'].removeprefix('Linearisation about ')}"
    yield f"modes     {_frequency_sentence(modes)}"
    yield from _damping_lines(modes)
    growth, scale = modes["eigenvalue_real"], modes["fastest_time_scale"]
    fastest, largest = float(growth.max()) if growth.size else 0.0, 1.0 / float(scale)
    if fastest > ROUNDING * largest:
        yield f"growth    {fastest:.4g}{unit_suffix(str(growth.attrs['units']))} of the eigenmode that grows fastest"
    scale_text = f"{float(scale):.4g}{unit_suffix(str(scale.attrs['units']))}, one over the largest eigenvalue"
    yield f"fastest   {scale_text if largest > 0.0 else 'nothing turns, grows or decays here'}"
    yield from _suggested_step_lines(modes)


def _damping_lines(modes: xr.Dataset) -> Iterator[str]:
    """Tell how fast oscillations decay and what they turn at then, where anything damps them."""
    values = modes["eigenvalue_real"].values + 1j * modes["eigenvalue_imag"].values
    size = float(np.abs(values).max(initial=0.0))
    damped = values[values.real < -ROUNDING * size]
    unit = unit_suffix(str(modes["eigenvalue_real"].attrs["units"]))
    turning = damped[damped.imag > ROUNDING * size]
    if turning.size:
        shown = [
            f"{value.imag:.4g}{unit.replace(' ', ' rad ', 1)} decaying at {-value.real:.4g}{unit}"
            for value in turning[:MOST_TOLD]
        ]
        rest = f", … and {turning.size - MOST_TOLD} more" if turning.size > MOST_TOLD else ""
        yield f"damped    {', '.join(shown)}{rest}"
    if creeping := int((np.abs(damped.imag) <= ROUNDING * size).sum()):
        yield f"decays    {creeping} without oscillation"


def _frequency_sentence(modes: xr.Dataset) -> str:
    """Tell how many modes there are, and the frequencies of the slowest and of the fastest."""
    frequency = modes["frequency"]
    values = frequency.values[np.isfinite(frequency.values)]
    oscillating, second = values[values > 0.0], unit_suffix(str(modes["period"].attrs["units"]))
    distinct = [*dict.fromkeys(f"{value:.4g}" for value in oscillating.tolist())]
    shown_frequencies = distinct if len(distinct) <= MOST_TOLD + 1 else [*distinct[:MOST_TOLD], f"… {distinct[-1]}"]
    phrases = [f"{frequency.size}"]
    if shown_frequencies:
        units, longest = unit_suffix(str(frequency.attrs["units"])), 2.0 * np.pi / float(oscillating[0])
        word = "undamped frequency" if len(shown_frequencies) == 1 else "undamped frequencies"
        phrases.append(f"{word} {', '.join(shown_frequencies)}{units}; the longest period is {longest:.4g}{second}")
    if rigid := values.size - oscillating.size:
        phrases.append(f"{rigid} {'rigid motion' if rigid == 1 else 'rigid motions'}")
    if non_oscillating := frequency.size - values.size:
        phrases.append(f"{non_oscillating} {'does' if non_oscillating == 1 else 'do'} not oscillate")
    return "; ".join(phrases)


def _suggested_step_lines(modes: xr.Dataset) -> Iterator[str]:
    """Tell the step to begin with, and the methods that it is suggested for; the longest step first."""
    step, methods = modes["suggested_step"], np.array(words_of_flag(modes["method_name"]))
    longest_first = np.argsort(-step.values, kind="stable").tolist()
    for size, names in methods_by_step({str(methods[k]): float(step.values[k]) for k in longest_first}).items():
        step_text = f"{size}{unit_suffix(str(step.attrs['units']))} to begin with by {', '.join(names)}"
        yield from textwrap.wrap(step_text, WIDTH, initial_indent="step      ", subsequent_indent=" " * 10)


SUMMARIES = {"modes": modes_lines}
