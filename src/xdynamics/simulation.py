"""Simulate a model; simulate an archive's model again and compare every bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics import archive, record
from xdynamics.comparison import bitwise
from xdynamics.faults import InputError
from xdynamics.march import March, Settings
from xdynamics.methods import METHODS, method_named
from xdynamics.model import Model
from xdynamics.units import Scales, parse_time

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

FORCE_SAMPLES = ("all", "none")


def simulate(
    model: Model,
    *,
    method: str | None = None,
    step: str | float | None = None,
    until: str | float | None = None,
    path: str | Path | None = None,
    force_samples: str | None = None,
    scales: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """March a model and return its run record.

    Parameters
    ----------
    model : Model
    method : str
        Name of a method; `xdynamics methods` lists them. Like the others, it may stand in the model's `[run]`.
    step : str or float
        Step of the grid t0 + n h: ``"1 ms"``, or a number of seconds.
    until : str or float
        Time at which to end, unless an event stops the run before.
    path : str or Path, optional
        Stream the run to this file, in bounded memory, and return it opened.
    force_samples : {"all", "none"}
        Whether to record every force evaluation of the accepted steps.
    scales : mapping, optional
        Length, time and mass to march in nondimensional variables with: ``{"length": "0.4 m"}``. Everything reported
        has its units again.
    progress : callable, optional
        Called now and then with the fraction done, the time in s and the rows so far.

    Returns
    -------
    xarray.Dataset
        A run that ends badly is returned too, up to its last finite state; see ``run.attrs["run_outcome"]``.

    Raises
    ------
    InputError
        If a setting is missing or cannot be used, or the method refuses the model; nothing is computed or written.

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
    asked = {"method": method, "step": step, "until": until, "force_samples": force_samples, "scales": scales}
    settings = settings_for(model, **asked)
    march = March(model, settings, progress)
    if path is not None:
        return archive.open_run(archive.stream(march, path), check=False)
    return record.dataset(march, march.blocks())


def settings_for(model: Model, **asked: Any) -> Settings:
    """Join what is asked with the model's `[run]` defaults, and check it.

    Raises
    ------
    InputError
        Naming what is missing or wrong.
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    chosen = {"force_samples": "all", "scales": None} | model.run | {k: v for k, v in asked.items() if v is not None}
    for key in ("method", "step", "until"):
        if chosen.get(key) is None:
            raise InputError(f"model '{model.name}' has no {key} in its [run]; give {key}=…")
    if chosen["force_samples"] not in FORCE_SAMPLES:
        raise InputError(f"force_samples is {chosen['force_samples']!r}; there are {', '.join(FORCE_SAMPLES)}")
    settings = Settings(
        method_named(str(chosen["method"]), model, METHODS),
        parse_time(chosen["step"], "step"),
        parse_time(chosen["until"], "until"),
        chosen["force_samples"] == "all",
        Scales.parse(chosen["scales"]),
    )
    settings.check(model)
    return settings


def reproduce(path: str | Path, *, functions: Mapping[str, Callable[..., float]] | None = None) -> xr.Dataset:
    """March an archive's own model again, from the file alone, and compare every variable bit for bit.

    Parameters
    ----------
    path : str or Path
    functions : mapping of str to callable, optional
        The Python functions its forces call; their digests are compared first. Archived source is never run.

    Returns
    -------
    xarray.Dataset
        One row a variable, as `compare` gives it; ``attrs["identical"]`` is 1 where every bit agrees and
        ``attrs["first_difference"]`` names the first that does not.

    Raises
    ------
    ArchiveError
        If the file is damaged.
    ModelError
        If a function is missing or another one.
    """
    kept = archive.open_run(path)
    with kept:
        return bitwise(kept, _again(kept, functions))


def _again(kept: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None) -> xr.Dataset:
    used = kept.attrs
    model = Model.from_text(str(kept["model_toml"].values), functions=functions)
    units = {"length": "m", "time": "s", "mass": "kg"}
    scales = {
        name: f"{float(used[f'solver_{name}_scale'])!r} {unit}"
        for name, unit in units.items()
        if f"solver_{name}_scale" in used
    }
    return simulate(
        model,
        method=used["solver_method"],
        step=float(used["solver_step"]),
        until=float(used["solver_until"]),
        force_samples=used["solver_force_samples"],
        scales=scales or None,
    )
