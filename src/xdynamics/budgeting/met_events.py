"""The events that a run met before its number: runs that met different ones are different motions, not better and worse ones."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from xdynamics.budgeting.measurand import Target
from xdynamics.faults import first_names
from xdynamics.record.flag_words import words_of_flag
from xdynamics.shapes.naming import display_text

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.model import Model

REMEDY = "they are different motions, and no distance between them tells how far the number is off"


class MetEvents(NamedTuple):
    """How many events a run met.

    Attributes
    ----------
    counts_before : dict of str to int
        By detector, before the time of the number.
    compared : int
        By all together, as far as other runs are compared with it: up to the time that was asked for, or, where the number
        is at an event or an extreme, in the whole run, since equal extremes may be at different times.
    """

    counts_before: dict[str, int]
    compared: int

    @classmethod
    def from_run(cls, target: Target, run: xr.Dataset, model: Model) -> MetEvents:
        """Count the events of a run that has the number."""
        if not run.sizes.get("event", 0):
            return cls({}, 0)
        is_earlier = run["event_time"].values < target.moment_in(run, model)
        counts = Counter(
            name for name, is_met in zip(words_of_flag(run["event_detector"]), is_earlier, strict=True) if is_met
        )
        return cls(dict(counts), int(is_earlier.sum()) if target.at is not None else len(is_earlier))

    def are_apart(self, second_run: MetEvents) -> bool:
        """Whether the number is behind different events, as `refine` tells it: by how many there were."""
        return (
            sum(self.counts_before.values()) != sum(second_run.counts_before.values())
            and self.compared != second_run.compared
        )

    def in_words(self, second_run: MetEvents) -> str:
        """Say which events were met unequally often.

        Examples
        --------
        >>> MetEvents({"floor": 3, "discs": 7}, 10).in_words(MetEvents({"floor": 3, "discs": 9}, 12))
        'did not meet the same events (discs 7 and 9 times): they are different motions, and no distance between them tells how far the number is off'
        """
        names = dict.fromkeys((*self.counts_before, *second_run.counts_before))
        counts = {name: (self.counts_before.get(name, 0), second_run.counts_before.get(name, 0)) for name in names}
        unequal_text = first_names(
            f"{display_text(name)} {count} and {second_count}"
            for name, (count, second_count) in counts.items()
            if count != second_count
        )
        return f"did not meet the same events ({unequal_text} times): {REMEDY}"
