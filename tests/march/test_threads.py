"""Threads: whatever is marched, sampled or marched in numbers at once comes out as it does alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for

NAMES = ("kepler", "ball_drag", "double_pendulum", "rocket_c6")


def work(number: int) -> str:
    """March, sample and march many of one model of four, by a law that may be compiled by several threads at once."""
    model = xd.Model.from_toml(MODELS / f"{NAMES[number % 4]}.toml")
    method = ("dop853", "rk4", "heun")[number % 3]
    run = xd.simulate(model, method=method, rtol=1e-7, until=2.5)
    found = xd.sample(run, np.linspace(0.0, float(run.time[-1]), 50))
    settings = settings_for(model, method=method, rtol=1e-6, until=1.0)
    name = settings.layout(model).used[0]
    runs = march_many(model, settings, initial={name: model.statement.initial[name].si + 1e-3 * np.arange(20)})
    return (
        xd.content_digest(run)
        + str(float(sum(found[name].values.sum() for name in found.data_vars)))
        + repr(runs.state.sum())
    )


@pytest.mark.dear
def test_eight_threads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that eight threads over a cache without laws give what one gives."""
    from xdynamics.kernels import law
    from xdynamics.march.engine import engine

    engine()
    alone = [work(number) for number in range(12)]
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    law.law_of.cache_clear()
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(work, list(range(12)) * 4))
    assert together == alone * 4
