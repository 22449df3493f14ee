"""What xarray's verbs do not know of a run asked for a time: that its rows are steps, and what gives states between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

import numpy as np
import xarray as xr

from xdynamics.faults import InputError
from xdynamics.schema import STEPS

NOTED = ("sel", "interp", "drop_sel", "resample", "groupby", "groupby_bins", "rolling", "coarsen")
# a name that is no index is left out of these by xarray without a word
REFUSED = ("reindex", "reindex_like", "interp_like")
LONGEST_NOTE = 60  # characters of times that a note repeats
REMEDY = (
    "xdynamics: rows of a run are its steps, two at an event, and none ends at just any time: run.dynamics.at({0}) gives the"
    " states there, each as if a step had ended there; run.sel(time=slice(…)) gives the rows of a span"
)


def show_time_notes() -> None:
    """Let errors of verbs that are asked for times of a run name `run.dynamics.at`, and refuse those that do nothing."""
    for kind in (xr.Dataset, xr.DataArray):
        for verb in (*NOTED, *REFUSED):
            method = getattr(kind, verb)
            if not hasattr(method, "notes_times"):
                setattr(kind, verb, _noting(method) if verb in NOTED else _refusing(method))


def _noting(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return the method with a note below its errors."""

    @wraps(method)
    def noting_call(self: Any, *arguments: Any, **keywords: Any) -> Any:
        try:
            return method(self, *arguments, **keywords)
        except Exception as error:
            requested_times = _requested_times(arguments, keywords)
            if requested_times is not None and _is_of_steps(self) and not getattr(error, "__notes__", None):
                error.add_note(REMEDY.format(_times_text(requested_times)))
            raise

    noting_call.notes_times = True  # type: ignore[attr-defined]
    return noting_call


def _refusing(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return the method, which refuses times of a run: without a word it would give the rows as they were."""

    @wraps(method)
    def refusing_call(self: Any, *arguments: Any, **keywords: Any) -> Any:
        requested_times = _requested_times(arguments, keywords)
        if requested_times is not None and _is_of_steps(self):
            raise InputError(f"{method.__name__} cannot follow time. {REMEDY.format(_times_text(requested_times))}")
        return method(self, *arguments, **keywords)

    refusing_call.notes_times = True  # type: ignore[attr-defined]
    return refusing_call


def _requested_times(arguments: tuple[Any, ...], keywords: Mapping[str, Any]) -> Any:
    """Return the times that are asked for: by name, in a mapping, as those of another record, or all; None where none are."""
    first = arguments[0] if arguments else {name: keywords[name] for name in ("other", "group") if name in keywords}
    if isinstance(first, str):  # groupby("time")
        return ... if first == "time" else None
    if isinstance(first, xr.Dataset | xr.DataArray):
        return first["time"].values if "time" in first.indexes else None
    indexers = first if isinstance(first, Mapping) else {}
    return {**indexers, **keywords}.get("time")


def _times_text(times: Any) -> str:
    """Return times as they may be typed; of many, that they are."""
    text = repr(times.tolist() if hasattr(times, "tolist") else times)
    return text if isinstance(times, int | float | list | np.ndarray) and len(text) <= LONGEST_NOTE else "times"


def _is_of_steps(data: Any) -> bool:
    """Whether `time` is that of a run's rows, in a record or in one of its variables."""
    time = data.coords.get("time") if isinstance(data, xr.Dataset | xr.DataArray) else None
    return time is not None and time.dims == (STEPS,) and time.attrs.get("role") == "time"
