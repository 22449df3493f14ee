"""Losses of a fit: how much a residual counts that is many times its uncertainty.

With z the square of a residual over its scale, a loss rho(z) takes the place of z in the sum of squares; near zero it is z.
A residual has the influence psi(r) = r rho'(z): bounded, of `cauchy` falling again, so that an outlier moves the estimate by
no more than a good value does. The scales are those at which an estimate from normal residuals is 95 % as sharp as that of
least squares (Holland, Welsch 1977, doi:10.1080/03610927708827533).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import log
from xdynamics.faults import InputError

Floats = NDArray[np.float64]

LINEAR = "linear"
LOSS_WIDTHS = {LINEAR: 1.0, "soft_l1": 1.287, "huber": 1.345, "cauchy": 2.385}  # scales, in standard uncertainties
NORMAL = 0.6744897501960817  # median size of a normal residual, in standard deviations


@dataclass(frozen=True)
class Loss:
    """A loss with its scale.

    Attributes
    ----------
    name : {"linear", "soft_l1", "huber", "cauchy"}
    spread : float
        Standard deviation of good residuals, in the units of the weighted ones: 1 where uncertainties are known.
    """

    name: str = LINEAR
    spread: float = 1.0

    @property
    def scale(self) -> float:
        """Size of a residual at which it begins to count less."""
        return LOSS_WIDTHS[self.name] * self.spread

    def sizes(self, residuals: Floats) -> Floats:
        """Return what each residual adds to the sum that is made small."""
        z = (residuals / self.scale) ** 2
        if self.name == "soft_l1":
            z = 2.0 * (np.sqrt(1.0 + z) - 1.0)
        elif self.name == "huber":
            z = np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0)
        elif self.name == "cauchy":
            z = log(1.0 + z)
        return z * self.scale**2

    def influences(self, residuals: Floats) -> tuple[Floats, Floats]:
        """Return psi of each residual, and its derivative."""
        z = (residuals / self.scale) ** 2
        if self.name == "soft_l1":
            return residuals / np.sqrt(1.0 + z), (1.0 + z) ** -1.5
        if self.name == "huber":
            is_near = z <= 1.0
            return np.clip(residuals, -self.scale, self.scale), is_near.astype(float)
        if self.name == "cauchy":
            return residuals / (1.0 + z), (1.0 - z) / (1.0 + z) ** 2
        return residuals, np.ones_like(residuals)

    def variance(self, residuals: Floats, fitted: int) -> float:
        """Return the factor of (J^T J)^-1 that makes it the covariance of the estimates.

        Huber 1981, Robust Statistics, equation 7.6.8; with a linear loss it is the variance of the residuals.
        """
        psi, slope = self.influences(residuals)
        share, mean = fitted / residuals.size, float(slope.mean())
        if not mean > 0.0:
            return float("inf")
        correction = 1.0 + share * float(slope.var()) / mean**2
        return correction**2 * float(psi @ psi) / (residuals.size - fitted) / mean**2


def loss_by_name(name: str) -> Loss:
    """Return a loss by its name.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in LOSS_WIDTHS:
        raise InputError(f"loss is {name!r}; there are {', '.join(LOSS_WIDTHS)}")
    return Loss(name)


def residual_spread(residuals: Floats) -> float:
    """Return the standard deviation of good residuals: the median size over that of normal ones."""
    return float(np.median(np.abs(residuals))) / NORMAL
