"""The command line: arguments in, a few lines out. Exit codes: 0 done, 1 ended badly, 2 wrong input."""

from xdynamics.cli import looking, marching, proving
from xdynamics.cli.command import main

__all__ = ["looking", "main", "marching", "proving"]
