"""The variables of a refinement for one number: its differences, orders, gates, verdict, limit and uncertainty."""

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
        Of the places; none for one number per run.
    values, errors : ndarray, shape (places, levels)
        The values, and their errors by interpolation or location.
    rounding, moved : ndarray, shape (places,)
        Errors of the finest values by rounding, and by the uncertain location of events before.
    kinks : ndarray, shape (places,)
        The order left by switches that steps went over, inf where there are none.
    scale : float
        By which differences are divided: a size of the quantity that is never zero.
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
        """Difference to the next finer level; nan for the finest, shape (places, levels)."""
        differences = np.full(self.values.shape, np.nan)
        differences[:, :-1] = np.diff(self.values, axis=-1)
        return differences


def family(one: Watched, levels: Levels, accepted: int) -> dict[str, Any]:
    """Return every variable about one number, ready for a Dataset; `accepted` counts the finest level's steps."""
    name, units, changes = one.name, one.units, one.changes
    dims = (LEVEL, *one.dims)

    def along(values: Floats) -> Floats:
        """Return values with levels first; without places, levels only."""
        return values.T if one.dims else values[0]

    # the finest level has no difference of its own: its gate uses the last one
    last = np.abs(np.concatenate([changes[:, :-1], changes[:, -2:-1]], axis=-1))
    gate = (~(one.errors <= last)).astype(np.int8)
    scale = {"scale": one.scale, "scale_units": units}
    variables: dict[str, Any] = {
        name: (dims, along(one.values), about(units, one.said, ROLE)),
        f"difference_{name}": (
            dims,
            along(changes),
            about(units, f"{name} of the next finer level less that of this one", ROLE),
        ),
        f"scaled_difference_{name}": (
            dims,
            along(changes / one.scale),
            about("1", f"difference_{name} over a scale, {one.scale:.6g} {units}", ROLE) | scale,
        ),
        f"interpolation_error_{name}": (
            dims,
            along(one.errors),
            about(units, f"how far interpolation, or the location of an event, may have {name} off", ROLE),
        ),
        f"gate_{name}": (
            dims,
            along(gate),
            about(
                "1",
                f"passed where interpolation_error_{name} is at most the difference to the next finer level",
                "flag",
            )
            | flags(dict(enumerate(GATES))),
        ),
    }
    return variables | (_judged(one, levels, accepted) if levels.ordered else {})


def _judged(number: Watched, levels: Levels, accepted: int) -> dict[str, Any]:
    """Return orders, verdicts, limits and uncertainties, where levels are numbers with which errors shrink."""
    name, units, steps = number.name, number.units, levels.values
    orders = observed_orders(number.values, steps).T if number.dims else observed_orders(number.values, steps)[0]
    smooth = levels.varied is not RTOLS
    kinks = (
        np.full(len(number.values), np.inf)
        if number.kinks is None or levels.varied is TIME_TOLERANCES
        else number.kinks
    )
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
            number.values, number.errors, number.rounding.tolist(), number.moved.tolist(), kinks.tolist(), strict=True
        )
    ]
    rules = sorted({judgement.rule for judgement in judged}) or ["none"]

    def once(values: list[Any], dtype: Any) -> Any:
        return (number.dims, np.array(values if number.dims else values[0], dtype))

    words = {i: rule.replace(" ", "_").replace(":", "") for i, rule in enumerate(rules)}
    return {
        f"order_{name}": (
            (LEVEL, *number.dims),
            orders,
            about("1", f"observed order of {name}, with the levels before and behind; below 0 differences grow", ROLE),
        ),
        f"verdict_{name}": (
            *once([judgement.verdict for judgement in judged], np.int8),
            about("1", f"what the levels tell of {name}", "flag") | flags(dict(enumerate(VERDICTS))),
        ),
        f"limit_{name}": (
            *once([judgement.limit for judgement in judged], float),
            about(units, f"{name} with an ever smaller {levels.varied.name}", ROLE),
        ),
        f"uncertainty_{name}": (
            *once([judgement.uncertainty for judgement in judged], float),
            about(units, f"uncertainty of {name} at the finest level, at about 95 %", ROLE),
        ),
        f"uncertainty_rule_{name}": (
            *once([rules.index(judgement.rule) for judgement in judged], np.int8),
            about("1", f"where the uncertainty of {name} is from", "flag") | flags(words),
        ),
    }
