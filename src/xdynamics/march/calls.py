"""Calls of laws and of the engine's entries by their addresses, and runs behind addresses.

What is called so is compiled once and by itself: a law for its model and method, an entry for all its callers. Here stands
what each does where nothing is compiled, with a key of `UNCOMPILED` for an address and the run itself for a run's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics.kernels.compiling import UNCOMPILED, in_code


def _instruction_named(name: str) -> Any:
    # late: only a process that compiles the engine needs numba
    from xdynamics.march.run_in_code import instruction_named

    return instruction_named(name)


def _itself(run: Any) -> Any:
    return run


def _march_plainly(march: Any, run: Any, rows: int) -> None:
    march(run, rows)


def _by_key(entry: int, *arguments: Any) -> None:
    UNCOMPILED[int(entry)](*arguments)


def call_law_plainly(address: int, run: Any, y: Any, z: Any, sample: int) -> None:
    """Call the Python function that stands for an address where nothing is compiled."""
    UNCOMPILED[int(address)](run.at, y, run.p, run.tables, run.places, z, run.e, run.samples[sample:], run.w)


def apply_plainly(address: int, x: float) -> Any:
    """Call the function of one number that stands for an address where nothing is compiled."""
    return np.float64(UNCOMPILED[int(address)](float(x)))


def write_row_plainly(address: int, run: Any, y: Any, row: int) -> None:
    """Call the Python function that fills a row of the log where nothing is compiled."""
    call_law_plainly(address, run, y, run.log_rows[:, row], 0)


run_at: Any = in_code(_itself, "run_at", _instruction_named)
floats_at: Any = in_code(_itself, "floats_at", _instruction_named)
stepped_by: Any = in_code(_by_key, "stepped_by", _instruction_named)
enclosed_by: Any = in_code(_by_key, "enclosed_by", _instruction_named)
row_by: Any = in_code(_by_key, "row_by", _instruction_named)
march_by: Any = in_code(_march_plainly, "march_by", _instruction_named)
strode_by: Any = in_code(_by_key, "strode_by", _instruction_named)  # without a compiler there are no lanes
apply_function: Any = in_code(apply_plainly, "applied", _instruction_named)
call_law: Any = in_code(call_law_plainly, "called", _instruction_named)
call_row_writer: Any = in_code(write_row_plainly, "noted", _instruction_named)
