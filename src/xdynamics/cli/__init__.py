"""The command line: arguments in, a few lines out. Exit codes: 0 done, 1 ended badly, 2 wrong input."""

from xdynamics.cli import budgeting, judging, looking, marching, proving, sweeping, writing
from xdynamics.cli.command import main

__all__ = ["budgeting", "judging", "looking", "main", "marching", "proving", "sweeping", "writing"]
