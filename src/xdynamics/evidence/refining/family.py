"""All that levels tell of one number: its differences, orders, gates, verdict, limit and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.evidence_dataset import about
from xdynamics.evidence.refining.convergence import VERDICTS, judge, observed_orders
from xdynamics.evidence.refining.levels import RTOLS, TIME_TOLERANCES, Levels
from xdynamics.schema import LEVEL, flags

Floats = NDArray[np.float64]

GATES = ("passed", "failed")
ROLE = "refinement"


@dataclass(frozen=True)
class Watched:
    """One number of every level, at several places.

    Attributes
    ----------
    name, units, said : str
    dims : tuple of str
        What the places are; none for one number of a run.
    values, errors : ndarray, shape (places, levels)
        What it came to, and how far interpolation or location may have that off.
    rounding, moved : ndarray, shape (places,)
        How far rounding, and what is not known of events before, may have the finest values off.
    kinks : ndarray, shape (places,)
        The order that switches leave which steps went over, inf where none did.
    scale : float
        What differences are measured by besides: a size of the quantity that is never zero.
    """

    name: str
    units: str
    said: str
    dims: tuple[str, ...]
    values: Floats
    errors: Floats
    rounding: Floats
    moved: Floats
    scale: float
    kinks: Floats | None = None

    @property
    def changes(self) -> Floats:
        """To the next finer level; nan for the finest, shape (places, levels)."""
        found = np.full(self.values.shape, np.nan)
        found[:, :-1] = np.diff(self.values, axis=-1)
        return found


def family(one: Watched, levels: Levels, accepted: int) -> dict[str, Any]:
    """Return every variable that is said of one number, ready for a Dataset; `accepted` are the finest level's steps."""
    name, units, changes = one.name, one.units, one.changes
    each = (LEVEL, *one.dims)

    def along(values: Floats) -> Floats:
        """Levels first; without places, levels alone."""
        return values.T if one.dims else values[0]

    # the finest level has no difference of its own: its gate is that of the last one
    last = np.abs(np.concatenate([changes[:, :-1], changes[:, -2:-1]], axis=-1))
    gate = (~(one.errors <= last)).astype(np.int8)
    scale = {"scale": one.scale, "scale_units": units}
    found: dict[str, Any] = {
        name: (each, along(one.values), about(units, one.said, ROLE)),
        f"difference_{name}": (each, along(changes), about(units, f"{name} of the next finer level less that of this one", ROLE)),
        f"scaled_difference_{name}": (each, along(changes / one.scale), about("1", f"difference_{name} over a scale, {one.scale:.6g} {units}", ROLE) | scale),
        f"interpolation_error_{name}": (each, along(one.errors), about(units, f"how far interpolation, or the location of an event, may have {name} off", ROLE)),
        f"gate_{name}": (each, along(gate), about("1", f"passed where interpolation_error_{name} is at most the difference to the next finer level", "flag") | flags(dict(enumerate(GATES)))),
    }  # fmt: skip
    return found | (_judged(one, levels, accepted) if levels.ordered else {})


def _judged(one: Watched, levels: Levels, accepted: int) -> dict[str, Any]:
    """Return what can be said where levels are numbers that errors shrink with."""
    name, units, steps = one.name, one.units, levels.values
    orders = observed_orders(one.values, steps).T if one.dims else observed_orders(one.values, steps)[0]
    smooth = levels.varied is not RTOLS
    kinks = np.full(len(one.values), np.inf) if one.kinks is None or levels.varied is TIME_TOLERANCES else one.kinks
    judged = [
        judge(
            values,
            steps,
            levels.formal,
            rounding,
            float(errors[-2:].max()),
            moved,
            smooth=smooth,
            kink=kink,
            accepted=accepted,
            order=levels.order,
        )
        for values, errors, rounding, moved, kink in zip(
            one.values, one.errors, one.rounding.tolist(), one.moved.tolist(), kinks.tolist(), strict=True
        )
    ]
    rules = sorted({found.rule for found in judged}) or ["none"]

    def once(values: list[Any], dtype: Any) -> Any:
        return (one.dims, np.array(values if one.dims else values[0], dtype))

    words = {i: rule.replace(" ", "_").replace(":", "") for i, rule in enumerate(rules)}
    return {
        f"order_{name}": ((LEVEL, *one.dims), orders, about("1", f"observed order of {name}, with the levels before and behind; below 0 differences grow", ROLE)),
        f"verdict_{name}": (*once([found.verdict for found in judged], np.int8), about("1", f"what the levels tell of {name}", "flag") | flags(dict(enumerate(VERDICTS)))),
        f"limit_{name}": (*once([found.limit for found in judged], float), about(units, f"{name} with an ever smaller {levels.varied.name}", ROLE)),
        f"uncertainty_{name}": (*once([found.uncertainty for found in judged], float), about(units, f"uncertainty of {name} at the finest level, at about 95 %", ROLE)),
        f"uncertainty_rule_{name}": (*once([rules.index(found.rule) for found in judged], np.int8), about("1", f"where the uncertainty of {name} is from", "flag") | flags(words)),
    }  # fmt: skip
