"""Solvers of the equations of a step: their code, the arrays that they work on, and their columns in a record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Law, Layout
from xdynamics.kernels.jets.recurrences import has_pairs
from xdynamics.kernels.newton_matrix import band_as_written, is_compressed, pattern_of
from xdynamics.march.engine import solvers
from xdynamics.march.implicit.newton import MOST_ITERATIONS, NEWTON_TOLERANCE
from xdynamics.march.implicit.radau import MOST_SETTLING, MOST_TURNS, SETTLED, SOLVED_BY, SOLVED_WITH_LINKS
from xdynamics.march.log import unwritten
from xdynamics.march.run import EQUATIONS, Run
from xdynamics.march.settings import Settings
from xdynamics.methods import Method
from xdynamics.methods.implicit import SHARE
from xdynamics.methods.scheme import DOUBLE_DOUBLE, EMBEDDED
from xdynamics.methods.steppers import EXACT, NEWTON, NOTHING, SERIES, SIMPLIFIED
from xdynamics.schema import SERIES_ARITHMETIC

Arrays = dict[str, NDArray[Any]]
Floats = NDArray[np.float64]

FUSED = (
    "fma: each product is rounded together with the sum that it is added to, and a quotient by what does not change is a"
    " product with a reciprocal of 106 bits, in high orders (from two fifths of the order) of 53; products are summed in"
    " two parts, the terms of a step in four"
)
PAIRED = (
    f"{FUSED}; in loops over elements the terms j and k - j of a sum are added to two sums, of squares to one that is"
    " doubled, and powers of one value follow from its series at once"
)
SEPARATE = "products, sums and quotients are rounded one by one, to 106 bits"
MOST_COEFFICIENTS = 1 << 13  # of a run up to which lanes pay with Taylor series: of 16, 1 MB
MOST_FACTORISED = 5  # velocities and states up to which lanes pay where equations are solved: factors are written out
# runs of explicit methods share empty arrays, which nothing writes to
_NOTHING: Arrays = {
    "equations": np.zeros(0, EQUATIONS),
    "unknowns": np.zeros((0, 3), np.int64),
    "entries": np.zeros((0, 4), np.int32),
    "order": np.zeros(0, np.int32),
    "pivots": np.zeros(0, np.int32),
    **{name: np.zeros(0, np.int64) for name in ("groups", "band")},
} | dict.fromkeys(("matrix", "right", "stage", "shifted", "stages", "turned", "past"), np.zeros(0))


class Solver(NamedTuple):
    """A way to solve the equations of a step."""

    address: Callable[[], int]  # of its compiled code, 0 if there is nothing to solve
    arrays: Callable[[Law], Arrays]  # of a run
    reported: Callable[[Settings, Law], dict[str, Any]]  # attributes of a record
    corrections: Callable[[Run, int], tuple[Floats, Floats]]  # the last of every variable, and its size
    sizes: Callable[[Law], dict[str, float]]  # bytes that a march writes to, by what stands there
    in_lanes: Callable[[Law, Settings], bool]  # whether steps side by side can be solved, too


def solver_of(method: Method) -> Solver:
    """Return the solver of the equations of a method's steps."""
    return _SOLVERS[method.solver]


def _newton_arrays(law: Law) -> Arrays:
    """Return the equations of a step as flat lists, and room for one matrix."""
    rows = np.zeros(len(law.equations), EQUATIONS)
    unknowns: list[NDArray[np.int64]] = [np.zeros((0, 3), np.int64)]
    entries: list[tuple[int, int, int, int]] = []
    for row, equations in zip(rows, law.equations, strict=True):
        row.evaluations, row.residuals = equations.evaluations, equations.residuals
        row.first_unknown, row.first_entry = sum(map(len, unknowns)), len(entries)
        for *places, count in equations.unknowns:
            unknowns.append(np.arange(count)[:, None] + np.array(places))
        row.unknowns, row.entries = sum(map(len, unknowns)) - row.first_unknown, len(equations.entries)
        entries += equations.entries
        row.state, row.weights, row.derivatives = equations.state, equations.weights, equations.derivatives
    largest = int(max(rows["unknowns"]))
    arrays: Arrays = {"equations": rows, "unknowns": np.concatenate(unknowns), "right": np.zeros(largest)}
    if (rows["state"] < 0).all():
        dense_arrays: Arrays = {
            "entries": np.array(entries, np.int32).reshape(-1, 4),
            "matrix": np.zeros(largest * largest),
        }
        dense_arrays["shifted"] = np.zeros(2 * largest)
        return _NOTHING | arrays | dense_arrays
    system, height = _matrix_system(law.layout, largest)
    lengths = dict.fromkeys(("stage", "shifted"), law.layout.record.size) | {"matrix": largest * height}
    scratch: Arrays = {name: unwritten(length) for name, length in lengths.items()}
    return _NOTHING | arrays | system | scratch | {"pivots": unwritten(3 * largest, np.int32)}


def _simplified_arrays(law: Law) -> Arrays:
    layout, used = law.layout, law.layout.used.size
    size = used - layout.coordinates.size
    lengths = dict.fromkeys(("stages", "turned", "past"), 3 * used)
    system, height = _matrix_system(layout, size)
    lengths |= dict.fromkeys(("stage", "shifted"), layout.record.size) | {"matrix": 3 * size * height}
    arrays: Arrays = {name: unwritten(length) for name, length in lengths.items()}
    arrays["right"] = arrays["stage"]  # while equations are solved nothing is evaluated
    return _NOTHING | arrays | system | {"pivots": unwritten(6 * size, np.int32)}


def _matrix_system(layout: Layout, size: int) -> tuple[Arrays, int]:
    """Return the entries of a matrix and the order of its unknowns, and how many numbers a column has."""
    if not is_compressed(layout):
        entries = np.array(layout.couplings, np.int32).reshape(-1, 2)
        written_system: Arrays = {"entries": entries, "order": np.arange(size, dtype=np.int32)}
        band = band_as_written(entries, layout.coordinates.size, size)
        return (
            (written_system, size)
            if band is None
            else (written_system | {"band": np.array([band.lower, band.upper])}, band.height)
        )
    pattern = pattern_of(layout)
    band = pattern.band
    system: Arrays = {"entries": pattern.entries, "groups": pattern.groups}
    if band is None:
        return system | {"order": np.arange(size, dtype=np.int32)}, size
    return system | {"order": band.order, "band": np.array([band.lower, band.upper])}, band.height


def _newton_sizes(law: Law) -> dict[str, float]:
    arrays = _newton_arrays(law)
    return {"the matrix": float(arrays["matrix"].nbytes), "the equations": 8.0 * law.memory}


def _simplified_sizes(law: Law) -> dict[str, float]:
    """Return the bytes of `_simplified_arrays` that a march touches, part by part.

    Less than is allocated: a third of the array for row exchanges, and no stages in the memory that laws see.
    """
    layout, used = law.layout, law.layout.used.size
    size = used - layout.coordinates.size
    system, height = _matrix_system(layout, size)
    entries = system["entries"]
    return {
        "factors of a real and a complex matrix": 24.0 * size * height + 8.0 * size,
        "derivatives and their places": 8.0 * len(entries) + entries.nbytes + 8.0 * used + 4.0 * size,
        "stages, their corrections and those of the step before": 72.0 * used,
        "a state for them": 8.0 * layout.record.size,
    }


def _newton_reported(_settings: Settings, _law: Law) -> dict[str, Any]:
    return {
        "solver_equations_solved_by": (
            "Newton's method with exact Jacobians, until a correction is below the tolerance times the size of its"
            " unknown"
        ),
        "solver_newton_tolerance": NEWTON_TOLERANCE,
        "solver_newton_most_iterations": MOST_ITERATIONS,
    }


def _simplified_reported(settings: Settings, law: Law) -> dict[str, Any]:
    linked = bool(law.layout.model.assemblies)
    loosely = settings.adaptive and not linked
    return {
        "solver_equations_solved_by": SOLVED_WITH_LINKS if linked else SOLVED_BY,
        "solver_jacobian": settings.jacobian,
        "solver_newton_tolerance": SHARE if loosely else SETTLED,
        "solver_newton_most_iterations": int(MOST_TURNS if loosely else MOST_SETTLING),
    }


def _series_reported(settings: Settings, law: Law) -> dict[str, Any]:
    if settings.precision == DOUBLE_DOUBLE:
        return {SERIES_ARITHMETIC: SEPARATE}
    return {SERIES_ARITHMETIC: PAIRED if has_pairs(law.source) else FUSED}


def _newton_corrections(run: Run, n: int) -> tuple[Floats, Floats]:
    last = run.equations[-1]
    first, unknowns = int(last["first_unknown"]), int(last["unknowns"])
    places, variable_indices = run.unknowns[first : first + unknowns, 0], run.unknowns[first : first + unknowns, 1]
    corrections, sizes = np.zeros(n), np.zeros(n)
    corrections[variable_indices], sizes[variable_indices] = (
        run.right[:unknowns],
        np.abs(run.w[places]) + np.abs(run.y[variable_indices]),
    )
    return corrections, sizes


def _simplified_corrections(run: Run, n: int) -> tuple[Floats, Floats]:
    stages = np.abs(run.stages[: 3 * n]).reshape(3, n).max(axis=0)
    return run.right[:n], np.abs(run.y[:n]) + stages


def _simplified_in_lanes(law: Law, settings: Settings) -> bool:
    """Whether steps are chosen by the embedded formula, with exact derivatives of few variables."""
    scheme, layout = law.scheme, law.layout
    small = layout.used.size - layout.coordinates.size <= MOST_FACTORISED
    exact = scheme.estimator == EMBEDDED and scheme.jacobian == EXACT
    return settings.adaptive and small and exact and not layout.compensation


def _series_in_lanes(law: Law, _settings: Settings) -> bool:
    """Whether the coefficients of some runs are few enough to stay near the processor."""
    return law.memory <= MOST_COEFFICIENTS


_SOLVERS = {
    NOTHING: Solver(
        address=lambda: 0,
        arrays=lambda _law: _NOTHING,
        reported=lambda _settings, _law: {},
        corrections=lambda _run, n: (np.zeros(n), np.ones(n)),
        sizes=lambda law: {"stages": 8.0 * law.storage},
        in_lanes=lambda _law, _settings: True,
    ),
    SERIES: Solver(
        address=lambda: solvers().series,
        arrays=lambda _law: _NOTHING,
        reported=_series_reported,
        corrections=lambda _run, n: (np.zeros(n), np.ones(n)),
        sizes=lambda law: {"coefficients of the series": 8.0 * law.memory},
        in_lanes=_series_in_lanes,
    ),
    NEWTON: Solver(
        address=lambda: solvers().newton,
        arrays=_newton_arrays,
        reported=_newton_reported,
        corrections=_newton_corrections,
        sizes=_newton_sizes,
        in_lanes=lambda _law, _settings: False,
    ),
    SIMPLIFIED: Solver(
        address=lambda: solvers().radau,
        arrays=_simplified_arrays,
        reported=_simplified_reported,
        corrections=_simplified_corrections,
        sizes=_simplified_sizes,
        in_lanes=_simplified_in_lanes,
    ),
}
