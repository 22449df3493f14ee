"""Models with uncertain inputs, and what a budget says of one."""

from __future__ import annotations

import xarray as xr

import xdynamics as xd


def slope(budget: xr.Dataset, name: str) -> tuple[float, str]:
    """Sensitivity to an input, with its unit."""
    i = budget["term_name"].values.tolist().index(name)
    return float(budget["sensitivity"][i]), str(budget["sensitivity_units"].values[i])


def doubtful(model: xd.Model, **spreads: str) -> xd.Model:
    """A model whose named parameters and starts have an uncertainty."""
    text = model.to_toml()
    for name, spread in spreads.items():
        of_model = name in model.parameters
        given = model.parameters[name].quantity if of_model else model.initial[name]
        head, section, rest = text.partition("[parameters]" if of_model else "[initial]")
        line = next(line for line in rest.split("\n") if line.startswith(f"{name} = "))
        entry = f'{name} = {{ value = {given.value!r}, unit = "{given.unit.text}", {spread} }}'
        text = head + section + rest.replace(line, entry, 1)
    return xd.Model.from_text(text)
