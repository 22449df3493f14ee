"""The whole runs of a sweep's members together: states at common times, each read from its file when it is used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import GIVEN, Given, Place
from xdynamics.archive.reading import columns_of
from xdynamics.archive.sandboxed_reading import is_known, know
from xdynamics.archive.seals import Tail
from xdynamics.dynamics.shortened_steps import sampled
from xdynamics.dynamics.stacked_columns import step_columns
from xdynamics.dynamics.wanted_times import wanted_times
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record import unfold
from xdynamics.record.element_attributes import of_wholes
from xdynamics.record.element_names import expanded
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import AT, AT_TIME, GIVEN_STEP, ROOT_DIGEST, TEXT_NAMES
from xdynamics.sweeping.catalogue import open_sweep
from xdynamics.sweeping.collection import DIGEST as DIGEST_OF_SWEEP
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.grid import At
from xdynamics.sweeping.kept_quantities import DIGEST
from xdynamics.sweeping.member import check_digest, folder_of, opened, place_of
from xdynamics.sweeping.members import FILE, SEAL, Plan

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]


def open_logs(
    sweep: xr.Dataset | Given,
    times: Any = None,
    *,
    names: Sequence[str] | None = None,
    functions: Functions | None = None,
) -> xr.Dataset:
    """Open the runs that a sweep with ``keep=["log"]`` archived, as one lazy Dataset along its axes, at common times.

    Parameters
    ----------
    sweep : xarray.Dataset, str or Path
        What `open_sweep` returned, a part of it, or the folder.
    times : array_like, s, or texts like ``"0:10:101 s"``
        By default the sweep's own.
    names : sequence of str, optional
        Coordinates, velocities and states; by default all.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        On the axes' dimensions and `at`, what `sample` gives of every run: nan outside it, and where a member has no run.
        A file is opened, verified and read when a value of its member is used, by threads or on a cluster.

    Raises
    ------
    InputError
        If the sweep has no archived runs, it is not known where they are, or there are no times.

    Examples
    --------
    >>> import tempfile
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     grid = xd.sweep(model, {"m": "1:2:3 kg"}, keep=["log"], step="0.1 s", until="1 s", path=folder)
    ...     logs = open_logs(grid, "0:1:11 s", names=["x"])
    ...     print(dict(logs.sizes), float(logs.x.sel(m=2)[-1]) == float(xd.member(grid, m=2.0).x[-1]))
    {'m': 3, 'at': 11} True
    """
    load_dask_whole()
    catalogue = open_sweep(sweep) if isinstance(sweep, GIVEN) else sweep
    plan = plan_of(catalogue, functions)
    folder = folder_of(catalogue)
    if FILE not in catalogue:
        raise InputError("the sweep has no archived runs: give sweep keep=['log'] and path='a folder'")
    if folder is None:
        raise InputError("it is not known where the runs of the sweep are: open it by open_sweep")
    model = plan.grid.model
    chosen = expanded(map(model.shapes.inside, names or model.units), model.units, model.shapes)
    if unknown := [name for name in chosen if name not in model.units]:
        raise InputError(f"names have '{unknown[0]}'; there are {', '.join(of_wholes(model.units))}")
    if times is None and not plan.keeping.times.size:
        raise InputError("the sweep has no times of its own; give times, like '0:10:101 s'")
    wanted = plan.keeping.times if times is None else wanted_times(times, model.time_unit)
    arrays = _arrays(catalogue, folder, _Reading(plan, wanted, tuple(chosen), functions))
    dims = catalogue[FILE].dims
    variables: dict[str, Any] = {
        name: ((*dims, AT), arrays[name], about(model.units[name].text, f"{name} of the run at a time", "coordinate"))
        for name in chosen
    }
    variables[AT_TIME] = ((AT,), wanted, about(model.time_unit.text, "wanted time", "time"))
    described = ((name, entry) for name, entry in catalogue.coords.items() if name not in TEXT_NAMES)
    axes = {name: entry for name, entry in described if {*entry.dims} <= {*dims}}
    logs = exhibit(
        "logs of a sweep",
        f"{model.name}: runs over {', '.join(map(str, dims))}",
        [],
        variables | {str(name): (entry.dims, entry.values, dict(entry.attrs)) for name, entry in axes.items()},
        {DIGEST_OF_SWEEP: catalogue.attrs[DIGEST_OF_SWEEP], "model_digest": model.digest},
        shapes=model.shapes,
    )
    return logs.set_coords([*axes])


@dataclass(frozen=True)
class _Reading:
    """What is wanted of every run.

    Attributes
    ----------
    plan : Plan
    times : ndarray, s
    names : tuple of str
    functions : mapping of str to callable, optional
    dims : tuple of str
        The axes that are left in what is read, in its order.
    """

    plan: Plan
    times: Floats
    names: tuple[str, ...]
    functions: Functions | None
    dims: tuple[str, ...] = ()

    def states(self, at: At, file: Place, digest: str, seal: str) -> Floats:
        """Read the states of one run at the times, in the order of the names.

        Parameters
        ----------
        at : sequence of int
            Its place along the dimensions.
        file : Path, or name of an object
        digest : str
            Its content digest, in the catalogue.
        seal : str
            Its seal, where the bytes that it is of are known to who asks; else empty.

        Raises
        ------
        ArchiveError
            If the file is damaged, or holds another run.
        """
        if seal:
            know(seal)
        numbers = dict(zip(self.dims, at, strict=True))
        model = self.plan.grid.model_of([numbers.get(dim, 0) for dim in self.plan.grid.dims])
        run = unfold(opened(file, digest)) if model.shapes.dims else _columns(file, digest, self._columns(model))
        with run:
            ends = np.asarray(run["time"][[0, -1]])
            inside = (self.times >= ends[0]) & (self.times <= ends[1])
            states = np.full((len(self.names), self.times.size), np.nan)
            if inside.any():
                same = run["model_toml"].values.item() == model.to_toml()
                own = model if same else None  # else of another version
                found = sampled(
                    run, self.times[inside], after=True, rule=REINTEGRATE, functions=self.functions, model=own
                )
                states[:, inside] = [found[name].values for name in self.names]
        return states

    def _columns(self, model: Model) -> set[str]:
        """Name all variables of a run that its states within steps are found from."""
        settings, none = self.plan.grid.settings_of((0,) * len(self.plan.grid.shape)), np.zeros(0, np.int64)
        return {"time", "model_toml", GIVEN_STEP.name, *(name for name, _ in step_columns(model, settings, none, none))}


def _columns(file: Place, digest: str, names: set[str]) -> xr.Dataset:
    """Read columns of a member's archive, checking that it holds the run named in the catalogue."""
    run = columns_of(file, names)
    check_digest(file, str(run.attrs[ROOT_DIGEST]), digest)
    return run


def _arrays(sweep: xr.Dataset, folder: Place, reading: _Reading) -> dict[str, Any]:
    """Return every variable as a dask array, whose tasks read one run each, once for all variables."""
    import dask.array
    from dask.base import tokenize
    from dask.highlevelgraph import HighLevelGraph

    da: Any = dask.array  # its functions are not typed
    files, digests = (np.asarray(sweep[name].values) for name in (FILE, DIGEST))
    seals = np.asarray(sweep[SEAL].values) if SEAL in sweep else np.full(files.shape, "")
    token = tokenize(str(folder), files, digests, reading.times, reading.names)
    wanted, read = f"wanted-{token}", f"log-{token}"
    reading = replace(reading, dims=tuple(map(str, sweep[FILE].dims)))
    layers: dict[str, Any] = {
        wanted: {wanted: reading},
        read: {
            (read, *at): (
                _states,
                wanted,
                at,
                place_of(folder, str(files[at])),
                str(digests[at]),
                _if_known(str(seals[at])),
            )
            if files[at]
            else np.full((len(reading.names), reading.times.size), np.nan)
            for at in product(*map(range, files.shape))
        },
    }
    dependencies: dict[str, set[str]] = {wanted: set(), read: {wanted}}
    shape = (1,) * files.ndim
    arrays = {}
    for i, name in enumerate(reading.names):
        key = f"{name}-{read}"
        graph = {(key, *at, 0): (_taken, (read, *at), i, shape) for at in product(*map(range, files.shape))}
        merged = HighLevelGraph(layers | {key: graph}, dependencies | {key: {read}})
        arrays[name] = da.Array(merged, key, (*((1,) * n for n in files.shape), (reading.times.size,)), dtype=float)
    return arrays


def _if_known(seal: str) -> str:
    """Return the seal of a run that was written or examined for this process; a worker need not examine it again."""
    return seal if is_known(Tail(seal)) else ""


def _states(reading: _Reading, *which: Any) -> Floats:
    return reading.states(*which)


def _taken(states: Floats, i: int, shape: tuple[int, ...]) -> Floats:
    values: Floats = states[i].reshape(*shape, -1)
    return values
