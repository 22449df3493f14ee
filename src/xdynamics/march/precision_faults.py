"""What does not go with numbers that are sums of two floats, and what to do about it."""

from __future__ import annotations

from typing import Any

from xdynamics.march.root_methods import EARLIEST_FIRST
from xdynamics.methods.scheme import DOUBLE_DOUBLE, EMBEDDED, INTERPOLANT, NO_ESTIMATE, PRECISIONS
from xdynamics.methods.summation import COMPENSATED
from xdynamics.model import Model
from xdynamics.units import UNSCALED


def precision_faults(settings: Any, model: Model) -> list[str]:
    """List what settings ask for that numbers of that precision do not have."""
    if settings.precision not in PRECISIONS:
        return [f"precision is {settings.precision!r}; there are {', '.join(map(repr, PRECISIONS))}"]
    if settings.precision != DOUBLE_DOUBLE:
        return _of_sums(settings, model)
    faults = [why for holds, why in _beyond_float64(settings, model) if holds]
    return [f"precision = 'double_double' does not go with {why}" for why in faults]


def _of_sums(settings: Any, model: Model) -> list[str]:
    """Refuse to carry rounding errors along where impulses of constraints are added to sums as they are made."""
    if settings.summation != COMPENSATED or not (model.constraints and settings.method.kept):
        return []
    owner = f"constraints under '{settings.method.name}', whose impulses change what is summed"
    return [f"summation = 'compensated' does not go with {owner}; leave it out"]


def _beyond_float64(settings: Any, model: Model) -> list[tuple[bool, str]]:
    """Return what is asked for that is made of single floats, and what to do about it."""
    on_interpolant = [name for name, event in model.events.items() if event.root_state == INTERPOLANT]
    return [
        (
            bool(settings.method.solves),
            f"method '{settings.method.name}', whose equations are solved in float64; take an explicit one, such as dop853",
        ),
        (
            settings.estimator not in (EMBEDDED, NO_ESTIMATE),
            (
                f"estimator = {settings.estimator!r}, a difference of single floats; take a method with an embedded formula, such as"
                " dop853, or a fixed step"
            ),
        ),
        (
            settings.summation == COMPENSATED,
            "summation = 'compensated': a rest is carried of every number; leave it out",
        ),
        (settings.scales != UNSCALED, "scales, which are single floats; leave them out"),
        (
            bool(model.python_functions),
            (
                f"functions in Python ({', '.join(sorted({f.name for f in model.python_functions}))}), which return a float; write"
                " them as expressions"
            ),
        ),
        (
            bool(model.contacts or model.frictions or model.assemblies),
            (
                "contacts and frictions, whose impacts and forces are solved in float64; write an impact as an event with"
                " action = 'reset'"
            ),
        ),
        (
            bool(model.constraints),
            f"constraints ({', '.join(model.constraints)}), which are held to 1e-12; take float64",
        ),
        (
            bool(on_interpolant),
            (
                f"root_state = 'interpolant' of event '{''.join(on_interpolant[:1])}'; leave it out: the state at an event is then"
                " that of a shortened step"
            ),
        ),
        (
            settings.event_root_method != EARLIEST_FIRST,
            f"event_root_method = {settings.event_root_method!r}; leave it out",
        ),
    ]
