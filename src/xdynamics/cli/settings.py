"""Options of the command line for a march, a cluster of marches, and measured data.

The options of a march are made from the table of keywords, for every verb that marches.

Verbs that march many runs have options for a cluster, or for a number of processes.

Verbs that read measured data have options for the layout of a file that does not state it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import progress
from xdynamics.keywords import (
    COLUMNS,
    KEYWORDS,
    NUMBER,
    PAIR,
    RECORD,
    SCALES,
    STEP,
    TIME,
    TIMES,
    TOLERANCES,
    TRUTH,
    WHOLE,
    WORD,
    Keyword,
)

if TYPE_CHECKING:
    import xarray as xr

SEVERAL = (TOLERANCES, SCALES, TIMES)  # kinds that may be given more than once
_METAVARS = {TIME: "TIME", STEP: "TIME", NUMBER: "NUMBER", WHOLE: "N", WORD: "WORD"}
OF_RECORDS = tuple(name for name, keyword in KEYWORDS.items() if keyword.group == RECORD)


class Setting(click.Option):
    """An option for a setting of a march; the help lists options by group."""

    def __init__(self, *arguments: Any, group: str, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.group = group


def settings(*, excluded: Iterable[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the options of a march to a verb, except some; the verb receives them under the names of their keywords."""
    left_out = {*excluded}

    def add_options(verb: Callable[..., Any]) -> Callable[..., Any]:
        # click lists options in the order of decorators from the top, which are applied from the bottom
        for name, keyword in reversed(KEYWORDS.items()):
            if name not in left_out:
                verb = _option(keyword)(verb)
        return verb

    return add_options


def _option(keyword: Keyword) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    default = keyword.default if keyword.default.startswith("needed") else f"default: {keyword.default}"
    help_text = f"{keyword.about[0].upper()}{keyword.about[1:]}; {default}."
    form: dict[str, Any] = {"multiple": keyword.kind in SEVERAL, "metavar": _metavar(keyword)}
    if keyword.kind == TRUTH:
        form = {"is_flag": True, "default": None}
    return click.option(keyword.flag, keyword.name, cls=Setting, group=keyword.group, help=help_text, **form)


def _metavar(keyword: Keyword) -> str | None:
    """Return the placeholder of an option in the help: its own, the allowed words, or the kind of its value."""
    words = keyword.takes.replace(" | ", "|").replace('"', "") if keyword.kind == WORD and "|" in keyword.takes else ""
    return keyword.metavar or words or _METAVARS.get(keyword.kind)


def simulate_arguments(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values given on the command line, as `simulate` takes them.

    Raises
    ------
    InputError
        Naming the option that cannot be read.
    """
    arguments: dict[str, Any] = {}
    for name, value in options.items():
        if value is None or value == ():
            continue
        read = _READERS.get(KEYWORDS[name].kind)
        arguments[name] = value if read is None else read(value, KEYWORDS[name].flag)
    return arguments


def named_values(texts: Iterable[str], option: str) -> dict[str, str]:
    """Read the values that an option gives to several names.

    Raises
    ------
    InputError
        If a text is not NAME=VALUE, or repeats a name.
    """
    from xdynamics.faults import InputError

    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {text!r} needs NAME=VALUE")
        if name.strip() in values:
            raise InputError(f"{option} sets {name.strip()!r} twice")
        values[name.strip()] = value.strip()
    return values


def absolute_tolerances(texts: Iterable[str], option: str = "--atol") -> dict[str, Any]:
    """Sort absolute tolerances: a bare number applies to every variable without its own.

    Raises
    ------
    InputError
        If there are two bare ones, or one is no number.
    """
    from xdynamics.faults import InputError

    bare = [entry for entry in texts if "=" not in entry]
    if len(bare) > 1:
        raise InputError(f"{option} is given {len(bare)} times without a name: {', '.join(bare)}")
    tolerances: dict[str, Any] = dict(named_values((entry for entry in texts if "=" in entry), option))
    for text in bare:
        try:
            tolerances[""] = float(text)
        except ValueError:
            raise InputError(f"{option} {text!r} needs a number, in every variable's own unit, or NAME=VALUE") from None
    return tolerances


def names_in(text: str) -> list[str]:
    """Return the names between commas; commas in brackets of elements do not separate.

    Examples
    --------
    >>> names_in("r[Jupiter, x], energy")
    ['r[Jupiter, x]', 'energy']
    """
    # a comma with a closing bracket ahead, and no opening one before that, is inside an element's brackets
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text)]


def _column_words(text: str, _: str) -> str | list[str]:
    return text if text in ("full", "states") else names_in(text)


_READERS: dict[str, Callable[[Any, str], Any]] = {
    TOLERANCES: absolute_tolerances,
    SCALES: named_values,
    TIMES: lambda texts, _: list(texts),
    COLUMNS: _column_words,
    PAIR: lambda text, _: [word.strip() for word in text.split(",")],
}


def clustered(verb: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a cluster; the verb receives `scheduler` and `workers`."""
    options = (
        click.option(
            "--scheduler", metavar="tcp://…", help="The dask cluster to compute on; see `xdynamics help cluster`."
        ),
        click.option(
            "--workers",
            type=click.IntRange(1),
            metavar="N",
            help="Processes to start on this machine, and to compute on.",
        ),
    )
    for option in reversed(options):
        verb = option(verb)
    return verb


def goes_on(folder: str) -> str:
    """Return the hint of an interrupted command that its results stay in a folder."""
    return f"what is done is kept in '{folder}', and the same command goes on with it"


KEPT = click.option(
    "--keep",
    metavar="FOLDER",
    help="Keep each result in this folder as soon as it is known: the same command goes on with the others.",
)


def make_evidence(
    make: Callable[..., xr.Dataset], *arguments: Any, scheduler: str | None, workers: int | None, **options: Any
) -> xr.Dataset:
    """Compute evidence in this process, or as a graph on a cluster, with progress.

    Raises
    ------
    InputError
        If the evidence cannot be made, or the cluster cannot be reached or is gone.
    """
    from xdynamics.evidence.cluster import cluster_of
    from xdynamics.evidence.stages import compute_datasets

    resume_hint = [goes_on(options["keep"])] if options.get("keep") else []
    with cluster_of(scheduler, workers) as client:
        if client is None:
            try:
                return make(*arguments, **options)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(*resume_hint) from None
        stage = make(*arguments, compute=False, **options)
        with progress("{count} tasks done") as tell:
            try:
                return compute_datasets(stage, tell=tell)[0]
            except KeyboardInterrupt:
                raise KeyboardInterrupt("the cluster was told to drop what was asked of it", *resume_hint) from None


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
    """Return the options of a measured file's layout, as `compare` and `fit` take them."""
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
