"""The command line, called in this process."""

from __future__ import annotations

from click.testing import CliRunner, Result

from xdynamics.cli import main


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])
