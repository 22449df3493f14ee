"""Numerical dynamics as self-describing xarray datasets.

>>> import xdynamics as xd
>>> model = xd.Model.from_toml("data/models/ball_drag.toml")
>>> run = xd.simulate(model, until="1 s")
>>> run.attrs["run_outcome"]
'completed'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xdynamics.runtime.lazy_imports import entrance, when_imported

if TYPE_CHECKING:
    from xdynamics.archive import content_digest, discard, open_run, save
    from xdynamics.archive.signatures import sign, verify_signature
    from xdynamics.budgeting.budget import error_budget
    from xdynamics.budgeting.certificate import certify
    from xdynamics.budgeting.fitting import fit
    from xdynamics.budgeting.term import Declared
    from xdynamics.documenting.bundling import bundle, recheck
    from xdynamics.documenting.document import document
    from xdynamics.documenting.reporting import report
    from xdynamics.evidence.cluster import cluster
    from xdynamics.evidence.companion import companion
    from xdynamics.evidence.comparing.comparison import compare
    from xdynamics.evidence.diagnosing.diagnosis import diagnose
    from xdynamics.evidence.enclosing.enclosure import enclose
    from xdynamics.evidence.modes import modes
    from xdynamics.evidence.refining.refinement import refine
    from xdynamics.evidence.sampling import sample
    from xdynamics.evidence.validating.ledger import validate
    from xdynamics.evidence.validating.limiting import limiting
    from xdynamics.evidence.validating.manufacturing import manufactured
    from xdynamics.faults import (
        AccuracyWarning,
        ArchiveError,
        EditedWarning,
        InputError,
        KindWarning,
        ModelError,
        PartialRunWarning,
        ResumeWarning,
        SignatureWarning,
        StabilityWarning,
    )
    from xdynamics.figures import plot
    from xdynamics.figures.animation import animate
    from xdynamics.interchange.run_index import open_runs
    from xdynamics.methods import METHODS
    from xdynamics.model import Model
    from xdynamics.record import check
    from xdynamics.simulation.completion import complete
    from xdynamics.simulation.extension import extend
    from xdynamics.simulation.scipy_interface import solve
    from xdynamics.simulation.single_run import reproduce, simulate
    from xdynamics.sweeping.axes import Draws
    from xdynamics.sweeping.catalogue import open_sweep, verify
    from xdynamics.sweeping.ensemble_analysis import contrast, convergence, precision, sensitivities
    from xdynamics.sweeping.indices import influences, sobol_indices
    from xdynamics.sweeping.logs import open_logs, ragged
    from xdynamics.sweeping.member import member
    from xdynamics.sweeping.sweep import sweep

# room -> the public names that live in it; a room is entered when one of its names is first used
_ROOMS = {
    "archive": ("content_digest", "discard", "open_run", "save", "save_many"),
    "archive.signatures": ("sign", "verify_signature"),
    "budgeting.budget": ("error_budget",),
    "budgeting.certificate": ("certify",),
    "budgeting.fitting": ("fit",),
    "budgeting.term": ("Declared",),
    "documenting.bundling": ("bundle", "recheck"),
    "documenting.document": ("document",),
    "documenting.reporting": ("report",),
    "evidence.cluster": ("cluster",),
    "evidence.companion": ("companion",),
    "evidence.comparing.comparison": ("compare",),
    "evidence.diagnosing.diagnosis": ("diagnose",),
    "evidence.enclosing.enclosure": ("enclose",),
    "evidence.modes": ("modes",),
    "evidence.refining.refinement": ("refine",),
    "evidence.sampling": ("sample",),
    "evidence.validating.ledger": ("validate",),
    "evidence.validating.limiting": ("limiting",),
    "evidence.validating.manufacturing": ("manufactured",),
    "faults": (
        "AccuracyWarning",
        "ArchiveError",
        "EditedWarning",
        "InputError",
        "KindWarning",
        "ModelError",
        "PartialRunWarning",
        "ResumeWarning",
        "SignatureWarning",
        "StabilityWarning",
    ),
    "figures": ("plot",),
    "figures.animation": ("animate",),
    "interchange.run_index": ("open_runs",),
    "methods": ("METHODS",),
    "model": ("Model",),
    "record": ("check",),
    "simulation.completion": ("complete",),
    "simulation.extension": ("extend",),
    "simulation.scipy_interface": ("solve",),
    "simulation.single_run": ("reproduce", "simulate"),
    "sweeping.catalogue": ("open_sweep", "verify"),
    "sweeping.axes": ("Draws",),
    "sweeping.ensemble_analysis": ("contrast", "convergence", "precision", "sensitivities"),
    "sweeping.indices": ("influences", "sobol_indices"),
    "sweeping.logs": ("open_logs", "ragged"),
    "sweeping.member": ("member",),
    "sweeping.sweep": ("sweep",),
}

__all__ = [
    "METHODS",
    "AccuracyWarning",
    "ArchiveError",
    "Declared",
    "Draws",
    "EditedWarning",
    "InputError",
    "KindWarning",
    "Model",
    "ModelError",
    "PartialRunWarning",
    "ResumeWarning",
    "SignatureWarning",
    "StabilityWarning",
    "animate",
    "bundle",
    "certify",
    "check",
    "cluster",
    "companion",
    "compare",
    "complete",
    "content_digest",
    "contrast",
    "convergence",
    "diagnose",
    "discard",
    "document",
    "enclose",
    "error_budget",
    "extend",
    "fit",
    "influences",
    "limiting",
    "manufactured",
    "member",
    "modes",
    "open_logs",
    "open_run",
    "open_runs",
    "open_sweep",
    "plot",
    "precision",
    "ragged",
    "recheck",
    "refine",
    "report",
    "reproduce",
    "sample",
    "save",
    "save_many",
    "sensitivities",
    "sign",
    "simulate",
    "sobol_indices",
    "solve",
    "sweep",
    "validate",
    "verify",
    "verify_signature",
]


# verbs that take records, with units as attributes or in their arrays
_OF_RECORDS = (
    "animate",
    "check",
    "companion",
    "compare",
    "complete",
    "content_digest",
    "diagnose",
    "extend",
    "modes",
    "plot",
    "sample",
    "save",
    "contrast",
    "convergence",
    "influences",
    "precision",
    "sensitivities",
    "ragged",
)

_entered = entrance(
    __name__,
    {name: room for room, names in _ROOMS.items() for name in names},
    companion_module="interchange.accessor",
    through={
        "keywords.checked_keywords": tuple(name for name in __all__ if name[0].islower()),
        "record.arguments.marching": _OF_RECORDS,
        "record.pint_records.taking": _OF_RECORDS,
    },
    other_words={
        **dict.fromkeys(("open", "load", "read", "open_dataset", "load_run", "read_run", "open_archive"), "open_run"),
        **dict.fromkeys(("run", "march", "integrate", "simulation"), "simulate"),
        **dict.fromkeys(("solve_ivp", "odeint", "ode"), "solve"),
        **dict.fromkeys(("write", "dump", "to_netcdf"), "save"),
        **dict.fromkeys(("scan", "grid", "ensemble", "parameter_study"), "sweep"),
        **dict.fromkeys(("convergence", "converge"), "refine"),
    },
)

when_imported("xarray", "xdynamics.interchange.registration", "register")
when_imported("pint_xarray", "xdynamics.record.pint_records", "teach")


def __getattr__(name: str) -> Any:
    if name == "__version__":  # read on demand: it takes longer than everything else here
        from importlib.metadata import version

        return version("xdynamics")
    return _entered(name)


def __dir__() -> list[str]:
    return sorted(__all__)
