"""Causes of a difference between two runs: their models, parameters, starts and settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import zip_longest
from typing import Any

import xarray as xr

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.faults import InputError, escaped
from xdynamics.model.file_access import parse_model_text
from xdynamics.record import is_of_model

SECTIONS = ("parameters", "initial")  # of a model, whose entries are listed separately from its other entries
# settings that follow from the model, the method and how its steps are chosen
FOLLOWING = (
    "title",
    "summary",
    "source",
    "model_digest",
    "force_digest",
    "run_outcome_text",
    "solver_order",
    "solver_update_equations",
    "solver_update_order",
    "solver_reference",
    "solver_last_step",
    "solver_first_step",
    "solver_rtol_used",
)


def model_differences(first: xr.Dataset, second: xr.Dataset) -> dict[str, str]:
    """List the differences of two models by name and value: parameters, initial values, and the rest."""
    models = [
        {name.removesuffix(".value"): value for name, value in _flatten_table("", table)}
        for table in _model_tables(first, second)
    ]
    differences: dict[str, list[str]] = {"parameters": [], "initial": [], "model": []}
    for name in dict.fromkeys([*models[0], *models[1]]):
        values = [model.get(name, "absent") for model in models]
        section, _, entry_path = name.partition(".")
        if values[0] != values[1] and section not in ("name", "description", "run"):
            heading, key = (section, entry_path) if section in SECTIONS else ("model", name)
            differences[heading].append(escaped(f"{key}: {_side_by_side(*values)}"))
    return {name: "\n".join(lines) for name, lines in differences.items()}


def _side_by_side(first: str, second: str) -> str:
    """Return two values beside each other; of tables, which are texts of many rows, the first row that differs."""
    rows = first.splitlines(), second.splitlines()
    pairs = [*zip_longest(*rows, fillvalue="absent")]
    differing = [number for number, pair in enumerate(pairs) if pair[0] != pair[1]]
    if min(map(len, rows)) < 2 or not differing:
        return " | ".join(_shortened_text(value.removesuffix(" 1")) for value in (first, second))
    more = f", and {len(differing) - 1} more" if len(differing) > 1 else ""
    return f"row {differing[0] + 1}: {' | '.join(map(_shortened_text, pairs[differing[0]]))}{more}"


def _model_tables(first: xr.Dataset, second: xr.Dataset) -> list[dict[str, Any]]:
    """Return the sections of two models; with numbers for elements, where one of them has an expression for them."""
    texts = [run["model_toml"].values.item() for run in (first, second)]
    tables = [parse_model_text(text, recorded=True) for text in texts]
    if texts[0] != texts[1] and any("dimensions" in table for table in tables):
        with suppress(InputError):  # of Python functions, which are not at hand
            return [model_of_record(run, None).written_out() for run in (first, second)]
    return tables


def is_restated(first: xr.Dataset, second: xr.Dataset) -> bool:
    """Whether the models of two runs differ, and only in that one has numbers where the other has an expression."""
    if first.attrs["model_digest"] != second.attrs["model_digest"]:
        with suppress(InputError):
            return is_of_model(first, model_of_record(second, None))
    return False


def _flatten_table(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Flatten a model's text into dotted names and values."""
    if isinstance(value, Mapping) and {"value", "unit"} <= set(value):  # one quantity, however it is written
        value = {key: entry for key, entry in value.items() if key != "unit"} | {
            "value": f"{value['value']} {value['unit']}"
        }
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flatten_table(f"{name}.{key}" if name else str(key), entry)
    else:
        yield name, str(value)


def cause_of(attributes: Mapping[str, Any]) -> str:
    """Name the likely cause of a difference: the first differing section, from the model to the settings."""
    if attributes["identical"]:
        return ""
    for section in ("model", "parameters", "initial", "settings"):
        if attributes[section]:
            lines = independent_settings(str(attributes[section]).splitlines())
            return f"{section}: {lines[0]}" + (f", and {len(lines) - 1} more" if len(lines) > 1 else "")
    return "nothing that is recorded differs but the numbers"


def independent_settings(lines: list[str]) -> list[str]:
    """Drop settings that follow from others, or that only one of two kinds of step control has."""
    names = [line.partition(":")[0] for line in lines]
    return [
        setting
        for setting, name in zip(lines, names, strict=True)
        if name not in FOLLOWING and "'absent'" not in setting
    ] or lines


def _shortened_text(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "…"
