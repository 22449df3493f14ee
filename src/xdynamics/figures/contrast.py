"""Colours that can be told from the paper: darker on a light sheet, lighter on a dark one, where they are too near to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LINES, LETTERS = 3.0, 4.5  # least ratios of luminances: WCAG 2.1, success criteria 1.4.11 and 1.4.3
WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of red, green, blue in a luminance: IEC 61966-2-1
FLARE = 0.05  # of a screen, that is added to luminances
LINEAR = (0.04045, 12.92)  # up to where sRGB is linear, and how steep


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour: 0 for black, 1 for white."""
    return float(WEIGHTS @ _light(colour))


def contrast_ratio(colour: str, paper: str) -> float:
    """Return the ratio of the luminances of a colour and of the paper, the larger one over the smaller: from 1 to 21."""
    low, high = sorted((luminance(colour), luminance(paper)))
    return (high + FLARE) / (low + FLARE)


def legible(colour: str, min_contrast: float = LINES, paper: str = "") -> str:
    """Return a colour, darker or lighter as far as its contrast with the paper needs.

    Parameters
    ----------
    colour : str
    min_contrast : float
        Contrast.
    paper : str
        By default that of the sheet.

    Examples
    --------
    >>> legible("#1f5a96", paper="white"), legible("#f0f921", paper="white"), legible("#1f5a96", paper="black")
    ('#1f5a96', '#959b10', '#225b97')
    """
    from matplotlib import rcParams
    from matplotlib.colors import to_hex

    paper = paper or str(rcParams["axes.facecolor"])
    if contrast_ratio(colour, paper) >= min_contrast:
        return to_hex(colour)
    light, brightness = _light(colour), luminance(paper) + FLARE
    if brightness > FLARE + 0.5:
        light = light * max(0.0, brightness / min_contrast - FLARE) / float(WEIGHTS @ light)
    else:
        light_luminance = float(WEIGHTS @ light)
        light = light + (1.0 - light) * (min(1.0, brightness * min_contrast - FLARE) - light_luminance) / (
            1.0 - light_luminance
        )
    edge, slope = LINEAR
    coded = np.where(light <= edge / slope, slope * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    # whole numbers of 255 on the far side of the contrast
    rounding = np.floor if brightness > FLARE + 0.5 else np.ceil
    red, green, blue = (np.clip(rounding(255.0 * coded), 0.0, 255.0) / 255.0).tolist()
    return to_hex((red, green, blue))


def _light(colour: str) -> NDArray[np.float64]:
    """Return the light of red, green and blue, shape (3,)."""
    from matplotlib.colors import to_rgb

    coded = np.array(to_rgb(colour))
    edge, slope = LINEAR
    light: NDArray[np.float64] = np.where(coded <= edge, coded / slope, ((coded + 0.055) / 1.055) ** 2.4)
    return light
