"""Runs that are still to be marched: a verb is given the run that will have been."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

from xdynamics.faults import InputError
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import EVIDENCE, RAGGED, STAGE


def is_unmarched(run: Any) -> bool:
    """Whether a Dataset is what `simulate` or `ragged` returned with ``compute=False``, or made from that."""
    if "dask" not in sys.modules or STAGE not in getattr(run, "encoding", ()):
        return False
    return EVIDENCE not in run.attrs or (run.attrs[EVIDENCE] == RAGGED and any(map(is_chunked, run.variables.values())))


def march_argument(argument: Any) -> Any:
    """March a run that is still to be marched; return anything else as it is.

    Raises
    ------
    InputError
        If only a part of the run is left, or it was changed: there is no whole record of that.
    """
    if isinstance(argument, Mapping) and not hasattr(argument, "variables"):
        return {key: march_argument(value) for key, value in argument.items()}
    if not is_unmarched(argument):
        return argument
    run = argument.encoding[STAGE].computed(argument)
    if run is None:
        raise InputError(
            "this is a part of a run that is still to be marched, or was computed or changed by other means than these"
            " verbs; give them the run as simulate(…, compute=False) returned it, or march with compute=True"
        )
    return run


def marching(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Let a verb take runs that are still to be marched; with ``compute=False`` it marches none itself."""

    @wraps(verb)
    def marching_call(*arguments: Any, **keywords: Any) -> Any:
        if "dask" not in sys.modules or keywords.get("compute") is False:
            return verb(*arguments, **keywords)
        return verb(*map(march_argument, arguments), **{key: march_argument(value) for key, value in keywords.items()})

    return marching_call
