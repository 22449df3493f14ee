"""What xarray's errors do not know of a run asked for a time: that its rows are steps, and what gives states between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

import xarray as xr

from xdynamics.schema import STEPS

LONGEST = 60  # characters of times that a note repeats
REMEDY = (
    "xdynamics: rows of a run are its steps, two at an event, and none ends at just any time: run.dynamics.at({0}) gives the"
    " states there, each as if a step had ended there; run.sel(time=slice(…)) gives the rows of a span"
)


def show_time_notes() -> None:
    """Let errors of `sel` and `interp` by the time of a run name `run.dynamics.at`; nothing else of them changes."""
    for verb in ("sel", "interp"):
        method = getattr(xr.Dataset, verb)
        if not hasattr(method, "notes_times"):
            setattr(xr.Dataset, verb, _noting(method))


def _noting(method: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(method)
    def called(self: xr.Dataset, *arguments: Any, **named: Any) -> Any:
        try:
            return method(self, *arguments, **named)
        except Exception as error:
            wanted = _times(arguments, named)
            if wanted is not None and _is_of_steps(self):
                error.add_note(REMEDY.format(_shown(wanted)))
            raise

    called.notes_times = True  # type: ignore[attr-defined]
    return called


def _times(arguments: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
    """Return the times that are asked for; None where none are."""
    given = arguments[0] if arguments and isinstance(arguments[0], Mapping) else {}
    return {**given, **named}.get("time")


def _shown(times: Any) -> str:
    """Return times as they may be typed; of many, that they are."""
    text = repr(times.tolist() if hasattr(times, "tolist") else times)
    return text if len(text) <= LONGEST else "times"


def _is_of_steps(data: xr.Dataset) -> bool:
    """Whether `time` is that of a run's rows, in a record or in one of its variables."""
    time = data.coords.get("time")
    return time is not None and time.dims == (STEPS,) and time.attrs.get("role") == "time"
