"""Words of panels: what an axis shows, whose values are drawn, and where lines are straight."""

from __future__ import annotations

from collections.abc import Iterable

import xarray as xr

from xdynamics.figures.curves import has_chords, is_torn
from xdynamics.figures.level_lines import REACTION, is_mean, known_model
from xdynamics.record.unfolding import whole_of
from xdynamics.shapes import element, parted

CONTACT = {REACTION, "gap"}  # roles
LONGEST_LABEL = 24  # characters


def straight(run: xr.Dataset, *names: str, exact: bool = False, beside: Iterable[xr.Dataset] = ()) -> str:
    """Note where lines are straight between rows, because states there, or forces of contacts of many bodies, are unknown.

    Forces of contacts that act over whole steps are known as means alone; where not all runs that are drawn have such
    forces, their method is named.
    """
    drawn = [run, *beside]
    if of_means := [each for each in drawn if any(is_mean(each, name) for name in names)]:
        whose = f" of {of_means[0].attrs['solver_method']}" * (len(of_means) < len(drawn))
        torn = any(map(is_torn, of_means))
        return f"; means over the step before each row{whose}" + ", straight between those" * torn
    if not has_chords(run, *names, exact=exact):
        return ""
    roles, model = {run.variables[name].attrs.get("role") for name in names if name in run.variables}, known_model(run)
    if roles and roles <= CONTACT and model is not None and model.assemblies:
        return "; of many links: solved at rows, straight between them"
    return "; straight between rows"


def joined(names: list[str]) -> str:
    """Name what an axis shows, briefly: the legend has all names."""
    wholes = {parted(name)[0] for name in names}
    if len(wholes) == 1:
        return shared_axis(names) or wholes.pop() if len(names) > 1 else names[0]
    every = ", ".join(names)
    return every if len(every) <= LONGEST_LABEL else f"{names[0]} … {names[-1]}"


def shared_axis(names: list[str]) -> str:
    """Return the component that several elements have in common, `r[x]` of `r[0, x]` and `r[1, x]`; empty if none."""
    found = {(whole, labels[-1]) for whole, labels in map(parted, names) if len(labels) > 1}
    is_one = len(names) > 1 and len(found) == 1 and all(len(parted(name)[1]) > 1 for name in names)
    (whole, label) = found.pop() if is_one else ("", "")
    return element(whole, [label]) if is_one else ""


def counted_by(run: xr.Dataset, names: list[str]) -> str:
    """Return what there is one variable of: the dimensions of a quantity, without an axis that all have in common."""
    wholes = {parted(name)[0] for name in names}
    whole = wholes.pop() if len(wholes) == 1 else ""
    dims = [str(dim) for dim in whole_of(run).variables[whole].dims[1:]] if whole in whole_of(run).variables else []
    return " and ".join(dims[:-1] if shared_axis(names) else dims) or "variable"
