"""Words of panels: what an axis shows, whose values are drawn, and where lines are straight."""

from __future__ import annotations

from collections.abc import Iterable

import xarray as xr

from xdynamics.figures.curves import REACTION, has_chords, has_missing_rows, is_mean, known_model
from xdynamics.record.unfolding import whole_of
from xdynamics.shapes import join_element_name, split_element_name

CONTACT = {REACTION, "gap"}  # roles
LONGEST_LABEL = 24  # characters


def straight_lines_note(
    run: xr.Dataset, *names: str, exact: bool = False, companion_records: Iterable[xr.Dataset] = ()
) -> str:
    """Note where lines are straight between rows, because states there, or forces of contacts of many bodies, are unknown.

    Forces of contacts that act over whole steps are known as means alone; where not all runs that are drawn have such
    forces, their method is named.
    """
    drawn_runs = [run, *companion_records]
    if of_means := [drawn_run for drawn_run in drawn_runs if any(is_mean(drawn_run, name) for name in names)]:
        method_note = f" of {of_means[0].attrs['solver_method']}" * (len(of_means) < len(drawn_runs))
        has_gaps = any(map(has_missing_rows, of_means))
        return f"; means over the step before each row{method_note}" + ", straight between those" * has_gaps
    if not has_chords(run, *names, exact=exact):
        return ""
    roles, model = {run.variables[name].attrs.get("role") for name in names if name in run.variables}, known_model(run)
    if roles and roles <= CONTACT and model is not None and model.assemblies:
        return "; of many links: solved at rows, straight between them"
    return "; straight between rows"


def axis_title(names: list[str]) -> str:
    """Name what an axis shows, briefly: the legend has all names."""
    quantities = {split_element_name(name)[0] for name in names}
    if len(quantities) == 1:
        return shared_axis(names) or quantities.pop() if len(names) > 1 else names[0]
    all_names = ", ".join(names)
    return all_names if len(all_names) <= LONGEST_LABEL else f"{names[0]} … {names[-1]}"


def shared_axis(names: list[str]) -> str:
    """Return the component that several elements have in common, `r[x]` of `r[0, x]` and `r[1, x]`; empty if none."""
    components = {(quantity, labels[-1]) for quantity, labels in map(split_element_name, names) if len(labels) > 1}
    is_one = len(names) > 1 and len(components) == 1 and all(len(split_element_name(name)[1]) > 1 for name in names)
    (quantity, label) = components.pop() if is_one else ("", "")
    return join_element_name(quantity, [label]) if is_one else ""


def element_dims_text(run: xr.Dataset, names: list[str]) -> str:
    """Return what there is one variable of: the dimensions of a quantity, without an axis that all have in common."""
    quantities = {split_element_name(name)[0] for name in names}
    quantity = quantities.pop() if len(quantities) == 1 else ""
    dims = (
        [str(dim) for dim in whole_of(run).variables[quantity].dims[1:]] if quantity in whole_of(run).variables else []
    )
    return " and ".join(dims[:-1] if shared_axis(names) else dims) or "variable"
