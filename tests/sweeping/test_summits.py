"""Extremes and times of sweeps: random models and axes against single runs, lanes against one lane, closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.evidence.diagnosing.summits import ROUNDS, Summits, crests, humps, summits
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for

N = 40  # members, enough for lanes on any machine
X, V = "(x/metre)", "(v_x*second/metre)"
PARTS = (
    f"sin(3*{X})",
    f"exp(-{X}**2)",
    f"tanh({X}*{V})",
    f"atan2({X}, 1 + {V}**2)",
    f"hypot({X}, {V})",
    f"abs({V})",
    f"{X}**3",
    "t/second",
    f"where({X} > 0.3, 1, -0.5)",
    "cos(2*t/second)",
)
WAYS: tuple[dict[str, Any], ...] = (
    {"method": "dop853", "rtol": 1e-8},
    {"method": "dormand_prince", "rtol": 1e-6},
    {"method": "bogacki_shampine", "rtol": 1e-5},
    {"method": "rk4", "step": 0.06},
    {"method": "heun", "step": 0.05},
)


def random_model(rng: np.random.Generator) -> xd.Model:
    """A mass on a spring with random forces, perhaps a measured one, perhaps a hidden switch, perhaps an event."""
    text = " + ".join(f"{float(rng.normal())!r}*{part}" for part in rng.choice(PARTS, 2, replace=False))
    more: dict[str, Any] = {}
    forces: dict[str, Any] = {
        "spring": {"potential": "k*x**2/2"},
        "strange": {"x": f"newton*({text})", "smooth": bool(rng.random() < 0.6)},
    }
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
        name="random",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces=forces,
        observables={"power": "k*x*v_x", "depth": "-abs(x - 0.1*metre)"},
        initial={"x": "0.3 m", "v_x": "0 m s-1"},
        **more,
    )


@pytest.mark.dear
@pytest.mark.every(3)
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
    assert alone.log_block.log.rows.tobytes() == abreast.log_block.log.rows.tobytes()
    assert alone.log_block.log.flags.tobytes() == abreast.log_block.log.flags.tobytes()
    words = [
        f"{word}_{name}" for word in ("maximum", "minimum") for name in ("x", "v_x", "power", "depth", "total_energy")
    ]
    times = np.sort(rng.uniform(0.0, end, 7))
    found = xd.sweep(model, {"k": stiffness}, keep=[*words, "x", "power"], times=times, until=end, **way).compute()
    i = int(rng.integers(N))
    run = xd.simulate(model.replace(parameters={"k": f"{float(stiffness[i])!r} N m-1"}), until=end, **way)
    inside = times <= float(run.time[-1])  # a motion may end at a switch that both sides drive it back to
    told, at = xd.diagnose(run, companion=False), xd.sample(run, times[inside])
    for word in words:
        assert float(found[word][i]) == float(told[word]), word
        assert float(found[f"{word}_time"][i]) == float(told[f"{word}_time"]), word
    assert found.x[i].values[inside].tobytes() == at.x.values.tobytes()
    assert found.power[i].values[inside].tobytes() == (float(stiffness[i]) * at.x * at.v_x).values.tobytes()
    assert np.isnan(found.x[i].values[~inside]).all()


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


def test_crests_are_no_lower_than_their_neighbours() -> None:
    """Assert rows and members of peaks, plateaus and ends, of two members beside one another and of one with gaps."""
    nan = np.nan
    for values, first, wanted, members in (
        ([1.0, 3.0, 2.0, 2.0, 5.0, 5.0, 1.0, 0.0, 4.0], [0, 9], [1, 4, 5, 8], [0, 0, 0, 0]),
        ([5.0, 1.0, 9.0, 2.0, 3.0, 3.0], [0, 3, 6], [0, 2, 4, 5], [0, 0, 1, 1]),
        ([1.0, 1.0, 1.0], [0, 3], [0, 2], [0, 0]),
        ([nan, 2.0, nan, 1.0, nan], [0, 5], [1, 3], [0, 0]),
        ([-5.0, -3.0, -4.0], [0, 3], [1], [0]),
    ):
        rows, own = crests(np.array(values), np.array(first))
        assert (rows.tolist(), own.tolist()) == (wanted, members)


def test_the_highest_humps_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that crests without a step about them are left out, and of too many in a member the lower ones."""
    monkeypatch.setitem(humps.__globals__, "MOST_HUMPS", 2)
    values = np.array([3.0, 0.0, 5.0, 0.0, 4.0, 0.0, 4.0, 7.0, 0.0, 1.0])
    time, first = np.array([0.0, 1, 2, 3, 4, 5, 6, 0, 0, 0.5]), np.array([0, 7, 10])
    rows, members = humps(values, time, first, *crests(values, first))
    # of equal ones the later; one at 0 s has no step
    assert (rows.tolist(), members.tolist()) == ([2, 6, 9], [0, 0, 1])
    monkeypatch.undo()
    values = np.where(np.arange(2401) % 2, np.arange(2401.0), -1.0)
    rows, _ = humps(values, np.arange(2401.0), np.array([0, 2401]), *crests(values, np.array([0, 2401])))
    assert rows.tolist() == list(range(401, 2400, 2))


def begun(
    sign: float, values: list[float], time: list[float], rates: list[list[float]] | None, rows: list[int]
) -> Summits:
    """A search about humps of one member."""
    best = int(np.argmax(sign * np.array(values)))
    given = None if rates is None else np.array(rates).T
    first, where = np.array([0, len(values)]), np.array(rows)
    return summits(
        sign,
        np.array(values)[[best]],
        np.array(time)[[best]],
        np.array(values),
        np.array(time),
        first,
        given,
        where,
        0 * where,
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_brackets_are_where_the_rate_changes_its_sign(sign: float) -> None:
    """Assert the step to the hump or from it, by the rate there; and that the rest is looked through, or is no place to look."""
    values, time = [sign * value for value in (0.0, 2.0, 1.0)], [1.0, 2.0, 4.0]
    before, behind = (
        begun(sign, values, time, [[3 * sign, -sign, -sign]], [1]),
        begun(sign, values, time, [[3 * sign, sign, -sign]], [1]),
    )
    assert (before.ends.ravel().tolist(), before.rows.tolist()) == ([1.0, 2.0], [0])
    assert (before.values.ravel().tolist(), before.rates.ravel().tolist()) == ([0.0, 2.0], [3.0, -1.0])
    assert (behind.ends.ravel().tolist(), behind.rows.tolist()) == ([2.0, 4.0], [1])
    assert (behind.values.ravel().tolist(), behind.rates.ravel().tolist()) == ([2.0, 1.0], [1.0, -1.0])
    assert before.blind.size == behind.blind.size == 0
    for rates, borders in (([-3.0, -1.0, -1.0], [1.0, 4.0]), ([3.0, 1.0, 1.0], [1.0, 4.0]), ([3.0, 0.0, -1.0], [])):
        search = begun(sign, values, time, [[sign * rate for rate in rates]], [1])
        assert (search.members.size, search.borders.ravel().tolist()) == (0, borders)
    unknown = begun(sign, values, time, None, [1])
    assert (unknown.members.size, unknown.blind.tolist(), unknown.borders.ravel().tolist()) == (0, [0], [1.0, 4.0])
    assert unknown.place_members.tolist() == [0] * 9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_summit_of_a_cubic_is_where_is_looked_first(sign: float) -> None:
    """Assert the first place for a cubic with a summit at 0.4, and that the search ends there."""

    def value(t: Any) -> Any:
        return sign * (7.0 - (t - 0.4) ** 2 * (3.0 - t))

    def rate(t: Any) -> Any:
        return sign * (-2.0 * (t - 0.4) * (3.0 - t) + (t - 0.4) ** 2)

    time = [-0.5, 0.3, 1.0]
    search = begun(sign, [value(t) for t in time], time, [[rate(t) for t in time]], [1])
    places = search.places()
    assert places == pytest.approx([0.4], abs=1e-14)
    search.narrow(value(places), rate(places))
    assert search.places().size == 0
    assert (search.best.tolist(), search.when.tolist()) == (value(places).tolist(), places.tolist())
    assert search.best[0] == pytest.approx(sign * 7.0, abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_has_no_rate_is_looked_through(sign: float) -> None:
    """Assert nine places over a bracket, then nine between the neighbours of the best, twelve times; no number is lowest."""

    def value(t: Any) -> Any:
        return np.where(np.abs(t - 0.7) < 0.05, np.nan, -sign * np.abs(t - 0.3))

    search = begun(sign, [-sign, -sign * 0.5, -sign], [0.0, 0.5, 2.0], None, [1])
    first = search.places()
    assert first.tolist() == np.linspace(0.0, 2.0, 9).tolist()
    search.narrow(value(first), np.zeros(9))
    assert search.places().tolist() == np.linspace(0.0, 0.5, 9).tolist()
    rounds = 1
    while (places := search.places()).size:
        search.narrow(value(places), np.zeros(9))
        rounds += 1
    assert rounds == 11  # and one before, of which the places were asked for twice
    assert search.when[0] == pytest.approx(0.3, abs=2.0 / 4**10)
    assert search.best[0] == value(search.when)[0]
    lost = begun(sign, [-sign, -sign, -sign], [0.0, 1.0, 2.0], None, [1])
    lost.narrow(np.full(lost.places().size, np.nan), np.zeros(9))
    assert (lost.best.tolist(), lost.when.tolist()) == ([-sign], [0.0])


def test_the_first_of_equal_summits_is_taken() -> None:
    """Assert time and value of two summits of one height, and that one that cannot come up to the best is not searched."""
    value, rate = (lambda t: -((np.cos(np.pi * t)) ** 2)), (lambda t: np.pi * np.sin(2 * np.pi * t))
    time = [0.25, 0.5 - 1e-9, 0.75, 1.0, 1.25, 1.5 - 1e-9, 1.75]
    rows, at = [1, 5], np.array(time)
    search = begun(1.0, value(at).tolist(), time, [rate(at[k - 1 : k + 2]).tolist() for k in rows], rows)
    while (places := search.places()).size:
        search.narrow(value(places), rate(places))
    assert search.when[0] < 1.0
    for steep, searched in ((0.9, 0), (1.1, 1)):  # its tangents meet half as high above it as they are steep
        there = begun(1.0, [0.0, 9.0, 0.0, 8.0, 8.0], [0.0, 1.0, 2.0, 3.0, 4.0], [[1.0, steep / 2, -steep / 2]], [3])
        assert there.places().size == searched


@pytest.mark.parametrize("kink", [0.6, 0.35])
def test_a_kink_is_where_tangents_meet(kink: float) -> None:
    """Assert that the fourth place, at the latest, is the kink between two straight lines."""

    def value(t: Any) -> Any:
        return np.where(t < kink, t - kink, 2.0 * (kink - t))

    search = begun(1.0, [value(0.0), value(1.0), -9.0], [0.0, 1.0, 2.0], [[1.0, -2.0, -2.0]], [1])
    for _ in range(4):
        places = search.places()
        search.narrow(value(places), np.where(places < kink, 1.0, -2.0))
    assert float(search.when[0]) == pytest.approx(kink, abs=1e-15)
