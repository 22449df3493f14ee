"""The modes of a model about a state, in lines of text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.record.flag_words import words_of_flag
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

MOST_TOLD = 4  # of the slowest modes
WIDTH = 120
ROUNDING = 1e-6  # of the largest eigenvalue: a triple eigenvalue of 0 is found within the cube root of a rounding


def modes_lines(modes: xr.Dataset) -> Iterator[str]:
    """Describe frequencies, growth, the shortest time scale, and the step suggested for each method."""
    yield f"about     {modes.attrs['summary'].removeprefix('Linearisation about ')}"
    yield f"modes     {_frequency_sentence(modes)}"
    growth, scale = modes["eigenvalue_real"], modes["fastest_time_scale"]
    fastest, largest = float(growth.max()) if growth.size else 0.0, 1.0 / float(scale)
    if fastest > ROUNDING * largest:
        yield f"growth    {fastest:.4g}{unit_suffix(str(growth.attrs['units']))} of the eigenmode that grows fastest"
    scale_text = f"{float(scale):.4g}{unit_suffix(str(scale.attrs['units']))}, one over the largest eigenvalue"
    yield f"fastest   {scale_text if largest > 0.0 else 'nothing turns, grows or decays here'}"
    yield from _suggested_step_lines(modes)


def _frequency_sentence(modes: xr.Dataset) -> str:
    """Tell how many modes there are, and the frequencies of the slowest and of the fastest."""
    frequency = modes["frequency"]
    values = frequency.values[np.isfinite(frequency.values)]
    oscillating, second = values[values > 0.0], unit_suffix(str(modes["period"].attrs["units"]))
    distinct = [*dict.fromkeys(f"{value:.4g}" for value in oscillating.tolist())]
    shown_frequencies = distinct if len(distinct) <= MOST_TOLD + 1 else [*distinct[:MOST_TOLD], f"… {distinct[-1]}"]
    phrases = [f"{frequency.size}"]
    if shown_frequencies:
        units, longest = unit_suffix(str(frequency.attrs["units"])), 2.0 * np.pi / float(oscillating[0])
        word = "frequency" if len(shown_frequencies) == 1 else "frequencies"
        phrases.append(f"{word} {', '.join(shown_frequencies)}{units}; the longest period is {longest:.4g}{second}")
    if rigid := values.size - oscillating.size:
        phrases.append(f"{rigid} {'rigid motion' if rigid == 1 else 'rigid motions'}")
    if non_oscillating := frequency.size - values.size:
        phrases.append(f"{non_oscillating} {'does' if non_oscillating == 1 else 'do'} not oscillate")
    return "; ".join(phrases)


def _suggested_step_lines(modes: xr.Dataset) -> Iterator[str]:
    """Tell the step to begin with, and the methods that it is suggested for; the longest step first."""
    step, methods = modes["suggested_step"], np.array(words_of_flag(modes["method_name"]))
    by_step: dict[str, list[str]] = {}
    for k in np.argsort(-step.values, kind="stable").tolist():
        if 0.0 < step.values[k] < np.inf:
            by_step.setdefault(f"{float(f'{step.values[k]:.2g}'):g}", []).append(str(methods[k]))
    for size, names in by_step.items():
        step_text = f"{size}{unit_suffix(str(step.attrs['units']))} to begin with by {', '.join(names)}"
        yield from textwrap.wrap(step_text, WIDTH, initial_indent="step      ", subsequent_indent=" " * 10)


SUMMARIES = {"modes": modes_lines}
