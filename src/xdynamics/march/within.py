"""States between the rows of a log: steps of one run or of many made again, shortened to end where they are asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.kernels import Law
from xdynamics.march.engine import engine
from xdynamics.march.log import allocate
from xdynamics.march.posing import posed
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.units import TIME

Floats = NDArray[np.float64]


def states_within(
    model: Model,
    settings: Settings,
    law: Law,
    where: Floats,
    columns: Floats,
    factors: Floats,
    *,
    reintegrated: bool,
    parameters: Floats | None = None,
    runs: NDArray[np.int64] | None = None,
) -> Floats:
    """Evaluate states inside steps, and how far each is from a more accurate one.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
    where : ndarray, shape (3, k), s
        Wanted time, start and end of its step.
    columns : ndarray, shape (3 + r + n or 3 + r + 2*n, k)
        Step size, regime, kind of the row at the start, what each reaction does there, the state there, and of a method
        whose iterations go on from those of the step before the state that the step led to; in units of the record.
    factors : ndarray, shape (n, 1)
        From internal numbers to those.
    reintegrated : bool
        Whether by a shorter step, or by the interpolant of the whole one.
    parameters : ndarray, shape (m, …), optional
        Of each of many runs, in internal units.
    runs : ndarray of int, shape (k,), optional
        Which of them each time is of.

    Returns
    -------
    ndarray, shape (2*n, k)
        The states, and their distances. At an accepted time the accepted state, to the bit.
    """
    scale, n, touching = settings.scales.of(TIME), len(law.layout.used), len(reactions(model))
    times, starts, ends = where / scale
    moving = np.flatnonzero(times > starts)
    size, regime, behind = columns[0], columns[1], columns[2] == schema.EVENT_AFTER
    states, columns = columns[3 : 3 + touching], columns[3 + touching :]
    found = np.vstack([columns[:n], np.zeros((n, times.size))])
    if not moving.size:
        return found
    which = np.zeros(times.size) if runs is None else runs
    steps = np.stack([starts, ends, size / scale, times, which, regime, behind, *states])
    given = [steps, columns[:n] / factors, columns[n:] / factors[: len(columns) - n]]
    inner = np.empty((2 * n, moving.size))
    # a run of its own: this is called in several threads
    addresses = law.addresses if reintegrated else law.addresses_inside
    run = posed(model, settings, law, allocate(law.layout, 1, sampled=0), addresses)
    given = [np.ascontiguousarray(one[:, moving]) for one in given]
    told = np.zeros((0, 0)) if parameters is None else np.ascontiguousarray(parameters)
    engine().states_inside(run, told, *given, inner, reintegrated)
    found[:, moving] = inner * np.vstack([factors, factors])
    return found
