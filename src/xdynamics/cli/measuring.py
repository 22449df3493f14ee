"""The options of verbs that read measured data: how a file is laid out that does not say it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from xdynamics.cli.settings import named_values

TABLES = (".csv", ".txt", ".tsv", ".dat", ".xlsx", ".eng")
_OPTIONS = {
    "gaps": click.option(
        "--gaps",
        type=click.Choice(["refuse", "skip"]),
        default="refuse",
        help="What to do with rows in which a number is missing.",
    ),
    "skip": click.option("--skip", type=int, metavar="N", help="Lines before the header of a file; by default found."),
    "header": click.option(
        "--header",
        metavar="TITLES",
        help="Titles in the place of a file's own, like 't [s],x [mm]'; one for each column.",
    ),
    "units": click.option(
        "--units", multiple=True, metavar="NAME=UNIT", help="The unit of a column whose title has none, like t=s."
    ),
    "columns": click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="NAME=COLUMN",
        help="The file's name for a quantity of the model, like x=Position.",
    ),
    "time_zero": click.option("--time-zero", metavar="TIME|first", help="What the times of the data are counted from."),
    "decimal": click.option("--decimal", type=click.Choice([".", ","]), help="Decimal mark; by default found."),
}


def measured_data(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options to a verb, which receives them under their names."""
    for option in reversed(_OPTIONS.values()):
        verb = option(verb)
    return verb


def reading_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what these options say, as `compare` and `fit` take it."""
    layout_options = {
        name: options[name] for name in _OPTIONS if name != "gaps" and options.get(name) not in (None, ())
    }
    tables = {"units": "--units", "columns": "--column"}
    return layout_options | {
        name: named_values(layout_options[name], option) for name, option in tables.items() if name in layout_options
    }


def other_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the other options of a verb."""
    return {name: value for name, value in options.items() if name not in _OPTIONS}
