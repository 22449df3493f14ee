"""Extremes and times of sweeps: random models and axes against single runs, lanes against one lane, closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.evidence.diagnosing.summits import ROUNDS, crests, humps, summits
from xdynamics.march import march_many
from xdynamics.march.asking import settings_for

N = 40  # members, enough for lanes on any machine
X, V = "(x/metre)", "(v_x*second/metre)"
PARTS = (
    f"sin(3*{X})", f"exp(-{X}**2)", f"tanh({X}*{V})", f"atan2({X}, 1 + {V}**2)", f"hypot({X}, {V})", f"abs({V})", f"{X}**3",
    "t/second", f"where({X} > 0.3, 1, -0.5)", "cos(2*t/second)",
)  # fmt: skip
WAYS: tuple[dict[str, Any], ...] = (
    {"method": "dop853", "rtol": 1e-8}, {"method": "dormand_prince", "rtol": 1e-6}, {"method": "bogacki_shampine", "rtol": 1e-5},
    {"method": "rk4", "step": 0.06}, {"method": "heun", "step": 0.05},
)  # fmt: skip


def random_model(rng: np.random.Generator) -> xd.Model:
    """A mass on a spring with random forces, perhaps a measured one, perhaps a hidden switch, perhaps an event."""
    text = " + ".join(f"{float(rng.normal())!r}*{part}" for part in rng.choice(PARTS, 2, replace=False))
    more: dict[str, Any] = {}
    forces: dict[str, Any] = {
        "spring": {"potential": "k*x**2/2"}, "strange": {"x": f"newton*({text})", "smooth": bool(rng.random() < 0.6)},
    }  # fmt: skip
    if rng.random() < 0.5:
        times, kind = (
            np.cumsum(rng.uniform(0.01, 0.3, int(rng.integers(3, 60)))),
            str(rng.choice(["previous", "linear", "pchip"])),
        )
        rows = "".join(f"{float(t)!r},{float(f)!r}\n" for t, f in zip(times, rng.normal(size=times.size), strict=True))
        more["drives"] = {"push": {"table": "p.csv", "csv": f"t [s],p [N]\n0,0\n{rows}19,0\n", "interpolation": kind}}
        forces["push"] = {"x": "push"}
    if rng.random() < 0.3:
        more["events"] = {"level": {"function": "x - 0.2*metre", "direction": "rising"}}
    return xd.Model(
        name="random", coordinates={"x": "m"}, parameters={"m": "1 kg", "k": "4 N m-1"}, mass={"x": "m"}, forces=forces,
        observables={"power": "k*x*v_x", "depth": "-abs(x - 0.1*metre)"}, initial={"x": "0.3 m", "v_x": "0 m s-1"}, **more,
    )  # fmt: skip


@pytest.mark.cases(100)
def test_random_sweeps_are_single_runs(case: int) -> None:
    """Assert of random models the bits of logs in lanes, of extremes as a diagnosis has them, of states at times."""
    rng = np.random.default_rng([case, 27])
    model, way = random_model(rng), WAYS[int(rng.integers(len(WAYS)))]
    stiffness, end = rng.uniform(1.0, 9.0, N), float(rng.uniform(1.0, 4.0))
    settings = settings_for(model, until=end, force_samples="none", **way)
    given = {"parameters": {"k": stiffness}, "initial": {"x": rng.uniform(-1.0, 1.0, N)}}
    alone, abreast = (march_many(model, settings, lanes=lanes, logs=True, **given) for lanes in (1, 4))
    for name in ("ends", "first_row", "largest", "events"):
        assert getattr(alone, name).tobytes() == getattr(abreast, name).tobytes(), name
    assert alone.kept.log.rows.tobytes() == abreast.kept.log.rows.tobytes()
    assert alone.kept.log.flags.tobytes() == abreast.kept.log.flags.tobytes()
    words = [
        f"{word}_{name}" for word in ("maximum", "minimum") for name in ("x", "v_x", "power", "depth", "total_energy")
    ]
    times = np.sort(rng.uniform(0.0, end, 7))
    found = xd.sweep(model, {"k": stiffness}, keep=[*words, "x", "power"], times=times, until=end, **way).compute()
    i = int(rng.integers(N))
    run = xd.simulate(model.replace(parameters={"k": f"{float(stiffness[i])!r} N m-1"}), until=end, **way)
    told, at = xd.diagnose(run, companion=False), xd.sample(run, times)
    for word in words:
        assert float(found[word][i]) == float(told[word]), word
        assert float(found[f"{word}_time"][i]) == float(told[f"{word}_time"]), word
    assert found.x[i].values.tobytes() == at.x.values.tobytes()
    assert found.power[i].values.tobytes() == (float(stiffness[i]) * at.x * at.v_x).values.tobytes()


@pytest.mark.cases(300)
def test_summits_of_curves(case: int) -> None:
    """Assert summits of random sums of sines, and of a kink, to rounding, in few looks; none below a value at a row."""
    rng = np.random.default_rng([case, 28])
    if case % 3:
        size, pace, phase = rng.uniform(0.2, 1.0, (3, 3)) * [[1.0], [2.0], [6.0]]

        def value(t: Any) -> Any:
            return sum(a * np.sin(w * t + p) for a, w, p in zip(size, pace, phase, strict=True))

        def rate(t: Any) -> Any:
            return sum(a * w * np.cos(w * t + p) for a, w, p in zip(size, pace, phase, strict=True))
    else:
        left, right, kink = rng.uniform(0.1, 3.0), rng.uniform(0.1, 3.0), rng.uniform(2.0, 8.0)

        def value(t: Any) -> Any:
            return np.where(t < kink, left * (t - kink), right * (kink - t))

        def rate(t: Any) -> Any:
            return np.where(t < kink, left, -right)

    time, first = np.sort(np.concatenate([[0.0, 10.0], rng.uniform(0.0, 10.0, 60)])), np.array([0, 62])
    rows, members = humps(value(time), time, first, *crests(value(time), first))
    rates = rate(time[np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, 61)])])
    top = int(np.argmax(value(time)))
    search = summits(1.0, value(time[[top]]), time[[top]], value(time), time, first, rates, rows, members)
    rounds = 0
    while (places := search.places()).size:
        search.narrow(value(places), rate(places))
        rounds += 1
    fine = np.linspace(0.0, 10.0, 200_001)
    assert search.best[0] >= value(fine).max() - 1e-13
    assert search.best[0] <= value(fine).max() + 1e-7 * (case % 3 > 0) + 2e-4 * (case % 3 == 0)
    assert search.best[0] == value(search.when)[0]
    assert case % 3 == 0 or search.best[0] - value(fine).max() >= -1e-15
    assert rounds <= (12 if case % 3 else ROUNDS)
