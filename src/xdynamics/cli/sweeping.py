"""The verb of grids: sweep."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from xdynamics.cli.command import BADLY, DONE, json_option, main, print_json, say
from xdynamics.cli.marching import read_changed_model
from xdynamics.cli.settings import clustered, goes_on, named_values, names_in, settings, simulate_arguments
from xdynamics.faults import InputError


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FOLDER",
    help="The folder of the sweep; members that are there already are not computed again.",
)
@click.option(
    "--axis",
    "axes",
    multiple=True,
    metavar="NAME=VALUES",
    help="What varies: c='0:2e-3:41 kg m-1' (first:last:count), m='1, 2, 5 kg', method=heun,dop853, thrust=motors.csv.",
)
@click.option(
    "--together", "groups", multiple=True, metavar="NAME=A,B", help="Axes that vary together along one dimension."
)
@click.option(
    "--draw",
    "ranges",
    multiple=True,
    metavar="NAME=LOW:HIGH",
    help="What is drawn, like m='1:2 kg'; only its name with --design declared.",
)
@click.option("--draws", type=int, help="Number of draws; a power of two for Sobol points.")
@click.option(
    "--design",
    default="sobol",
    show_default=True,
    help="sobol, latin_hypercube, or declared (the distributions in the model).",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the draws.")
@click.option(
    "--keep",
    "kept",
    multiple=True,
    metavar="WORD",
    help=(
        "What is kept of each member: end (default), event_time_NAME, event_count_NAME, maximum_NAME, NAME at the times"
        " of --at, log, …"
    ),
)
@click.option("--at", "times", multiple=True, metavar="TIME", help="A time at which states are kept.")
@click.option(
    "--occurrences", type=int, default=1, show_default=True, help="How many occurrences of every event are kept."
)
@click.option(
    "--check",
    type=float,
    default=0.0,
    help="Fraction of the members that are also computed alone and compared bit for bit.",
)
@clustered
@click.option("--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@json_option
@settings()
def sweep(
    model_file: str,
    output: str,
    axes: tuple[str, ...],
    groups: tuple[str, ...],
    ranges: tuple[str, ...],
    draws: int | None,
    design: str,
    seed: int,
    kept: tuple[str, ...],
    times: tuple[str, ...],
    occurrences: int,
    check: float,
    scheduler: str | None,
    workers: int | None,
    changes: tuple[str, ...],
    **options: Any,
) -> None:
    """Run a model over a grid of parameters, initial values, methods or steps; every member is kept with its outcome."""
    from xdynamics.documenting.summary import summary
    from xdynamics.evidence.cluster import cluster_of
    from xdynamics.march.outcomes import GOOD
    from xdynamics.sweeping.sweep import sweep as swept

    model = read_changed_model(model_file, changes)
    grid = _group_axes(named_values(axes, "--axis"), named_values(groups, "--together"))
    _check_varied(grid, ranges, changes)
    if ranges or draws is not None:
        grid["draw"] = _draws_from_options(ranges, draws, design, seed)
    words = [word for text in kept for word in names_in(text) if word] or ["end"]
    with cluster_of(scheduler, workers), _task_counter() as report:
        try:
            result = swept(
                model,
                grid,
                keep=words,
                times=list(times) or None,
                occurrences=occurrences,
                path=output,
                check=check,
                progress=report,
                **simulate_arguments(options),
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(goes_on(output)) from None
    say([*summary(result), f"sweep     {output}"])
    print_json(result, archive=output)
    sys.exit(DONE if {*map(str, result["run_outcome"].values.ravel().tolist())} <= GOOD else BADLY)


def _check_varied(grid: Mapping[str, Any], ranges: tuple[str, ...], changes: tuple[str, ...]) -> None:
    """Refuse a sweep in which nothing varies, or one quantity is both set and varied."""
    if not grid and not ranges:
        raise InputError("nothing varies; give --axis NAME=VALUES, like --axis 'c=0:2e-3:41 kg m-1', or --draw")
    repeated = [text.partition("=")[0] for text in changes if text.partition("=")[0] in grid]
    if repeated:
        raise InputError(f"--set {repeated[0]} and --axis {repeated[0]} contradict each other; give one")


def _group_axes(axes: dict[str, str], groups: dict[str, str]) -> dict[str, Any]:
    """Combine axes that vary together into one."""
    grouped: dict[str, Any] = dict(axes)
    for name, members in groups.items():
        names = names_in(members)
        missing = [axis for axis in names if axis not in grouped]
        if missing:
            raise InputError(f"--together {name} names {missing[0]!r}, for which there is no --axis")
        grouped[name] = {axis: grouped.pop(axis) for axis in names}
    return grouped


def _draws_from_options(ranges: tuple[str, ...], draws: int | None, design: str, seed: int) -> Any:
    from xdynamics.sweeping.axes import DECLARED, Draws

    if draws is None or not ranges:
        raise InputError("--draw NAME=LOW:HIGH and --draws N go together")
    if design == DECLARED:
        return Draws(draws, [text.partition("=")[0] for text in ranges], design=design, seed=seed)
    return Draws(draws, value_ranges(ranges, "--draw"), design=design, seed=seed)


def value_ranges(ranges: tuple[str, ...], option: str) -> dict[str, tuple[str, str]]:
    """Read the lowest and the highest value of several names.

    Raises
    ------
    InputError
        If a text is not NAME=LOW:HIGH, or repeats a name.
    """
    ends = {}
    for name, text in named_values(ranges, option).items():
        low, colon, high_with_unit = text.partition(":")
        high, _, unit = high_with_unit.strip().partition(" ")
        if not colon:
            raise InputError(f"{option} {name}={text!r} needs LOW:HIGH, like '1:2 kg'")
        ends[name] = (f"{low.strip()} {unit}".strip(), f"{high} {unit}".strip())
    return ends


@contextmanager
def _task_counter() -> Iterator[Callable[[float, float, int], None]]:
    """Show a line on the terminal that counts finished tasks."""
    started = time.monotonic()

    def show_count(done: float, _: float, tasks: int) -> None:
        if sys.stderr.isatty():
            remaining = f", {(time.monotonic() - started) * (1.0 - done) / done:.0f} s to go" if done else ""
            click.echo(f"\r\033[K{done:4.0%}  {tasks} tasks done{remaining}", nl=False, err=True)

    yield show_count
    if sys.stderr.isatty():
        click.echo("\r\033[K", nl=False, err=True)
