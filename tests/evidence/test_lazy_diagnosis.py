"""Diagnoses and limiting cases as graphs."""

from __future__ import annotations

from typing import Any

import dask
import numpy as np
import pytest

import xdynamics as xd
from cases.chunked import chunked
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches, no_march
from xdynamics.documenting.summary import summary

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
DIAGNOSED: dict[str, tuple[dict[str, Any], dict[str, Any], int]] = {
    "harmonic_oscillator": (
        {"method": "rk4", "step": 0.05, "until": 8.0},
        {"exact": {"x": "cos(2*t/second)*metre"}},
        3,
    ),
    "ball_drag": ({"step": 0.05}, {}, 3),
    "coupled_masses": ({"step": 0.01, "until": 5.0}, {"level": "1 mm", "reference": "2 s"}, 2),
    "bouncing_ball": ({"until": 2.0}, {"companion": False}, 1),
    "double_pendulum": ({"method": "dop853", "rtol": 1e-6, "until": 2.0}, {"lyapunov": 2, "companion": False}, 1),
}
SAID_LATER = ("drift_", "energy_drift", "cycle_time", "lyapunov_exponents")  # whose words depend on cycles and pieces


def test_gates_of_a_lazy_diagnosis_have_their_labels() -> None:
    """Assert that what is asked of a record with contacts is named before anything is marched."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    run = xd.simulate(model, until="1 s", compute=False, sizes={"step": 2000})
    lazy = xd.diagnose(run, occurrences=1, companion=False, compute=False)
    assert lazy["gate"].values.tolist() == ["contacts_admissible"]


@pytest.mark.dear
@pytest.mark.parametrize("name", DIAGNOSED)
def test_a_lazy_diagnosis_is_described_and_has_the_bits_of_the_eager_one(name: str) -> None:
    """Assert names, units and sizes of a run that is still to be marched, each march once, and the same numbers."""
    asked, more, count = DIAGNOSED[name]
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    eager = xd.diagnose(xd.simulate(model, **asked), occurrences=4, **more)
    with no_march():
        run = xd.simulate(model, compute=False, sizes={"step": eager.sizes.get("step", 9)}, **asked)
        found = xd.diagnose(run, occurrences=4, compute=False, **more)
    apart = [name for name in eager.variables if str(name).startswith(SAID_LATER)]
    later = {*found.variables} - {*eager.variables}
    assert later == {"level", "level_rule", "maxima", "reference", "cycle_doubt", "continuity_rule"}
    assert_described(
        *(
            item.drop_vars(apart)
            .drop_attrs(deep=False)
            .assign_attrs({k: v for k, v in item.attrs.items() if k not in later})
            for item in (found.drop_vars(later), eager)
        )
    )
    with marches() as begun:
        assert_same_bits(found, eager)
    assert len(begun) == count
    assert {k: found[k].values.item() for k in later} == {k: eager.attrs.get(k, "") for k in later}
    assert summary(found.compute())[2:] == summary(eager)[2:]


@pytest.mark.dear
def test_only_as_many_cycles_as_are_asked_for() -> None:
    """Assert the first ones, nan behind the last, words that count those that there are, and the remedy without a number."""
    run = xd.simulate(OSCILLATOR, method="rk4", step=0.05, until=14.0)
    every = xd.diagnose(run, companion=False)
    for count in (0, 2, 9):
        some = xd.diagnose(run, companion=False, occurrences=count)
        both = min(count, every.sizes["cycle"])
        assert some.sizes["cycle"] == some.sizes["turn"] == count
        assert some.period.values[:both].tobytes() == every.period.values[:both].tobytes()
        assert np.isnan(some.period.values[both:]).all()
    assert any(f": {every.sizes['cycle']}, phases" in line for line in summary(some))
    with pytest.raises(xd.InputError, match="give the number to list, like occurrences=10"):
        xd.diagnose(run, compute=False)
    with pytest.raises(xd.InputError, match="occurrences is -1, needs a non-negative whole number"):
        xd.diagnose(run, occurrences=-1)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"of": "z"}, "'z' is no coordinate"),
        ({"level": "1 kg"}, "level is '1 kg', needs the unit 'm'"),
        ({"reference": -1.0}, "needs a positive period"),
        ({"exact": {"x": "cos(t)"}}, "exact 'x'"),
        ({"exact": {"q": "t"}}, "exact names 'q'"),
        ({"lyapunov": 0}, "lyapunov is 0, needs true"),
        ({"occurrences": None}, "like occurrences=10"),
    ],
)
def test_what_is_wrong_with_a_diagnosis_is_told_before_the_march(more: dict[str, Any], message: str) -> None:
    """Assert one line each while every march fails."""
    run = xd.simulate(OSCILLATOR, compute=False, method="rk4", step=0.05, until=8.0)
    with no_march(), pytest.raises(xd.InputError, match=message):
        xd.diagnose(run, compute=False, **{"occurrences": 3} | more)


@pytest.mark.dear
def test_diagnoses_of_several_methods_share_their_reference() -> None:
    """Assert that the nearly exact run is one task of a graph, and that a study's level is not marched again."""
    asked: dict[str, Any] = {"step": 0.02, "until": 4.0, "force_samples": "none"}
    runs = [xd.simulate(OSCILLATOR, method=method, compute=False, **asked) for method in ("rk4", "heun")]
    stages = [xd.diagnose(run, occurrences=1, compute=False) for run in runs]
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.02, 0.01], until=4.0, compute=False)
    with marches() as begun:
        dask.compute(*stages, study, *(run.x for run in runs))
    assert sorted(line.partition("oscillator ")[2] for line in begun) == [
        "dop853 None",
        "heun 0.01",
        "heun 0.02",
        "rk4 0.01",
        "rk4 0.02",
    ]


@pytest.mark.dear
def test_exponents_of_a_run_in_chunks() -> None:
    """Assert the bits of the run in memory, from chunks that are read once."""
    model = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-6, until=2.0)
    lazy, reads = chunked(run, [5, 7, run.sizes["step"] - 12])
    asked: dict[str, Any] = {"companion": False, "lyapunov": True}
    found, whole = (xd.diagnose(item, **asked) for item in (lazy, run))
    assert found.lyapunov_exponents.values.tobytes() == whole.lyapunov_exponents.values.tobytes()
    assert {*reads.values()} == {1}


def test_what_is_wrong_with_a_limiting_case_is_told_before_the_march() -> None:
    """Assert an unknown observable, values that do not come closer, and a run that ends before when it is computed."""
    asked: dict[str, Any] = {"at": ["1 s"], "method": "rk4", "step": "10 ms", "until": "1 s", "compute": False}
    with no_march():
        with pytest.raises(xd.InputError, match="observable 'z' is none of the model's"):
            xd.limiting(OSCILLATOR, "k", [4.4, 4.2], 4.0, observables=["z"], **asked)
        with pytest.raises(xd.InputError, match="that come closer"):
            xd.limiting(OSCILLATOR, "k", [4.2, 4.4], 4.0, **asked)
        late = xd.limiting(OSCILLATOR, "k", [4.4, 4.2], 4.0, **asked | {"at": ["2 s"]})
    with pytest.raises(xd.InputError, match=r"with k = 4\.4 N m-1 the run ends before"):
        late.x.compute()
