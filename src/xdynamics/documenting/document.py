"""The report of a bundle: a number, its model in formulas, convergence, budget, events, ledger, reproduction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xdynamics import archive
from xdynamics.archive.folder_store import check_target, store_of, taking_name
from xdynamics.archive.store import Given, Place, location_of, resolve_links
from xdynamics.budgeting.budget_summary import contribution_text, drawn_doubt, terms_by_share
from xdynamics.budgeting.certificate import gate_reasons
from xdynamics.documenting import carried_wheel, equations
from xdynamics.documenting.bundling import CERTIFICATE, LEDGER, MODEL, RUN, check_files, remaking_command
from xdynamics.documenting.equations import CodeBlock, PageSection, Paragraph, PictureBlock, TextTable, model_blocks
from xdynamics.evidence.evidence_dataset import FAILED, GATES, NOT_CHECKED, stated_value
from xdynamics.evidence.refining.convergence import verdict_text
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.record.flag_words import in_prose, time_unit_of, words_of_flag
from xdynamics.schema import SCALED_RESIDUAL
from xdynamics.units import unit_suffix
from xdynamics.units.digits import digits, known_to

if TYPE_CHECKING:
    import xarray as xr

FORMATS = {
    ".html": equations.html_document,
    ".htm": equations.html_document,
    ".md": equations.markdown_document,
}
MOST_EVENTS = 30
MOST_BYTES = 50_000_000  # of a figure


def document(folder: Given, path: Given) -> Place:
    """Write the report of a bundle as one file, with figures and formulas embedded.

    Parameters
    ----------
    folder : str or Path
        Made by `bundle`.
    path : str or Path
        HTML or Markdown by its ending.

    Returns
    -------
    Path, or name of an object

    Raises
    ------
    InputError
        If the folder is no bundle, or the file's ending is unknown.
    ArchiveError
        If an archive in it is damaged.
    """
    bundle, path = location_of(folder), location_of(path)
    store = store_of(bundle)
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"report '{path}' has the ending '{path.suffix}'; there are {', '.join(FORMATS)}")
    check_files(bundle)
    if missing_files := [name for name in (CERTIFICATE, RUN, LEDGER, MODEL) if store.kind(bundle / name) is not None]:
        raise InputError(
            f"'{bundle}' is no bundle: there is no {missing_files[0]} in it; `bundle` makes one of a certificate"
        )
    check_target(path)
    with (
        archive.open_run(bundle / CERTIFICATE) as certificate,
        archive.open_run(bundle / RUN) as run,
        archive.open_run(bundle / LEDGER) as ledger,
    ):
        model = Model.from_record(certificate["model_toml"].values.item())
        sections = [
            _gates_section(certificate),
            _budget_section(certificate, _picture(bundle / CERTIFICATE)),
            _run_section(run, _picture(bundle / RUN)),
            _convergence_section(certificate),
            PageSection("The model", list(model_blocks(model))),
            _method_section(run),
            _ledger_section(ledger),
            _reproduction_section(certificate, bundle),
            _equations_section(run),
        ]
        title = str(certificate.attrs["title"]).removeprefix("certificate of ")
        text = FORMATS[path.suffix.lower()](
            title, f"{certificate.attrs['of']} = {stated_value(certificate, 'result')}", sections
        )
    with taking_name(path) as temporary:
        temporary.part.write_text(text, encoding="utf-8")
    return path


def _picture(archived: Place) -> bytes:
    """Return the figure of an archive in a bundle."""
    picture = archived.with_suffix(".png")
    return store_of(picture).content(picture, MOST_BYTES)


def _gates_section(certificate: xr.Dataset) -> PageSection:
    """The gates that the number has to pass."""
    verdicts = [GATES[code] for code in certificate["gate_verdict"].values.tolist()]
    rows = [
        [str(name).replace("_", " "), in_prose(verdict), str(reason)]
        for name, verdict, reason in zip(
            certificate["gate_name"].values, verdicts, gate_reasons(certificate), strict=True
        )
    ]
    failed_count, unchecked_count = verdicts.count(FAILED), verdicts.count(NOT_CHECKED)
    statement = f"It fails {failed_count} of {len(verdicts)} gates." if failed_count else "It passes every gate."
    if unchecked_count:
        statement = (
            f"{statement if failed_count else 'It fails none.'} {'One is' if unchecked_count == 1 else f'{unchecked_count} are'} not decided:"
            " the table says what would decide."
        )
    return PageSection(
        "What it has to pass", [Paragraph(statement), TextTable(["gate", "verdict", "what was looked at"], rows)]
    )


def _method_section(run: xr.Dataset) -> PageSection:
    attributes = run.attrs
    control = (
        f"step {float(attributes['solver_step']):g}{unit_suffix(time_unit_of(run))}"
        if "solver_step" in attributes
        else (
            f"rtol {float(attributes['solver_rtol']):g}"
            if "solver_rtol" in attributes
            else str(attributes["solver_step_control"])
        )
    )
    counts = (
        f"{attributes['run_accepted_steps']} accepted steps, {attributes['run_rejected_trials']} rejected trials,"
        f" {attributes['run_force_evaluations']} force evaluations"
    )
    return PageSection(
        "The method",
        [
            Paragraph(f"of order {attributes['solver_order']}, {control}: {counts}.", str(attributes["solver_method"])),
            Paragraph(f"Outcome: {attributes['run_outcome_text']}."),
        ],
    )


def _equations_section(run: xr.Dataset) -> PageSection:
    """The update with its coefficients, which few read and nobody should have to pass."""
    attributes = run.attrs
    return PageSection(
        "The method's equations",
        [
            Paragraph(f"{attributes['solver_update_order']}.", str(attributes["solver_method"])),
            CodeBlock("\n".join(str(attributes["solver_update_equations"]).split("; "))),
            Paragraph(f"After {attributes['solver_reference']}."),
        ],
    )


def _convergence_section(certificate: xr.Dataset) -> PageSection:
    varied = "step_size" if "step_size" in certificate else "rtol"
    units = str(certificate["value"].attrs["units"])
    values, orders = certificate["level_value"].values, certificate["observed_order"].values
    changes = np.append(np.diff(values), np.nan)
    finest = float(np.abs(changes[:-1]).min(initial=np.inf))  # values are told apart by as much as they differ
    rows = [
        [f"{size:.6g}", _level_value_text(value, finest), _finite_number_text(change), _finite_number_text(order)]
        for size, value, change, order in zip(
            certificate[varied].values.tolist(), values.tolist(), changes.tolist(), orders.tolist(), strict=True
        )
    ]
    verdict = verdict_text(words_of_flag(certificate["level_verdict"])[0])
    unit_suffix = "" if certificate[varied].attrs["units"] == "1" else f" ({certificate[varied].attrs['units']})"
    header = [
        f"{varied.replace('_', ' ')}{unit_suffix}",
        f"{certificate.attrs['of']} ({units})",
        f"to the next level ({units})",
        "observed order",
    ]
    return PageSection(
        "Convergence",
        [Paragraph(f"The first row is the run's own. Together they are {verdict}."), TextTable(header, rows)],
    )


def _total_rows(certificate: xr.Dataset) -> list[list[str]]:
    """Return the totals of all terms, and the results of draws."""
    unit = unit_suffix(str(certificate["value"].attrs["units"]))
    together = {
        "numerical, sum of bounds": "numerical_bound",
        "numerical, root of squares": "numerical_rss",
        "physical, root of squares": "physical_rss",
        "together": "total_rss",
    }
    sizes = {words: float(certificate[name]) for words, name in together.items()}
    totals = [[words, f"{contribution_text(size)}{unit if size < np.inf else ''}"] for words, size in sizes.items()]
    if "monte_carlo_shortest" in certificate:
        coverage = f"{float(certificate.attrs['coverage']):.0%}"
        for name in ("shortest", "symmetric"):
            low, high = certificate[f"monte_carlo_{name}"].values.tolist()
            doubt = float(certificate["monte_carlo_end_doubt"])
            ends = f"{known_to(low, doubt)} to {known_to(high, doubt)}{unit}, its ends ± {doubt:.1g}{unit}"
            totals.append([f"{name} {coverage} interval of {certificate.attrs['draws']} draws", ends])
        standard, doubt = (float(certificate[f"monte_carlo_standard_uncertainty{suffix}"]) for suffix in ("", "_doubt"))
        totals.append(["standard uncertainty of the draws", f"{contribution_text(standard, doubt)}{unit}"])
        totals.append(["the linear budget", words_of_flag(certificate["linear_verdict"])[0].replace("_", " ")])
    return totals


def _budget_section(certificate: xr.Dataset, picture: bytes) -> PageSection:
    unit, kinds = unit_suffix(str(certificate["value"].attrs["units"])), words_of_flag(certificate["term_kind"])
    behind = f" ({unit.strip()})" if unit else ""
    rows = [
        [
            str(certificate["term_name"].values[i]),
            kinds[i],
            _value_with_unit(certificate, "sensitivity", "sensitivity_units", i),
            _value_with_unit(certificate, "input_uncertainty", "input_units", i),
            contribution_text(float(certificate["standard_uncertainty"][i]), drawn_doubt(certificate, i)),
            contribution_text(float(certificate["bound"].values[i])),
            contribution_text(np.inf) if np.isnan(certificate["share"][i]) else f"{float(certificate['share'][i]):.1%}",
            str(certificate["term_rule"].values[i]),
        ]
        for i in terms_by_share(certificate)
    ]
    header = [
        "term",
        "kind",
        "sensitivity",
        "uncertainty of the input",
        f"contributes{behind}",
        f"at most{behind}",
        "share",
        "how it was found",
    ]
    return PageSection(
        "The budget",
        [
            TextTable(header, rows),
            TextTable(["total", ""], _total_rows(certificate)),
            PictureBlock(picture, "Terms of the budget, and intervals where they were drawn"),
        ],
    )


def _run_section(run: xr.Dataset, picture: bytes) -> PageSection:
    rows = []
    unit_suffix = f" ({time_unit_of(run).text})".replace(" (1)", "")
    if run.sizes.get("event", 0):
        names, kinds = words_of_flag(run["event_detector"]), words_of_flag(run["event_kind"])
        times, doubts = run["event_time"].values.tolist(), run["event_time_uncertainty"].values.tolist()
        rows = [
            [name, kind.replace("_", " "), f"{time:.{digits(time, uncertainty=doubt)}g}", f"{doubt:.2g}"]
            for name, kind, time, doubt in zip(names, kinds, times, doubts, strict=True)
        ]
    further_note = (
        [Paragraph(f"{len(rows) - MOST_EVENTS} further events are in {RUN}.")] if len(rows) > MOST_EVENTS else []
    )
    events = (
        [TextTable(["event", "kind", f"time{unit_suffix}", f"located within{unit_suffix}"], rows[:MOST_EVENTS])]
        if rows
        else []
    )
    return PageSection("The run", [PictureBlock(picture, str(run.attrs["title"])), *events, *further_note])


def _ledger_section(ledger: xr.Dataset) -> PageSection:
    verdicts, units = words_of_flag(ledger["verdict"]), ledger["case_units"].values
    # ledgers of older versions have none
    over_scale = ledger.get(SCALED_RESIDUAL, ledger["residual"] * np.nan).values
    rows = [
        [
            str(name),
            verdict,
            f"{_finite_number_text(float(residual))}{unit_suffix(str(unit))}",
            _finite_number_text(float(scaled)),
            f"{_finite_number_text(float(bound))}{unit_suffix(str(unit))}",
            str(relation),
        ]
        for name, verdict, residual, scaled, bound, unit, relation in zip(
            ledger["case_name"].values,
            verdicts,
            ledger["residual"].values,
            over_scale,
            ledger["bound"].values,
            units,
            ledger["case_relation"].values,
            strict=True,
        )
        if verdict != "refused"
    ]
    summary = (
        f"The method beside closed forms: {verdicts.count('passed')} passed, {verdicts.count('failed')} failed,"
        f" {verdicts.count('refused')} refused."
    )
    return PageSection(
        "The method's ledger",
        [
            Paragraph(summary),
            TextTable(["case", "verdict", "residual", "residual over scale", "bound", "closed form"], rows),
        ],
    )


def _reproduction_section(certificate: xr.Dataset, bundle: Place) -> PageSection:
    name = resolve_links(bundle).name
    wheels = [entry.name for entry in store_of(bundle).names(bundle) if carried_wheel.is_wheel(entry.name)]
    version = certificate.attrs.get("xdynamics_version", "")
    command = remaking_command(name, wheels[0]) if wheels else f"xdynamics recheck {name} # by xdynamics {version}"
    digests = [
        ["model", str(certificate.attrs["model_digest"])],
        *([f"run, level {k + 1}", str(digest)] for k, digest in enumerate(certificate["run_digest"].values)),
    ]
    return PageSection(
        "Made again",
        [
            Paragraph("Every number of it, compared one by one, from the bundle alone:"),
            CodeBlock(command),
            TextTable(["sha256 of the content", ""], digests),
        ],
    )


def _value_with_unit(certificate: xr.Dataset, name: str, units: str, i: int) -> str:
    value, unit = float(certificate[name][i]), str(certificate[units].values[i])
    return "" if not np.isfinite(value) else f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


def _level_value_text(value: float, change: float) -> str:
    """Write a level's value with two digits of the smallest change between levels."""
    return f"{value:.{digits(value, spacing=change / 10.0)}g}"


def _finite_number_text(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""
