"""The coordinate, velocity or state that made a test fail."""

from __future__ import annotations

import numpy as np

from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.runner import March


def of_error(march: March) -> str:
    """Name the component with the largest estimated error over its scale in the last trial; empty if not estimated."""
    run, n = march.run, march.layout.used.size
    if not march.settings.scheme.estimates:
        return ""
    size_before, size_after = np.abs(run.y[:n]), np.abs(run.z[:n])
    return _worst_variable(march, run.e[:n], run.atol[:n] + run.plan[0].rtol * np.fmax(size_before, size_after))


def of_newton(march: March) -> str:
    """Name the component with the largest correction over its size in Newton's last iteration."""
    run, n = march.run, march.layout.used.size
    return _worst_variable(march, *solver_of(march.settings.method).corrections(run, n))


def _worst_variable(march: March, errors: np.ndarray, scales: np.ndarray) -> str:
    with np.errstate(all="ignore"):
        ratios = np.where(errors == 0.0, 0.0, np.abs(errors) / scales)
    return march.layout.used[int(np.argmax(np.where(np.isnan(ratios), np.inf, ratios)))]
