"""The largest stable step of a method, computed by applying the lines of its update to linear systems."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial

import numpy as np

from xdynamics.methods.method import Method
from xdynamics.model import Model, Trait
from xdynamics.model.linearisation import free_coordinates, linearise, linearise_each
from xdynamics.runtime.fork_safety import one_blas_thread
from xdynamics.stability.amplification import (
    AT_REST,
    SLOWEST,
    Complexes,
    Floats,
    LinearSystem,
    amplification,
    amplification_factors,
)

ROUND_OFF = 1e-12  # growth in one step that counts as none
SMALLEST, FINER, LARGEST = 1e-5, 1e-2, 1e4  # steps that are tried, over the fastest time scale
CHUNK = 256
FEW_ENTRIES = 8  # in a row of a matrix, on average, up to which it is multiplied entry by entry
MANY = 64  # eigenvalues from which on conjugate ones are left out
FEW_MODES, MOST_MODES = 9, 128  # joined by damping, from which on a search has a guess; that are taken together
AROUND = np.array([1 / 64, 1 / 8, 1 / 2, 1 / 1.2, 1 / 1.02, 1.02, 1.2, 2.0, 8.0, 64.0])  # first steps, over a guess
JOINED, CREEPING = 1e-9, 1e-5  # relative width of a bracket at the end of that search; where slow growth is let pass
NARROW, HALVINGS = 1e-13, 4  # of a bracket: its relative width at the end; halvings that are computed at once

Growth = Callable[[Floats], Floats]  # of each step, relative to what is allowed
OSCILLATOR = LinearSystem.from_jacobian(np.array([[0.0, 1.0], [-1.0, 0.0]]), 1)
DRAGGED = LinearSystem.from_jacobian(np.array([[0.0, 1.0], [0.0, -1.0]]), 1)
DECAY, GROWTH = (LinearSystem.from_jacobian(np.array([[rate]]), 0) for rate in (-1.0, 1.0))


@cache
def oscillator_limit(method: Method) -> float:
    """Return the largest w h below which q'' = -w**2 q stays bounded for every step.

    Returns
    -------
    float
        2 for velocity Verlet, sqrt(8) for the classical Runge-Kutta method; 0 if every step makes it grow, inf if none
        does.

    Notes
    -----
    Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2; the linear test of splitting methods
    in Hairer, Lubich and Wanner, section I.5. The factors of a step lie on the unit circle for conservative methods;
    growth below 1e-12 per step is taken for round-off if it stays there.
    """
    return _largest_step(partial(_relative_growth, method, OSCILLATOR, 0.0), 1.005, creeping=False)


@cache
def decay_limit(method: Method) -> float:
    """Return the largest h over the decay time below which y' = -y/tau stays bounded for every step.

    Returns
    -------
    float
        The smaller of the limits for a velocity under linear drag and for a first-order state; 2 for forward Euler, inf
        for an A-stable method, nan for a method that refuses both.

    Notes
    -----
    The real stability interval of Hairer and Wanner II, section IV.2.
    """
    tests = ((Trait.VELOCITY_DEPENDENT, DRAGGED), (Trait.COUPLED_STATES, DECAY))
    systems = [system for trait, system in tests if trait not in method.refuses]
    return min(
        (_largest_step(partial(_relative_growth, method, system, 0.0), 1.005, creeping=False) for system in systems),
        default=np.nan,
    )


def stable_step(model: Model, method: Method, state: Mapping[str, float], *, growth: float = 0.0) -> float:
    """Return the largest step for which a method is stable on a model linearised about a state.

    Parameters
    ----------
    model : Model
    method : Method
    state : mapping of str to float
        SI numbers for `t`, coordinates, velocities and first-order states.
    growth : float, s-1
        Rate of growth that is tolerated: one over the length of a run lets a mode grow e-fold in it.

    Returns
    -------
    float, s
        inf if every step is stable, 0 if none is, as with forward Euler and an undamped oscillation; nan if the method
        refuses the model, or the linearisation is not finite.

    Raises
    ------
    InputError
        If a force is written in Python, or the state lacks a number.

    Notes
    -----
    Modes that grow in the model itself may grow. If they oscillate, `oscillator_limit` is applied to their frequency.
    """
    system = LinearSystem.from_jacobian(linearise(model, state).reduced, free_coordinates(model))
    return stable_step_of(system, method, model, growth=growth)


@one_blas_thread()
def stable_step_of(
    system: LinearSystem, method: Method, model: Model, *, growth: float = 0.0, at_most: float = np.inf
) -> float:
    """Return the largest stable step for the changes that satisfy constraints, from their linear system.

    Steps over `at_most` need not be looked at, which saves the greater part of the work: a step over it means that all
    below it are stable.
    """
    follows = treats_alike(method) or bool(len(system.acceleration)) or not model.constraints
    if method.refusals(model) or not (follows and np.isfinite(system.fastest)):
        return float(np.nan)
    if system.fastest == 0.0:
        return np.inf
    growing_limit = _growing_limit(method, system)
    step = largest_step(method, system, growth / system.fastest, at_most * system.fastest)
    return (min(step, growing_limit) if growing_limit > 0.0 else step) / system.fastest


@one_blas_thread()
def grows_at(system: LinearSystem, method: Method, step: float, *, growth: float = 0.0) -> bool:
    """Whether errors may grow at a step itself: of one matrix the eigenvalues, of which `stable_step_of` finds hundreds.

    True without a look where that has each mode alone, or is not for the system.
    """
    modes_are_separate = treats_alike(method) or any(
        x is not None for x in (system.squares, system.modes, system.uncoupled)
    )
    if modes_are_separate or not 0.0 < system.fastest < np.inf:
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        scaled_step = step * system.fastest
        growing = _relative_growth(method, system, growth / system.fastest, np.array([scaled_step]))[0] > 1.0
    return bool(growing or scaled_step > _growing_limit(method, system))


def _growing_limit(method: Method, system: LinearSystem) -> float:
    """Return the limit of the fastest oscillation that grows in the model itself."""
    frequency = float(np.max(np.abs(system.eigenvalues.imag), initial=0.0, where=system.growing))
    return oscillator_limit(method) / frequency if frequency > AT_REST else np.inf


def fastest_rate(jacobian: Floats) -> float:
    """Bound the size of every eigenvalue, s-1, of a Jacobian, shape (n, n), by the largest row sum of its square.

    No eigenvalue is computed.
    """
    rows, columns = np.nonzero(jacobian)
    if rows.size > FEW_ENTRIES * len(jacobian):
        squared = jacobian @ jacobian
    else:  # without BLAS, whose threads wait for one another on a busy machine: 50 ms instead of 1 for 100 masses
        begins = np.flatnonzero(np.diff(rows, prepend=-1))
        products = jacobian[rows, columns, None] * jacobian[columns]
        squared = np.add.reduceat(products, begins) if begins.size else products
    return float(np.sqrt(np.abs(squared).sum(axis=1).max(initial=0.0)))


def rough_rate(jacobian: Floats) -> float:
    """Return an upper bound of `fastest_rate` by absolute values, in as many operations as there are entries.

    The square of a matrix of 120 rows waits 30 ms for a second thread of BLAS where the other cores are at work.
    """
    sizes = np.abs(jacobian)
    return float(np.sqrt((sizes * sizes.sum(axis=1)).sum(axis=1).max(initial=0.0)))


def surely_stable(jacobian: Floats, method: Method, coordinates: int, step: float) -> bool:
    """Whether a step can be shown to be stable without eigenvalues, which take 8 s for 1,000 masses.

    This holds for q'' = -K q with a symmetric, diagonally dominant K: its modes oscillate, none faster than the root of
    the largest row sum (Gershgorin), and the method is stable at that frequency.
    """
    n = coordinates
    if len(jacobian) != 2 * n or jacobian[n:, n:].any():
        return False
    k = -jacobian[n:, :n]
    sums, diagonal = np.abs(k).sum(axis=1), k.diagonal()
    oscillates = np.array_equal(k, k.T) and bool(np.all(2.0 * diagonal >= sums * (1.0 - 1e-12)))
    return oscillates and step * float(np.max(sums, initial=0.0)) ** 0.5 < oscillator_limit(method)


@one_blas_thread()
def stiffness(model: Model, method: Method, states: Sequence[Mapping[str, float]], steps: Iterable[float]) -> float:
    """Return the fraction of rows at which the stability of a fast decay limits the step.

    Parameters
    ----------
    model : Model
    method : Method
    states : sequence of mapping
        SI numbers of each row, as `stable_step` takes them.
    steps : iterable of float, s
        Step used at each row; rows without a positive one do not count.

    Returns
    -------
    float
        Rows at which the fastest eigenvalue l that decays rather than oscillates (-Re l >= abs(Im l)) has -Re(l) h
        between 0.5 and 1.5 of `decay_limit`, over all rows; 0 for a method without such a limit.

    Raises
    ------
    InputError
        If a force is written in Python, or a state lacks a number.

    Notes
    -----
    A problem is stiff where the error test of an explicit method keeps its step at the edge of its region of stability:
    Hairer and Wanner II, section IV.2.
    """
    limit = decay_limit(method)
    stepped = [(state, h) for state, h in zip(states, steps, strict=True) if h > 0.0]
    if not stepped or not 0.0 < limit < np.inf:
        return 0.0
    limited = 0
    for linearisation, (_, h) in zip(linearise_each(model, (state for state, _ in stepped)), stepped, strict=True):
        # the eigenvalues of 1,000 masses take 20 s, the bound on them half a second
        jacobian = linearisation.reduced
        if np.isfinite(jacobian).all() and fastest_rate(jacobian) * h >= 0.49 * limit:
            eigenvalues = np.linalg.eigvals(jacobian)
            decays = -eigenvalues.real[-eigenvalues.real >= np.abs(eigenvalues.imag)]
            limited += bool(0.5 * limit <= float(np.max(decays, initial=0.0)) * h <= 1.5 * limit)
    return limited / len(stepped)


def largest_step(method: Method, system: LinearSystem, rate: float = 0.0, at_most: float = np.inf) -> float:
    """Return the largest step below which no mode grows that does not grow in the system itself.

    Parameters
    ----------
    method : Method
    system : LinearSystem
    rate : float
        Rate of growth that is tolerated, over the fastest eigenvalue.
    at_most : float
        The step up to which the search goes, in the unit of the result.

    Returns
    -------
    float
        In units of the fastest time scale; 0 below 1e-5, inf above 1e4.

    Notes
    -----
    For a method that treats all kinds of vector alike each eigenvalue is examined separately, and so are the modes of
    q'' = -K q - C v for every method, if C has them, too; otherwise the factors of the full step are examined, of over
    128 coordinates within the 128 modes that are nearest to growth without what joins them (Rayleigh and Ritz).
    """
    creeping = rate > 0.0
    search = partial(_largest_step, creeping=creeping, at_most=at_most)
    if treats_alike(method):
        examined_values = system.eigenvalues[~system.growing & (system.eigenvalues != 0.0)]
        if examined_values.size >= MANY:  # of a pair, one has the factors of both
            examined_values = np.unique(examined_values.real + 1j * np.abs(examined_values.imag))
        return search(partial(_growth_along, method, examined_values, rate), 1.02)
    if system.squares is not None and np.all(np.abs(system.squares.imag) < AT_REST):
        fastest = float(np.max(system.squares.real, initial=0.0)) ** 0.5
        return _oscillator_limit(method, rate / fastest) / fastest if fastest > SLOWEST else np.inf
    if system.modes is not None:
        return search(partial(_growth_of_modes, method, system.modes, rate), 1.02)
    if system.uncoupled is not None and len(system.acceleration) >= FEW_MODES:
        return _joined_limit(method, system, system.uncoupled, rate)
    ratio = 1.02 if len(system.eigenvalues) <= 16 else 1.1
    return search(partial(_relative_growth, method, system, rate), ratio)


@cache
def treats_alike(method: Method) -> bool:
    """Whether coordinates, velocities and states are advanced by one rule, as Runge-Kutta methods do for y' = k."""
    if not {Trait.VELOCITY_DEPENDENT, Trait.COUPLED_STATES, Trait.NO_COORDINATES}.isdisjoint(method.refuses):
        return False
    jacobian = np.array([[0.0, 1.0, 0.0], [-0.7, -0.2, 0.4], [0.3, 0.5, -0.6]])
    h = np.array([0.3, 0.9])
    first, second = (amplification(method, LinearSystem.from_jacobian(jacobian, n), h) for n in (1, 0))
    scale = np.diag([1.0, LinearSystem.from_jacobian(jacobian, 1).fastest, 1.0])
    return bool(np.allclose(np.linalg.inv(scale) @ second @ scale, first, rtol=0.0, atol=1e-12))


def _joined_limit(method: Method, system: LinearSystem, uncoupled: LinearSystem, rate: float) -> float:
    """Compute the limit of modes that damping couples, from that of the uncoupled modes."""
    creeping = rate > 0.0
    guess = _largest_step(partial(_growth_of_modes, method, uncoupled, rate), 1.02, creeping=creeping)
    near = np.array([guess if 0.0 < guess < np.inf else 1.0])
    order = np.argsort(-_growth_by_mode(method, uncoupled, rate, near)[0], kind="stable")
    growth = partial(_relative_growth, method, system.mode_subsystem(np.sort(order[:MOST_MODES])), rate)
    excess = cache(lambda step: float(growth(np.array([step]))[0]) - 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = (guess * AROUND).tolist() if 0.0 < guess < np.inf else []
        high = next((h for h in steps if excess(h) > 0.0), np.inf)
        low = max((h for h in steps if h < high), default=0.0)
        if low == 0.0 or high == np.inf:
            return _largest_step(growth, 1.1, creeping=creeping)
        low, high = _stability_crossing(excess, low, high, CREEPING if creeping else JOINED)
        return low if creeping or excess(1.01 * high) > 1.0 else 0.0


def _stability_crossing(excess: Callable[[float], float], low: float, high: float, width: float) -> tuple[float, float]:
    """Narrow a bracket in a fifth of the steps that halvings take: eigenvalues are computed for each."""
    from scipy.optimize import brentq

    tried = {low: excess(low), high: excess(high)}

    def bounded_excess(step: float) -> float:
        tried[step] = excess(step)
        return min(max(tried[step], -1.0 / ROUND_OFF), 1.0 / ROUND_OFF)

    brentq(bounded_excess, low, high, xtol=width * high, rtol=width, maxiter=100)
    return max(h for h, more in tried.items() if more <= 0.0), min(h for h, more in tried.items() if more > 0.0)


def _oscillator_limit(method: Method, rate: float) -> float:
    if rate == 0.0:
        return oscillator_limit(method)
    return _largest_step(partial(_relative_growth, method, OSCILLATOR, rate), 1.02, creeping=True)


def _largest_step(growth: Growth, ratio: float, *, creeping: bool, at_most: float = np.inf) -> float:
    """Find the smallest step with growth; inf if none up to `at_most` has.

    Steps in a fixed ratio are tried before bisection: instability over a narrower range can be missed. Unless growth
    may be creeping, growth that rises slowly out of round-off was present at every smaller step: the limit is zero.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow counts as growth
        low, high = _stability_bracket(growth, ratio, at_most)
        if low == 0.0 or high == np.inf:
            return low
        low, high = _bisect_bracket(growth, low, high)
        return low if creeping or growth(np.array([1.01 * high]))[0] > 2.0 else 0.0


def _bisect_bracket(growth: Growth, low: float, high: float) -> tuple[float, float]:
    """Halve a bracket until it is narrow; growth is computed for all middles of some halvings at once, a quarter of the time."""
    while high - low > NARROW * high:
        brackets, middles = [(low, high)], []
        for middle_index in range(2**HALVINGS - 1):  # each followed by that below its middle, and that above
            left, right = brackets[middle_index]
            middles.append((left + right) / 2.0)
            brackets += [(left, middles[-1]), (middles[-1], right)]
        grows, middle_index = growth(np.array(middles)) > 1.0, 0
        for _ in range(HALVINGS):
            if high - low > NARROW * high:
                low, high = (low, middles[middle_index]) if grows[middle_index] else (middles[middle_index], high)
                middle_index = 2 * middle_index + (1 if grows[middle_index] else 2)
    return low, high


def _stability_bracket(growth: Growth, ratio: float, at_most: float) -> tuple[float, float]:
    """Return a stable step and the unstable one next to it; (0, …) if none is stable, (inf, inf) if all are that are tried.

    The first step over `at_most` is the last that is tried.
    """
    fine = np.geomspace(FINER, LARGEST, 2 + int(np.log(LARGEST / FINER) / np.log(ratio)))
    tried = np.concatenate([np.geomspace(SMALLEST, FINER, 20)[:-1], fine])
    tried = tried[: np.searchsorted(tried, at_most) + 1]
    for first in range(0, len(tried), CHUNK):
        unstable = np.flatnonzero(growth(tried[first : first + CHUNK]) > 1.0)
        if unstable.size:
            index = first + int(unstable[0])
            return (float(tried[index - 1]) if index else 0.0), float(tried[index])
    return np.inf, np.inf


def _relative_growth(method: Method, system: LinearSystem, rate: float, h: Floats) -> Floats:
    """Return the growth per step of modes that do not grow in the system, relative to its allowance."""
    multipliers = amplification_factors(amplification(method, system, h))
    scaled_rates = np.abs(system.eigenvalues) * h[:, None]
    at_rest = np.sum(scaled_rates < AT_REST, axis=1)
    growing = np.sum((scaled_rates >= AT_REST) & system.growing, axis=1)
    # a slow mode has nearly parallel eigenvectors, and its factors are less accurate
    slowest = np.min(scaled_rates, axis=1, initial=1.0, where=scaled_rates >= AT_REST)
    growth = _over_allowed(multipliers, (1.0 + h * h) * ROUND_OFF * (1.0 + 0.1 / slowest) + rate * h)
    sorted_index = np.arange(growth.shape[1])
    changes = np.argsort(np.argsort(np.abs(multipliers - 1.0), axis=1), axis=1)
    growth[changes < at_rest[:, None]] = -np.inf
    growth = np.sort(growth, axis=1)
    growth[sorted_index >= growth.shape[1] - growing[:, None]] = -np.inf
    return np.asarray(np.max(growth, axis=1, initial=-np.inf))


def _growth_of_modes(method: Method, modes: LinearSystem, rate: float, h: Floats) -> Floats:
    """Return the relative growth of systems of one coordinate each, along the first axis of `modes`."""
    return np.asarray(_growth_by_mode(method, modes, rate, h).max(axis=1))


def _growth_by_mode(method: Method, modes: LinearSystem, rate: float, h: Floats) -> Floats:
    """Return the relative growth of every mode, shape (steps, modes)."""
    n = len(modes.acceleration)
    return np.asarray(
        _relative_growth(method, modes.repeated_systems(len(h)), rate, np.repeat(h, n)).reshape(len(h), n)
    )


def _growth_along(method: Method, eigenvalues: Complexes, rate: float, h: Floats) -> Floats:
    """Return the relative growth by the stability function R(h l), of a method that treats all vectors alike."""
    z = (h[:, None] * eigenvalues).ravel()
    multipliers = amplification(method, GROWTH, z)[:, 0, 0].reshape(len(h), len(eigenvalues))
    growth = _over_allowed(multipliers, (1.0 + h * h) * ROUND_OFF + rate * h)
    return np.asarray(np.max(growth, axis=1, initial=-np.inf))


def _over_allowed(multipliers: Complexes, allowed: Floats) -> Floats:
    growth = (np.abs(multipliers) - 1.0) / allowed[:, None]
    # nan counts as growth: every comparison with nan is false, and the step would seem stable
    return np.where(np.isnan(growth), np.inf, growth)
