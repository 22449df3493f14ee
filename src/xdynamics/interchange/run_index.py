"""Archived runs of a folder as one Dataset: settings, endings and chosen numbers, read when they are used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from xdynamics.archive import open_run
from xdynamics.archive.folder_store import is_folder, store_of
from xdynamics.archive.store import GIVEN, ZARR, Given, location_of
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.faults import ArchiveError, InputError, first_names
from xdynamics.march.configuration import THINNING, unthinned_settings_for
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.schemas import is_evidence, kind_description
from xdynamics.record.unfolding import unfold
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import EVENTS, INTEGRATED, ROOT_DIGEST, STEPS
from xdynamics.sweeping.kept_quantities import (
    AFTER,
    BEFORE,
    COUNT_FUNCTIONS,
    END,
    EVENT_COUNT,
    EVENT_TIME,
    RunQuantity,
    misspelling_text,
    run_quantities,
    run_values,
)
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

KIND, MEMBER = "index of runs", "member"
SETTINGS = {
    "method": "method",
    "rtol": "relative tolerance",
    "step": "step",
    "until": "time up to which it was asked for",
}
Functions = Mapping[str, Callable[..., float]]


class _Number(NamedTuple):
    """A number of runs: its unit, its description, and how a run gives it; None if that takes a diagnosis."""

    units: str
    long_name: str
    read: Callable[[xr.Dataset], float] | None = None


def open_runs(
    runs: Given | Sequence[Given], *, keep: Sequence[str] | str = (END,), functions: Functions | None = None
) -> xr.Dataset:
    """Open archived runs as one Dataset along `member`: an index of a folder.

    Parameters
    ----------
    runs : str, Path or sequence of these
        A folder, or a pattern, ``"results/*.nc"``, of whose files those that are runs are taken, sorted by name; or files.
    keep : sequence of str
        Numbers of each run, as `sweep` has them: ``end`` (coordinates, velocities, states in the last row),
        ``end_total_energy``, ``event_time_ground``, ``event_count_ground``, ``after_ground_v_y``, ``event_residual_ground``
        (of the first occurrence), and any number that a diagnosis has, ``maximum_y``, ``energy_drift``.
    functions : mapping of str to callable, optional
        The Python functions that the models' forces call.

    Returns
    -------
    xarray.Dataset
        Along `member`, labelled by the files' names: `title`, `run_outcome`, `solver_method`, `solver_rtol`, `solver_step`,
        `solver_until`, `model_digest`, `content_digest`, counts, every parameter, and what `keep` names, in the units of
        the first run that has it; nan where a run has none. These numbers are dask arrays: a file is verified, and read,
        when a number of it is used, once for all of its numbers. Attribute `left_out` names files of a folder that are no
        runs.

    Raises
    ------
    InputError
        If there is no run, a file is none, a word is a number of no run, or two runs have it in units of different kinds.
    ArchiveError
        If a file is damaged, or another one than when it was indexed.

    Examples
    --------
    >>> import tempfile
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for vt in (20, 40):
    ...         run = xd.simulate(model.replace(parameters={"vt": vt}), rtol=1e-6, path=f"{folder}/{vt}.nc")
    ...     found = open_runs(folder, keep="event_time_ground").load()
    >>> found.member.values.tolist(), found.event_time_ground.round(3).values.tolist()
    (['20.nc', '40.nc'], [3.399, 3.854])
    """
    import dask.array
    from dask.delayed import delayed

    load_dask_whole()
    paths, is_chosen = _paths(runs)
    heads, left_out = _heads(paths, is_chosen=is_chosen)
    if not heads:
        raise InputError(
            f"there is no archived run in '{runs}'; {first_names(left_out) if left_out else 'it has no .nc file, nor a .zarr store'}"
        )
    words = _requested_words(keep, [*heads.values()], functions)
    da: Any = dask.array
    variables: dict[str, Any] = _describe_runs(heads)
    tasks = []
    for path, head in heads.items():
        digest = str(head.attrs[ROOT_DIGEST])
        call = delayed(_read_numbers, pure=True)
        tasks.append(call(path, digest, [*words], functions, dask_key_name=f"numbers-{digest}-{'-'.join(words)}"))
    for word, (units, long_name, factors) in words.items():
        cells = [
            da.from_delayed(task[word], (), dtype=float) * factor for task, factor in zip(tasks, factors, strict=True)
        ]
        variables[word] = (
            (MEMBER,),
            da.stack(cells),
            attrs_of(units, f"{long_name}; nan of a run that has none", "number"),
        )
    digests = [str(head.attrs[ROOT_DIGEST]) for head in heads.values()]
    runs_index = evidence_dataset(
        KIND, f"{len(heads)} archived runs", digests, variables, {"left_out": "\n".join(left_out)} if left_out else {}
    )
    return runs_index.assign_coords(
        {MEMBER: (MEMBER, np.array(_run_names([*heads])), attrs_of("1", "file of the run", "axis"))}
    )


def _paths(runs: Any) -> tuple[list[str], bool]:
    """Return the files that are meant, and whether they were chosen one by one."""
    if isinstance(runs, GIVEN):
        text = str(runs)
        if has_magic(text):
            return sorted(glob(text)), False  # noqa: PTH207 - of a text, which may be absolute
        folder = location_of(runs)
        if folder.suffix != ZARR and is_folder(folder):
            entries = store_of(folder).names(folder)
            return sorted(str(entry) for entry in entries if entry.suffix in (".nc", ZARR)), False
        return [text], True
    if not isinstance(runs, Sequence) or not runs or not all(isinstance(run, GIVEN) for run in runs):
        raise InputError(f"runs are {str(runs)[:60]!r}, need a folder, a pattern like 'results/*.nc', or files")
    return [str(run) for run in runs], True


def _heads(paths: Sequence[str], *, is_chosen: bool) -> tuple[dict[str, xr.Dataset], list[str]]:
    """Open files without reading them; a file without a run is an error if it was chosen, else listed."""
    heads, left_out = {}, []
    for path in paths:
        try:
            heads[path] = _open_head(path)
        except (InputError, ArchiveError) as error:
            if is_chosen:
                raise
            left_out.append(str(error).splitlines()[0])
    return heads, left_out


def _open_head(path: str) -> xr.Dataset:
    """Open a run without reading it.

    Raises
    ------
    InputError
        If the file is no run.
    """
    head = open_run(path, check=False)
    if is_evidence(head.attrs) or STEPS not in head.dims or ROOT_DIGEST not in head.attrs:
        kind_text = kind_description(head.attrs) if is_evidence(head.attrs) else "no run"
        head.close()
        raise InputError(f"'{path}' is {kind_text}; an index is of runs")
    return head


def _run_names(paths: list[str]) -> list[str]:
    """Call runs by their files' names, or by their paths where names repeat."""
    names = [Path(path).name for path in paths]
    return names if len({*names}) == len(names) else paths


def _describe_runs(heads: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    """Return the descriptive attributes of records as variables along `member`."""
    runs = [*heads.values()]
    texts = {"title": "title of the run", "run_outcome": "how the run ended", "model_digest": "sha256 of the model"}
    texts |= {ROOT_DIGEST: "content digest of the run"}
    described_variables: dict[str, Any] = {
        name: ((MEMBER,), np.array([str(run.attrs.get(name, "")) for run in runs]), attrs_of("1", description, "text"))
        for name, description in texts.items()
    }
    for word, description in SETTINGS.items():
        name = f"solver_{word}"
        if word == "method":
            described_variables[name] = (
                (MEMBER,),
                np.array([str(run.attrs[name]) for run in runs]),
                attrs_of("1", description, "setting"),
            )
            continue
        values = np.array([_scalar_number(run.attrs.get(name)) for run in runs])
        units = next((str(run.attrs[f"{name}_units"]) for run in runs if f"{name}_units" in run.attrs), "1")
        if np.isfinite(values).any():
            described_variables[name] = (
                (MEMBER,),
                values,
                attrs_of(units, f"{description}; nan of runs without one", "setting"),
            )
    for name in COUNT_FUNCTIONS:
        values = np.array([int(run.attrs.get(name, -1)) for run in runs])
        described_variables[name] = (
            (MEMBER,),
            values,
            attrs_of("1", name.removeprefix("run_").replace("_", " "), "effort"),
        )
    return described_variables | _describe_parameters(runs, {*described_variables})


def _describe_parameters(runs: Sequence[xr.Dataset], described_names: set[str]) -> dict[str, Any]:
    """Return the parameters of records, in one unit each, as variables along `member`."""
    described_variables: dict[str, Any] = {}
    parameters = {
        str(name): variable
        # reversed, because the last entry stays: the first run that has a parameter gives its unit
        for run in reversed(runs)
        for name, variable in run.variables.items()
        if variable.attrs.get("role") == "parameter" and not variable.dims
    }
    for name, variable in parameters.items():
        if name not in described_names:
            unit = str(variable.attrs["units"])
            values = np.array(
                [
                    _scalar_number(run[name].values) * _unit_factor(name, run[name].attrs, unit)
                    if name in run
                    else np.nan
                    for run in runs
                ]
            )
            described_variables[name] = (
                (MEMBER,),
                values,
                attrs_of(unit, str(variable.attrs["long_name"]), "parameter"),
            )
    return described_variables


def _scalar_number(value: Any) -> float:
    return float(value) if value is not None and np.ndim(value) == 0 else np.nan


def _unit_factor(name: str, attributes: Mapping[Any, Any], units: str) -> float:
    """Return the factor that converts numbers to a unit."""
    given_unit, common_unit = parse_unit(str(attributes["units"])), parse_unit(units)
    if given_unit.dimension != common_unit.dimension:
        raise InputError(f"'{name}' is in '{units}' in one run and in '{given_unit.text}' in another; open them apart")
    # factors are fractions: the quotient is exact, and rounded once
    return float(given_unit.factor / common_unit.factor)


def _requested_words(
    keep: Any, heads: Sequence[xr.Dataset], functions: Functions | None
) -> dict[str, tuple[str, str, list[float]]]:
    """Return unit, description and each run's conversion factor of every wanted number."""
    row = [keep] if isinstance(keep, str) or not isinstance(keep, Sequence) else list(keep)
    if not all(isinstance(word, str) for word in row):
        raise InputError(f"keep is {str(keep)[:60]}, needs words like 'end'")
    of_runs: dict[Any, Any] = {}
    numbers_of_runs = [_RunNumbers(unfold(head), functions, of_runs) for head in heads]
    if END in row:
        end_position = row.index(END)
        ends = dict.fromkeys(word for run_numbers in numbers_of_runs for word in run_numbers.ends)
        row = [*row[:end_position], *ends, *row[end_position + 1 :]]
    requested_numbers: dict[str, tuple[str, str, list[float]]] = {}
    for word in dict.fromkeys(row):
        numbers = [run_numbers.number(word) for run_numbers in numbers_of_runs]
        first = next((number for number in numbers if number is not None), None)
        if first is None:
            every = list(dict.fromkeys(name for run_numbers in numbers_of_runs for name in run_numbers.names))
            raise InputError(f"keep has {misspelling_text(word, every)}")
        factors = [
            1.0 if number is None else _unit_factor(word, {"units": number.units}, first.units) for number in numbers
        ]
        requested_numbers[word] = first.units, first.long_name, factors
    return requested_numbers


class _RunNumbers:
    """The numbers that a run has, by name, from its header alone."""

    def __init__(self, run: xr.Dataset, functions: Functions | None, of_runs: dict[Any, Any]) -> None:
        self.run, self.functions, self.of_runs = run, functions, of_runs
        self.along = [
            str(name)
            for name, variable in run.variables.items()
            if variable.dims == (STEPS,) and variable.dtype.kind == "f"
        ]
        meanings = str(run["event_detector"].attrs.get("flag_meanings", "")) if "event_detector" in run else ""
        self.detectors = meanings.replace(":", ".").split() if run.sizes.get(EVENTS) else []

    @property
    def ends(self) -> list[str]:
        """The words of the last states."""
        states = [name for name in self.along if self.run[name].attrs.get("role") in INTEGRATED]
        return [f"end_{name}" for name in ("time", *states)]

    @property
    def names(self) -> list[str]:
        """All words."""
        ends = [f"end_{name}" for name in self.along]
        events = [word + name for name in self.detectors for word in (EVENT_TIME, EVENT_COUNT)]
        return [*ends, *events, *self._run_quantities()]

    def number(self, word: str) -> _Number | None:
        """Return a number by its word; None if the run has none of that name."""
        run = self.run
        if (name := word.removeprefix("end_")) in ("time", *self.along) and name != word:
            return _Number(str(run[name].attrs["units"]), f"{name} in the last row", lambda run: float(run[name][-1]))
        for detector in self.detectors:
            if (event_number := self._number_of_event(word, detector)) is not None:
                return event_number
        of_run = self._run_quantities().get(word)
        if of_run is None or of_run.dims:
            return None
        return _Number(str(of_run.attributes["units"]), str(of_run.attributes["long_name"]))

    def _number_of_event(self, word: str, detector: str) -> _Number | None:
        run = self.run
        if word == f"{EVENT_COUNT}{detector}":
            return _Number(
                "1", f"how often '{detector}' was met", lambda run: float(len(_event_indices(run, detector)))
            )
        for head, side in ((AFTER, "event_row_after"), (BEFORE, "event_row_before")):
            name = word.removeprefix(f"{head}{detector}_")
            if name != word and name in self.along:
                long_name = f"{name}, {head.removesuffix('_')} '{detector}' was met, first"
                return _Number(
                    str(run[name].attrs["units"]), long_name, partial(_value_beside_event, name, side, detector)
                )
        name = word.removesuffix(f"_{detector}")
        if name != word and name in run and run[name].dims == (EVENTS,) and run[name].dtype.kind in "fi":
            long_name = f"{run[name].attrs['long_name']}, '{detector}', first"
            return _Number(
                str(run[name].attrs["units"]),
                long_name,
                lambda run: _first_value(run[name].values[_event_indices(run, detector)]),
            )
        return None

    def _run_quantities(self) -> Mapping[str, RunQuantity]:
        """Return the numbers that need a diagnosis, listed once for all runs of a model by one method."""
        key = tuple(str(self.run.attrs[name]) for name in ("model_digest", "solver_method", "solver_step_control"))
        if key not in self.of_runs:
            model, recorded_settings = model_of_record(self.run, self.functions), recorded_arguments(self.run).items()
            used_settings = {
                name: value for name, value in recorded_settings if value is not None and name not in THINNING
            }
            self.of_runs[key] = run_quantities(model, unthinned_settings_for(model, **used_settings))
        return cast("Mapping[str, RunQuantity]", self.of_runs[key])


def _event_indices(run: xr.Dataset, detector: str) -> Any:
    return np.flatnonzero(np.array(words_of_flag(run["event_detector"])) == detector)


def _value_beside_event(name: str, side: str, detector: str, run: xr.Dataset) -> float:
    return _first_value(run[name].values[run[side].values[_event_indices(run, detector)]])


def _first_value(values: Any) -> float:
    return float(values[0]) if len(values) else np.nan


def _read_numbers(path: str, digest: str, words: Sequence[str], functions: Functions | None) -> dict[str, Any]:
    """Read the numbers of one run, verified.

    Raises
    ------
    ArchiveError
        If the file is damaged, or not that which was indexed.
    """
    with open_run(path) as opened:
        if str(opened.attrs[ROOT_DIGEST]) != digest:
            raise ArchiveError(f"'{path}' is another run than when it was indexed; open the runs again")
        run = unfold(opened)
        run_numbers = _RunNumbers(run, functions, {})
        numbers = {word: run_numbers.number(word) for word in words}
        of_runs = [word for word, number in numbers.items() if number is not None and number.read is None]
        computed_values = (
            {word: _first_value(np.ravel(value)) for word, value in run_values(run, of_runs).items()} if of_runs else {}
        )
        return {
            word: np.array(
                computed_values.get(word, np.nan) if number is None or number.read is None else number.read(run)
            )
            for word, number in numbers.items()
        }
