"""Gates: questions that a record or a number has to pass, with what became of each and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.schema import flag_attributes

GATE = "gate"
PASSED, FAILED, NOT_CHECKED = GATES = ("passed", "failed", "not_checked")


class Gate(NamedTuple):
    """A question, what became of it, one of `GATES`, and why."""

    name: str
    verdict: str
    reason: str


def gate_variables(gates: Sequence[tuple[str, str, str]], question: str) -> dict[str, Any]:
    """Return gates as variables of a Dataset; `question` says in words what a gate asks."""
    names, verdicts, reasons = zip(*gates, strict=True)
    return {
        "gate_name": ((GATE,), np.array(names), attrs_of("1", question, "name")),
        "gate_reason": ((GATE,), np.array(reasons), attrs_of("1", "what was looked at", "rule")),
        "gate_verdict": (
            (GATE,),
            np.array([GATES.index(verdict) for verdict in verdicts], np.int8),
            attrs_of("1", "what became of it", "flag") | flag_attributes(dict(enumerate(GATES))),
        ),
    }
