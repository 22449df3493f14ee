"""Verbs for writing a model: what it may contain, a first one, and a check of one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from xdynamics.cli.command import ALSO, VERBS, json_option, main, print_json, say
from xdynamics.cli.marching import read_changed_model


@main.command(name="help")
@click.argument("topic", required=False)
@click.option(
    "--html", "folder", metavar="DIR", help="Write the whole manual there as a site, to be opened in a browser."
)
def help_on(topic: str | None, folder: str | None) -> None:
    """Explain what may stand in a model file: `help model`, `help drives`, `help language`; or a verb: `help plot`."""
    if folder is not None:
        say([f"manual    {_site(folder)}"])
        return
    from xdynamics.documenting.guide import guide, topic_named, topics

    named = "" if topic is None or topic_named(topic) in topics() else topic.lower()
    verb = next((verb for verb in main.commands if named == verb or named in ALSO.get(verb, ())), None)
    if verb:
        command = main.commands[verb]
        say(command.get_help(click.Context(command, click.get_current_context().parent, verb)).splitlines())
    else:
        say(guide(topic, VERBS))


def _site(folder: str) -> str:
    """Write the manual as a site, and return its first page."""
    import xdynamics
    from xdynamics.cli.looking import page_of
    from xdynamics.documenting.site import site
    from xdynamics.methods import METHODS

    parent = click.get_current_context().parent
    verbs = {name: command.get_help(click.Context(command, parent, name)) for name, command in main.commands.items()}
    methods = {name: "\n".join(page_of(method)) for name, method in METHODS.items()}
    public = {name: getattr(xdynamics, name) for name in xdynamics.__all__}
    return str(site(folder, verbs, methods, public) / "index.html")


@main.command(makes=True)
@click.argument("path", metavar="MODEL.toml")
def new(path: str) -> None:
    """Write a model to begin with: a driven pendulum, with a word on each section."""
    from xdynamics.documenting.guide import STARTER
    from xdynamics.faults import ArchiveError, InputError
    from xdynamics.runtime.files import reason, write_new

    target = Path(path)
    if target.suffix != ".toml":
        raise InputError(f"'{path}' is not a name for a model file; it needs one like pendulum.toml")
    try:
        write_new(target, STARTER.encode())
    except FileExistsError:
        raise InputError(f"'{path}' is there already, and is not written over; give another name") from None
    except FileNotFoundError:
        raise InputError(f"'{path}' cannot be written: No such file or directory '{target.parent}'") from None
    except NotADirectoryError as error:
        raise InputError(f"'{path}' cannot be written: {reason(error, target)}") from None
    except OSError as error:
        raise ArchiveError(f"'{path}' cannot be written: {error.strerror or error}") from None
    say(_next_commands(path))


def _next_commands(path: str) -> Iterator[str]:
    yield f"model     {path}"
    yield f"next      xdynamics check {path}; xdynamics run {path} -o run.nc; xdynamics plot run.nc"


@main.command()
@click.argument("model_file", metavar="MODEL.toml|RUN.nc")
@click.option("--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a parameter or initial value.")
@click.option(
    "--tables", type=click.Choice(["below", "anywhere"]), default="below", help="Where the model may take tables from."
)
@json_option
def check(model_file: str, changes: tuple[str, ...], tables: str) -> None:
    """Read a model and check every unit; print its equations, time scales, and the methods that take it. Nothing is run."""
    from xdynamics.documenting.plain_text import model_lines

    model = read_changed_model(model_file, changes, tables)
    say(model_lines(model))
    print_json(model)
