"""Verbs that show: archives, and the available methods."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import json_option, main, on_board, print_json, say, terminal_width
from xdynamics.cli.settings import names_in

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.methods import Method

MORE = (
    "`xdynamics methods NAME` describes one: its equations, where they stand in the literature, how long a step may be.",
    "With --precision double_double those that are not implicit compute with 31 digits: `xdynamics help precision`.",
)


@main.command()
@click.argument("archives", metavar="RUN.nc…", nargs=-1, required=True)
@click.option("--all", "whole", is_flag=True, help="Also print equations, settings and digests.")
@json_option
def show(archives: tuple[str, ...], whole: bool) -> None:
    """Print what archives hold: outcome, events, parameters; of a sweep's folder its members. With --json a line each."""
    from xdynamics.documenting.summary import details

    for number, archive in enumerate(archives):
        record = open_archive(archive)
        title, *further = details(record, with_settings=whole)
        say([*([""] if number else []), title, *on_board(record), *further])
        print_json(record)


def open_archive(name: str) -> xr.Dataset:
    """Open an archive, or the catalogue of a sweep's folder."""
    from xdynamics.archive import open_run
    from xdynamics.archive.store import location_of
    from xdynamics.sweeping.catalogue import is_sweep_folder, open_sweep

    return open_sweep(name) if is_sweep_folder(location_of(name)) else open_run(name)


@main.command(makes=True)
@click.argument("archive", metavar="RUN.nc")
@click.option(
    "-o",
    "--output",
    metavar="FIGURE",
    help="The figure to write: PNG, SVG or PDF, by its suffix, or HTML that is interactive; by default a PNG beside the archive.",
)
@click.option("--only", metavar="NAMES", help="Draw only these panels or variables, like 'plane,energy,x'.")
@click.option(
    "--panels",
    type=click.Choice(["few", "all"]),
    default="few",
    help="Of a run: the four that one looks at first (few), or all, with steps, errors, and how events were located.",
)
@click.option(
    "--with",
    "beside",
    multiple=True,
    metavar="FILE",
    help="Another run, or measured data as CSV, drawn over the first.",
)
@click.option(
    "--transient",
    metavar="N|TIME",
    help="Leave out of a bifurcation diagram or a section the first N occurrences, or what is before a time.",
)
@click.option("--size", metavar="WxH", help="Width and height in inches, like 8x5.")
@click.option("--dpi", type=int, default=130, help="Dots per inch of a PNG (130).")
@click.option("--dark", is_flag=True, help="Draw on a dark background.")
def plot(
    archive: str,
    output: str | None,
    only: str | None,
    panels: str,
    beside: tuple[str, ...],
    transient: str | None,
    size: str | None,
    dpi: int,
    dark: bool,
) -> None:
    """Draw a run: its motion, energy, contacts and drives, with the events; of a sweep's folder maps of its members."""
    from xdynamics.figures import plot as draw

    names = None if only is None else names_in(only)
    output = output or _path_beside(archive, ".png")
    record = open_archive(archive)
    how: dict[str, Any] = {"only": names, "panels": panels, "beside": list(beside), "transient": transient}
    draw(record, output, **how, size=_figure_size(size), dpi=dpi, dark=dark)
    say([f"figure    {output}"])


def _path_beside(archive: str, suffix: str) -> str:
    """Return the name of a file beside an archive, or beside the folder of a sweep, that is called after it."""
    from xdynamics.archive.store import location_of

    location = location_of(archive)
    stem = location.stem if location.suffix in (".nc", ".zarr") else location.name
    return str(location.with_name(stem + suffix))


def _figure_size(text: str | None) -> tuple[float, float] | None:
    """Read width and height."""
    from xdynamics.faults import InputError

    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    try:
        return float(width), float(height)
    except ValueError:
        raise InputError(f"--size {text!r} needs width and height in inches, like 8x5") from None


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILM.gif|.html|.mp4",
    help="The film to write: GIF, HTML with a slider, or MP4 if ffmpeg is installed.",
)
@click.option("--seconds", type=float, help="Duration of the film in seconds.")
@click.option("--trail", type=float, help="Length of the trail, in the run's own time.")
@click.option("--dark", is_flag=True, help="Draw on a dark background.")
def animate(archive: str, output: str, seconds: float | None, trail: float | None, dark: bool) -> None:
    """Film the motion in the plane, with the time and trails.

    Bodies that turn are drawn with their points and joints. Between bodies along a dimension lines are drawn where a
    relation has them as neighbours, or by a table: [relations.rod] of = "body", neighbours = 1.
    """
    from xdynamics.figures.animation import animate as film

    film(open_archive(archive), output, seconds=seconds, trail=trail, dark=dark)
    say([f"film      {output}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("--times", required=True, help="The times: '1 s', '0.1 s, 0.2 s' or '0:20:201 s' (first:last:count).")
@click.option("-o", "--output", metavar="TABLE.csv", help="The table to write; printed if not given.")
@json_option
def sample(archive: str, times: str, output: str | None) -> None:
    """Write the states of a run at any times as a table, each as if a step had ended there."""
    from xdynamics.archive import open_run
    from xdynamics.archive.store import location_of
    from xdynamics.dynamics.recorded_steps import wanted_times
    from xdynamics.evidence.sampling import sample as states_at
    from xdynamics.interchange.tables import check_text_target, states_as_csv, write_text_table
    from xdynamics.record.flag_words import time_unit_of

    target = check_text_target(location_of(output)) if output else None
    with open_run(archive) as run:
        states = states_at(run, wanted_times(times, time_unit_of(run)))
    text = states_as_csv(states)
    say([write_text_table(text, target)] if target is not None else text.splitlines())
    print_json(states, archive=output)


@main.command()
@click.argument("archives", metavar="FILE.nc…", nargs=-1, required=True)
@click.option(
    "--of",
    metavar="ROWS",
    help="What a row is of: steps, trials, events, samples, closed, levels, cases, terms, times, members or parameters; by"
    " default what the file has first.",
)
@click.option(
    "-o", "--output", metavar="T.csv|.xlsx|.parquet|.md|.tex", help="The table to write; printed if not given."
)
@click.option("--rounded", is_flag=True, help="Round each number to the digits that its uncertainty supports.")
@click.option(
    "--keep",
    "kept",
    multiple=True,
    metavar="WORD",
    help="Of several runs: which numbers, like event_time_ground or energy_drift; by default the states at their ends.",
)
@json_option
def table(archives: tuple[str, ...], of: str | None, output: str | None, rounded: bool, kept: tuple[str, ...]) -> None:
    """Write what a file holds as a table, with units in its headers: of a run its steps, of a refinement its levels.

    Of several runs, or those of a folder with --keep, each has a row. Events have both one-sided states in their row; a sweep's folder has a row a member.
    The states at chosen times are written by `xdynamics sample`.
    """
    from xdynamics.archive.store import location_of
    from xdynamics.faults import InputError
    from xdynamics.interchange import tables
    from xdynamics.interchange.run_index import open_runs

    target = tables.check_table_target(location_of(output)) if output else None
    if len(archives) > 1 or kept:
        if of is not None or rounded:
            raise InputError(f"of {len(archives)} files each has a row; give one for {'--of' if of else '--rounded'}")
        words = [word for text in kept for word in names_in(text) if word] or ["end"]
        made = tables.table(open_runs(archives if len(archives) > 1 else archives[0], keep=words))
    else:
        made = tables.table(open_archive(archives[0]), of, rounded=rounded)
    say([tables.write_table(made, target)] if target is not None else tables.table_lines(made, terminal_width()))
    rows = {"units": made.attrs["units"], "rows": made.to_dict("records")}
    print_json({"kind": "table", "title": f"table of {', '.join(archives)}", **rows}, archive=output)


@main.command()
@click.argument("name", required=False)
@json_option
def methods(name: str | None) -> None:
    """Print the table of methods, or all that is known of one."""
    from xdynamics.faults import InputError
    from xdynamics.methods import METHODS, unknown_method

    if name is None:
        say([*repr(METHODS).splitlines(), *MORE])
        print_json({"kind": "methods", "methods": {method.name: _data_of(method) for method in METHODS.values()}})
    elif name in METHODS:
        say(page_of(METHODS[name]))
        print_json({"kind": "method", "name": name} | _data_of(METHODS[name]))
    else:
        raise InputError(f"{unknown_method(name, METHODS)}there are {', '.join(METHODS)}")


def page_of(method: Method) -> Iterable[str]:
    """Yield all that is known of a method."""
    from xdynamics.methods.table import step_kind

    work = "an iteration" if method.solves else "a step"
    yield f"{method.name}: order {method.order}, {step_kind(method)}, {method.evaluations} force evaluations {work}"
    yield f"    update    {method.equations()}"
    yield f"    in words  {method.words}"
    yield (
        "    estimate "
        f" {f'embedded formula of order {method.estimate_order}' if method.estimate else 'by step doubling'}"
    )
    yield (
        f"    between   re-integration, order {method.order}; or {method.interpolant.words}, order"
        f" {method.interpolant.order}"
    )
    yield f"    stable    {', '.join(_stability_limits(method))}"
    yield f"    digits    {'16' if method.solves else '16; 31 with precision = double_double, see `xdynamics help precision`'}"
    yield f"    refuses   {'; '.join(method.refuses) or 'nothing'}"
    yield f"    also      {', '.join(method.synonyms) or 'no other name'}"
    yield f"    source    {method.reference}"


def _data_of(method: Method) -> dict[str, Any]:
    """Return the properties of a method as plain data; an infinite limit is None, nan an unknown one."""
    from xdynamics.methods.table import step_kind
    from xdynamics.stability import decay_limit, oscillator_limit

    return {
        "order": method.order,
        "is": step_kind(method).split(", "),
        "evaluations": method.evaluations,
        "evaluations_in": "iteration" if method.solves else "step",
        "estimate_order": method.estimate_order if method.estimate else None,
        "interpolation_order": method.interpolant.order,
        "refuses": [*method.refuses],
        "synonyms": [*method.synonyms],
        "oscillation_limit": oscillator_limit(method),
        "decay_limit": decay_limit(method),
        "equations": method.equations(),
        "reference": method.reference,
    }


def _stability_limits(method: Method) -> Iterable[str]:
    """Report how long a step may be, from the method's own stability."""
    from xdynamics.stability import decay_limit, oscillator_limit

    for limit, words in ((oscillator_limit(method), "oscillation, w*h"), (decay_limit(method), "decay, h/tau")):
        if limit == limit:  # nan where the method refuses such forces
            bound = "any" if limit == float("inf") else "none" if limit == 0 else f"up to {limit:.4g}"
            yield f"{bound} ({words})"
