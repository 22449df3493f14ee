"""The report of a bundle: a number, its model in formulas, convergence, budget, events, ledger, how to make it again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xdynamics import archive
from xdynamics.archive.target import check_target, taking_name
from xdynamics.budgeting.certificate import FAILED, GATES, NOT_CHECKED
from xdynamics.budgeting.told import doubt_of, known_to, with_doubt
from xdynamics.bundling import CERTIFICATE, LEDGER, MODEL, RUN, check_files
from xdynamics.documenting import blocks
from xdynamics.documenting.blocks import Code, Picture, Section, Table, Words
from xdynamics.documenting.equations import of_model
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.record.words import time_unit, words_of
from xdynamics.schema import SCALED_RESIDUAL
from xdynamics.units import behind

if TYPE_CHECKING:
    import xarray as xr

FORMATS = {".html": blocks.html, ".htm": blocks.html, ".md": blocks.markdown}
MOST_EVENTS = 30


def document(folder: str | Path, path: str | Path) -> Path:
    """Write the report of a bundle as one file, figures and formulas in it.

    Parameters
    ----------
    folder : str or Path
        What `bundle` made.
    path : str or Path
        HTML or Markdown by its ending.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If it is no bundle, or the ending is another.
    ArchiveError
        If an archive in it is damaged.
    """
    folder, path = Path(folder), Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"report '{path}' has the ending '{path.suffix}'; there are {', '.join(FORMATS)}")
    if folder.is_dir():
        check_files(folder)
    if missing := [name for name in (CERTIFICATE, RUN, LEDGER, MODEL) if not (folder / name).is_file()]:
        raise InputError(
            f"'{folder}' is no bundle: there is no {missing[0]} in it; `bundle` makes one of a certificate"
        )
    check_target(path)
    with archive.open_run(folder / CERTIFICATE) as found, archive.open_run(folder / RUN) as run, archive.open_run(folder / LEDGER) as ledger:  # fmt: skip
        model = Model.from_text(str(found["model_toml"].values))
        sections = [
            _result(found), Section("The model", list(of_model(model))), _method(run), _convergence(found),
            _budget(found, (folder / CERTIFICATE).with_suffix(".png").read_bytes()),
            _run(run, (folder / RUN).with_suffix(".png").read_bytes()), _ledger(ledger), _again(found, folder),
        ]  # fmt: skip
        title = str(found.attrs["title"]).removeprefix("certificate of ")
        text = FORMATS[path.suffix.lower()](title, f"{found.attrs['of']} = {found.attrs['result']}", sections)
    with taking_name(path) as new:
        new.part.write_text(text, encoding="utf-8")
    return path


def _result(found: xr.Dataset) -> Section:
    """The gates that the number has to pass."""
    verdicts = [GATES[one] for one in found["gate_verdict"].values.tolist()]
    rows = [[str(name).replace("_", " "), verdict.replace("_", " "), str(why)] for name, verdict, why in zip(found["gate_name"].values, verdicts, found["gate_reason"].values, strict=True)]  # fmt: skip
    failed, unknown = verdicts.count(FAILED), verdicts.count(NOT_CHECKED)
    said = f"It fails {failed} of {len(verdicts)} gates." if failed else "It passes every gate."
    if unknown:
        said = (
            f"{said if failed else 'It fails none.'} Of {unknown} it is not known whether it passes: more draws tell."
        )
    return Section("What it has to pass", [Words(said), Table(["gate", "verdict", "what was looked at"], rows)])


def _method(run: xr.Dataset) -> Section:
    used = run.attrs
    control = f"step {float(used['solver_step']):g}{behind(time_unit(run))}" if "solver_step" in used else f"rtol {float(used['solver_rtol']):g}" if "solver_rtol" in used else str(used["solver_step_control"])  # fmt: skip
    counts = f"{used['run_accepted_steps']} accepted steps, {used['run_rejected_trials']} rejected trials, {used['run_force_evaluations']} force evaluations"
    return Section("The method", [
        Words(f"of order {used['solver_order']}, {control}: {counts}.", str(used["solver_method"])),
        Words(f"{used['solver_update_order']}."),
        Code("\n".join(str(used["solver_update_equations"]).split("; "))),
        Words(f"After {used['solver_reference']}."),
        Words(f"Outcome: {used['run_outcome_text']}."),
    ])  # fmt: skip


def _convergence(found: xr.Dataset) -> Section:
    varied = "step_size" if "step_size" in found else "rtol"
    units = str(found["value"].attrs["units"])
    values, orders = found["level_value"].values, found["observed_order"].values
    changes = np.append(np.diff(values), np.nan)
    rows = [[f"{size:.6g}", f"{value!r}", _number(change), _number(order)] for size, value, change, order in zip(found[varied].values.tolist(), values.tolist(), changes.tolist(), orders.tolist(), strict=True)]  # fmt: skip
    verdict = words_of(found["level_verdict"])[0].replace("_", " ")
    second = "" if found[varied].attrs["units"] == "1" else f" ({found[varied].attrs['units']})"
    head = [f"{varied.replace('_', ' ')}{second}", f"{found.attrs['of']} ({units})", f"to the next level ({units})", "observed order"]  # fmt: skip
    return Section(
        "Convergence", [Words(f"The first row is the run's own. Together they are {verdict}."), Table(head, rows)]
    )


def _budget(found: xr.Dataset, picture: bytes) -> Section:
    units, kinds = str(found["value"].attrs["units"]), words_of(found["term_kind"])
    order = np.argsort(-np.abs(found["share"].values), kind="stable").tolist()
    rows = [
        [
            str(found["term_name"].values[i]), kinds[i], _with_unit(found, "sensitivity", "sensitivity_units", i),
            _with_unit(found, "input_uncertainty", "input_units", i), with_doubt(float(found["standard_uncertainty"][i]), doubt_of(found, i)),
            f"{float(found['bound'].values[i]):.3g}", f"{float(found['share'][i]):.1%}", str(found["term_rule"].values[i]),
        ] for i in order
    ]  # fmt: skip
    head = [
        "term",
        "kind",
        "sensitivity",
        "uncertainty of the input",
        f"contributes ({units})",
        f"at most ({units})",
        "share",
        "how it was found",
    ]
    totals = [
        ["numerical, sum of bounds", f"{float(found['numerical_bound']):.3g} {units}"],
        ["numerical, root of squares", f"{float(found['numerical_rss']):.3g} {units}"],
        ["physical, root of squares", f"{float(found['physical_rss']):.3g} {units}"],
        ["together", f"{float(found['total_rss']):.3g} {units}"],
    ]
    if "monte_carlo_shortest" in found:
        part = f"{float(found.attrs['coverage']):.0%}"
        for name in ("shortest", "symmetric"):
            low, high = found[f"monte_carlo_{name}"].values.tolist()
            doubt = float(found["monte_carlo_end_doubt"])
            ends = f"{known_to(low, doubt)} to {known_to(high, doubt)} {units}, its ends ± {doubt:.1g} {units}"
            totals.append([f"{name} {part} interval of {found.attrs['draws']} draws", ends])
        standard, doubt = (float(found[f"monte_carlo_standard_uncertainty{one}"]) for one in ("", "_doubt"))
        totals.append(["standard uncertainty of the draws", f"{with_doubt(standard, doubt)} {units}"])
        totals.append(["the linear budget", words_of(found["linear_verdict"])[0].replace("_", " ")])
    return Section("The budget", [Table(head, rows), Table(["total", ""], totals), Picture(picture, "Terms of the budget, and intervals where they were drawn")])  # fmt: skip


def _run(run: xr.Dataset, picture: bytes) -> Section:
    rows = []
    second = f" ({time_unit(run).text})".replace(" (1)", "")
    if run.sizes.get("event", 0):
        names, kinds = words_of(run["event_detector"]), words_of(run["event_kind"])
        times, doubts = run["event_time"].values.tolist(), run["event_time_uncertainty"].values.tolist()
        rows = [[name, kind.replace("_", " "), f"{time!r}", f"{doubt:.2g}"] for name, kind, time, doubt in zip(names, kinds, times, doubts, strict=True)]  # fmt: skip
    more = [Words(f"{len(rows) - MOST_EVENTS} further events are in {RUN}.")] if len(rows) > MOST_EVENTS else []
    events = [Table(["event", "kind", f"time{second}", f"located within{second}"], rows[:MOST_EVENTS])] if rows else []
    return Section("The run", [Picture(picture, str(run.attrs["title"])), *events, *more])


def _ledger(ledger: xr.Dataset) -> Section:
    verdicts, units = words_of(ledger["verdict"]), ledger["case_units"].values
    # ledgers of older versions have none
    over_scale = ledger.get(SCALED_RESIDUAL, ledger["residual"] * np.nan).values
    rows = [[str(name), verdict, f"{_number(float(residual))} {unit}", _number(float(scaled)), f"{_number(float(bound))} {unit}", str(relation)] for name, verdict, residual, scaled, bound, unit, relation in zip(ledger["case_name"].values, verdicts, ledger["residual"].values, over_scale, ledger["bound"].values, units, ledger["case_relation"].values, strict=True) if verdict != "refused"]  # fmt: skip
    said = f"The method beside closed forms: {verdicts.count('passed')} passed, {verdicts.count('failed')} failed, {verdicts.count('refused')} refused."
    return Section(
        "The method's ledger",
        [Words(said), Table(["case", "verdict", "residual", "scaled", "bound", "closed form"], rows)],
    )


def _again(found: xr.Dataset, folder: Path) -> Section:
    version, name = found.attrs.get("xdynamics_version", ""), folder.resolve().name
    lines = f"pip install xdynamics=={version} && xdynamics recheck {name}"
    digests = [["model", str(found.attrs["model_digest"])], *([f"run, level {k + 1}", str(one)] for k, one in enumerate(found["run_digest"].values))]  # fmt: skip
    return Section("Made again", [Words("Every number of it, compared one by one, from the bundle alone:"), Code(lines), Table(["sha256 of the content", ""], digests)])  # fmt: skip


def _with_unit(found: xr.Dataset, name: str, units: str, i: int) -> str:
    value, unit = float(found[name][i]), str(found[units].values[i])
    return "" if not np.isfinite(value) else f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""
