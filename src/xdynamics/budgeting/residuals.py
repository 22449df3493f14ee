"""Tests whether the residuals of a fit are noise: their size against the uncertainties, and their order in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

UNLIKELY = 1e-3  # probability below which residuals are not noise
FEWEST = 8  # residuals of each sign needed to count runs
SLIGHT = 1e-3  # of the data's standard deviation, below which residuals do not matter
FAR_BELOW = 0.1  # likewise, of the uncertainties if there are any


@dataclass(frozen=True)
class ResidualTests:
    """Results of the tests of residuals.

    Attributes
    ----------
    chi_square_probability : float
        Probability of a larger sum of squares if model and uncertainties are right; nan without uncertainties.
    runs_probability : float
        Probability of fewer runs of one sign if the residuals are independent; nan where there are too few.
    adequate : bool
    text : str
        The reason, in words.
    """

    chi_square_probability: float
    runs_probability: float
    adequate: bool
    text: str


def judge_residuals(
    square: float, freedom: int, rows: Sequence[Floats], measured: Sequence[Floats], *, has_uncertainties: bool
) -> ResidualTests:
    """Test the residuals of a fit.

    Parameters
    ----------
    square : float
        Weighted sum of their squares.
    freedom : int
    rows, measured : sequence of ndarray
        Residuals and measured values of each quantity, in the order of time.
    has_uncertainties : bool
        Whether the data have uncertainties.

    Notes
    -----
    Chi-square: Bevington, Robinson, Data Reduction and Error Analysis, 2003, section 11.1. Runs of one sign: Wald and
    Wolfowitz 1940, doi:10.1214/aoms/1177731909, over all quantities by Bonferroni's inequality. Where residuals are
    small compared with the data, or far below their uncertainties, their order does not matter.
    """
    from scipy.stats import chi2

    chi_square = float(chi2.sf(square, freedom)) if has_uncertainties else nan
    probabilities = [probability for probability in map(runs_probability, rows) if probability == probability]
    runs = min(1.0, len(probabilities) * min(probabilities)) if probabilities else nan
    is_slight = (
        square / freedom <= FAR_BELOW**2
        if has_uncertainties
        else all(_is_slight(*pair) for pair in zip(rows, measured, strict=True))
    )
    if chi_square < UNLIKELY:
        text = (
            f"residuals are {sqrt(square / freedom):.3g} times as large as the uncertainties: the model, the"
            " uncertainties or the minimum that the search came to is wrong"
        )
    elif runs < UNLIKELY and not is_slight:
        text = (
            f"residuals are not in a random order (fewer changes of sign have the probability {runs:.1g}): the model or"
            " the minimum that the search came to is wrong"
        )
    else:
        judgement = "no matter beside the data" if is_slight else "no more than noise"
        return ResidualTests(chi_square, runs, adequate=True, text=f"residuals are {judgement}")
    return ResidualTests(chi_square, runs, adequate=False, text=text)


def runs_probability(row: Floats) -> float:
    """Return the probability of at most so many runs of one sign in independent numbers.

    Examples
    --------
    >>> round(runs_probability(np.tile([1.0, -1.0], 10)), 3), runs_probability(np.repeat([1.0, -1.0], 20)) < 1e-8
    (1.0, True)
    """
    from scipy.special import ndtr

    signs = np.sign(row)[np.sign(row) != 0.0]
    positive_count, negative_count = int(np.count_nonzero(signs > 0)), int(np.count_nonzero(signs < 0))
    if positive_count + negative_count < 2 * FEWEST:
        return nan
    if not min(positive_count, negative_count):
        return 0.5 ** (positive_count + negative_count - 1)
    runs, n = 1 + int(np.count_nonzero(signs[1:] != signs[:-1])), positive_count + negative_count
    mean = 1.0 + 2.0 * positive_count * negative_count / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1)
    return float(ndtr((runs + 0.5 - mean) / sqrt(variance))) if variance > 0.0 else nan


def _is_slight(row: Floats, measured: Floats) -> bool:
    """Whether residuals are small compared with the variation of the data."""
    return float(np.sqrt(np.mean(row**2))) <= SLIGHT * float(np.std(measured))
