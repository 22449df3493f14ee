"""Numbers that take the whole run of a member: what its diagnosis finds, and what its record says of the march."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.conservation import ROLE
from xdynamics.evidence.diagnosing.diagnosis import diagnose, foreseen_diagnosis
from xdynamics.evidence.diagnosing.turns import TURNS
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.march import March, Settings
from xdynamics.march.outcomes import GOOD
from xdynamics.model import Model
from xdynamics.schema import COUNTS, CYCLE
from xdynamics.units import NUMBERS

if TYPE_CHECKING:
    import xarray as xr

LISTED = (CYCLE, TURNS)  # of which a run has as many as it happens to have
BY_COMPANION = ("believed_until", "phase_offset")  # for which a diagnosis marches once more


@dataclass(frozen=True)
class RunQuantity:
    """A number of a whole run, or a list of them.

    Attributes
    ----------
    dims : tuple of str
        Without those of `LISTED`.
    dtype : str
    attributes : mapping
    is_listed : bool
        Whether a run has any number of them: of its cycles or turns.
    """

    dims: tuple[str, ...]
    dtype: str
    attributes: Mapping[str, Any]
    is_listed: bool = False


def run_quantities(model: Model, settings: Settings) -> dict[str, RunQuantity]:
    """Return by name the numbers that the record and the diagnosis of a model's run have; nothing is marched for it."""
    rate, time = NUMBERS.per(model.time_unit).text, model.time_unit.text
    units = dict.fromkeys(COUNTS, "1") | {"run_fastest_rate": rate, "run_slowest_period": time}
    units |= dict.fromkeys(("run_h_omega_start", "run_h_omega_largest"), "1")
    quantities = {
        name: RunQuantity((), "f8", attrs_of(unit, name.removeprefix("run_").replace("_", " "), ROLE))
        for name, unit in units.items()
    }
    diagnosis = foreseen_diagnosis(March(model, settings), 1)
    for name, variable in diagnosis.variables.items():
        dims = tuple(str(dim) for dim in variable.dims)
        is_known = {*dims} <= {*LISTED, *model.shapes.extents}  # gates are of the model, and no numbers
        if variable.dtype.kind in "fi" and variable.attrs.get("role") != "rule" and is_known:
            element_dims = tuple(dim for dim in dims if dim not in LISTED)
            quantities[str(name)] = RunQuantity(
                element_dims, variable.dtype.str[1:], dict(variable.attrs), is_listed=element_dims != dims
            )
    return quantities


def run_values(run: xr.Dataset, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named numbers of a run; a run that failed has attributes alone."""
    of_diagnosis = [name for name in names if name not in run.attrs and run.attrs["run_outcome"] in GOOD]
    diagnosis = diagnose(run, companion=bool({*of_diagnosis} & {*BY_COMPANION})) if of_diagnosis else run
    values = {name: diagnosis.variables[name].values for name in of_diagnosis if name in diagnosis.variables}
    return values | {name: np.asarray(run.attrs[name]) for name in names if name in run.attrs}
