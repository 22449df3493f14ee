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
RANGES = {"k": ("1 N m-1", "2 N m-1"), "m": ("1 kg", "2 kg"), "x": ("1 m", "2 m")}
ASKED = {"method": "rk4", "step": 0.1, "until": 1.0}


def members(n: int, **axes: str) -> xr.Dataset:
    """A sweep of n stiffnesses, each a task."""
    how = {name: value for name, value in ASKED.items() if name not in axes}
    return xd.sweep(OSCILLATOR, {"k": f"1:2:{n} N m-1"} | axes, members_per_task=1, keep=["end"], **how)


def unmarched(k: int) -> xr.Dataset:
    """A run that is still to be marched."""
    return xd.simulate(OSCILLATOR, **ASKED | {"step": 0.1 / (k + 1)}, compute=False)


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
    "sweep": members,
    "contrast": lambda n: xd.contrast(members(n), "k", compute=False),
    "sensitivities": lambda n: xd.sensitivities(members(n), compute=False),
    "influences": lambda n: xd.influences(members(n), compute=False),
    "convergence": lambda n: xd.convergence(members(n, step="40, 20, 10 ms"), "step", compute=False),
    "precision": lambda n: xd.precision(members(n, step="40, 20, 10 ms"), "step", compute=False),
    "sobol_indices": lambda n: xd.sobol_indices(
        OSCILLATOR, dict([*RANGES.items()][: n // 2]), "end_x", draws=4, members_per_task=4, compute=False, **ASKED
    ),
    "limiting": lambda n: xd.limiting(
        OSCILLATOR, "k", [f"{3 + k} N m-1" for k in range(n)][::-1], "1 N m-1", at="1 s", compute=False, **ASKED
    ),
    "compare": lambda n: xr.merge(
        [
            xd.compare(unmarched(k), unmarched(k + 1), [0.5], compute=False)[["difference_x"]].rename(
                difference_x=f"d{k}"
            )
            for k in range(n)
        ],
        compat="override",
    ),
    "sample": lambda n: xr.merge(
        [xd.sample(unmarched(k), [0.5], compute=False)[["x"]].rename(x=f"x{k}") for k in range(n)], compat="override"
    ),
}


@pytest.mark.every(2)
@pytest.mark.parametrize("stage", STAGES)
def test_a_graph_is_linear_in_marches(stage: str) -> None:
    """Assert as many more tasks from two marches to four as from four to six, while every march fails."""
    with no_march():
        made = [STAGES[stage](n) for n in (2, 4, 6)]
        two, four, six = (len(dict(found.__dask_graph__())) for found in made)
    assert six - four == four - two > 0


def test_rows_of_all_members_are_one_task() -> None:
    """Assert as many tasks for two members as for six, which are marched abreast."""
    with no_march():
        made = [xd.ragged(members(n), sizes={"row": 11 * n}, compute=False) for n in (2, 6)]
    assert len({len(dict(found.__dask_graph__())) for found in made}) == 1


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
    assert len(marched) == {"limiting": 3, "companion": 2, "modes": 0}.get(stage, 1)
    assert len(names) <= 3 * max(1, len(marched))
