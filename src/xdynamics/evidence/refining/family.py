"""The variables of a refinement for one number: its differences, orders, gates, verdict, limit and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.refining.convergence import observed_orders
from xdynamics.evidence.refining.judgements import UNCERTAINTY_RULES, VERDICTS, Judged, judge
from xdynamics.evidence.refining.levels import RTOLS, TIME_TOLERANCES, Levels
from xdynamics.schema import LEVEL, flag_attributes, scale_name

Floats = NDArray[np.float64]

GATES = ("passed", "failed")
ROLE = "refinement"
RULES = {rule: rule.replace(" ", "_").replace(":", "") for rule in UNCERTAINTY_RULES}  # by the words of their flags
RULE_WORDS = sorted(RULES.values())
RULE_NUMBERS = np.array([RULE_WORDS.index(RULES[rule]) for rule in UNCERTAINTY_RULES], np.int8)

Subject = tuple[str, str, str, tuple[str, ...]]  # name, units, long name and dimensions of a number


@dataclass(frozen=True)
class TrackedValue:
    """One quantity of every level, at several places: a number, or with dimensions those of all elements.

    Attributes
    ----------
    name, units, long_name : str
    dims : tuple of str
        Of the places, then of the quantity; none for one number per run.
    values, errors : ndarray, shape (places, ..., levels)
        The values, and their errors by interpolation or location.
    rounding, event_errors : ndarray, shape (places, ...)
        Errors of the finest values by rounding, and by the uncertain location of events before.
    kinks : ndarray, shape (places,) or (places, ...)
        The order left by switches that steps went over, inf where there are none.
    scale : float, or ndarray, shape (...)
        By which differences are divided: a size of the quantity, of every element its own, that is never zero.
    """

    name: str
    units: str
    long_name: str
    dims: tuple[str, ...]
    values: Floats
    errors: Floats
    rounding: Floats
    event_errors: Floats
    scale: Any
    kinks: Floats | None = None

    @classmethod
    def blank(cls, subject: Subject, places: int, levels: int, shape: tuple[int, ...] = ()) -> TrackedValue:
        """Return what is known of a quantity before anything is marched: everything but its values."""
        nothing = np.full((places, *shape, levels), np.nan)
        return cls(*subject, nothing, nothing, nothing[..., 0], nothing[..., 0], np.full(shape, np.nan))

    def element(self, name: str, element_index: tuple[int, ...]) -> TrackedValue:
        """Return one element of a quantity, as a number of its own."""
        index: Any = (slice(None), *element_index)

        return replace(
            self,
            name=name,
            dims=self.dims[:1],
            values=self.values[index],
            errors=self.errors[index],
            rounding=self.rounding[index],
            event_errors=self.event_errors[index],
            scale=float(self.scale[element_index]),
        )

    @property
    def changes(self) -> Floats:
        """Difference to the next finer level; nan for the finest, shape (places, ..., levels)."""
        differences = np.full(self.values.shape, np.nan)
        differences[..., :-1] = np.diff(self.values, axis=-1)
        return differences


def family(number: TrackedValue, levels: Levels, accepted: int, estimated: float = 0.0) -> dict[str, Any]:
    """Return every variable about one number, ready for a Dataset.

    `accepted` counts the finest level's steps, and `estimated` is what these estimate to be off together, as a part of
    the number's size, where something else than the tolerance set them.
    """
    name, units, changes = number.name, number.units, number.changes
    dims = (LEVEL, *number.dims)

    def levels_first(values: Floats) -> Floats:
        """Return values with levels first; without places, levels only."""
        return np.moveaxis(values, -1, 0) if number.dims else values[0]

    # the finest level has no difference of its own: its gate uses the last one
    last = np.abs(np.concatenate([changes[..., :-1], changes[..., -2:-1]], axis=-1))
    gate = (~(number.errors <= last)).astype(np.int8)
    size = scale_name("difference", name)
    variables: dict[str, Any] = {
        name: (dims, levels_first(number.values), attrs_of(units, number.long_name, ROLE)),
        f"difference_{name}": (
            dims,
            levels_first(changes),
            attrs_of(units, f"{name} at the next finer level minus {name} at this level", ROLE),
        ),
        f"scaled_difference_{name}": (
            dims,
            levels_first(changes / np.asarray(number.scale)[..., np.newaxis]),
            attrs_of("1", f"difference_{name} over {size}", ROLE),
        ),
        size: (
            number.dims[1:],
            np.asarray(number.scale, float),
            attrs_of(units, f"scale of difference_{name}, never zero", "scale"),
        ),
        f"interpolation_error_{name}": (
            dims,
            levels_first(number.errors),
            attrs_of(units, f"estimated error of {name} by interpolation, or by locating the event", ROLE),
        ),
        f"gate_{name}": (
            dims,
            levels_first(gate),
            attrs_of(
                "1",
                f"passed where interpolation_error_{name} is at most the difference to the next finer level",
                "flag",
            )
            | flag_attributes(dict(enumerate(GATES))),
        ),
    }
    return variables | (_judgement_variables(number, levels, accepted, estimated) if levels.ordered else {})


def _judgement_variables(number: TrackedValue, levels: Levels, accepted: int, estimated: float) -> dict[str, Any]:
    """Return orders, verdicts, limits and uncertainties, where levels are numbers with which errors shrink."""
    name, units = number.name, number.units
    orders, judgement = observed_orders(number.values, levels.values), _judgement(number, levels, accepted, estimated)

    def once(values: Any, dtype: Any) -> Any:
        return number.dims, np.asarray(values if number.dims else values[0], dtype)

    return {
        f"order_{name}": (
            (LEVEL, *number.dims),
            np.moveaxis(orders, -1, 0) if number.dims else orders[0],
            attrs_of(
                "1",
                f"observed order of {name}, from this level and its two neighbours; negative where differences grow",
                ROLE,
            ),
        ),
        f"verdict_{name}": (
            *once(judgement.verdict, np.int8),
            attrs_of("1", f"verdict on the convergence of {name}", "flag") | flag_attributes(dict(enumerate(VERDICTS))),
        ),
        f"limit_{name}": (
            *once(judgement.limit, float),
            attrs_of(units, f"limit of {name} as {levels.varied.name} tends to zero", ROLE),
        ),
        f"uncertainty_{name}": (
            *once(judgement.uncertainty, float),
            attrs_of(units, f"uncertainty of {name} at the finest level, at about 95 %", ROLE),
        ),
        f"uncertainty_rule_{name}": (
            *once(RULE_NUMBERS[judgement.rule], np.int8),
            attrs_of("1", f"rule by which the uncertainty of {name} was found", "flag")
            | flag_attributes(dict(enumerate(RULE_WORDS))),
        ),
    }


def _judgement(number: TrackedValue, levels: Levels, accepted: int, estimated: float) -> Judged:
    """Judge the levels at every place of a quantity."""
    kinks = np.full(len(number.values), np.inf)
    if number.kinks is not None and levels.varied != TIME_TOLERANCES:
        kinks = number.kinks
    return judge(
        number.values,
        levels.values,
        levels.formal,
        number.rounding,
        number.errors[..., -2:].max(axis=-1),
        number.event_errors,
        smooth=levels.varied != RTOLS,
        kink=kinks.reshape(*kinks.shape, *[1] * (number.values.ndim - 1 - kinks.ndim)),
        accepted=accepted,
        order=levels.order,
        estimated=estimated * np.asarray(number.scale),
    )
