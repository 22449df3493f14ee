"""What people type in the place of a verb, and the command that they meant."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from difflib import get_close_matches

# verb -> words for what it does
ALSO = {
    "run": ("simulate", "march", "integrate", "solve", "start", "sim", "exec", "execute"),
    "plot": ("draw", "figure", "picture", "graph", "chart"),
    "animate": ("film", "movie", "video", "animation"),
    "show": ("info", "print", "dump", "summary", "view", "open", "describe", "inspect", "events"),
    "check": ("lint", "parse", "read", "units", "equations"),
    "new": ("init", "create", "template", "start"),
    "fit": ("calibrate", "estimate", "identify"),
    "budget": ("uncertainty", "error", "errors", "uncertainties"),
    "enclose": ("enclosure", "bounds", "tube", "interval", "intervals", "rigorous", "proof"),
    "certify": ("certificate", "prove"),
    "refine": ("converge", "convergence", "refinement", "order"),
    "compare": ("diff", "difference", "cmp"),
    "validate": ("test", "validation", "ledger"),
    "diagnose": ("diagnosis", "analyse", "analyze", "lyapunov", "energy"),
    "sweep": ("scan", "ensemble", "grid", "parameter", "parameters", "montecarlo", "batch"),
    "sample": ("interpolate", "at"),
    "table": ("export", "csv", "xlsx", "excel", "frame", "latex"),
    "modes": ("eigenvalues", "frequencies", "linearise", "linearize", "stability"),
    "methods": ("solvers", "method", "integrators", "list"),
    "extend": ("continue", "resume", "longer"),
    "reproduce": ("rerun", "replay", "again"),
    "help": ("man", "docs", "manual", "guide"),
}


def verb_meant(word: str, verbs: Sequence[str]) -> str:
    """Return the verb that a word stands for; empty if none is like it."""
    word = word.lower()
    if word in verbs:
        return word
    exact = [verb for verb, synonyms in ALSO.items() if word in synonyms]
    return next(iter([*exact, *get_close_matches(word, verbs, n=1, cutoff=0.7)]), "")


def command_meant(arguments: Sequence[str], verbs: Sequence[str]) -> str:
    """Return the whole command that was meant by one without a verb that is known; empty if that is not clear.

    Examples
    --------
    >>> command_meant(["simulate", "ball.toml"], ["run", "show"])
    'xdynamics run ball.toml -o ball.nc'
    >>> command_meant(["ball.nc"], ["run", "show"])
    'xdynamics show ball.nc'
    """
    first, *remaining_args = arguments
    file = next((argument for argument in arguments if argument.endswith((".toml", ".nc"))), "")
    verb = verb_meant(first, verbs)
    if not verb and first == file:
        verb, remaining_args = "run" if file.endswith(".toml") else "show", [*arguments]
    if not verb:
        return ""
    if verb == "run" and file.endswith(".toml") and not {"-o", "--output"} & {*remaining_args}:
        remaining_args += ["-o", file.removesuffix(".toml") + ".nc"]
    return shlex.join(["xdynamics", verb, *remaining_args])
