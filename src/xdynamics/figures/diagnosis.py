"""Figures of diagnoses: what changes from cycle to cycle, and how fast small changes grow."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.evidence.diagnosing.chaos import exponents_with_uncertainty
from xdynamics.evidence.diagnosing.diagnosis import cycle_count, cycles_text, diagnosed
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.faults import InputError
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, label_with_unit, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import CYCLE, FINITE_TIME_GROWTH, LYAPUNOV_UNCERTAINTY, LYAPUNOVS
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEADY = 1e-4  # of the first value: what changes by less is drawn as its change
MOST_LABELS = 12  # exponents up to which each has its digits beside it
SHOWN = ("period", "phase_offset", "amplitude", "phase_space_area")


def panels_of(diagnosis: xr.Dataset) -> list[Panel]:
    """Return the panels of period, phase, amplitude and area of each cycle, and of Lyapunov exponents.

    Raises
    ------
    InputError
        If there is neither a cycle nor an exponent.
    """
    names = [
        name
        for name in SHOWN
        if name in diagnosis and diagnosis.sizes.get(CYCLE, 0) and diagnosis[name].notnull().any()
    ]
    residuals = [
        str(name)
        for name, variable in diagnosis.data_vars.items()
        if str(name).startswith("residual_") and variable.dims
    ]
    if not names and LYAPUNOVS not in diagnosis:
        raise InputError("there is nothing to draw: the diagnosis has no cycle; `xdynamics show` prints what it found")
    panels: list[Panel] = [partial(_draw_along_cycles, diagnosis, name) for name in names]
    panels += [partial(_draw_exponents, diagnosis)] if LYAPUNOVS in diagnosis else []
    return panels + [partial(_draw_residual, diagnosis, name) for name in residuals]


def foot_of(diagnosis: xr.Dataset) -> str:
    """Describe the cycles, the reference of their phases, and how the energy behaved."""
    energy = ""
    if "energy_band" in diagnosis:
        energy = f"; energy band {diagnosed(diagnosis, 'energy_band')}, drift {diagnosed(diagnosis, 'energy_drift')}"
    remarks = []
    if cycle_count(diagnosis):
        remarks.append(f"cycles of {cycles_text(diagnosis)}; phases beside {stated_value(diagnosis, 'reference')}")
    if doubt := stated_value(diagnosis, "cycle_doubt"):
        remarks.append(str(doubt))
    if LYAPUNOVS in diagnosis:
        remarks.append(f"exponents: {diagnosis[LYAPUNOVS].attrs['transient']}; bars are standard uncertainties")
    return "; ".join(remarks) + energy


def _draw_exponents(diagnosis: xr.Dataset, axes: Axes) -> None:
    """Draw every exponent with its uncertainty and its digits; for -inf the digits alone."""
    values, doubts = diagnosis[LYAPUNOVS].values, diagnosis[LYAPUNOV_UNCERTAINTY].values
    finite = np.where(np.isfinite(values), values, np.nan)
    numbers = np.arange(1, len(values) + 1)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.errorbar(numbers, finite, yerr=doubts, fmt="o", color=COLOURS[0], markersize=4, capsize=3.0, linewidth=1.0)
    labels = exponents_with_uncertainty(diagnosis) if len(values) <= MOST_LABELS else []
    for number, value, label in zip(numbers, finite, labels, strict=False):
        label_point = (number, value if np.isfinite(value) else 0.0)
        axes.annotate(label, label_point, xytext=(6, 5), textcoords="offset points", fontsize=8)
    units = str(diagnosis[LYAPUNOVS].attrs["units"])
    axes.set(
        xlim=(0.5, len(values) + 0.9), xlabel="number", ylabel=escaped_text(label_with_unit("Lyapunov exponent", units))
    )
    axes.margins(y=0.15)
    axes.locator_params(axis="x", integer=True)
    growth = f"growth over the run's own time {_growth_text(diagnosis)}"
    axes.set_title(escaped_text(f"Lyapunov exponents; {growth}"), loc="left", fontsize=10)


def _growth_text(diagnosis: xr.Dataset) -> str:
    """Write the growth over the run's own time, of which a figure needs three digits."""
    growth = diagnosis[FINITE_TIME_GROWTH]
    return f"{float(growth):.3g}{unit_suffix(str(growth.attrs['units']))}"


def _typeset_number(number_with_unit: str) -> str:
    """Typeset the unit behind a number."""
    number, _, unit = number_with_unit.partition(" ")
    return f"{number} {typeset(unit)}".rstrip()


def _draw_along_cycles(diagnosis: xr.Dataset, name: str, axes: Axes) -> None:
    variable, units = diagnosis[name], diagnosis[name].attrs["units"]
    first = float(variable[0])
    is_steady = variable.size > 1 and float(np.nanmax(np.abs(variable.values - first))) < STEADY * abs(first)
    values, quantity_label = (
        (variable.values - first, f"{name} less its start, {_typeset_number(diagnosed(diagnosis, name, 0))}")
        if is_steady
        else (variable.values, name)
    )
    axes.plot(diagnosis["cycle_time"].values, values, ".-", color=COLOURS[0], linewidth=1.0, markersize=4)
    label_time(axes, diagnosis["cycle_time"], "time at the end of the cycle")
    axes.set(ylabel=escaped_text(f"{name} ({units})"))
    title = (
        quantity_label
        if is_steady or variable.size > 1
        else f"{name}, {_typeset_number(diagnosed(diagnosis, name, 0))}"
    )
    axes.set_title(escaped_text(title), loc="left", fontsize=10, pad=14)


def _draw_residual(diagnosis: xr.Dataset, name: str, axes: Axes) -> None:
    variable = diagnosis[name]
    axes.plot(diagnosis["time"].values, variable.values, color=COLOURS[1], linewidth=1.0)
    label_time(axes, diagnosis["time"])
    axes.set(ylabel=escaped_text(f"{name} ({variable.attrs['units']})"))
    scale = diagnosis.get(schema.scale_name(*name.split("_", 1)))
    suffix = "" if scale is None else f"; scale {float(scale):.3g} {scale.attrs['units']}".removesuffix(" 1")
    axes.set_title(escaped_text(f"{variable.attrs['long_name']}{suffix}"), loc="left", fontsize=10)


PAGE = Page(("diagnosis",), panels_of, foot_of)
