"""Values that are drawn: Sobol points, a Latin hypercube, or from the distributions that a model declares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError

SOBOL, LATIN, DECLARED = "sobol", "latin_hypercube", "declared"
DESIGNS = (SOBOL, LATIN, DECLARED)
MIN_PROBABILITY = 2.0**-54  # smallest probability at which an unbounded distribution is evaluated


@dataclass(frozen=True)
class Draws:
    """Values of several parameters or initial values drawn together, for an axis of a sweep.

    Parameters
    ----------
    count : int
        Number of draws; for Sobol points a power of two.
    ranges : mapping of str to (lowest, highest), or sequence of str
        Ranges to draw from: ``{"m": ("1 kg", "2 kg")}``. For the design ``declared``, names of parameters and initial
        values that have an uncertainty in the model: each is drawn from its distribution, normal ones with their
        correlations.
    design : {"sobol", "latin_hypercube", "declared"}
    seed : int
        Recorded, like the values.

    Raises
    ------
    InputError
        If count, ranges, design or seed cannot be used; with every fault.

    Notes
    -----
    Scrambled Sobol points: Owen 1998 (doi:10.1006/jcom.1998.0487), by `scipy.stats.qmc`; Latin hypercube: McKay,
    Beckman, Conover 1979 (doi:10.1080/00401706.1979.10489755).

    Examples
    --------
    >>> import xdynamics as xd
    >>> axes = {"draw": xd.Draws(8, {"v_y": ("10 m s-1", "20 m s-1")}, seed=1)}
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = xd.sweep(model, axes, until="1 s")
    >>> found.sizes["draw"], bool((found.v_y < 20).all())
    (8, True)
    """

    count: int
    ranges: Mapping[str, Sequence[Any]] | Sequence[str] = field(default_factory=dict)
    design: str = SOBOL
    seed: int = 0

    def __post_init__(self) -> None:
        faults = []
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 1:
            faults.append(f"count is {self.count!r}, needs a positive whole number")
        elif self.design == SOBOL and self.count & (self.count - 1):
            next_power = 1 << self.count.bit_length()
            faults.append(f"count is {self.count}, and Sobol points need a power of two, like {next_power}")
        if self.design not in DESIGNS:
            faults.append(f"design is {self.design!r}; there are {', '.join(DESIGNS)}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            faults.append(f"seed is {self.seed!r}, needs a non-negative whole number")
        if isinstance(self.ranges, str) or not self.ranges:
            faults.append(f"ranges are {self.ranges!r}, need names, and of what is no declared design their ends")
        elif self.design == DECLARED and (isinstance(self.ranges, Mapping) or not hasattr(self.ranges, "__iter__")):
            faults.append(
                f"ranges are {str(self.ranges)[:60]}, and what a model declares is drawn by names alone: ['m', 'k']"
            )
        if self.design != DECLARED and not isinstance(self.ranges, Mapping):
            faults.append(
                f"a design of {self.design} needs the lowest and the highest of each: {{'m': ('1 kg', '2 kg')}}"
            )
        if faults:
            raise InputError("draws: " + "; ".join(faults), tuple(faults))

    @property
    def ends(self) -> Mapping[str, Sequence[Any]]:
        """Lowest and highest value of each name; empty for a declared design."""
        return self.ranges if isinstance(self.ranges, Mapping) else {}

    def points(self) -> NDArray[np.float64]:
        """Return numbers from 0 to 1, one row per draw, one column per name; the declared design never gives 0 or 1."""
        rng, dimensions = np.random.default_rng(self.seed), len(self.ranges)
        if self.design == DECLARED:
            return np.maximum(rng.random((self.count, dimensions)), MIN_PROBABILITY)
        from scipy.stats import qmc

        sampler = (qmc.Sobol if self.design == SOBOL else qmc.LatinHypercube)(dimensions, seed=rng)
        sample: NDArray[np.float64] = sampler.random(self.count)
        return sample
