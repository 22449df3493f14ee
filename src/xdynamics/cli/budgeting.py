"""Verbs of defended numbers: budget, certify, bundle, report, recheck, fit."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import click

from xdynamics.cli.command import BADLY, DONE, json_option, main, print_json, say
from xdynamics.cli.marching import read_changed_model
from xdynamics.cli.settings import (
    KEPT,
    OF_RECORDS,
    clustered,
    make_evidence,
    measured_data,
    other_options,
    reading_of,
    settings,
    simulate_arguments,
)
from xdynamics.cli.sweeping import value_ranges
from xdynamics.keywords import KEYWORDS

OF_A_NUMBER = (
    click.option(
        "--quantity",
        required=True,
        metavar="NAME",
        help=(
            "Which number: a coordinate, velocity, state, energy or observable; t at an event (its time); maximum_… or"
            " minimum_… over the whole run, of one of these or of a force."
        ),
    ),
    click.option("--at", metavar="TIME", help="The time at which the number is wanted."),
    click.option("--event", metavar="NAME", help="The event at which the number is wanted, instead of a time."),
    click.option("--occurrence", type=int, default=1, show_default=True, help="Which occurrence of the event."),
    click.option(
        "--side",
        type=click.Choice(["before", "after"]),
        default="before",
        show_default=True,
        help="State before or after the event.",
    ),
    click.option("--seed", type=int, default=0, show_default=True, help="Seed of all random draws."),
    click.option(
        "--coverage", type=float, default=0.95, show_default=True, help="Coverage probability of the intervals."
    ),
    click.option(
        "--inadequate-fit", is_flag=True, help="Take a fitted model even if its residuals are more than noise."
    ),
    click.option("--proven", is_flag=True, help="Also prove bounds of the number, as `enclose` does."),
    click.option("--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value."),
    KEPT,
    clustered,
    json_option,
    settings(excluded=OF_RECORDS),
)


def of_a_number(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of one number and of the run that it is of."""
    for option in reversed(OF_A_NUMBER):
        command = option(command)
    return command


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@of_a_number
@click.option("--draws", type=int, default=0, show_default=True, help="Draws of the Monte Carlo check.")
@click.option(
    "--until-uncertainty", metavar="SIZE", help="Draw until the intervals are known this well, like '10 m at 95 %'."
)
@click.option("--only", multiple=True, metavar="TERM", help="Compute this term alone, like truncation or an input.")
@click.option("--without", multiple=True, metavar="TERM", help="Leave this term out, like roundoff or an input.")
@click.option("-o", "--output", metavar="B.nc", help="Where to write the budget.")
def budget(model_file: str, output: str | None, changes: tuple[str, ...], **options: Any) -> None:
    """Estimate how far one number may be off, and why: by the integration, and by every uncertain input."""
    from xdynamics.budgeting.budget import error_budget

    options |= {name: options[name] or None for name in ("only", "without")}
    _make_and_save(error_budget, model_file, changes, output, **_of_number_and_march(options))
    if output:
        say([f"budget    {output}"])
    sys.exit(DONE)


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@of_a_number
@click.option("--draws", type=int, default=10_000, show_default=True, help="Draws of the Monte Carlo check.")
@click.option("-o", "--output", required=True, metavar="C.nc", help="Where to write the certificate.")
def certify(model_file: str, output: str, changes: tuple[str, ...], **options: Any) -> None:
    """Certify one number with all that defends it: budget, convergence, ledger, gates."""
    from xdynamics.budgeting.certificate import certify as certified

    certificate = _make_and_save(certified, model_file, changes, output, **_of_number_and_march(options))
    say([f"kept      {output}"])
    sys.exit(DONE if not int(certificate["gate_verdict"].values.max()) else BADLY)


@main.command()
@click.argument("certificate", metavar="C.nc")
@click.option(
    "-o", "--output", required=True, metavar="FOLDER", help="The folder to write; it must be empty or not exist."
)
def bundle(certificate: str, output: str) -> None:
    """Write a certificate into a folder with its model, run, ledger, figures and scripts; one line remakes it."""
    from xdynamics.documenting.bundling import bundle as bundled

    say([f"bundle    {bundled(output, certificate)}"])


@main.command()
@click.argument("folder", metavar="FOLDER")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="REPORT.html|.md",
    help="The report to write: one file, figures and formulas included.",
)
def report(folder: str, output: str) -> None:
    """Write the report of a bundle: the number, its model in formulas, convergence, budget, events, ledger, how to remake it."""
    from xdynamics.documenting.document import document

    say([f"report    {document(folder, output)}"])


@main.command()
@click.argument("certificate", metavar="C.nc|FOLDER")
@json_option
def recheck(certificate: str) -> None:
    """Make a certificate again from its file or bundle alone and compare every number; exit code 1 if one differs."""
    from xdynamics.documenting.bundling import recheck as made_again

    result = made_again(certificate)
    say([f"the same  {certificate}: {result.attrs['of']} = {result.attrs['result']}"])
    print_json(result)


def _of_number_and_march(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of one number as they stand, and those of the march as `simulate` takes them."""
    settings = {name: value for name, value in options.items() if name in KEYWORDS}
    return {name: value for name, value in options.items() if name not in settings} | simulate_arguments(settings)


def _make_and_save(
    make: Callable[..., Any],
    model_file: str,
    changes: tuple[str, ...],
    output: str | None,
    quantity: str,
    **arguments: Any,
) -> Any:
    """Compute evidence of one number, print its summary, and save it."""
    from xdynamics import archive
    from xdynamics.archive.store import location_of
    from xdynamics.documenting.summary import summary

    model = read_changed_model(model_file, changes)
    if output:
        archive.check_archive(location_of(output))
    evidence = make_evidence(make, model, quantity, **arguments)
    if output:
        archive.save(evidence, output)
    say(summary(evidence))
    print_json(evidence, archive=output)
    return evidence


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@click.argument("data", metavar="DATA...", nargs=-1, required=True)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="A parameter or initial value to fit; all records share it.",
)
@click.option("--own", multiple=True, metavar="NAME", help="One that each of several records has for itself.")
@click.option(
    "--loss",
    type=click.Choice(["linear", "soft_l1", "huber", "cauchy"]),
    default="linear",
    show_default=True,
    help="What a residual counts; all but linear are robust against outliers.",
)
@click.option(
    "--intervals",
    type=click.Choice(["covariance", "profile"]),
    default="covariance",
    show_default=True,
    help="How intervals are made; profile follows laws that are not linear.",
)
@click.option("--coverage", type=float, default=0.95, show_default=True, help="Coverage probability of the intervals.")
@click.option("--bounds", multiple=True, metavar="NAME=LOW:HIGH", help="Bounds of a parameter, like k='0:10 N m-1'.")
@click.option("-o", "--output", metavar="F.nc", help="Where to write the fit.")
@click.option(
    "--starts",
    type=int,
    default=8,
    show_default=True,
    help="The most searches; the first whose residuals are no more than noise is the last.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of randomly drawn starting points.")
@measured_data
@click.option("--model", "fitted", metavar="FITTED.toml", help="Where to write the fitted model, with uncertainties.")
@click.option("--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@json_option
@settings(excluded=OF_RECORDS)
def fit(
    model_file: str,
    data: tuple[str, ...],
    parameters: tuple[str, ...],
    bounds: tuple[str, ...],
    output: str | None,
    fitted: str | None,
    changes: tuple[str, ...],
    **options: Any,
) -> None:
    """Find parameters from measured data, with their uncertainties.

    Several files are several records, fitted at once. Columns are quantities of the model along a time, or times of events,
    event_time_floor [s], a row for each occurrence. Exit code 1 where the search did not come to an end, or the residuals are more than noise.
    """
    from xdynamics import archive
    from xdynamics.archive.folder_store import taking_name
    from xdynamics.archive.store import location_of
    from xdynamics.budgeting.fitting import fit as fitted_to
    from xdynamics.documenting.summary import summary

    model = read_changed_model(model_file, changes)
    if output:
        archive.check_archive(location_of(output))
    if fitted:
        archive.check_target(location_of(fitted))
    choices = {name: options.pop(name) for name in ("own", "loss", "intervals", "coverage", "gaps", "starts", "seed")}
    result = fitted_to(
        model,
        data[0] if len(data) == 1 else list(data),
        parameters,
        bounds=value_ranges(bounds, "--bounds"),
        reading=reading_of(options),
        **choices,
        **simulate_arguments(other_options(options)),
    )
    if output:
        archive.save(result, output)
    models = _fitted_files(fitted, result) if fitted else {}
    for path, text in models.items():
        with taking_name(location_of(path)) as new:
            new.part.write_text(text)
    say([*summary(result), *(f"model     {path}" for path in models), *[f"fit       {output}"] * bool(output)])
    print_json(result, archive=output, model=fitted)
    sys.exit(DONE if int(result.attrs["adequate"]) else BADLY)


def _fitted_files(path: str, result: Any) -> dict[str, str]:
    """Return the texts of fitted models by their files: one, or one for each record that has numbers of its own."""
    texts = result["model_toml"].values
    if "record_name" not in result.variables:
        return {path: texts.item()}
    stem, ending = path.removesuffix(".toml"), ".toml" if path.endswith(".toml") else ""
    return {
        f"{stem}_{record}{ending}": str(text) for record, text in zip(result["record_name"].values, texts, strict=True)
    }
