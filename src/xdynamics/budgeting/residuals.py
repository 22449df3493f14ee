"""Whether what a fit leaves is noise: its size beside what the data say of themselves, and its order in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

UNLIKELY = 1e-3  # a probability, under which residuals are no noise
FEWEST = 8  # residuals of each sign, of which runs are counted
SLIGHT = 1e-3  # of the deviation of the data from their mean, as which residuals are no matter
FAR_BELOW = 0.1  # of the uncertainties, the same where there are some


@dataclass(frozen=True)
class Tested:
    """What tests of residuals tell.

    Attributes
    ----------
    chi_square_probability : float
        Of a larger sum of squares, were the model and the uncertainties right; nan without uncertainties.
    runs_probability : float
        Of fewer runs of one sign, were the residuals independent; nan where there are too few.
    adequate : bool
    text : str
        Why, in words.
    """

    chi_square_probability: float
    runs_probability: float
    adequate: bool
    text: str


def tested(square: float, freedom: int, rows: Sequence[Floats], measured: Sequence[Floats], *, known: bool) -> Tested:
    """Test the residuals of a fit.

    Parameters
    ----------
    square : float
        Weighted sum of their squares.
    freedom : int
    rows, measured : sequence of ndarray
        Residuals of each quantity, and what was measured, in the order of time.
    known : bool
        Whether the data have uncertainties.

    Notes
    -----
    Chi-square: Bevington, Robinson, Data Reduction and Error Analysis, 2003, section 11.1. Runs of one sign: Wald and
    Wolfowitz 1940, doi:10.1214/aoms/1177731909, of as many quantities as there are by Bonferroni's inequality. Where
    residuals are small beside the data, or far below their uncertainties, their order is no matter.
    """
    from scipy.stats import chi2

    chi_square = float(chi2.sf(square, freedom)) if known else nan
    probabilities = [probability for probability in map(runs_probability, rows) if probability == probability]
    runs = min(1.0, len(probabilities) * min(probabilities)) if probabilities else nan
    slight = square / freedom <= FAR_BELOW**2 if known else all(_is_slight(*pair) for pair in zip(rows, measured, strict=True))  # fmt: skip
    if chi_square < UNLIKELY:
        text = f"residuals are {sqrt(square / freedom):.3g} times as large as the uncertainties: the model, the uncertainties or the minimum that the search came to is wrong"
    elif runs < UNLIKELY and not slight:
        text = f"residuals are not in a random order (fewer changes of sign have the probability {runs:.1g}): the model or the minimum that the search came to is wrong"
    else:
        judgement = "no matter beside the data" if slight else "no more than noise"
        return Tested(chi_square, runs, adequate=True, text=f"residuals are {judgement}")
    return Tested(chi_square, runs, adequate=False, text=text)


def runs_probability(row: Floats) -> float:
    """Return the probability of as few runs of one sign, or fewer, in numbers that are independent.

    Examples
    --------
    >>> round(runs_probability(np.tile([1.0, -1.0], 10)), 3), runs_probability(np.repeat([1.0, -1.0], 20)) < 1e-8
    (1.0, True)
    """
    from scipy.special import ndtr

    signs = np.sign(row)[np.sign(row) != 0.0]
    above, below = int(np.count_nonzero(signs > 0)), int(np.count_nonzero(signs < 0))
    if above + below < 2 * FEWEST:
        return nan
    if not min(above, below):
        return 0.5 ** (above + below - 1)
    runs, n = 1 + int(np.count_nonzero(signs[1:] != signs[:-1])), above + below
    mean = 1.0 + 2.0 * above * below / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1)
    return float(ndtr((runs + 0.5 - mean) / sqrt(variance))) if variance > 0.0 else nan


def _is_slight(row: Floats, measured: Floats) -> bool:
    """Whether residuals are small beside what the data go up and down."""
    return float(np.sqrt(np.mean(row**2))) <= SLIGHT * float(np.std(measured))
