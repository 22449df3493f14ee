"""Remarks on a run that follow from its attributes alone, in lines of text: each says a thing only where it is so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from xdynamics.methods.scheme import DOUBLE_DOUBLE
from xdynamics.record.arguments import precision_of
from xdynamics.schema import AT_REST

Attributes = Mapping[Any, Any]
SHORT = 0.25  # of the slowest period


def at_rest_remark(attributes: Attributes) -> Iterator[str]:
    """Report the velocities that the model does not give."""
    if AT_REST in attributes:
        names = ", ".join(str(attributes[AT_REST]).split())
        yield f"at rest   {names}: [initial] gives none, so that they are 0 at the start"


def double_double_remark(attributes: Attributes) -> Iterator[str]:
    """Say where the other half of numbers is, if they are sums of two floats."""
    if precision_of(attributes) == DOUBLE_DOUBLE:
        yield "numbers   of 31 digits, x + rest_x: `xdynamics help precision`"


def step_size_remarks(attributes: Attributes) -> Iterator[str]:
    """Compare steps with the fastest time scale, and report a span that is short beside the slowest one."""
    if attributes.get("run_h_omega_largest"):  # none where nothing pulls back, as in free flight
        yield (
            f"h*omega   {attributes['run_h_omega_start']:.3g} at the start, {attributes['run_h_omega_largest']:.3g} at"
            " most, of the fastest rate"
        )
    if float(attributes.get("run_slowest_periods", 1.0)) < SHORT:
        unit_suffix = (
            "" if attributes["run_slowest_period_units"] == "1" else f" {attributes['run_slowest_period_units']}"
        )
        yield (
            f"span      {attributes['run_slowest_periods']:.2g} of the slowest period at the start,"
            f" {attributes['run_slowest_period']:g}{unit_suffix}: what it does in a period is not seen"
        )


def table_kinks_remark(attributes: Attributes) -> Iterator[str]:
    """Count the kinks of tables that are no events, and say what else could be done about them."""
    if count := attributes.get("run_kinks_landed_on"):
        yield (
            f"kinks     {count} at points of tables of {attributes['solver_switches_landed_on']}, landed on, without"
            " events: switches = 'located' has them as events; with interpolation = 'pchip' there are none"
        )
