"""The modes of a model about a state, in lines of text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.record.flag_words import words_of
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

MOST_TOLD = 4  # of the slowest modes
WIDTH = 120
ROUNDING = 1e-6  # of the largest eigenvalue: a triple eigenvalue of 0 is found within the cube root of a rounding


def lines_of(modes: xr.Dataset) -> Iterator[str]:
    """Describe frequencies, growth, the shortest time scale, and the step suggested for each method."""
    yield f"about     {modes.attrs['summary'].removeprefix('Linearisation about ')}"
    yield f"modes     {_modes(modes)}"
    growth, scale = modes["eigenvalue_real"], modes["fastest_time_scale"]
    fastest, largest = float(growth.max()) if growth.size else 0.0, 1.0 / float(scale)
    if fastest > ROUNDING * largest:
        yield f"growth    {fastest:.4g}{unit_suffix(str(growth.attrs['units']))} of the eigenmode that grows fastest"
    told = f"{float(scale):.4g}{unit_suffix(str(scale.attrs['units']))}, one over the largest eigenvalue"
    yield f"fastest   {told if largest > 0.0 else 'nothing turns, grows or decays here'}"
    yield from _steps(modes)


def _modes(modes: xr.Dataset) -> str:
    """Tell how many modes there are, and the frequencies of the slowest and of the fastest."""
    frequency = modes["frequency"]
    values = frequency.values[np.isfinite(frequency.values)]
    oscillating, second = values[values > 0.0], unit_suffix(str(modes["period"].attrs["units"]))
    distinct = [*dict.fromkeys(f"{each:.4g}" for each in oscillating.tolist())]
    named = distinct if len(distinct) <= MOST_TOLD + 1 else [*distinct[:MOST_TOLD], f"… {distinct[-1]}"]
    told = [f"{frequency.size}"]
    if named:
        units, longest = unit_suffix(str(frequency.attrs["units"])), 2.0 * np.pi / float(oscillating[0])
        word = "frequency" if len(named) == 1 else "frequencies"
        told.append(f"{word} {', '.join(named)}{units}; the longest period is {longest:.4g}{second}")
    if rigid := values.size - oscillating.size:
        told.append(f"{rigid} {'rigid motion' if rigid == 1 else 'rigid motions'}")
    if others := frequency.size - values.size:
        told.append(f"{others} {'does' if others == 1 else 'do'} not oscillate")
    return "; ".join(told)


def _steps(modes: xr.Dataset) -> Iterator[str]:
    """Tell the step to begin with, and the methods that it is suggested for; the longest step first."""
    step, methods = modes["suggested_step"], np.array(words_of(modes["method_name"]))
    by_step: dict[str, list[str]] = {}
    for k in np.argsort(-step.values, kind="stable").tolist():
        if 0.0 < step.values[k] < np.inf:
            by_step.setdefault(f"{float(f'{step.values[k]:.2g}'):g}", []).append(str(methods[k]))
    for size, names in by_step.items():
        told = f"{size}{unit_suffix(str(step.attrs['units']))} to begin with by {', '.join(names)}"
        yield from textwrap.wrap(told, WIDTH, initial_indent="step      ", subsequent_indent=" " * 10)


SUMMARIES = {"modes": lines_of}
