"""Verbs that march: run, extend, and what is done with segments of runs that were not finished."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import BADLY, DONE, main, progress, say

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.model import Model


@main.command()
@click.argument("model_file", metavar="MODEL.toml")
@click.option("-o", "--output", required=True, metavar="RUN.nc", help="The archive to write.")
@click.option("--method", help="Name of a method; see `xdynamics methods`.")
@click.option("--step", help="Step of the time grid, like '1 ms'; with a tolerance, the first step.")
@click.option("--rtol", help="Relative tolerance, like 1e-8: steps are chosen by the error test.")
@click.option(
    "--atol",
    "atols",
    multiple=True,
    metavar="[NAME=]VALUE",
    help="Absolute tolerance: 1e-9 is in every variable's own unit, y='1 um' for one; where none is given, rtol times the variable's largest value so far.",
)
@click.option("--estimator", help="embedded, step_doubling, step_doubling_extrapolated or none.")
@click.option("--switches", help="located (default) or 'stepped over': kinks and jumps inside forces.")
@click.option("--time-tolerance", help="How well events are located that do not say so, like '1 ps'.")
@click.option("--summation", help="compensated (default of symplectic methods) or plain.")
@click.option("--jacobian", help="exact (default) or differences, of `radau_iia`.")
@click.option("--min-step", help="Shortest step that control may take, like '1 ns'.")
@click.option("--max-step", help="Longest step that control may take.")
@click.option("--max-steps", help="Accepted and rejected steps after which the run ends.")
@click.option("--until", help="End, like '5 s', unless an event stops the run before.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Change a parameter or initial value; a bare number keeps its unit.",
)
@click.option(
    "--force-samples", type=click.Choice(["all", "none"]), help="Record every force evaluation (default), or none."
)
@click.option(
    "--scale",
    "scales",
    multiple=True,
    metavar="NAME=VALUE",
    help="March with a length, time or mass scale, like length='0.4 m'.",
)
@click.option("--node", "nodes", multiple=True, metavar="TIME", help="A time to land on, like '1 s'.")
@click.option("--keep-every", metavar="N", help="Record every N-th row of the grid, beside events and ends.")
@click.option("--log", metavar="COLUMNS", help="full (default), states, or variables to record, like x,total_energy.")
@click.option("--compress", is_flag=True, default=None, help="Compress the archive, without loss.")
@click.option("--json", "as_json", is_flag=True, help="For scripts: print outcome, end and events as JSON.")
@click.option("--times", metavar="TIMES", help="Write the states at these times too, like '0:20:201 s', into RUN.csv.")
@click.option("--resume", is_flag=True, help="Go on from the segments that a process left behind.")
@click.option(
    "--tables",
    type=click.Choice(["below", "anywhere"]),
    default="below",
    help="Where the model may take tables from: its own folder and below (default), or anywhere.",
)
def run(
    model_file: str,
    output: str,
    method: str | None,
    step: str | None,
    rtol: str | None,
    atols: tuple[str, ...],
    estimator: str | None,
    switches: str | None,
    time_tolerance: str | None,
    summation: str | None,
    jacobian: str | None,
    min_step: str | None,
    max_step: str | None,
    max_steps: str | None,
    until: str | None,
    changes: tuple[str, ...],
    force_samples: str | None,
    scales: tuple[str, ...],
    nodes: tuple[str, ...],
    keep_every: str | None,
    log: str | None,
    compress: bool | None,
    as_json: bool,
    times: str | None,
    resume: bool,
    tables: str,
) -> None:
    """March a model file and archive the run.

    What a long run has done is kept in segments beside the archive, until it is whole: --resume goes on from there.
    """
    model = changed_model(model_file, changes, tables)
    asked: dict[str, Any] = {"method": method, "step": step, "until": until, "rtol": rtol, "atol": absolute(atols), "estimator": estimator,
             "min_step": min_step, "max_step": max_step, "max_steps": max_steps, "force_samples": force_samples}  # fmt: skip
    from xdynamics.simulation import simulate

    asked |= {"scales": pairs(scales, "--scale") or None, "nodes": list(nodes) or None}
    asked |= {
        "summation": summation,
        "jacobian": jacobian,
        "switches": switches,
        "time_tolerance": time_tolerance,
        "keep_every": keep_every,
        "log": columns(log),
        "compress": compress,
    }
    if times is not None:
        from xdynamics.march.asking import settings_for
        from xdynamics.simulation import check_sampled, times_within
        from xdynamics.tabling import check_target

        table = check_target(Path(output).with_suffix(".csv"))
        settings = settings_for(model, **asked)
        check_sampled(settings)
        wanted = times_within(times, model.time_unit, model.initial["t"].si, settings.until)
    with progress() as told:
        finished = simulate(model, **asked, path=output, resume=resume, progress=told)
    if times is not None:
        from xdynamics.tabling import tabled

        written = tabled(finished, wanted, table)
        if not as_json:
            say([written])
    _close(finished, output, as_json=as_json)


@main.command(makes=True)
@click.argument("archives", nargs=-1, required=True, metavar="RUN.nc…")
def discard(archives: tuple[str, ...]) -> None:
    """Remove the segments of runs that were not finished; archives stay."""
    from xdynamics.archive import discard as discarded

    for archive in archives:
        say([f"discarded {discarded(archive)} segments of {archive}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("--until", required=True, help="The new end, like '20 s'.")
@click.option("-o", "--output", required=True, metavar="LONGER.nc", help="The archive to write.")
@click.option("--resume", is_flag=True, help="Go on from the segments that a process left behind.")
def extend(archive: str, until: str, output: str, resume: bool) -> None:
    """Go on behind the end of a complete run, as if it had been asked for more at once."""
    from xdynamics.extension import extend as extended

    with progress() as told:
        longer = extended(archive, until=until, path=output, resume=resume, progress=told)
    _close(longer, output)


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("-o", "--output", required=True, metavar="WHOLE.nc", help="The archive to write.")
@click.option("--keep-every", type=int, default=1, metavar="N", help="Every N-th row alone, of all columns.")
@click.option("--resume", is_flag=True, help="Go on from the segments that a process left behind.")
def complete(archive: str, output: str, keep_every: int, resume: bool) -> None:
    """Add what --log and --keep-every left out of a run, to the bits: it is marched again and compared."""
    from xdynamics.completion import complete as completed

    with progress() as told:
        whole = completed(archive, keep_every=keep_every, path=output, progress=told, resume=resume)
    _close(whole, output)


def _close(finished: xr.Dataset, output: str, *, as_json: bool = False) -> None:
    """Say what became of a run, and end with the exit code of its outcome."""
    from xdynamics.archive import has_segments
    from xdynamics.march.outcomes import GOOD
    from xdynamics.summary import as_data, summary

    if as_json:
        click.echo(json.dumps(as_data(finished) | {"archive": str(finished.encoding["source"])}))
    else:
        say([*summary(finished), f"archive   {finished.encoding['source']}"])
    if has_segments(Path(output)) and not as_json:
        say([f"segments  kept: go on with --resume, or remove them with `xdynamics discard {output}`"])
    sys.exit(DONE if finished.attrs["run_outcome"] in GOOD else BADLY)


def changed_model(model_file: str, changes: tuple[str, ...], tables: str = "below") -> Model:
    """Read a model file, and change what `--set` says."""
    from xdynamics.model import Model

    model = Model.from_toml(model_file, tables=tables)
    return model.replace(**_changed(model, pairs(changes, "--set"))) if changes else model


def pairs(texts: tuple[str, ...], option: str) -> dict[str, str]:
    """Read what an option says of several names."""
    from xdynamics.faults import InputError

    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {text!r} needs NAME=VALUE")
        if name.strip() in found:
            raise InputError(f"{option} sets {name.strip()!r} twice")
        found[name.strip()] = value.strip()
    return found


def columns(text: str | None) -> str | list[str] | None:
    """Read which columns are to be recorded: a word for many, or their names."""
    return text if text in (None, "full", "states") else [one.strip() for one in str(text).split(",")]


def asked_of(settings: Mapping[str, Any], atols: tuple[str, ...]) -> dict[str, Any]:
    """Return the settings that were given on the command line."""
    given: dict[str, Any] = {name: one for name, one in settings.items() if one is not None}
    return given | ({"atol": absolute(atols)} if atols else {})


def absolute(texts: tuple[str, ...]) -> dict[str, Any] | None:
    """Sort absolute tolerances: a bare number is for every variable that has none of its own."""
    from xdynamics.faults import InputError

    bare = [one for one in texts if "=" not in one]
    if len(bare) > 1:
        raise InputError(f"--atol is given {len(bare)} times without a name: {', '.join(bare)}")
    named: dict[str, Any] = dict(pairs(tuple(one for one in texts if "=" in one), "--atol"))
    for text in bare:
        try:
            named[""] = float(text)
        except ValueError:
            raise InputError(f"--atol {text!r} needs a number, in every variable's own unit, or NAME=VALUE") from None
    return named or None


def _changed(model: Any, given: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Sort changes into sections; a bare number goes as a number, so that it keeps the unit there."""
    from xdynamics.faults import InputError

    sections: dict[str, dict[str, Any]] = {}
    for name, text in given.items():
        section = "parameters" if name in model.parameters else "initial" if name in model.initial else None
        if section is None:
            raise InputError(
                f"--set {name}: no such parameter or initial value; there are {', '.join([*model.parameters, *model.initial])}"
            )
        try:
            value: Any = float(text)
        except ValueError:
            value = text
        sections.setdefault(section, {})[name] = value
    return sections
