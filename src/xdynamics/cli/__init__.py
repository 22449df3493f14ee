"""The command line: arguments in, a few lines out. Exit codes: 0 done, 1 ended badly, 2 wrong input."""

from xdynamics.cli import budgeting, examples, judging, looking, marching, model_writing, proving, sweeping
from xdynamics.cli.command import main

__all__ = ["budgeting", "examples", "judging", "looking", "main", "marching", "model_writing", "proving", "sweeping"]
