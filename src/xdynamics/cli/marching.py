"""Verbs that march: run, extend, complete, and discard for the segments of unfinished runs."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import BADLY, DONE, json_option, main, print_json, progress, say
from xdynamics.cli.settings import named_values, settings, simulate_arguments

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.model import Model


@main.command()
@click.argument("model_files", metavar="MODEL.toml|RUN.nc…", nargs=-1, required=True)
@click.option(
    "-o", "--output", required=True, metavar="RUN.nc|FOLDER", help="The archive to write; of several models a folder."
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="Change a parameter or initial value; a bare number keeps its unit.",
)
@click.option("--times", metavar="TIMES", help="Write the states at these times too, like '0:20:201 s', into RUN.csv.")
@click.option("--resume", is_flag=True, help="Continue from the segments that an interrupted process left.")
@click.option("--memory", metavar="SIZE", help="The most that the log may take in memory, like '2 GB'.")
@click.option(
    "--tables",
    type=click.Choice(["below", "anywhere"]),
    default="below",
    help="Where the model may take tables from: its own folder and below (default), or anywhere.",
)
@json_option
@settings()
def run(
    model_files: tuple[str, ...],
    output: str,
    changes: tuple[str, ...],
    times: str | None,
    resume: bool,
    memory: str | None,
    tables: str,
    **options: Any,
) -> None:
    """Simulate a model file and archive the run; of an archived run its model, with the settings of that run.

    Of several models each has an archive of its name in the folder. A long run keeps its finished segments beside the
    archive until it is complete; --resume continues from them.
    """
    archives = _archives(model_files, output)
    models = {archive: read_changed_model(file, changes, tables) for file, archive in archives.items()}
    finished = [
        _march_and_archive(archive, model, times, resume, memory, simulate_arguments(options))
        for archive, model in models.items()
    ]
    sys.exit(DONE if all(finished) else BADLY)


def _archives(model_files: tuple[str, ...], output: str) -> dict[str, str]:
    """Return the archive of each model file.

    Raises
    ------
    InputError
        If two files have one name, or what several are archived in is a file, or has the name of one.
    """
    from pathlib import Path

    from xdynamics.faults import InputError

    if len(model_files) == 1:
        return {model_files[0]: output}
    if Path(output).suffix == ".nc" or Path(output).is_file():
        raise InputError(f"-o {output!r} is one archive, and there are {len(model_files)} models; give a folder")
    names = [Path(file).stem for file in model_files]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two models are called {repeated[0]!r}, and would have one archive; run them apart")
    Path(output).mkdir(exist_ok=True)
    return {file: str(Path(output) / f"{name}.nc") for file, name in zip(model_files, names, strict=True)}


def _march_and_archive(
    output: str, model: Model, times: str | None, resume: bool, memory: str | None, arguments: dict[str, Any]
) -> bool:
    """March a model into an archive, print its summary, and return whether it ended well."""
    from xdynamics.archive import check_archive
    from xdynamics.archive.store import location_of

    check_archive(location_of(output), model)  # before what marches is imported
    from xdynamics.simulation.single_run import simulate

    if times is not None:
        from xdynamics.interchange import tables
        from xdynamics.march.configuration import settings_for
        from xdynamics.simulation.unmarched_runs import check_sampled, times_within

        table = tables.check_text_target(location_of(output).with_suffix(".csv"))
        resolved = settings_for(model, **arguments)
        check_sampled(resolved)
        sample_times = times_within(times, model.time_unit, model.statement.initial["t"].si, resolved.until)
    with progress() as report:
        finished = simulate(model, **arguments, path=output, resume=resume, memory=memory, progress=report)
    if times is not None:
        from xdynamics.interchange.tables import write_states_table

        say([write_states_table(finished, sample_times, table)])
    return _print_run_summary(finished, output)


@main.command(makes=True)
@click.argument("archives", nargs=-1, required=True, metavar="RUN.nc…")
def discard(archives: tuple[str, ...]) -> None:
    """Remove the segments of runs that were not finished; archives stay."""
    from xdynamics.archive import discard as discarded

    for archive in archives:
        say([f"discarded {discarded(archive)} segments of {archive}"])


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("--until", required=True, metavar="TIME", help="The new end, like '20 s'.")
@click.option("-o", "--output", required=True, metavar="LONGER.nc", help="The archive to write.")
@click.option("--resume", is_flag=True, help="Continue from the segments that an interrupted process left.")
@json_option
def extend(archive: str, until: str, output: str, resume: bool) -> None:
    """Continue a complete run beyond its end, with the bits of a single run that also has a step end there."""
    from xdynamics.simulation.extension import extend as extended

    with progress() as report:
        longer = extended(archive, until=until, path=output, resume=resume, progress=report)
    _exit_by_outcome(longer, output)


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("-o", "--output", required=True, metavar="WHOLE.nc", help="The archive to write.")
@click.option("--keep-every", type=int, default=1, metavar="N", help="Keep only every N-th row, with all columns.")
@click.option("--resume", is_flag=True, help="Continue from the segments that an interrupted process left.")
@json_option
def complete(archive: str, output: str, keep_every: int, resume: bool) -> None:
    """Add what --log and --keep-every left out of a run, bit for bit: it is computed again and compared."""
    from xdynamics.simulation.completion import complete as completed

    with progress() as report:
        full_record = completed(archive, keep_every=keep_every, path=output, progress=report, resume=resume)
    _exit_by_outcome(full_record, output)


def _exit_by_outcome(finished: xr.Dataset, output: str) -> None:
    """Print the summary of a run, and end with the exit code of its outcome."""
    sys.exit(DONE if _print_run_summary(finished, output) else BADLY)


def _print_run_summary(finished: xr.Dataset, output: str) -> bool:
    """Print the summary of a run, and return whether it ended well."""
    from xdynamics.archive import has_segments
    from xdynamics.archive.store import location_of
    from xdynamics.documenting.summary import summary
    from xdynamics.march.outcomes import GOOD

    say([*summary(finished), f"archive   {finished.encoding['source']}"])
    print_json(finished, archive=str(finished.encoding["source"]))
    if has_segments(location_of(output)):
        say([f"segments  kept: go on with --resume, or remove them with `xdynamics discard {output}`"])
    return finished.attrs["run_outcome"] in GOOD


def read_changed_model(model_file: str, changes: tuple[str, ...], tables: str = "below") -> Model:
    """Read a model file, and apply the changes of `--set`."""
    from xdynamics.model import Model

    model = _recorded_model(model_file) if model_file.endswith(".nc") else Model.from_toml(model_file, tables=tables)
    if not changes:
        return model
    requested_changes = named_values(changes, "--set")
    changed = model.replace(**_changes_by_section(model, requested_changes))
    say(_kept_uncertainties(changed, requested_changes))
    return changed


def _kept_uncertainties(model: Model, requested_changes: Mapping[str, str]) -> Iterator[str]:
    """State for each value set without an uncertainty that the model's uncertainty still applies."""
    from xdynamics.units import unit_suffix

    for name, text in requested_changes.items():
        parameter = model.uncertain.get(model.shapes.internal_name(name))
        if parameter is not None and parameter.uncertainty and not {"±", "("} & {*text}:
            value, unit = parameter.quantity.value, unit_suffix(parameter.quantity.unit.text)
            yield (
                f"set       {name} = {value:g}{unit} keeps the uncertainty of the model, {parameter.uncertainty:g}{unit};"
                f" write '{value:g} ± 0{unit}' for none"
            )


def _recorded_model(archive: str) -> Model:
    """Return the model of an archived run, with the settings of that run."""
    from xdynamics.archive import open_run
    from xdynamics.simulation.single_run import model_of_run

    with open_run(archive) as run:
        return model_of_run(run)


def _changes_by_section(model: Any, changes: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Sort changes into sections; a bare number stays a number, so that it takes the unit there."""
    from xdynamics.faults import InputError, display_text, first_names
    from xdynamics.keywords import KEYWORDS
    from xdynamics.record.folding import elements_of, quantity_names

    settable_names, sections = (
        (*model.elements.statement.parameters, *model.elements.statement.initial),
        dict[str, dict[str, Any]](),
    )
    for name, text in model.shapes.with_internal_names(changes, "--set").items():
        section = next(
            (title for title in ("parameters", "initial") if name in getattr(model.elements.statement, title)), None
        )
        if section is None:
            if elements := elements_of(name, settable_names):
                raise InputError(f"--set {name}: {elements.removeprefix('; ')}")
            remedy = f": give {KEYWORDS[name].flag}" if name in KEYWORDS else ""
            raise InputError(
                f"--set {display_text(name)}: no such parameter or initial value{remedy}; there are {first_names(quantity_names(settable_names))}"
            )
        try:
            value: Any = float(text)
        except ValueError:
            value = text
        sections.setdefault(section, {})[name] = value
    return sections
