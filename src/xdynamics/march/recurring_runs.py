"""Marches that begin alike, as in a loop over one model: what they begin with is made once, and copied for each."""

from __future__ import annotations

from functools import lru_cache

from xdynamics.kernels import Law, Layout
from xdynamics.kernels.machine import aligned_zeros
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import log_of
from xdynamics.march.run import ARRAYS, Run
from xdynamics.march.settings import Settings
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model

FEW = 64  # numbers of a state, and parameters, of which what a march begins with is kept


def recurs(model: Model, settings: Settings, layout: Layout) -> bool:
    """Whether what a march begins with is small, and given by what equal settings have in common.

    Equal floats may stand for unequal numbers, as they were written, and 0.0 for -0.0; times of controllers, of tables and
    nodes follow from these.
    """
    return (
        max(layout.used.size, len(model.statement.parameters)) <= FEW
        and not (layout.reactions or layout.watched or model.events)
        and not (model.python_functions or model.assemblies or model.delays or model.drives or model.controllers)
        and not (settings.nodes or isinstance(settings.step, tuple) or settings.until == 0.0)
        and settings.precision == FLOAT64
    )


def copy_template_run(model: Model, settings: Settings, law: Law) -> Run:
    """Return a run that has not begun, as `pose_run` makes it, with arrays of its own."""
    first, filled = _template_run(model, settings, law)
    arrays = {name: getattr(first, name).copy("K") for name in filled}
    return Run(first, **arrays | {"w": aligned_zeros(first.w.size)})


@lru_cache(maxsize=32)
def _template_run(model: Model, settings: Settings, law: Law) -> tuple[Run, tuple[str, ...]]:
    """Return a run that does not begin, and the names of its arrays that have elements."""
    run = pose_run(model, settings, law, log_of(law.layout, settings, 0), addresses_of(law))
    return run, tuple(name for name in ARRAYS if getattr(run, name).size)
