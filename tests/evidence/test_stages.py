"""Stages as graphs: described without a march, each march once however many numbers and stages need it, the same bits."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import dask
import dask.array
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches, no_march
from xdynamics.evidence.stage_tasks import LIMIT, Gathered, Memory, Task, remembered_megabytes, results_of
from xdynamics.evidence.stages import compute_datasets

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
PARTING = OSCILLATOR.replace(forces={"spring": {"x": "-k*x*sqrt(1.0 - t/second)"}})  # after which there is no force
STUDY: dict[str, Any] = {"method": "rk4", "steps": [0.04, 0.02, 0.01, 0.005], "at": [1.0, 1.234], "until": 10.0}
REFINEMENTS: dict[str, tuple[xd.Model, dict[str, Any]]] = {
    "times": (OSCILLATOR, STUDY),
    "ends": (OSCILLATOR, STUDY | {"at": None}),
    "runs": (OSCILLATOR, STUDY | {"observables": ["total_energy", "energy_range", "period_x", "phase_x"]}),
    "ends apart": (PARTING, STUDY | {"steps": [0.4, 0.3, 0.11], "at": None}),
    "before all ends": (PARTING, STUDY | {"steps": [0.32, 0.16], "at": [0.25, 0.9]}),
    "defects": (OSCILLATOR, STUDY | {"defects": True}),
    "tolerances": (OSCILLATOR, {"method": "dop853", "rtols": [1e-4, 1e-6, 1e-8], "until": 3.0}),
    "events": (BALL, {"steps": [0.04, 0.02, 0.01], "occurrences": 3}),
    "too few events": (BALL, {"steps": [0.04, 0.02], "occurrences": 40}),
    "no events": (BALL, {"steps": [0.04, 0.02], "at": [0.3], "occurrences": 0}),
    "rules": (BALL, {"rules": ["interpolant", "reintegrate"], "occurrences": 2}),
}


# ------------------------------------------------------------------------------------------------------------- refine


@pytest.mark.every(3)
@pytest.mark.parametrize("case", REFINEMENTS)
def test_a_lazy_refinement_is_described_and_has_the_bits_of_the_eager_one(case: str) -> None:
    """Assert names, units and sizes while every march fails, then each level marched once, and the same bits."""
    model, asked = REFINEMENTS[case]
    with no_march():
        study = xd.refine(model, compute=False, **asked)
    eager = xd.refine(model, **asked)
    with no_march():
        assert_described(study, eager)
    with marches() as begun:
        assert_same_bits(study, eager)
    assert len(begun) == len({*eager.run_digest.values})  # rules of events make no difference where there are none


def test_numbers_of_a_refinement_are_marched_once() -> None:
    """Assert one march a level for an order and then a limit, and none for what is known."""
    study = xd.refine(OSCILLATOR, compute=False, **STUDY)
    with marches() as begun:
        assert study.step_size.values.tolist() == STUDY["steps"]
        assert study.at_time.values.tolist() == STUDY["at"]
        assert not begun
        order, limit = float(study.order_x[2, 0]), float(study.limit_x[0])
        assert (round(order, 1), round(limit, 6)) == (4.0, round(np.cos(2.0), 6))
        assert len(begun) == 4


def test_two_refinements_share_their_levels() -> None:
    """Assert that levels that two studies have in common are one task of one graph, and the graph is linear in levels."""
    studies = [
        xd.refine(OSCILLATOR, compute=False, **STUDY | {"steps": steps}) for steps in ([0.04, 0.02], [0.02, 0.01])
    ]
    with marches() as begun:
        dask.compute(*studies)
    assert len(begun) == 3
    for levels in (2, 4, 8):
        steps = [0.1 / 2**k for k in range(levels)]
        study = xd.refine(OSCILLATOR, compute=False, **STUDY | {"steps": steps})
        names = {key for key in study.__dask_graph__() if str(key).startswith("march-")}
        assert len(names) == levels
        assert len(study.order_x.__dask_graph__()) == 2 * levels + 4  # the model, what is asked, the study, the number


def test_levels_are_kept_in_a_folder_when_they_are_computed(tmp_path: Path) -> None:
    """Assert that a lazy study writes no file before it is computed, and then one for each level."""
    study = xd.refine(OSCILLATOR, compute=False, keep=tmp_path / "levels", **STUDY)
    assert not list((tmp_path / "levels").iterdir())
    digests = study.run_digest.values.tolist()
    for k, digest in enumerate(digests):
        with xd.open_run(tmp_path / "levels" / f"level_{k}.nc") as run:
            assert xd.content_digest(run) == digest
    assert len(list((tmp_path / "levels").glob("*.nc"))) == len(digests)


@pytest.mark.dear
def test_a_study_whose_levels_are_kept_goes_on(tmp_path: Path) -> None:
    """Assert that levels that are whole are read, and that those which are missing, damaged or of another run are marched."""
    asked = STUDY | {"keep": tmp_path}
    whole = xd.refine(OSCILLATOR, **asked)
    with no_march():
        assert_same_bits(xd.refine(OSCILLATOR, **asked), whole)
    (tmp_path / "level_0.nc").unlink()
    content = bytearray((tmp_path / "level_1.nc").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "level_1.nc").write_bytes(content)
    (tmp_path / "level_3.nc").write_bytes((tmp_path / "level_2.nc").read_bytes())
    with marches() as begun:
        assert_same_bits(xd.refine(OSCILLATOR, compute=False, **asked).compute(scheduler="synchronous"), whole)
    assert sorted(begun) == [f"Harmonic oscillator rk4 {step}" for step in (0.005, 0.02, 0.04)]


def test_what_is_known_only_after_marching_is_refused_or_said() -> None:
    """Assert that levels added until changes are small, and events of unknown number, name what to give instead."""
    with pytest.raises(xd.InputError, match="give all levels, or compute=True"):
        xd.refine(OSCILLATOR, compute=False, until_change={"x": "1 mm"}, **STUDY)
    with pytest.raises(xd.InputError, match=r"how often floor will be met .* like occurrences=10"):
        xd.refine(BALL, compute=False, steps=[0.04, 0.02])
    for wrong in (-1, 1.5, True, "2"):
        with pytest.raises(xd.InputError, match="occurrences is .*, needs a non-negative whole number"):
            xd.refine(BALL, steps=[0.04, 0.02], occurrences=wrong)  # type: ignore[arg-type]


def test_faults_of_settings_are_told_before_and_of_runs_when_computed() -> None:
    """Assert that a wrong setting is refused at once, and a time that no run reaches by whoever computes."""
    with no_march(), pytest.raises(xd.InputError, match="step"):
        xd.refine(OSCILLATOR, compute=False, **STUDY | {"steps": [0.04, -0.02]})
    study = xd.refine(OSCILLATOR, compute=False, **STUDY | {"at": [11.0]})
    with pytest.raises(xd.InputError, match=r"at has 11\.0 s, needs times in every run"):
        study.order_x.compute()


def test_a_lazy_refinement_is_saved_as_the_eager_one(tmp_path: Path) -> None:
    """Assert that an archive of a lazy stage holds the same numbers, and is written from one march a level."""
    study = xd.refine(OSCILLATOR, compute=False, **STUDY)
    with marches() as begun:
        xd.save(study, tmp_path / "lazy.nc")
        xd.save(study.compute(), tmp_path / "computed.nc")
    assert len(begun) == 4
    with xd.open_run(tmp_path / "lazy.nc") as kept, xd.open_run(tmp_path / "computed.nc") as computed:
        assert_same_bits(kept, computed)


VARIED: dict[str, dict[str, Any]] = {
    "steps": {"method": "rk4", "steps": [0.04, 0.02, 0.01]},
    "rtols": {"method": "dop853", "rtols": [1e-4, 1e-6, 1e-8]},
    "time_tolerances": {"method": "rk4", "step": 0.02, "time_tolerances": ["1e-6 s", "1e-8 s"]},
    "rules": {"method": "rk4", "step": 0.02, "rules": ["interpolant", "reintegrate"]},
}


@pytest.mark.parametrize("varied", VARIED)
def test_a_lazy_refinement_travels_to_another_process(varied: str) -> None:
    """Assert that the graph of a study can be pickled, as a cluster does, and comes to the same bits and words there."""
    asked: dict[str, Any] = {"until": 1.0, "occurrences": 1, **VARIED[varied]}
    sent, eager = pickle.loads(pickle.dumps(xd.refine(BALL, compute=False, **asked))), xd.refine(BALL, **asked)
    with marches():
        found = compute_datasets(sent)[0]
    assert_same_bits(found, eager)
    assert_described(found, eager)


def test_a_lazy_budget_travels_to_another_process() -> None:
    """Assert the same of a budget, whose steps have the unit of the model's time."""
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    asked: dict[str, Any] = {"at": "1 s", "method": "rk4", "step": "50 ms"}
    sent = pickle.loads(pickle.dumps(xd.error_budget(ball, "y", compute=False, **asked)))
    with marches():
        found = compute_datasets(sent)[0]
    assert_described(found, eager := xd.error_budget(ball, "y", **asked))
    assert_same_bits(found, eager)


# ------------------------------------------------------------------------------------------------------------- memory


def test_a_lazy_sweep_is_sent_without_a_march(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a lazy sweep with its origin can be pickled, as `client.compute` does, and marches after that alone."""
    grid = xd.sweep(OSCILLATOR, {"k": ["1 N m-1", "2 N m-1"]}, keep=["end"], until=1.0)
    with monkeypatch.context() as patch:
        patch.setattr(dask.array.Array, "__array__", lambda *_, **__: pytest.fail("it is computed"))
        sent = pickle.loads(pickle.dumps(grid))
    assert_same_bits(sent, grid.compute())
    xd.archive.check_unchanged(sent.compute())


def test_a_memory_forgets_what_was_not_used_for_longest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the bound in bytes, the order in which results go, and that a larger one is not kept at all."""
    monkeypatch.setenv(LIMIT, "0.002")
    memory = Memory()
    for name in ("a", "b"):
        memory.result(name, lambda: np.zeros(100))
    memory.result("a", lambda: pytest.fail("made again"))
    memory.result("c", lambda: np.zeros(100))
    assert list(memory.names()) == ["a", "c"]
    assert memory.result("large", lambda: np.ones(1000)).size == 1000
    assert list(memory.names()) == []


def test_a_memory_counts_what_a_dataclass_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an object that holds a run is as large as the run."""

    @dataclass(frozen=True)
    class Holder:
        run: xr.Dataset
        label: str

    monkeypatch.setenv(LIMIT, "0.002")
    memory = Memory()
    memory.result("small", lambda: Holder(xr.Dataset({"a": ("n", np.zeros(100))}), "a"))
    assert list(memory.names()) == ["small"]
    memory.result("large", lambda: Holder(xr.Dataset({"a": ("n", np.zeros(1000))}), "a"))
    assert list(memory.names()) == []


@pytest.mark.parametrize(("text", "size"), [("7", 7.0), ("0", 0.0), ("-1", 256.0), ("much", 256.0)])
def test_the_bound_of_a_memory_is_set_by_the_environment(
    monkeypatch: pytest.MonkeyPatch, text: str, size: float
) -> None:
    """Assert megabytes, and the default where it is no number."""
    monkeypatch.setenv(LIMIT, text)
    assert remembered_megabytes() == size


def test_threads_that_want_the_same_make_it_once() -> None:
    """Assert that the second of two threads waits for the first, and that a failure is not remembered."""
    memory, made, begun = Memory(), [], threading.Barrier(4)

    def make() -> int:
        made.append(1)
        return 1

    def ask() -> None:
        begun.wait()
        memory.result("a", make)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
    with pytest.raises(ZeroDivisionError):
        memory.result("b", lambda: 1 // 0)
    assert memory.result("b", lambda: 2) == 2


def test_tasks_are_named_by_what_they_depend_on() -> None:
    """Assert that other inputs, needs or kinds make another name."""
    first = Task.of("stage", max, (), 1.0)
    assert first.name == Task.of("stage", max, (), 1.0).name
    others = [Task.of("stage", max, (), 1.5), Task.of("stage", max, (first,), 1.0), Task.of("other", max, (), 1.0)]
    assert len({task.name for task in (first, *others)}) == 4


def test_lazy_variables_that_tasks_need_are_computed_in_one_graph() -> None:
    """Assert that a block that two of them are made from is made once, when the first of them is needed."""
    made: list[str] = []
    block = dask.array.from_delayed(dask.delayed(lambda: made.append("block") or np.arange(3.0))(), (3,), float)
    doubled, squared = (Gathered(xr.DataArray(data)) for data in (2.0 * block, block**2))
    before = Task("before", lambda: made.append("before"))
    first = Task("first", lambda _, numbers: float(numbers.sum()), (before, doubled))
    assert results_of(first, Task("second", np.sum, (squared,)), doubled)[:2] == [6.0, 5.0]
    assert made == ["before", "block"]


# -------------------------------------------------------------------------------------------------------- other stages


COUPLED = xd.Model.from_toml(MODELS / "coupled_masses.toml")
Stage = Callable[..., xr.Dataset]


def companion_of(times: list[float] | None, **asked: Any) -> Stage:
    """A companion of a run that is marched."""
    return partial(xd.companion, xd.simulate(BALL, until=2.0, **asked), times)


def limit_of(observables: list[str] | None) -> Stage:
    """Two masses whose spring vanishes."""
    asked: dict[str, Any] = {"at": ["1 s"], "method": "rk4", "step": "10 ms", "until": "1 s"}
    return partial(xd.limiting, COUPLED, "kc", [0.1, 0.01, 0.001], 0.0, observables=observables, **asked)


LAZY: dict[str, tuple[Callable[[], Stage], int]] = {  # and how many marches each has
    "companion, step": (lambda: companion_of(None, method="rk4", step=0.05), 1),
    "companion at times, step": (lambda: companion_of([0.5, 1.25], method="rk4", step=0.05), 1),
    "companion, rtol": (lambda: companion_of(None, rtol=1e-6), 1),
    "companion at times, rtol": (lambda: companion_of([0.5, 1.25], rtol=1e-6), 1),
    "limiting": (lambda: limit_of(None), 4),
    "limiting of observables": (lambda: limit_of(["x1", "total_energy"]), 4),
    "modes of a start": (lambda: partial(xd.modes, COUPLED), 0),
    "modes of a state": (lambda: partial(xd.modes, OSCILLATOR, at={"x": "1 m"}), 0),
    "modes of a row": (lambda: partial(xd.modes, xd.simulate(COUPLED), row=7), 0),
    "validate": (lambda: partial(xd.validate, ["rk4", "velocity_verlet", "moreau_jean"]), -1),
}


@pytest.mark.every(3)
@pytest.mark.parametrize("name", LAZY)
def test_a_lazy_stage_has_the_bits_of_the_eager_one(name: str) -> None:
    """Assert the description while every march fails, each run marched once, and values; refused cases among them."""
    make, count = LAZY[name][0](), LAZY[name][1]
    with no_march():
        stage = make(compute=False)
    eager = make()
    with marches() as begun:
        assert_described(stage, eager)
        assert not begun
        assert_same_bits(stage, eager)
    if count < 0:  # a task for each of 15 cases and each method
        assert sum(str(key).startswith("case-") for key in stage.residual.__dask_graph__()) == 15 * 3
        assert 0 < len(begun) <= len({*eager.case_run.values}) * 3
    else:
        assert len(begun) == count


def test_a_companion_shares_its_run_with_a_refinement() -> None:
    """Assert that half the steps of a run are a level of a study that has them."""
    run = xd.simulate(OSCILLATOR, method="rk4", step=0.02, until=10.0)
    study = xd.refine(OSCILLATOR, compute=False, **STUDY)
    with marches() as begun:
        dask.compute(study, xd.companion(run, compute=False))
    assert len(begun) == 4


def test_a_lazy_stage_of_a_closed_file_opens_it_again(tmp_path: Path) -> None:
    """Assert that a record that was closed is read when a stage of it is computed, and one that is gone is named."""
    for gone in (False, True):
        xd.save(xd.simulate(OSCILLATOR, method="rk4", step=0.02, until=10.0), tmp_path / "run.nc")
        with xd.open_run(tmp_path / "run.nc") as run:
            stage = xd.companion(run, compute=False)
        with marches():
            if gone:
                (tmp_path / "run.nc").unlink()
                with pytest.raises(FileNotFoundError, match=r"run\.nc"):
                    stage.global_error_x.compute()
            else:
                assert np.isfinite(float(stage.global_error_x[0]))


# ----------------------------------------------------------------------------------------------------------- validate


def test_a_ledger_of_impacts_lists_as_many_as_are_asked_for() -> None:
    """Assert that a model with contacts needs a number, and that lines beyond those of the run are refused ones."""
    with pytest.raises(xd.InputError, match="give the number to list, like occurrences=10"):
        xd.validate(BALL, compute=False)
    with pytest.raises(xd.InputError, match="occurrences is -1, needs a non-negative whole number"):
        xd.validate(BALL, occurrences=-1)
    every = xd.validate(BALL)
    for impacts in (2, 9):
        stage, eager = xd.validate(BALL, occurrences=impacts, compute=False), xd.validate(BALL, occurrences=impacts)
        assert eager.sizes["case"] == len(BALL.validation) + impacts
        assert_described(stage, eager)
        assert_same_bits(stage, eager)
        both = min(eager.sizes["case"], every.sizes["case"])
        assert eager.residual.values[:both].tobytes() == every.residual.values[:both].tobytes()
        assert (eager.verdict[both:] == 2).all()


# ------------------------------------------------------------------------------------------------------------- sweeps


@pytest.mark.parametrize(("count", "tasks"), [(3, 3), (1000, 16), (100_000, 64)])
def test_a_sweep_is_built_without_a_march(count: int, tasks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert variables, units and tasks of sweeps of any size while no member can be marched."""
    monkeypatch.setattr("dask.system.CPU_COUNT", 4)
    monkeypatch.setattr("xdynamics.sweeping.tasks.march_block", lambda *_: pytest.fail("marched"))
    found = xd.sweep(OSCILLATOR, {"k": f"1:2:{count} N m-1"}, until=1.0)
    assert found.end_x.attrs["units"] == "m"
    assert found.end_x.chunks is not None
    assert len(found.end_x.chunks[0]) == pytest.approx(tasks, abs=1)


def test_a_result_is_never_out_of_both_tables() -> None:
    """Assert that whoever asks right after the work ends finds a result or its turn, and does not work again."""
    memory, made = Memory(), []

    class Interrupted:
        """A lock after whose release somebody else asks, if the result is then neither under way nor remembered."""

        held = threading.RLock()

        def __enter__(self) -> None:
            self.held.acquire()

        def __exit__(self, *_: object) -> None:
            self.held.release()
            if made == [1] and not memory._under_way and not memory._results:
                other = threading.Thread(target=lambda: memory.result("a", make))
                other.start()
                other.join()

    def make() -> int:
        made.append(1)
        return 7

    memory._lock = Interrupted()  # type: ignore[assignment]
    assert memory.result("a", make) == 7
    assert made == [1]
