"""What a record says of delayed values: delays, what was before the start, how past values were found."""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics.expressions import text_of
from xdynamics.march import March
from xdynamics.march.past_arrays import delay_times
from xdynamics.model.delayed_values import delayed_quantities

BREAKING_POINTS = (
    "start, ticks, points of tables, and events that change the motion, each plus sums of delays, are landed on up to those"
    " where derivative {most} of the motion jumps (Hairer, Norsett, Wanner, Solving ODEs I, II.17); no step is longer than"
    " the shortest delay"
)
AT_START = "its value at the start (default)"


def delay_attributes(march: March) -> dict[str, Any]:
    """Describe the delayed values of a run, if there are any."""
    model, scheme = march.model, march.settings.scheme
    if not model.delays:
        return {}
    history_words = {
        name: text_of(model.history[name]) if name in model.history else AT_START for name in delayed_quantities(model)
    }
    return {
        "solver_delays": np.array(delay_times(model)),
        "solver_delays_units": model.time_unit.text,
        "solver_delay_history": "; ".join(f"{name}: {words}" for name, words in history_words.items()),
        "solver_delay_interpolation": f"polynomials of accepted steps: {scheme.interpolant.words}",
        "solver_delay_interpolation_order": scheme.interpolant.order,
        "solver_breaking_points": BREAKING_POINTS.format(most=scheme.order + 1),
    }
