"""What evidence says along the time of a run: differences of runs, fits beside measurements, proven bounds, cycles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.archive import open_run
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL
from xdynamics.evidence.diagnosing.chaos import exponents_with_uncertainty
from xdynamics.evidence.diagnosing.diagnosis import cycle_count, cycles_text, diagnosed
from xdynamics.evidence.enclosing.enclosure import bounded_names
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.marks import COLOURS, draw_line, label_panel, label_time, label_with_unit, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import KEY
from xdynamics.shapes import split_element_name
from xdynamics.units import unit_suffix
from xdynamics.units.digits import with_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

MOST_LINES = 6  # in the panel of distances
MOST_APART = 3  # differences with a panel of their own, beside that of distances
FEW = 100  # points up to which each is a dot, and straight lines between them are seen


def panels_of(comparison: xr.Dataset) -> list[Panel]:
    """Return the panels of the differences; for measured data each follows the panel of its measurements.

    Of quantities with dimensions the elements that part farthest come first, those of each quantity in turn.

    Raises
    ------
    InputError
        If no quantity was compared.
    """
    is_of_several = comparison.attrs.get(schema.EVIDENCE) == OF_SEVERAL
    names = [
        str(name).removeprefix("difference_")
        for name, item in comparison.data_vars.items()
        if str(name).startswith("difference_") and item.dims == (("run", schema.AT) if is_of_several else (schema.AT,))
    ]
    if is_of_several:
        return [partial(_draw_distances_of_runs, comparison, name) for name in names]
    if not names:
        raise InputError("there is nothing to draw: the comparison has no difference along 'at'")
    measured_panels = [partial(_draw_measured, comparison, name) for name in names if f"measured_{name}" in comparison]
    if measured_panels:  # measurements are drawn left of their residuals
        residual_panels = [partial(_draw_difference, comparison, name) for name in names]
        return [item for pair in zip(measured_panels, residual_panels, strict=True) for item in pair]
    groups = _farthest_first(comparison, names)
    in_turn = [name for turn in zip_longest(*groups) for name in turn if name is not None]
    panels: list[Panel] = [
        partial(_draw_difference, comparison, name) for name in (in_turn if len(groups) < len(names) else names)
    ]
    if not any((np.abs(comparison[f"difference_{name}"]) > 0.0).any() for name in names):
        return panels[: MOST_APART + 1]
    distance_names = groups[0] if len(groups[0]) > 1 else names
    return [partial(_draw_distances, comparison, distance_names), *panels[:MOST_APART]]


def _farthest_first(comparison: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group elements by their quantity, those whose differences are largest first; quantities that do not differ come last."""
    largest = {name: float(np.nanmax(np.abs(comparison[f"difference_{name}"].values), initial=0.0)) for name in names}
    groups = {split_element_name(name)[0]: list[str]() for name in names}
    for name in sorted(names, key=lambda name: -largest[name]):
        groups[split_element_name(name)[0]].append(name)
    return sorted(groups.values(), key=lambda group: largest[group[0]] == 0.0)


def foot_of(comparison: xr.Dataset) -> str:
    """Describe what differs, and since when."""
    if comparison.attrs.get(schema.EVIDENCE) == OF_SEVERAL:
        runs = zip(comparison["run_name"].values.tolist(), comparison["cause"].values.tolist(), strict=True)
        return "; ".join(f"{run}: {cause or 'the same'}" for run, cause in runs)
    parting_event, cause = (str(comparison.attrs.get(key, "")) for key in ("parted", "cause"))
    shaded = "shaded: standard uncertainty as measured, else what interpolation may be off"
    return "; ".join(filter(None, (shaded, parting_event and f"parted at {parting_event}", cause)))


def _draw_measured(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw the measured values with their uncertainty, and the computed values at the same times."""
    time, order = comparison[schema.AT_TIME].values, np.argsort(comparison[schema.AT_TIME].values)
    doubt = comparison[f"measured_uncertainty_{name}"].values if f"measured_uncertainty_{name}" in comparison else None
    style: dict[str, Any] = {"fmt": ".", "color": COLOURS[1], "markersize": 3, "elinewidth": 1.0, "capsize": 3}
    axes.errorbar(time, comparison[f"measured_{name}"].values, doubt, zorder=3, label="measured", **style)
    draw_line(axes, time[order], comparison[name].values[order], label="computed, at the same times", width=0.9)
    label_time(axes, comparison[schema.AT_TIME])
    label_panel(axes, f"{name}, measured and computed", y=(name, comparison[name].attrs["units"]))
    axes.legend(fontsize=8, frameon=False)


def _draw_distance(axes: Axes, time: Floats, difference: Floats, k: int, label: str) -> None:
    """Draw how far two runs are apart, for a logarithmic scale, where exponential growth is a straight line."""
    distance = np.abs(difference)
    distance[distance == 0.0] = np.nan
    rows = thinned_rows(distance)
    draw_line(axes, time[rows], distance[rows], "-", k, label)


def _draw_distances(comparison: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw how far two runs are apart, or elements of one quantity, in its unit."""
    order = np.argsort(comparison[schema.AT_TIME].values, kind="stable")
    quantities = {split_element_name(name)[0] for name in names}
    units = {name: str(comparison[f"difference_{name}"].attrs["units"]) for name in names}
    is_of_elements = len(quantities) == 1 < len(names)
    for k, name in enumerate(names[:MOST_LINES]):
        label = name if is_of_elements else label_with_unit(name, units[name])
        difference = comparison[f"difference_{name}"].values[order]
        _draw_distance(axes, comparison[schema.AT_TIME].values[order], difference, k, label)
    axes.set_yscale("log")
    label_time(axes, comparison[schema.AT_TIME])
    superlative = "the farthest " if is_of_elements else ""
    left_out = f", {superlative}{MOST_LINES} of {len(names)}" if len(names) > MOST_LINES else ""
    y = (f"|difference of {quantities.pop()}|", units[names[0]]) if is_of_elements else "|difference|"
    label_panel(axes, f"distance of the runs{left_out}", y=y)
    axes.legend(fontsize=8, frameon=False)


def _draw_distances_of_runs(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw how far each of several runs is from the reference."""
    differences = comparison[f"difference_{name}"]
    for k, run in enumerate(comparison["run_name"].values[:MOST_LINES].tolist()):
        _draw_distance(axes, comparison[schema.AT_TIME].values, differences.isel(run=k).values, k, run)
    if any(np.isfinite(line.get_ydata()).any() for line in axes.lines):
        axes.set_yscale("log")
    label_time(axes, comparison[schema.AT_TIME])
    left_out = f", {MOST_LINES} of {comparison.sizes['run']} runs" if comparison.sizes["run"] > MOST_LINES else ""
    label_panel(axes, f"{name}{left_out}", y=("|difference|", str(differences.attrs["units"])))
    axes.legend(fontsize=8, frameon=False)


def _draw_difference(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a difference and its uncertainty."""
    order, difference = np.argsort(comparison[schema.AT_TIME].values, kind="stable"), comparison[f"difference_{name}"]
    time, values = comparison[schema.AT_TIME].values[order], difference.values[order]
    measured = f"measured_uncertainty_{name}"
    doubt = comparison[measured if measured in comparison else f"interpolation_error_{name}"].values[order]
    rows = thinned_rows(values)
    axes.fill_between(time[rows], -doubt[rows], doubt[rows], color=COLOURS[0], alpha=0.25, linewidth=0)
    style = "." if f"measured_{name}" in comparison else ".-" if len(time) <= FEW else "-"
    draw_line(axes, time[rows], values[rows], style)
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    label_time(axes, comparison[schema.AT_TIME])
    quantity, labels = split_element_name(name)
    title = str(difference.attrs["long_name"])
    if labels and title.startswith(f"{quantity},"):
        title = f"{name}{title.removeprefix(quantity)}"
    scale = _scale_note(comparison, "difference", name)
    label_panel(axes, f"{title}{scale}", y=("difference", difference.attrs["units"]))


def _scale_note(record: xr.Dataset, head: str, name: str) -> str:
    """Say what the scale of a number is, if the record has one."""
    scale = record.get(schema.scale_name(head, name))
    return (
        "" if scale is None else f"; scale {float(scale):.3g} {typeset(str(scale.attrs['units']))}".removesuffix(" 1")
    )


RESIDUAL, MEASURED, DOUBT, OF_EVENTS = "residual_", "measured_", "measured_uncertainty_", "event_time_"


def fit_panels(fit: xr.Dataset) -> list[Panel]:
    """Return the panels of each quantity and, beside it, of its residuals."""
    names = [str(name).removeprefix(RESIDUAL) for name in fit.data_vars if str(name).startswith(RESIDUAL)]
    return [partial(draw, fit, name) for name in names for draw in (_draw_fitted_values, _draw_residuals)]


def fit_foot(fit: xr.Dataset) -> str:
    """Report the estimates and the data."""
    records = fit["parameter_record"].values.tolist() if "parameter_record" in fit else [""] * fit.sizes["parameter"]
    columns = (fit[key].values for key in ("parameter_name", "estimate", "standard_uncertainty", "parameter_units"))
    estimates = ", ".join(
        f"{name}{f' of {record}' if record else ''} = {with_uncertainty(value, doubt)}{unit_suffix(unit)}"
        for record, name, value, doubt, unit in zip(records, *columns, strict=True)
    )
    caveat = "" if int(fit.attrs.get("adequate", 1)) else f"; not adequate: {fit.attrs['adequate_text']}"
    return f"{estimates}, at one standard uncertainty; {fit.attrs['data']}{caveat}"


def _draw_fitted_values(fit: xr.Dataset, name: str, axes: Axes) -> None:
    for record, rows, abscissa in _rows_by_record(fit, name):
        label = f"measured, {fit['record_name'].values[record]}" if "record_name" in fit else "measured"
        draw_line(axes, abscissa, fit[f"{MEASURED}{name}"].values[rows], ".", _record_colour(record), label)
        _draw_bands(fit, name, rows, abscissa, axes, centre=fit[name].values[rows], labels=not record)
        is_straight = abscissa.size < FEW and not name.startswith(OF_EVENTS)
        fitted = "" if record else "fitted model" + ", straight between the times" * is_straight
        draw_line(axes, abscissa, fit[name].values[rows], label=fitted)
    _label_abscissa(fit, name, axes)
    label_panel(axes, name, y=(name, fit[name].attrs["units"]))
    axes.legend(**KEY)


def _draw_bands(
    fit: xr.Dataset, name: str, rows: Any, abscissa: Floats, axes: Axes, *, centre: Floats, labels: bool
) -> None:
    """Draw where the fitted model is, and where one more measurement would be, with the fit's probability."""
    coverage, half = float(fit.attrs.get("coverage", np.nan)), float(fit.attrs.get("half_width", np.nan))
    for word, shade, band_name in (("predicted", 0.12, "one more measurement"), ("fitted", 0.3, "fitted model")):
        if f"{word}_uncertainty_{name}" in fit and np.isfinite(half):
            size = half * fit[f"{word}_uncertainty_{name}"].values[rows]
            style: dict[str, Any] = {"color": COLOURS[0], "alpha": shade, "linewidth": 0}
            label = f"{band_name}, {coverage:.0%}" if labels else None
            axes.fill_between(abscissa, centre - size, centre + size, label=label, **style)


def _draw_residuals(fit: xr.Dataset, name: str, axes: Axes) -> None:
    for record, rows, abscissa in _rows_by_record(fit, name):
        residuals = fit[f"{RESIDUAL}{name}"].values[rows]
        _draw_bands(fit, name, rows, abscissa, axes, centre=np.zeros(rows.size), labels=False)
        doubts = fit[f"{DOUBT}{name}"].values[rows] if f"{DOUBT}{name}" in fit else None
        colour = COLOURS[_record_colour(record)]
        axes.errorbar(abscissa, residuals, doubts, fmt=".", color=colour, markersize=3, linewidth=0.5)
    axes.axhline(0.0, color=COLOURS[0], linewidth=1.0)
    _label_abscissa(fit, name, axes)
    label_panel(axes, f"residuals of {name}", y=("measured minus fitted", fit[name].attrs["units"]))


def _record_colour(record: int) -> int:
    """Return the number of the colour of a record's measurements: the first is that of the model."""
    return 1 + record % (len(COLOURS) - 1)


def _rows_by_record(fit: xr.Dataset, name: str) -> Iterator[tuple[int, Any, Floats]]:
    """Yield each record that has a quantity, its rows, and what these are drawn over, in order: times, or occurrences."""
    abscissa = fit["at_occurrence" if name.startswith(OF_EVENTS) else schema.AT_TIME].values
    is_finite = np.isfinite(fit[name].values)
    record_of_row = fit["at_record"].values if "at_record" in fit else np.zeros(is_finite.size, int)
    for record in np.unique(record_of_row[is_finite]).tolist():
        rows = np.flatnonzero(is_finite & (record_of_row == record))
        rows = rows[np.argsort(abscissa[rows], kind="stable")]
        yield record, rows, abscissa[rows]


def _label_abscissa(fit: xr.Dataset, name: str, axes: Axes) -> None:
    if name.startswith(OF_EVENTS):
        axes.set_xlabel("occurrence")
    else:
        label_time(axes, fit[schema.AT_TIME])


NARROW = 1e-2  # of what a quantity goes through: a tube that is narrower is drawn about its middle


def tube_panels(tube: xr.Dataset, beside: Sequence[Any] = ()) -> list[Panel]:
    """Return the panel of each quantity with proven bounds, and the runs inside them.

    Raises
    ------
    InputError
        If what is to be drawn inside the tube is no run, or no time has bounds.
    """
    runs = [source if isinstance(source, xr.Dataset) else open_run(source) for source in beside]
    for run in runs:
        if run.attrs.get(schema.EVIDENCE) or "time" not in run:
            raise InputError("what is drawn inside proven bounds is a run; leave out what is none")
    time_dim, time = (schema.AT, schema.AT_TIME) if schema.AT_TIME in tube.variables else (schema.STEPS, "time")
    proven_part = tube.isel({time_dim: np.flatnonzero(tube[time].values <= float(stated_value(tube, "proven_until")))})
    if not proven_part.sizes[time_dim]:
        raise InputError(f"there is nothing to draw: {stated_value(tube, 'outcome_text')}")
    sorted_tube = proven_part.sortby(time)
    names = [name for name in bounded_names(tube, time_dim) if sorted_tube[schema.bounds_of(name)[0]].ndim == 1]
    sampled_runs = [_sampled_run(run, sorted_tube[time].values) for run in runs]
    return [partial(_draw_tube, sorted_tube, name, time, sampled_runs) for name in names]


def tube_foot(tube: xr.Dataset) -> str:
    """Say what is proven."""
    return f"{stated_value(tube, 'summary')} Bounds hold at the dots of a run, and wherever lines have corners."


def _sampled_run(run: xr.Dataset, times: Floats) -> xr.Dataset:
    """Return the states of a run at those times of a tube that it has."""
    ends = run.variables["time"].values[[0, -1]]
    return sample(run, times[(times >= ends[0]) & (times <= ends[1])])


def _draw_tube(tube: xr.Dataset, name: str, time: str, sampled_runs: list[xr.Dataset], axes: Axes) -> None:
    """Draw one tube; of a narrow one how far its bounds and the runs are from its middle."""
    times, (low, high) = tube[time].values, (tube[bound].values for bound in schema.bounds_of(name))
    width, unit = float((high - low).max()), str(tube[schema.bounds_of(name)[0]].attrs["units"])
    middle = low + 0.5 * (high - low)
    is_narrow = width < NARROW * float(np.ptp(middle))
    reference = middle if is_narrow else np.zeros_like(middle)
    axes.fill_between(times, low - reference, high - reference, color=COLOURS[0], alpha=0.3, linewidth=0.0)
    for bound in (low, high):
        draw_line(axes, times, bound - reference, width=0.8)
    for k, run in enumerate(sampled_runs):
        if name in run:
            run_times = run.variables[schema.AT_TIME].values
            deviation = run.variables[name].values - np.interp(run_times, times, reference)
            draw_line(axes, run_times, deviation, ".-", 1 + k, f"run by {run.attrs['solver_method']}", size=3)
            axes.legend(fontsize=8, loc="upper left", framealpha=0.6)
    label_time(axes, tube[time])
    last = f"{high[-1] - low[-1]:.2g}{unit_suffix(typeset(unit))} wide at the end"
    label_panel(axes, f"{name}, {last}", y=(f"{name} less the middle" if is_narrow else name, unit), pad=14)


NEARLY_CONSTANT = 1e-4  # of the first value: what changes by less is drawn as its change
MOST_LABELS = 12  # exponents up to which each has its digits beside it
SHOWN = ("period", "phase_offset", "amplitude", "phase_space_area")


def diagnosis_panels(diagnosis: xr.Dataset) -> list[Panel]:
    """Return the panels of period, phase, amplitude and area of each cycle, and of Lyapunov exponents.

    Raises
    ------
    InputError
        If there is neither a cycle nor an exponent.
    """
    has_cycles = diagnosis.sizes.get(schema.CYCLE, 0)
    names = [name for name in SHOWN if has_cycles and name in diagnosis and diagnosis[name].notnull().any()]
    if not names and schema.LYAPUNOVS not in diagnosis:
        raise InputError("there is nothing to draw: the diagnosis has no cycle; `xdynamics show` prints what it found")
    residuals = [
        str(name) for name, item in diagnosis.data_vars.items() if str(name).startswith(RESIDUAL) and item.dims
    ]
    return [
        *(partial(_draw_along_cycles, diagnosis, name) for name in names),
        *([partial(_draw_exponents, diagnosis)] if schema.LYAPUNOVS in diagnosis else []),
        *(partial(_draw_residual, diagnosis, name) for name in residuals),
    ]


def diagnosis_foot(diagnosis: xr.Dataset) -> str:
    """Describe the cycles, the reference of their phases, and how the energy behaved."""
    remarks = []
    if cycle_count(diagnosis):
        remarks.append(f"cycles of {cycles_text(diagnosis)}; phases beside {stated_value(diagnosis, 'reference')}")
    if doubt := stated_value(diagnosis, "cycle_doubt"):
        remarks.append(str(doubt))
    if schema.LYAPUNOVS in diagnosis:
        remarks.append(f"exponents: {diagnosis[schema.LYAPUNOVS].attrs['transient']}; bars are standard uncertainties")
    energy = ""
    if "energy_band" in diagnosis:
        energy = f"; energy band {diagnosed(diagnosis, 'energy_band')}, drift {diagnosed(diagnosis, 'energy_drift')}"
    return "; ".join(remarks) + energy


def _draw_exponents(diagnosis: xr.Dataset, axes: Axes) -> None:
    """Draw every exponent with its uncertainty and its digits; for -inf the digits alone."""
    values, doubts = diagnosis[schema.LYAPUNOVS].values, diagnosis[schema.LYAPUNOV_UNCERTAINTY].values
    finite = np.where(np.isfinite(values), values, np.nan)
    numbers = np.arange(1, len(values) + 1)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.errorbar(numbers, finite, yerr=doubts, fmt="o", color=COLOURS[0], markersize=4, capsize=3.0, linewidth=1.0)
    labels = exponents_with_uncertainty(diagnosis) if len(values) <= MOST_LABELS else []
    for number, value, label in zip(numbers, finite, labels, strict=False):
        label_point = (number, value if np.isfinite(value) else 0.0)
        axes.annotate(label, label_point, xytext=(6, 5), textcoords="offset points", fontsize=8)
    axes.set_xlim(0.5, len(values) + 0.9)
    axes.margins(y=0.15)
    axes.locator_params(axis="x", integer=True)
    growth = diagnosis[schema.FINITE_TIME_GROWTH]  # of which a figure needs three digits
    growth_text = f"{float(growth):.3g}{unit_suffix(str(growth.attrs['units']))}"
    title = f"Lyapunov exponents; growth over the run's own time {growth_text}"
    label_panel(axes, title, x="number", y=("Lyapunov exponent", str(diagnosis[schema.LYAPUNOVS].attrs["units"])))


def _first_value(diagnosis: xr.Dataset, name: str) -> str:
    """Write the value in the first cycle, its unit typeset."""
    number, _, unit = diagnosed(diagnosis, name, 0).partition(" ")
    return f"{number} {typeset(unit)}".rstrip()


def _draw_along_cycles(diagnosis: xr.Dataset, name: str, axes: Axes) -> None:
    values, title = diagnosis[name].values, name
    first, changes = float(values[0]), values - float(values[0])
    if values.size == 1:
        title = f"{name}, {_first_value(diagnosis, name)}"
    elif float(np.nanmax(np.abs(changes))) < NEARLY_CONSTANT * abs(first):
        values, title = changes, f"{name} less its start, {_first_value(diagnosis, name)}"
    draw_line(axes, diagnosis["cycle_time"].values, values, ".-")
    label_time(axes, diagnosis["cycle_time"], "time at the end of the cycle")
    label_panel(axes, title, y=(name, diagnosis[name].attrs["units"]), pad=14)


def _draw_residual(diagnosis: xr.Dataset, name: str, axes: Axes) -> None:
    variable = diagnosis[name]
    draw_line(axes, diagnosis["time"].values, variable.values, colour=1)
    label_time(axes, diagnosis["time"])
    scale = _scale_note(diagnosis, *name.split("_", 1))
    label_panel(axes, f"{variable.attrs['long_name']}{scale}", y=(name, variable.attrs["units"]))


TUBE_PAGE = Page((schema.ENCLOSURE,), tube_panels, tube_foot, 6)
PAGES = (
    TUBE_PAGE,
    Page(("comparison", OF_SEVERAL), panels_of, foot_of, most_panels=12),
    Page(("fit",), fit_panels, fit_foot, most_panels=8),
    Page(("diagnosis",), diagnosis_panels, diagnosis_foot),
)
