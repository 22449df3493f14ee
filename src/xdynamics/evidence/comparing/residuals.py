"""Residuals of a run against measured data: differences, their norms, and their size by the measured uncertainties."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive
from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.observables import observables_of, observe
from xdynamics.evidence.scaling import scale_of, scaled_variables
from xdynamics.faults import InputError, Ledger
from xdynamics.model.drives import REFUSE
from xdynamics.record.element_attributes import quantity_names
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.named_elements import get_column
from xdynamics.schema import AT, AT_TIME
from xdynamics.shapes import Shapes, split_element_name
from xdynamics.units import Unit, parse_unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr
from xdynamics.evidence.comparing.measured import Floats, Measured, read_measured_data


def data_residuals(
    run: xr.Dataset,
    source: Any,
    functions: Mapping[str, Callable[..., float]] | None,
    gaps: str = REFUSE,
    reading: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Compare a run with measured data; see `compare`.

    Raises
    ------
    InputError
        If a column cannot be read or has another dimension than the run, or a time is outside the run.
    """
    return residuals_with(run, measured_for(run, source, functions, gaps, reading), functions)


def measured_for(
    run: xr.Dataset,
    source: Any,
    functions: Mapping[str, Callable[..., float]] | None,
    gaps: str,
    reading: Mapping[str, Any] | None,
) -> Measured:
    """Read measured data to be compared with a run, of which no value is read.

    Raises
    ------
    InputError
        If a column cannot be read, or has another dimension than the run.
    """
    model = model_of_record(run, functions)
    recorded = {*map(str, run.variables)}
    observables = [name for name in observables_of(model) if {name, split_element_name(name)[0]} & recorded]
    data = read_measured_data(source, observables, gaps, time_unit_of(run), model.shapes, reading)
    ledger = Ledger(data.name)
    for name, (_, unit) in data.values.items():
        if name not in observables:
            ledger.note(
                f"column '{name}' is not a quantity of the run; there are {', '.join(quantity_names(observables))}"
            )
        elif unit.dimension != parse_unit(str(get_column(run, name).attrs["units"])).dimension:
            ledger.note(
                f"column '{name}' is in '{unit.text}', needs '{get_column(run, name).attrs['units']}' or a unit like it"
            )
    ledger.raise_faults()
    return data


def residuals_with(run: xr.Dataset, data: Measured, functions: Mapping[str, Callable[..., float]] | None) -> xr.Dataset:
    """Compare a run with data that were read for it.

    Raises
    ------
    InputError
        If a time is outside the run.
    """
    unit_text = unit_suffix(time_unit_of(run))
    begin, end = (float(run["time"][k]) for k in (0, -1))
    outside = np.flatnonzero((data.times < begin) | (data.times > end))
    if outside.size:
        raise InputError(
            f"{data.name}, row {int(outside[0]) + 1}: t = {float(data.times[outside[0]])!r}{unit_text} is outside the"
            f" run, from {begin!r}{unit_text} to {end!r}{unit_text}"
        )
    model = model_of_record(run, functions)
    computed = observe(run, model, list(data.values), data.times)
    return residuals_of(run, model.shapes, computed, data, [archive.digest_of_run(run)])


def residuals_of(
    run: xr.Dataset,
    shapes: Shapes,
    computed: Mapping[str, tuple[Floats, Floats]],
    data: Measured,
    digests: Sequence[str],
) -> xr.Dataset:
    """Put measured data beside what was computed at their times."""
    variables: dict[str, Any] = {
        AT_TIME: ((AT,), data.times, attrs_of(time_unit_of(run).text, "time of measurement", "time"))
    }
    for name in data.values:
        variables |= _residual_variables(name, str(get_column(run, name).attrs["units"]), *computed[name], data)
    return evidence_dataset(
        "comparison",
        f"{run.attrs['title']}, beside {data.name}",
        digests,
        variables,
        {"data": data.name, "data_left_out": ", ".join(data.left_out)},
        shapes=shapes,
    )


def _residual_variables(name: str, units: str, computed: Floats, errors: Floats, data: Measured) -> dict[str, Any]:
    record_unit = parse_unit(units)

    def to_record_unit(values: Floats, unit: Unit) -> Floats:
        return values * float(unit.factor / record_unit.factor)

    values = to_record_unit(*data.values[name])
    differences = values - computed
    scale_text = f"largest size of {name} as measured; where that is 0, as computed"
    variables: dict[str, Any] = {
        f"measured_{name}": ((AT,), values, attrs_of(units, f"{name} as measured", "measured")),
        name: ((AT,), computed, attrs_of(units, f"{name} as computed", "computed")),
        f"difference_{name}": ((AT,), differences, attrs_of(units, f"{name}, measured minus computed", "difference")),
        f"interpolation_error_{name}": (
            (AT,),
            errors,
            attrs_of(units, f"estimated error of interpolating {name} between accepted states", "error"),
        ),
        f"rms_difference_{name}": (
            (),
            np.sqrt(np.mean(differences**2)),
            attrs_of(units, f"root of the mean square of difference_{name}", "residual"),
        ),
        **scaled_variables(
            "difference", name, differences, scale_of(values, computed), (AT,), units, scale_text, ("rms",)
        ),
    }
    if name in data.uncertainties:
        uncertainty = to_record_unit(*data.uncertainties[name])
        square = np.mean((differences / uncertainty) ** 2)
        variables |= {
            f"measured_uncertainty_{name}": (
                (AT,),
                uncertainty,
                attrs_of(units, f"standard uncertainty of {name} as measured", "uncertainty"),
            ),
            f"reduced_chi_square_{name}": (
                (),
                square,
                attrs_of(
                    "1",
                    f"mean square of difference_{name} over its uncertainty; nothing was fitted, so all values are"
                    " degrees of freedom",
                    "residual",
                )
                | {"degrees_of_freedom": differences.size},
            ),
        }
    return variables
