"""What is marked on the lines of a run: regimes as bands; how times, units and names are written.

Colours that can be told from the paper: darker on a light sheet, lighter on a dark one, where they are too near to it.

Powers of ten of an axis: in its label, where nothing else lies, and not beside its ticks.

Words of panels: what an axis shows, whose values are drawn, and where lines are straight.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.faults import escaped
from xdynamics.figures.curves import REACTION, has_chords, has_missing_rows, is_mean, known_model
from xdynamics.record.long_times import HOURS, LONG_UNITS, long_unit
from xdynamics.record.unfolding import whole_of
from xdynamics.shapes import display_text, join_element_name, split_element_name
from xdynamics.units import SECONDS, unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LINES, LETTERS = 3.0, 4.5  # least ratios of luminances: WCAG 2.1, success criteria 1.4.11 and 1.4.3
WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of red, green, blue in a luminance: IEC 61966-2-1
FLARE = 0.05  # of a screen, that is added to luminances
LINEAR = (0.04045, 12.92)  # up to where sRGB is linear, and how steep


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour: 0 for black, 1 for white."""
    return float(WEIGHTS @ _light(colour))


def contrast_ratio(colour: str, paper: str) -> float:
    """Return the ratio of the luminances of a colour and of the paper, the larger one over the smaller: from 1 to 21."""
    low, high = sorted((luminance(colour), luminance(paper)))
    return (high + FLARE) / (low + FLARE)


def legible(colour: str, min_contrast: float = LINES, paper: str = "") -> str:
    """Return a colour, darker or lighter as far as its contrast with the paper needs.

    Parameters
    ----------
    colour : str
    min_contrast : float
        Contrast.
    paper : str
        By default that of the sheet.

    Examples
    --------
    >>> legible("#1f5a96", paper="white"), legible("#f0f921", paper="white"), legible("#1f5a96", paper="black")
    ('#1f5a96', '#959b10', '#225b97')
    """
    from matplotlib import rcParams
    from matplotlib.colors import to_hex

    paper = paper or str(rcParams["axes.facecolor"])
    if contrast_ratio(colour, paper) >= min_contrast:
        return to_hex(colour)
    light, brightness = _light(colour), luminance(paper) + FLARE
    if brightness > FLARE + 0.5:
        light = light * max(0.0, brightness / min_contrast - FLARE) / float(WEIGHTS @ light)
    else:
        light_luminance = float(WEIGHTS @ light)
        light = light + (1.0 - light) * (min(1.0, brightness * min_contrast - FLARE) - light_luminance) / (
            1.0 - light_luminance
        )
    edge, slope = LINEAR
    coded = np.where(light <= edge / slope, slope * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    # whole numbers of 255 on the far side of the contrast
    rounding = np.floor if brightness > FLARE + 0.5 else np.ceil
    red, green, blue = (np.clip(rounding(255.0 * coded), 0.0, 255.0) / 255.0).tolist()
    return to_hex((red, green, blue))


def _light(colour: str) -> NDArray[np.float64]:
    """Return the light of red, green and blue, shape (3,)."""
    from matplotlib.colors import to_rgb

    coded = np.array(to_rgb(colour))
    edge, slope = LINEAR
    light: NDArray[np.float64] = np.where(coded <= edge, coded / slope, ((coded + 0.055) / 1.055) ** 2.4)
    return light


MOST_BORDERS = 12  # of regimes that are named
MOST_BANDS = 400  # of regimes; what changes more often is not distinguished
SHORTEST_NAMED = 0.08  # of the span, for a regime to be named in its band
COLOURS = ("#1f5a96", "#c8501e", "#3a8f5c", "#7a4fa0", "#8c6d1f", "#7a7a7a")


LONGEST_NAME = 16  # letters of an element beside a map, or at a path

_POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SYMBOLS = {"astronomical_unit": "au"}
_UNIT = re.compile(r"(?<![A-Za-z])([A-Za-z_]+)(-?[1-9][0-9]?)?(?= |$)")


def INK() -> str:  # noqa: N802 - a colour, that of the sheet's text
    """The colour of text and marks."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def typeset(units: str) -> str:
    """Typeset a unit with superscripts and symbols: ``m s⁻¹``.

    Examples
    --------
    >>> typeset("kg m2 s-2"), typeset("astronomical_unit")
    ('kg m² s⁻²', 'au')
    """
    return _UNIT.sub(lambda match: _SYMBOLS.get(match[1], match[1]) + (match[2] or "").translate(_POWERS), units)


def superscript(power: int) -> str:
    """Write a whole number as a power."""
    return str(power).translate(_POWERS)


def time_axis_label(time: xr.DataArray, label: str = "time") -> str:
    """Label times with their unit; without one if the model's time is dimensionless."""
    return label_with_unit(label, str(time.attrs.get("units", SECONDS.text)))


def label_time(axes: Axes, time: xr.DataArray, label: str = "time") -> None:
    """Label the time axis of a panel: in the unit recorded, or in hours, days or years where seconds would be a great many.

    What is drawn stays in the unit recorded; ticks stand at whole ones, and the label says how long days and years are.
    """
    from matplotlib.ticker import FuncFormatter

    name, size = long_unit(time)
    if size == 1.0:
        axes.set_xlabel(time_axis_label(time, label))
        return
    axes.xaxis.set_major_locator(_locator_of(size))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / size:g}"))
    explained = name in dict(LONG_UNITS) and name != HOURS
    length = f" of {size:,.0f} {SECONDS.text}".replace(",", "\u2009") if explained else ""
    axes.set_xlabel(f"{label} ({name}{length})")


def _locator_of(size: float) -> Any:
    """Return what chooses ticks at round numbers of a unit of time that lasts some seconds."""
    from matplotlib.ticker import MaxNLocator

    class RoundTimes(MaxNLocator):
        """Ticks at round numbers of a unit of time."""

        def tick_values(self, vmin: float, vmax: float) -> Any:
            return np.asarray(super().tick_values(vmin / size, vmax / size)) * size

    return RoundTimes("auto", steps=[1, 2, 2.5, 5, 10])


def label_with_unit(label: str, units: str) -> str:
    """Write what an axis or a line is, with its unit; without one for pure numbers."""
    return label if units == "1" else f"{label} ({units})"


def at_time(time: xr.DataArray, value: float, digits: int = 6) -> str:
    """Write a time with its unit."""
    units, size = long_unit(time)
    return f"t = {value / size:.{digits}g}{unit_suffix(units)}"


def shortened_names(names: list[str]) -> list[str]:
    """Return names with their middle left out where they are long; numbers from 0 before them where that confuses some.

    Examples
    --------
    >>> shortened_names(["Sun", "a_body_with_a_long_label_no_007"])
    ['Sun', 'a_body_w…l_no_007']
    """
    half = LONGEST_NAME // 2
    short_names = [name if len(name) <= LONGEST_NAME else f"{name[:half]}…{name[-half:]}" for name in names]
    has_duplicates = len({*short_names}) < len({*names})
    return [f"{k}: {name}" for k, name in enumerate(short_names)] if has_duplicates else short_names


def escaped_text(text: Any) -> str:
    """Escape a record's text for a figure, so that it has no formula and no invisible characters."""
    return escaped(display_text(str(text))).replace("$", r"\$")


Label = str | tuple[str, str]  # what an axis shows: a text, or a quantity and its unit


def label_panel(axes: Axes, *title: str, x: Label = "", y: Label = "", **style: Any) -> None:
    """Write the title of a panel, each text on a line, and what its axes show; what is not given stays as it is."""
    if title:
        axes.set_title("\n".join(map(escaped_text, title)), loc="left", fontsize=10, **style)
    for axis, label in ((axes.xaxis, x), (axes.yaxis, y)):
        if label:
            axis.set_label_text(escaped_text(label if isinstance(label, str) else "{} ({})".format(*label)))


def draw_line(
    axes: Axes,
    x: Any,
    y: Any,
    style: str = "-",
    colour: int | str = 0,
    label: str = "",
    width: float = 1.0,
    size: float = 4.0,
    **options: Any,
) -> Any:
    """Draw a line or points, which the legend names if there is a label; of numbered colours the first follows the last."""
    shade = colour if isinstance(colour, str) else COLOURS[colour % len(COLOURS)]
    text = escaped_text(label)
    return axes.plot(x, y, style, color=shade, label=text, linewidth=width, markersize=size, **options)[0]


def draw_isolated(axes: Axes, x: Any, y: Any, colour: str) -> None:
    """Draw the points of a broken curve that no line joins, since their neighbours are left out, as dots; there may be none."""
    is_missing = np.concatenate([[True], np.isnan(x) | np.isnan(y), [True]])
    is_isolated = ~is_missing[1:-1] & is_missing[:-2] & is_missing[2:]
    if is_isolated.any():
        axes.plot(x[is_isolated], y[is_isolated], ".", color=colour, markersize=1.5)


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return numbers from 0 up to a count: all, or as many as are drawn at most, spread evenly with both ends.

    Examples
    --------
    >>> evenly_spaced(3, 4), evenly_spaced(7, 4)
    ([0, 1, 2], [0, 2, 4, 6])
    """
    return [round(number) for number in np.linspace(0, max(count - 1, 0), min(count, most)).tolist()]


def subpanels(axes: Axes, count: int, columns: int = 0, **style: Any) -> list[Any]:
    """Put several axes in the place of some: in one row, or in rows of some columns."""
    subplot_spec: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    columns = columns or count
    grid = subplot_spec.subgridspec(-(-count // columns), columns)
    # a grid of one would be laid out for itself, apart from the sheet's
    places = [subplot_spec] if count == 1 else [grid[divmod(k, columns)] for k in range(count)]
    return [figure.add_subplot(place, **style) for place in places]


def shade_regimes(run: xr.Dataset, axes: Axes) -> None:
    """Shade the time that each regime lasts, and name it, where there are several."""
    if "regime" not in run or len(names := run.variables["regime"].attrs["flag_meanings"].split()) < 2:
        return
    time, regime = run.variables["time"].values, run.variables["regime"].values
    flags = np.atleast_1d(run.variables["regime"].attrs["flag_values"]).tolist()
    edges = np.concatenate([[0], np.flatnonzero(np.diff(regime)) + 1, [len(regime)]])
    for first, last in list(pairwise(edges))[:MOST_BANDS]:
        regime_index = flags.index(int(regime[first]))
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=COLOURS[regime_index % len(COLOURS)], alpha=0.07, linewidth=0)
        if len(edges) <= MOST_BORDERS and end - time[first] > SHORTEST_NAMED * (time[-1] - time[0]):
            axes.annotate(
                escaped_text(names[regime_index]),
                ((time[first] + end) / 2, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, -9),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color="#555555",
            )


POWER = re.compile(r"10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+ ?")
OFFSET = re.compile("1e([-\u2212]?[0-9]+)")  # as matplotlib writes a power alone
UNIT = re.compile(r" \(([^()]*)\)$")  # behind a label, and not an argument: E(0)
PLAIN = (-4, 5)  # powers from which to which numbers are written out: those of matplotlib


def fold_power(axis: Any) -> None:
    """Move the power of ten that all ticks of an axis share into its label: ``x (10⁻¹² m)``."""
    from matplotlib.ticker import ScalarFormatter

    formatter = axis.get_major_formatter()
    if not isinstance(formatter, ScalarFormatter):
        return
    low, high = sorted(axis.get_view_interval())
    formatter.set_locs([tick for tick in axis.get_majorticklocs() if low <= tick <= high])
    if not (match := OFFSET.fullmatch(formatter.get_offset())):  # none, or beside a number that is taken from all ticks
        return
    power = int(match[1].replace("\u2212", "-"))
    formatter.set_powerlimits((power, power))  # whichever ticks another size has
    axis.offsetText.set_visible(False)
    axis.set_label_text(with_power(axis.get_label_text(), power))


def with_power(label: str, power: int) -> str:
    """Return a label with a power of ten before its unit.

    Examples
    --------
    >>> with_power("x (m)", -12), with_power("E - E(0)", 7), with_power("", 7)
    ('x (10⁻¹² m)', 'E - E(0) (10⁷)', '10⁷')
    """
    ten = f"10{superscript(power)}"
    if match := UNIT.search(label):
        return f"{label[: match.start()]} ({ten} {match[1]})"
    return f"{label} ({ten})" if label else ten


def without_power(label: str) -> str:
    """Return a label as it was before, for axes that write numbers in their own way.

    Examples
    --------
    >>> without_power("x (10⁻¹² m)"), without_power("share (10⁷)"), without_power("x (m)")
    ('x (m)', 'share', 'x (m)')
    """
    return POWER.sub("", label).removesuffix(" ()")


def shared_power(values: Any) -> int:
    """Return the power of ten in which to write numbers of several axes; 0 where they are written out."""
    largest = float(np.abs(values).max(initial=0.0))
    power = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    return 0 if PLAIN[0] <= power < PLAIN[1] else power


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
