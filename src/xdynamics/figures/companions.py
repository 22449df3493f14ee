"""What is drawn beside a run: its label, and lines in the units of the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.curves import plotted_lines
from xdynamics.schema import OF_MOTION, STEPS
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Columns = Mapping[str, tuple[Floats, Floats, Floats | None]]

MOST_TRAITS = 3  # that a label has


@dataclass(frozen=True)
class RunCompanion:
    """Another run, or measurements.

    Attributes
    ----------
    label : str
    columns : mapping of str to tuple of ndarray
        By variable times, values in the run's unit, and uncertainties, which runs have none of.
    record : xarray.Dataset, optional
        Of another run.
    factors : mapping of str to float
        From the units of that record to those of the run.
    """

    label: str
    columns: Columns
    record: xr.Dataset | None = None
    factors: Mapping[str, float] = field(default_factory=dict)

    def values_at_common_times(self, *names: str) -> list[Floats] | None:
        """Return values of several variables at the same times; None if not all are there."""
        if not {*names} <= {*self.columns}:
            return None
        if self.record is not None:
            _, lines = plotted_lines(self.record, *names)
            return [self.factors[name] * line for name, line in zip(names, lines, strict=True)]
        times = [self.columns[name][0] for name in names]
        if any(not np.array_equal(a, b) for a, b in combinations(times, 2)):
            return None
        return [self.columns[name][1] for name in names]


@dataclass(frozen=True)
class Overlay:
    """What is drawn beside a run, and how the run itself is called there.

    Attributes
    ----------
    run_label : str
        Empty if nothing is beside it.
    companions : tuple of RunCompanion
    """

    run_label: str = ""
    companions: tuple[RunCompanion, ...] = ()

    @property
    def records(self) -> list[tuple[str, xr.Dataset]]:
        """The other runs with their labels."""
        return [(companion.label, companion.record) for companion in self.companions if companion.record is not None]

    def with_run(self, run: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
        """Return the run and the others, with their labels."""
        return [(self.run_label, run), *self.records]


def run_labels(runs: Sequence[xr.Dataset]) -> list[str]:
    """Name runs by what differs between them: method, step or tolerance, parameters, starts; else by number.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/pendulum.toml")
    >>> run_labels([xd.simulate(model, step=step, until="0.1 s") for step in ("10 ms", "5 ms")])
    ['step 0.01 s', 'step 0.005 s']
    """
    traits = [_traits(run) for run in runs]
    keys = list(dict.fromkeys(key for run_traits in traits for key in run_traits))
    differing_traits = [key for key in keys if len({run_traits.get(key, "") for run_traits in traits}) > 1]
    labels = [", ".join(run_traits[key] for key in differing_traits if key in run_traits) for run_traits in traits]
    short = [
        ", ".join([run_traits[key] for key in differing_traits if key in run_traits][:MOST_TRAITS])
        for run_traits in traits
    ]
    labels = short if len({*short}) == len(runs) else labels
    return labels if len({*labels}) == len(runs) and all(labels) else [f"run {k + 1}" for k in range(len(runs))]


def _traits(run: xr.Dataset) -> dict[str, str]:
    """Return what may tell a run from others, as one says it."""
    attributes = run.attrs
    method = str(attributes.get("solver_method", ""))
    traits = {"title": str(attributes.get("title", "run")).removesuffix(f", by {method}"), "method": method}
    if attributes.get("solver_step_control") == "adaptive":
        traits["rtol"] = f"rtol {float(attributes.get('solver_rtol_used', 0.0)):.3g}"
    elif "solver_step" in attributes and np.ndim(attributes["solver_step"]) == 0:
        traits["step"] = f"step {_number_with_unit(attributes['solver_step'], attributes.get('solver_step_units', ''))}"
    for name in run.data_vars:
        variable = run.variables[name]
        role, units = variable.attrs.get("role"), variable.attrs.get("units", "1")
        if role == "parameter" and variable.ndim == 0:
            traits[f"parameter {name}"] = f"{name} = {_number_with_unit(variable.values, units)}"
        elif role in OF_MOTION and variable.dims == (STEPS,) and variable.size:
            traits[f"start {name}"] = f"{name}(0) = {_number_with_unit(variable[0].values, units)}"
    return {key: text for key, text in traits.items() if text}


def _number_with_unit(value: Any, units: Any) -> str:
    return f"{float(value):.6g}{unit_suffix(str(units))}"
