"""Verbs that judge: how good runs are, and how two of them differ."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import BADLY, DONE, json_option, main, on_board, print_json, say
from xdynamics.cli.marching import read_changed_model
from xdynamics.cli.settings import (
    KEPT,
    OF_RECORDS,
    TABLES,
    clustered,
    make_evidence,
    measured_data,
    named_values,
    reading_of,
    settings,
    simulate_arguments,
)

if TYPE_CHECKING:
    import xarray as xr


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@click.option("-o", "--output", metavar="R.nc", help="Where to write the refinement.")
@click.option("--step", help="The coarsest step, like '10 ms'.")
@click.option("--rtol", help="The coarsest relative tolerance, like 1e-4, in place of a step.")
@click.option(
    "--time-tolerance",
    help="The coarsest tolerance of event times, like '1 ms'; step and rtol are then the same at all levels.",
)
@click.option(
    "--precisions",
    is_flag=True,
    help="Two levels, with numbers of 16 digits and of 31: what is between them is rounding; step or rtol is the same.",
)
@click.option("--levels", type=int, default=5, show_default=True, help="Number of levels.")
@click.option(
    "--ratio", type=float, help="Ratio from one level to the next; by default 2 for steps and 10 for tolerances."
)
@click.option("--at", "times", multiple=True, metavar="TIME", help="A time at which to compare; by default the end.")
@click.option(
    "--observable",
    "observables",
    multiple=True,
    metavar="NAME",
    help="A quantity to compare, energy_range, period_x and phase_x included; by default every state.",
)
@click.option(
    "--until-change",
    "changes",
    multiple=True,
    metavar="NAME=SIZE",
    help="Add finer levels until NAME changes by less than SIZE, like y='10 m'.",
)
@click.option("--keep", metavar="FOLDER", help="Stream the run of each level into a file in this folder.")
@click.option("--most-rows", type=float, help="The most rows that an added level may have.")
@click.option("--memory", metavar="SIZE", help="The most that a level may take in memory, like '2 GB'.")
@click.option("--defects", is_flag=True, help="Also compute the largest local error of a single step at each level.")
@click.option("--occurrences", type=int, metavar="N", help="How many occurrences of every event are compared.")
@clustered
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@json_option
@settings(excluded=("step", "rtol", "time_tolerance", *OF_RECORDS))
def refine(
    model_file: str,
    output: str | None,
    step: str | None,
    rtol: str | None,
    time_tolerance: str | None,
    precisions: bool,
    levels: int,
    ratio: float | None,
    times: tuple[str, ...],
    observables: tuple[str, ...],
    changes: tuple[str, ...],
    keep: str | None,
    most_rows: float | None,
    memory: str | None,
    defects: bool,
    occurrences: int | None,
    scheduler: str | None,
    workers: int | None,
    values: tuple[str, ...],
    **options: Any,
) -> None:
    """Run a model with ever finer steps or tolerances: orders, limits and uncertainties of its numbers."""
    from xdynamics.evidence.refining.refinement import refine as refined
    from xdynamics.evidence.refining.refinement import refinement_lines

    _check_output(output)
    model = read_changed_model(model_file, values)
    study: dict[str, Any] = {
        "at": list(times) or None,
        "observables": list(observables) or None,
        "defects": defects,
        "keep": keep,
        "most_rows": most_rows,
        "memory": memory,
        "until_change": named_values(changes, "--until-change") or None,
        "occurrences": occurrences,
    }
    if precisions:
        study |= _precision_levels(time_tolerance, options, {"step": step, "rtol": rtol})
    else:
        study |= _setting_levels(model, step, rtol, time_tolerance, levels, ratio)
    refinement = make_evidence(
        refined, model, scheduler=scheduler, workers=workers, **study, **simulate_arguments(options)
    )
    _save_and_print(refinement, refinement_lines, output)


def _precision_levels(time_tolerance: str | None, options: dict[str, Any], fixed: dict[str, Any]) -> dict[str, Any]:
    """Return the kinds of numbers as levels; there are two, and what else has levels is given once or not at all."""
    from xdynamics.faults import InputError
    from xdynamics.methods.scheme import PRECISIONS

    if time_tolerance is not None or options.get("precision") is not None:
        option_flag = "--time-tolerance" if time_tolerance is not None else "--precision"
        raise InputError(f"{option_flag} and --precisions are both given; one of them is varied")
    source = click.get_current_context().get_parameter_source
    for name in ("levels", "ratio"):
        if source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(f"--{name} and --precisions are both given; there are two precisions, each a level")
    return fixed | {"precisions": [*PRECISIONS]}


def _setting_levels(
    model: Any, step: Any, rtol: Any, time_tolerance: Any, levels: int, ratio: float | None
) -> dict[str, Any]:
    """Return the varied setting, from its coarsest value, the number of levels and their ratio."""
    from xdynamics.evidence.refining.levels import TIME_TOLERANCES, levels_from_coarsest
    from xdynamics.faults import InputError
    from xdynamics.units import time_in

    if levels < 1 or (ratio is not None and not 1.0 < ratio < float("inf")):
        raise InputError(
            f"--levels is {levels} and --ratio {ratio}; there is at least one level, and a ratio is above 1"
        )
    if time_tolerance is None:
        return levels_from_coarsest(model, step, rtol, count=levels, ratio=ratio, head="--")
    first, factor = time_in(model.time_unit, time_tolerance, "--time-tolerance"), ratio or TIME_TOLERANCES.ratio
    return {"step": step, "rtol": rtol, TIME_TOLERANCES.keyword: [first / factor**k for k in range(levels)]}


def _check_output(output: str | None) -> None:
    """Check that a target can be written, before anything is marched for it."""
    if output:
        from xdynamics.archive import check_archive
        from xdynamics.archive.store import location_of

        check_archive(location_of(output))


def _save_and_print(evidence: xr.Dataset, describe: Any, output: str | None) -> None:
    """Save evidence if an output is named, and print its findings."""
    lines = [str(evidence.attrs["title"]), *on_board(evidence), *describe(evidence)]
    archive_path = None
    if output:
        from xdynamics.archive import save

        archive_path = str(save(evidence, output))
        lines.append(f"archive   {archive_path}")
    say(lines)
    print_json(evidence, archive=archive_path)


@main.command()
@click.argument("archive", metavar="RUN.nc")
@click.option("-o", "--output", metavar="D.nc", help="Where to write the diagnosis.")
@click.option("--of", help="The coordinate whose cycles are counted; by default the first.")
@click.option(
    "--level",
    metavar="VALUE",
    help="The level whose upward crossing begins a cycle, like '0.1 m'; by default one that is passed often.",
)
@click.option(
    "--reference",
    metavar="PERIOD|RUN.nc",
    help="What phases are compared with: a period, or another run; by default a companion run at a tighter setting.",
)
@click.option("--exact", multiple=True, metavar="NAME=EXPRESSION", help="A closed form, like x='x0*cos(w*t)'.")
@click.option(
    "--lyapunov",
    is_flag=True,
    help="Find all Lyapunov exponents, each with its uncertainty, by the variational equations along the run.",
)
@click.option("--exponents", type=click.IntRange(1), metavar="N", help="Find the N largest Lyapunov exponents only.")
@click.option("--no-companion", is_flag=True, help="Do without a companion run for error estimates.")
@json_option
def diagnose(
    archive: str,
    output: str | None,
    of: str | None,
    level: str | None,
    reference: str | None,
    exact: tuple[str, ...],
    lyapunov: bool,
    exponents: int | None,
    no_companion: bool,
) -> None:
    """Report energy, momentum, cycles, phases, extremes and residuals of a run, and until when it can be believed."""
    from xdynamics.archive import open_run
    from xdynamics.evidence.diagnosing.diagnosis import diagnose as diagnosed
    from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines

    _check_output(output)
    reference_run = open_run(reference) if reference and reference.endswith(".nc") else reference
    diagnosis = diagnosed(
        open_run(archive),
        of=of,
        level=level,
        reference=reference_run,
        exact=named_values(exact, "--exact"),
        companion=not no_companion,
        lyapunov=exponents or lyapunov,
    )
    _save_and_print(diagnosis, diagnosis_lines, output)


@main.command()
@click.argument("model_file", metavar="[MODEL.toml]", required=False)
@click.option(
    "--method",
    "methods",
    multiple=True,
    metavar="NAME",
    help="A method; by default all of them, or the one in the model's [run].",
)
@click.option("--step", metavar="TIME", help="The step of a model's run, in the place of what its [run] says.")
@click.option("--until", metavar="TIME", help="Its end, likewise.")
@click.option("--rtol", metavar="NUMBER", help="Its relative tolerance, likewise, in the place of a step.")
@click.option("--occurrences", type=int, metavar="N", help="Impacts to list of a model with contacts; by default all.")
@click.option("--proven", is_flag=True, help="Also compare the model's run, with a fixed step, with proven bounds.")
@KEPT
@clustered
@click.option("-o", "--output", metavar="L.nc", help="Where to write the ledger.")
@json_option
def validate(model_file: str | None, methods: tuple[str, ...], output: str | None, **more: Any) -> None:
    """Check methods against exact cases, or a model against its own [validation.*]; exit code 1 if one fails."""
    from xdynamics.evidence.validating.ledger import validate as validated
    from xdynamics.evidence.validating.ledger_rows import FAILED, ledger_lines

    _check_output(output)
    model = read_changed_model(model_file, ()) if model_file else None
    ledger = make_evidence(validated, list(methods) or None, model, **more)
    _save_and_print(ledger, ledger_lines, output)
    sys.exit(BADLY if (ledger["verdict"] == FAILED).any() else DONE)


@main.command()
@click.argument("subject", metavar="MODEL.toml|RUN.nc")
@click.option(
    "--row",
    type=int,
    metavar="N",
    help="Of a run, the row about which; from the end if negative. By default the first.",
)
@click.option("--set", "values", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@click.option("-o", "--output", metavar="M.nc", help="Where to write the modes.")
@json_option
def modes(subject: str, row: int | None, values: tuple[str, ...], output: str | None) -> None:
    """Linearise a model about its start, or a run about one of its rows: frequencies, eigenvalues, stable steps."""
    from xdynamics.archive import open_run
    from xdynamics.evidence.modes import modes as linearised
    from xdynamics.evidence.modes import modes_lines
    from xdynamics.faults import InputError

    _check_output(output)
    if row is None:
        linearised_modes = linearised(read_changed_model(subject, values))
    elif not subject.endswith(".nc") or values:
        raise InputError(
            f"--row {row} is for an archived run{' as it is, without --set' if values else ''}; give RUN.nc"
        )
    else:
        linearised_modes = linearised(open_run(subject), row=row)
    _save_and_print(linearised_modes, modes_lines, output)


@main.command()
@click.argument("first", metavar="RUN.nc|SWEEP")
@click.argument("others", metavar="OTHER.nc…|DATA|SWEEP", nargs=-1, required=True)
@click.option(
    "--at", "times", multiple=True, metavar="TIME", help="A time at which to compare; by default every accepted step."
)
@measured_data
@click.option("-o", "--output", metavar="C.nc", help="Where to write the comparison.")
@json_option
def compare(
    first: str, others: tuple[str, ...], times: tuple[str, ...], gaps: str, output: str | None, **options: Any
) -> None:
    """Compare two runs: what differs, since when, by how much; or a run with measured data, `time [s],y [mm],u(y) [mm]`.

    Of several runs each is compared with the first, at the same times: a row a run.

    Two sweeps, of folders or files, are compared member by member: which differ by more than they are uncertain, and why.

    Data are a table, a file of an instrument, a workbook or a netCDF file: `xdynamics help files`.

    Exit code 1 if two runs are not the same, bit for bit, or two sweeps not the same.
    """
    from xdynamics.cli.looking import open_archive
    from xdynamics.evidence.comparing.comparison import compare as compared
    from xdynamics.evidence.comparing.comparison_summary import SUMMARIES
    from xdynamics.evidence.comparing.measured import is_foreign
    from xdynamics.evidence.grid_axes import is_sweep
    from xdynamics.record.flag_words import time_unit_of
    from xdynamics.units import time_in

    _check_output(output)
    run = open_archive(first)
    second = others[0]
    is_data = len(others) == 1 and (second.lower().endswith(TABLES) or is_foreign(second))
    second_record: Any = second if is_data else open_archive(second)
    if len(others) > 1:
        second_record = [open_archive(name) for name in others]
    comparison_times = [time_in(time_unit_of(run), text, "--at") for text in times] or None
    if is_sweep(run) and is_sweep(second_record):
        run, second_record = run.compute(), second_record.compute()  # the numbers of the catalogues
    table = compared(run, second_record, comparison_times, gaps=gaps, reading=reading_of(options))
    _save_and_print(table, SUMMARIES[str(table.attrs["evidence"])], output)
    sys.exit(DONE if table.attrs.get("identical", 1) else BADLY)
