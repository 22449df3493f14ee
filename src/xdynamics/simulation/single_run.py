"""Simulation of a model, and simulation of an archive's model again, in which every bit is compared.

A fixed step beyond the stability limit of its method is warned of. The model of an archived run comes with the settings
of the run, so that it can be marched again with a change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from xdynamics import archive, record
from xdynamics.archive.folder_store import has_archive, store_of
from xdynamics.archive.store import Given, Place, location_of
from xdynamics.evidence.comparing.bits import compare_reproduction
from xdynamics.faults import InputError, StabilityWarning, warn
from xdynamics.kernels.model_programs import has_loops
from xdynamics.keywords import IN_FILES, KEYWORDS, STEP, TIME
from xdynamics.march import March, Settings
from xdynamics.march.configuration import settings_for, with_run
from xdynamics.march.timescales import SLOW, beyond_eigenvalues, jacobian_at_start
from xdynamics.methods import METHODS, Method
from xdynamics.model import Model, check_model
from xdynamics.model.linearisation import free_coordinates, initial_state, linearise
from xdynamics.model.parts import Authorship
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.run_dataset import check_record_room
from xdynamics.record.schemas import is_run, kind_description
from xdynamics.simulation.unmarched_runs import (
    check_destination,
    check_sampled,
    marched_record,
    sampled_march,
    sampled_states,
    times_within,
    unmarched_run,
)
from xdynamics.stability import LinearSystem, fastest_rate, grows_at, stable_step_of, surely_stable
from xdynamics.units import NUMBERS, SECONDS, Quantity, coherent, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress
    from xdynamics.simulation.unmarched_runs import Floats

OFTEN_STABLE = ("velocity_verlet", "rk4", "dormand_prince")  # named where another method is not
FEW_NUMBERS = 64  # of a state up to which the limit is found though errors do not grow: gaps below a step are met, too
SAFE_STEP = 0.1  # over the fastest time scale: stable for long with every method of order 2 and more


def warn_of_instability(model: Model, settings: Settings) -> None:
    """Warn once if a fixed step is beyond the method's stability limit at the initial state, as `modes` reports it."""
    step, method = settings.step, settings.method
    if not isinstance(step, float | int) or settings.adaptive or model.python_forces or model.delays:
        return
    if beyond_eigenvalues(model):
        return
    start = _Start(model, method, settings)
    jacobian, span = _start_jacobian(start), settings.until - model.statement.initial["t"].si
    if jacobian is None:
        return
    if method.order > 1:
        phase = step * _fastest_rate(start)
        if not (phase > SAFE_STEP or span / step * phase ** (method.order + 1) > 1.0):
            return
        if surely_stable(jacobian, method, free_coordinates(model), step):
            return
    unresolved = SLOW * _fastest_rate(start) if has_loops(model) else 0.0  # growth that differences may show
    if has_loops(model) and len(jacobian) > FEW_NUMBERS and not _grows(start, step, growth=unresolved):
        return
    limit, unit = _longest_stable_step(start, growth=unresolved), unit_suffix(model.time_unit)
    if limit > 0.0 and step > limit:
        warn(
            f"step {step:.6g}{unit} is beyond the stability limit {limit:.6g}{unit} of '{method.name}'"
            f" for '{model.name}' at its start: errors grow from step to step; take a shorter step, or see"
            " xdynamics.modes(model) for the steps that other methods allow",
            StabilityWarning,
        )
    elif limit == 0.0 and step > (longest := _longest_stable_step(start, growth=1.0 / span)):
        warn(
            f"no step of '{method.name}' is stable for '{model.name}' at its start, however short: errors grow from step"
            f" to step. Within this run of {span:.6g}{unit}, a step of {step:.6g}{unit} multiplies them by more than e"
            f" (2.7), one of up to {longest:.3g}{unit} by less; {_stable_methods(start, unit)}",
            StabilityWarning,
        )


def _stable_methods(start: _Start, unit: str) -> str:
    """Name some methods that are stable for a model, with their longest steps."""
    starts = {name: _Start(start.model, METHODS[name], start.settings) for name in OFTEN_STABLE}
    limits = {name: _longest_stable_step(method_start) for name, method_start in starts.items() if method_start.fits}
    stable = [f"{name} (up to {limit:.3g}{unit})" for name, limit in limits.items() if 0.0 < limit < np.inf]
    stable_text = f"stable are {', '.join(stable)}; " if stable else ""
    return f"{stable_text}xdynamics.modes(model) has the limits of all methods"


@dataclass(frozen=True)
class _Start:
    """The start of a run; its Jacobian and steps that are stable there depend on model and method alone."""

    model: Model
    method: Method
    settings: Settings = field(compare=False)

    @property
    def fits(self) -> bool:
        """Whether the method takes the model."""
        return not self.method.refusals(self.model)


@lru_cache(maxsize=64)
def _start_jacobian(start: _Start) -> Floats | None:
    """Return the Jacobian, of a law in loops by differences: trees of its elements would take longer than the run."""
    return jacobian_at_start(start.model, start.settings) if has_loops(start.model) else _linearised(start.model)


@lru_cache(maxsize=64)
def _fastest_rate(start: _Start) -> float:
    """Bound the modulus of every eigenvalue of the Jacobian at the start, 1/time; computed once."""
    jacobian = _start_jacobian(start)
    return np.inf if jacobian is None else fastest_rate(jacobian)


@lru_cache(maxsize=64)
def _linearised(model: Model) -> Floats | None:
    """Linearise a model at its start; None where that is not possible."""
    try:
        return linearise(model, initial_state(model)).reduced
    except InputError:
        return None  # the march will say what is wrong with the forces at the start


@lru_cache(maxsize=256)
def _grows(start: _Start, step: float, *, growth: float) -> bool:
    """Whether errors grow at the step itself."""
    jacobian = _start_jacobian(start)
    return jacobian is not None and grows_at(
        LinearSystem.from_jacobian(jacobian, free_coordinates(start.model)), start.method, step, growth=growth
    )


@lru_cache(maxsize=256)
def _longest_stable_step(start: _Start, *, growth: float = 0.0) -> float:
    """Return the largest stable step of a method at a model's start, from some hundred trial steps; cached."""
    jacobian = _start_jacobian(start)
    assert jacobian is not None  # noqa: S101 - who asks has seen it
    system = LinearSystem.from_jacobian(jacobian, free_coordinates(start.model))
    return stable_step_of(system, start.method, start.model, growth=growth)


ALWAYS = ("method", "until", "step", "rtol", "atol")  # the others are said where they are not what follows from these


def model_of_run(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None = None) -> Model:
    """Return the model of a run, with the settings that it was marched with as its `[run]`.

    Parameters
    ----------
    run : xarray.Dataset
        A run, or a part of one.
    functions : mapping of str to callable, optional
        The Python functions that its forces call.

    Raises
    ------
    InputError
        If it is no run, its model was left out, or its steps were given one by one, which a `[run]` does not say.
    ModelError
        If a function is missing or another one.
    """
    if "model_toml" not in run.variables:
        raise InputError("the record has no model_toml, from which its model is read; take the whole one")
    if not is_run(run.attrs):
        raise InputError(f"this is {kind_description(run.attrs)}; give a run")
    model = Model.from_record(
        run["model_toml"].values.item(), functions=functions, about=Authorship.from_attributes(run.attrs)
    )
    return with_run(model, _run_section(run, with_run(model, {})))


def changed_model(model: Model | xr.Dataset, **numbers: Mapping[str, Any] | None) -> Model:
    """Return a model, or that of a run, with other numbers in some of its sections.

    Raises
    ------
    InputError
        If it is neither.
    ModelError
        If an entry does not exist, or cannot be so.
    """
    if not isinstance(model, Model) and hasattr(model, "data_vars"):
        return changed_model(model_of_run(model), **numbers)
    check_model(model)
    changed = {title: entries for title, entries in numbers.items() if entries}
    return cast("Model", model.replace(**changed) if changed else model)


def _run_section(run: xr.Dataset, bare_model: Model) -> dict[str, Any]:
    """Return the settings of a record as a model file has them, without those that follow from the others."""
    recorded_settings = {
        name: value for name, value in recorded_arguments(run).items() if name in IN_FILES and value is not None
    }
    if isinstance(recorded_settings.get("step"), np.ndarray):
        raise InputError(
            "the steps of this run were given one by one, and a [run] has one step; run its model by"
            " simulate(Model.from_record(run.model_toml.item()), step=run.given_step_size, …)"
        )
    section = {name: _file_value(name, value, bare_model) for name, value in recorded_settings.items()}
    full_settings = settings_for(bare_model, **section)
    for name in [name for name in section if name not in ALWAYS]:
        fewer_settings = {other_name: value for other_name, value in section.items() if other_name != name}
        if settings_for(bare_model, **fewer_settings) == full_settings:
            section = fewer_settings
    return section


def _file_value(name: str, value: Any, model: Model) -> Any:
    """Return a setting as it stands in a file."""
    if KEYWORDS[name].kind in (TIME, STEP):
        return float(value) if model.time_unit == NUMBERS else str(Quantity(float(value), SECONDS))
    if name == "atol" and isinstance(value, Mapping):
        return {key: f"{size.value!r} {coherent(model.elements.units[key]).text}" for key, size in value.items()}
    return [*value] if isinstance(value, tuple) else value


def simulate(
    model: Model | xr.Dataset,
    *,
    # what is changed in the model
    parameters: Mapping[str, str | float] | None = None,
    initial: Mapping[str, str | float] | None = None,
    # the march
    method: str | None = None,
    until: str | float | None = None,
    step: str | float | Sequence[float] | None = None,
    nodes: Sequence[str | float] | None = None,
    # step control
    rtol: float | None = None,
    atol: float | Mapping[str, str | float | Quantity] | None = None,
    atol_floor: str | None = None,
    order: int | None = None,
    estimator: str | None = None,
    safety: float | None = None,
    growth_limits: tuple[float, float] | None = None,
    min_step: str | float | None = None,
    max_step: str | float | None = None,
    max_steps: int | None = None,
    # events
    time_tolerance: str | float | None = None,
    switches: str | None = None,
    event_root_method: str | None = None,
    event_start: str | None = None,
    sliding: str | None = None,
    # arithmetic
    scales: Mapping[str, str] | None = None,
    summation: str | None = None,
    precision: str | None = None,
    jacobian: str | None = None,
    math_functions: str | None = None,
    # the record
    force_samples: str | None = None,
    keep_every: int | None = None,
    log: str | Sequence[str] | None = None,
    compress: bool | None = None,
    # what is returned, and where it is kept
    times: Sequence[float | str] | str | float | None = None,
    path: Given | None = None,
    resume: bool = False,
    memory: str | float | None = None,
    progress: Progress | None = None,
    compute: bool = True,
    sizes: Mapping[str, int] | None = None,
) -> xr.Dataset:
    """March a model and return its run record.

    Parameters
    ----------
    model : Model, or xarray.Dataset
        Of a run, its model is marched with the settings that the run was marched with, but for those that are given.
    parameters, initial : mapping of str to str or float, optional
        Numbers of the model that are changed first, as by `Model.replace`: ``{"vt": "35 m s-1"}``.
    method : str
        Name of a method; `xdynamics methods` lists them. Like all that follows but arrays, it may stand in `[run]`.
    until : str or float
        Time at which to end, unless an event stops the run before.
    step : str, float or array of float
        Step of the grid t0 + n h: ``"1 ms"``, or a number of seconds. An array gives every step, like
        ``step=run.step_size[1:]``. With a tolerance, the first step to try.
    nodes : array of str or float
        Times to land on, besides the breakpoints of measured drives: ``["1 s", "2.5 s"]``.
    rtol, atol : float
        Relative and absolute tolerance: steps are chosen so that no component's estimated local error is larger than
        atol + rtol*max(abs(value before), abs(value after)). `atol` is a number for every coordinate, velocity and
        state, or one for each by name: ``{"y": "1 um", "v_y": "1 mm s-1"}``. A number without a unit is in each
        variable's own declared unit (a velocity's is that unit per second; with `scales`, theirs). What is given none
        follows the size of its variable, whatever its units: rtol times the largest absolute value so far, and of what
        starts at rest or at zero not less than a millionth of rtol times the largest of its kind, or times what the
        forces about the start make of it in the fastest time scale (`solver_atol_rule`; what was used last is the
        variable's `atol`). Without either, a method with an embedded formula and no step marches with rtol = 1e-6.
    atol_floor : {"terms that cancel", "none"}
        What a tolerance that follows is never less than. A body that rests, held by forces that cancel, moves by their
        rounding alone, and has no size of its own: a trial that fails by no more than ten spacings of the terms' sum, over
        the mass and along the step, passes (`atol_floor_rule`). The second is for the bits of older archives.
    order : int
        Order of `taylor`, from 2 to 60. By default the one with which a relative tolerance takes the least work,
        ceil(1 - ln(rtol)/2), and 8 for given steps.
    estimator : {"embedded", "step_doubling", "step_doubling_extrapolated", "none"}
        Where the error estimate comes from; the method's embedded formula if it has one, else step doubling.
    safety, growth_limits, min_step, max_step, max_steps
        Limits of step control; by default 0.9, (0.2, 10), the spacing of t, the span and 1,000,000.
    time_tolerance : str or float
        How well events, impacts and switches without a tolerance of their own are located: a picosecond, or of a run below
        a second 1e-12 of its span; never better than t is spaced.
    switches : {"located", "stepped over"}
        Whether the march lands where the argument of an `abs`, `sign`, `min`, `max` or `where` in a force passes through
        zero, as events of the kind `regime_switch`; not in forces that are declared smooth, nor if there are over 40.
    event_root_method : {"earliest first", "earliest first by Hermite", "one by one"}
        How events are located: of several in a step the earliest before others, its substeps counted in `event_substeps`.
        The others are for the bits of older archives: on Hermite's polynomials though a step leaves its own (`radau_iia`);
        or as version 0.2 did, in the order of their declaration, each substep a rejected trial.
    event_start : {"judged", "waiting"}
        What becomes of a stop, switch or reset whose function is zero at the start, or where another event acts: it has
        happened if the motion takes it on in its direction, `rising` or `falling`; or, for the bits of older archives,
        it waits until its function has left zero, in whichever direction.
    sliding : {"Filippov", "ends"}
        What becomes of a motion that both sides drive back to a switch at which a force jumps: it slides along it, by the
        convex combination of both forces that keeps the function of the switch at zero (Filippov, Differential Equations
        with Discontinuous Righthand Sides, 1988, chapter 2), and ``switch_share_<switch>(step)`` has the share of the
        positive side; or the run ends as ``sliding_mode``, as in older archives.
    scales : mapping, optional
        Length, time and mass to march in nondimensional variables with: ``{"length": "0.4 m"}``. Everything reported
        has its units again.
    summation : {"compensated", "plain"}
        Whether what rounding takes from the state at each update is carried to the next, so that a long run's error does
        not grow with its steps (Hairer, Lubich, Wanner, section VIII.5); the first for symplectic methods but
        `implicit_midpoint`, which has no such updates, else the second.
    precision : {"float64", "double_double"}
        The kind of every number: one float, or the unevaluated sum of two, which has 31 digits. Numbers and times in the
        model and here count as they are written, literals and coefficients of methods too; tables as the floats that they
        are. The record has a float and what is left beside it: `x` and `rest_x`, `time` and `rest_time`,
        `event_time` and `rest_event_time`, to be added. For explicit methods and `taylor`, which alone has coefficients
        of as many digits (those of `dop853` have 30); `rtol` may go down to 5e-31. What is of single floats is refused:
        contacts, functions in Python, scales, step doubling, sweeps. `compare` a run with its twin to see its rounding.
    jacobian : {"exact", "differences"}
        The source of the derivatives of the forces for `radau_iia`: their expressions, or, for forces in Python too,
        differences of the forces.
    math_functions : {"xdynamics 2", "xdynamics 1"}
        The set of elementary functions; an older one is for the bits of an older archive, which carries its name.
    force_samples : {"all", "none"}
        Whether to record every force evaluation of the accepted steps.
    keep_every : int
        Record only every n-th row of the grid (of chosen and given steps, every n-th row of the march), besides those of
        events, of `nodes` and of both ends; `step_number` says which row of the march each is. The march is the same, and
        what is kept of it has the same bits. `reproduce`, `extend` and `resume` take such a record; what needs every row,
        like states between, says so, and `complete` marches them again.
    log : {"full", "states"} or list of str
        Which columns to record: all; times, steps, flags, coordinates, velocities, states and their errors; or beside
        times, steps and flags those that are named, ``["x", "total_energy"]``. Events and rejected trials are whole.
        Of elements, ``["u[3]", "r[Jupiter, x]"]``, these alone are recorded, along dimensions of their own: ``u(step,
        logged_site)``, ``run.u.sel(logged_site=3)``, where several quantities share the union of their elements, nan for those
        that were not named. ``site`` keeps its size, for parameters and what is logged whole.
        By default all; of a model with dimensions whose state has over 1,000 numbers the second.
        `complete` adds the rest, to the bits. Of a model with dimensions, energies that are not recorded are not
        computed: one that is not finite ends no march.
    compress : bool
        Whether an archive of the run is compressed, by zlib with shuffled bytes: the same numbers and digests, in half of
        the bytes (a trajectory) to a seventh of them (what hardly changes); see `save` for what it costs.
    times : array_like of float, s; or text like ``"0:20:201 s"``
        Return the states at these times, what `sample` gives of the run, along `at`, in the place of the record; those
        after an early end are left out. Of the log only what they are computed from is kept in memory, a step for each.
        Accepted states joined by straight lines may be far off. With `path` the file still holds the whole record.
    path : str or Path, optional
        Stream the run to this file, or object like ``"s3://bucket/run.nc"``, in bounded memory, and return it opened. A run that ends badly does not replace an
        archive of one that ended well: it is written beside it, with a warning. Finished
        parts of a long run are kept in a folder beside it, `.run.nc.segments`, until it is whole.
    resume : bool
        Go on from the segments that a process left behind, to the bits of the uninterrupted run.
    memory : str or float, optional
        The most that the log may take in memory: ``"2 GB"``, or bytes; by default four fifths of what is free. A fixed
        grid that needs more is refused before it starts, other runs, and those of many events, once they come to it;
        with `path` rows are streamed, and the disk has to have room.
    progress : callable, optional
        Called now and then with the fraction done, the time in s and the rows so far.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, and nothing is marched before one is computed;
        `diagnose`, with ``compute=False``, and `report` march it in one graph with all else, and every other verb that
        takes a run marches it first. Each gets the whole record; see `sizes` for what the Dataset itself shows.
    sizes : mapping of str to int, optional
        With ``compute=False``, how much to show along dimensions whose sizes only marching tells: ``{"step": 5000,
        "event": 10}``. Beyond its end the run has nan there, -1 in flags and numbers of rows. Not needed for `step` of
        a fixed grid without events; what is along other dimensions is left out.

    Returns
    -------
    xarray.Dataset
        A run that ends badly is returned too, up to its last accepted state; see ``run.attrs["run_outcome"]``.

    Raises
    ------
    InputError
        If a setting is missing or cannot be used, or the method refuses the model; nothing is computed or written.

    Warns
    -----
    StabilityWarning
        If a fixed step is beyond the method's stability limit for the model linearised at its start.
    AccuracyWarning
        If the run ended badly, or the tolerances did not control a variable, being too large for it;
        `run_outcome_text` says so too.

    Notes
    -----
    Error test and controller: Hairer, Norsett, Wanner, Solving ODEs I, section II.4, with the largest component in the
    place of the root mean square, so that no component can hide behind others. Where the estimate is not of the order
    of what goes on, steps are judged by other tolerances, so that the error at the end is proportional to those asked
    for: with step doubling by rtol**((p + 1)/p), p the order of the method, and `radau_iia` with its own estimate by
    0.1*rtol**(4/5); atol keeps its ratio to rtol. The record has both, `solver_rtol` and `solver_rtol_used`.

    Examples
    --------
    >>> model = Model(
    ...     name="free fall", coordinates={"y": {"unit": "m"}}, parameters={"m": "1 kg", "g": "9.80665 m s-2"},
    ...     mass={"y": "m"}, forces={"gravity": {"potential": "m*g*y"}}, initial={"y": "0 m", "v_y": "0 m s-1"},
    ... )
    >>> run = simulate(model, method="velocity_verlet", step="0.5 s", until="1 s")
    >>> run.y.values.tolist()
    [0.0, -1.22583125, -4.903325]
    >>> run.y.attrs["units"], run.attrs["run_outcome"]
    ('m', 'completed')
    """
    requested_settings = {name: value for name, value in locals().items() if name in KEYWORDS}
    model = changed_model(model, parameters=parameters, initial=initial)
    settings = settings_for(model, **requested_settings)
    check_destination(path, resume=resume)
    sample_times = (
        None if times is None else times_within(times, model.time_unit, model.statement.initial["t"].si, settings.until)
    )
    if not compute:
        if progress is not None or resume:
            raise InputError(
                "progress and resume are for compute=True: what is lazy is computed by whoever computes it"
            )
        return unmarched_run(model, settings, sample_times, path, memory, sizes or {})
    if sizes is not None:
        raise InputError(f"sizes are {sizes!r}, and are for compute=False: a run that is computed has its own")
    return _march_or_sample(model, settings, sample_times, path, memory, progress, resume=resume)


def _march_or_sample(
    model: Model,
    settings: Settings,
    sample_times: Floats | None,
    path: Given | None,
    memory: str | float | None,
    progress: Progress | None,
    *,
    resume: bool,
) -> xr.Dataset:
    """March a model; return the record, or the states at wanted times."""
    if progress is not None and not callable(progress):
        raise InputError(f"progress is {progress!r}, needs a function")
    if sample_times is not None and path is not None:
        check_sampled(settings)
    warn_of_instability(model, settings)
    if sample_times is not None and path is None:
        return sampled_march(model, settings, sample_times, progress)
    march = March(model, settings, progress)
    location = None if path is None else location_of(path)
    check_record_room(march, memory, location and store_of(location).written_at(location))
    if resume and location is not None and _is_finished_archive(march, location):
        archive.clear_rest(location)
        return sampled_states(archive.open_run(location, check=False), sample_times, model)
    return sampled_states(marched_record(march, location, resume=resume, memory=memory), sample_times, model)


def _is_finished_archive(march: March, path: Place) -> bool:
    """Whether a file is the finished archive of a march, so that there is nothing to resume."""
    archive.check_target(path)
    if not has_archive(path) or archive.has_segments(path):
        return False
    try:
        with archive.open_run(path) as archived_run:
            return record.comes_of(archived_run, march)
    except InputError:  # damaged, or no run: a new one takes its place
        return False


def reproduce(path: Given, *, functions: Mapping[str, Callable[..., float]] | None = None) -> xr.Dataset:
    """March an archive's own model again, from the file alone, and compare every variable bit for bit.

    For a selection the whole run is marched again, and every kept value is looked up in it.

    Parameters
    ----------
    path : str or Path
    functions : mapping of str to callable, optional
        The Python functions its forces call; their digests are compared first. Archived source is never run.

    Returns
    -------
    xarray.Dataset
        One row for each variable, as `compare` gives it; ``attrs["identical"]`` is 1 where every bit agrees,
        ``attrs["first_difference"]`` names the first that does not, and ``attrs["arithmetic"]`` states the
        largest difference. Of an archive by another version the numbers count, not the words.

    Raises
    ------
    ArchiveError
        If the file is damaged.
    InputError
        If it holds derived data, or a selection without what its run is marched from.
    ModelError
        If a function is missing or another one.
    """
    archived_run = archive.open_run(path)
    with archived_run:
        if not is_run(archived_run.attrs):
            raise InputError(f"'{path}' is {kind_description(archived_run.attrs)}; reproduce the archive of that run")
        return compare_reproduction(
            archived_run, archive.selected_like(archived_run, _march_again(archived_run, functions))
        )


def _march_again(archived_run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None) -> xr.Dataset:
    needed_names = [
        "model_toml",
        *(["given_step_size"] if archived_run.attrs["solver_step_control"] == "given" else ()),
    ]
    missing = [name for name in needed_names if name not in archived_run.variables]
    if missing:
        raise InputError(
            f"the selection was saved without {' and '.join(missing)}, from which its run is computed again"
        )
    model = Model.from_record(archived_run["model_toml"].values.item(), functions=functions)
    return simulate(model, **recorded_arguments(archived_run))
