"""Random models with dimensions by Taylor series: loops side by side against the elements written out one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.random_shapes import random_shapes
from xdynamics.kernels.jets import Expansion, Motion, expansion
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import expanded, forces_by_elements
from xdynamics.march.configuration import settings_for
from xdynamics.model.motion import constants

DEGREE = 5


def coefficients(found: Expansion, layout: Layout, *, plain: bool = False, abreast: int = 1) -> NDArray[np.float64]:
    """The coefficients of a model's state at its start."""
    given, n = constants(layout.model), layout.coordinates.size
    y, w = np.zeros(layout.record.size), np.zeros(found.memory)
    for begin, name in ((0, "place"), (n, "speed")):
        y[begin : begin + n] = [value for key, value in given.items() if key.startswith(name)]
    call = in_python(found.program) if plain else compiled(found.program, abreast=abreast)
    call(y=y, w=w, p=np.array([*given.values()]), at=np.zeros(8))
    return w[: (DEGREE + 1) * layout.used.size].reshape(DEGREE + 1, -1)


@pytest.mark.cases(141)
def test_loops_have_the_series_of_elements_one_by_one(case: int) -> None:
    """Assert the same to rounding, and with 4, 8 or 16 rows at once what plain Python has to the bit."""
    model = xd.Model.from_text(random_shapes(case))
    layout = settings_for(model, method="taylor", step="1 s", until="1 s").layout(model)
    found, motion = expanded(layout, DEGREE), Motion(layout.coordinates.size, layout.states.size)
    single = expansion(forces_by_elements(layout), motion, DEGREE, written_out=False)
    loops, wanted = (coefficients(each, layout, plain=True) for each in (found, single))
    assert np.isfinite(wanted).all()
    assert (np.abs(loops - wanted) <= 1e-11 * np.abs(wanted).max(axis=1, keepdims=True)).all()
    assert coefficients(found, layout, abreast=(4, 8, 16)[case % 3]).tobytes() == loops.tobytes()
