"""Graphs of all stages that march: described before anything is marched, and linear in the number of marches."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import no_march
from xdynamics.evidence.stages import task_of

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
METHODS = ["rk4", "heun", "midpoint", "velocity_verlet", "position_verlet", "ruth3"]
# by the number of marches; of a budget four levels and as many blocks of 512 draws
STAGES: dict[str, Callable[[int], xr.Dataset]] = {
    "refine": lambda n: xd.refine(
        OSCILLATOR, method="rk4", steps=[0.1 / (k + 1) for k in range(n)], until=1.0, compute=False
    ),
    "error_budget": lambda n: xd.error_budget(
        BALL, "y", at="1 s", method="rk4", step=0.05, draws=512 * n, only=["truncation", "vt"], compute=False
    ),
    "certify": lambda n: xd.certify(BALL, "y", at="1 s", method="rk4", step=0.05, draws=512 * n, compute=False),
    "validate": lambda n: xd.validate(METHODS[:n], compute=False),
    "sweep": lambda n: xd.sweep(OSCILLATOR, {"k": f"1:2:{n} N m-1"}, members_per_task=1, keep=["end"]),
}


@pytest.mark.parametrize("stage", STAGES)
def test_a_graph_is_linear_in_marches(stage: str) -> None:
    """Assert as many more tasks from two marches to four as from four to six, while every march fails."""
    with no_march():
        made = [STAGES[stage](n) for n in (2, 4, 6)]
        two, four, six = (len(dict(found.__dask_graph__())) for found in made)
    assert six - four == four - two > 0


@pytest.mark.parametrize("stage", ["simulate", "companion", "modes", "limiting", "diagnose"])
def test_a_stage_of_a_run_marches_nothing_before_it_is_computed(stage: str) -> None:
    """Assert it of stages of one run or of three, as many marches in the graph, and tasks that are as few."""
    asked = {"method": "rk4", "step": 0.1, "until": 1.0}
    with no_march():
        run = xd.simulate(OSCILLATOR, **asked, sizes={"step": 11}, compute=False)
        makes: dict[str, Callable[[], xr.Dataset]] = {
            "simulate": lambda: run,
            "companion": lambda: xd.companion(run, compute=False),
            "modes": lambda: xd.modes(OSCILLATOR, compute=False),
            "diagnose": lambda: xd.diagnose(run, companion=False, occurrences=3, compute=False),
            "limiting": lambda: xd.limiting(
                OSCILLATOR, "k", ["3 N m-1", "2 N m-1"], "1 N m-1", at="1 s", compute=False, **asked
            ),
        }
        task = task_of(makes[stage]())
    assert task is not None
    names = {str(name) for name in task.layers}
    marched = {name for name in names if name.startswith("march-")}
    assert len(marched) == {"limiting": 3, "modes": 0}.get(stage, 1)
    assert len(names) <= 3 * max(1, len(marched))
