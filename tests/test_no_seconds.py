"""Models whose time is a pure number through every stage: no unit, sentence, figure or line of the command has a second."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call

LOTKA: dict[str, Any] = {
    "name": "Lotka and Volterra",
    "time": {"unit": "1"},
    "parameters": {"a": {"value": "1.1", "uncertainty": 0.01}, "b": "0.4"},
    "states": {"x": {"unit": "1", "rate": "a*x - b*x*y"}, "y": {"unit": "1", "rate": "b*x*y/4 - b*y"}},
    "initial": {"x": 10, "y": 5},
    "events": {"few": {"function": "x - 2", "direction": "falling"}},
    "observables": {"both": "x + y"},
    "run": {"method": "dop853", "rtol": 1e-9, "until": "8"},
}
DUFFING: dict[str, Any] = {
    "name": "Duffing",
    "time": {"unit": "1"},
    "coordinates": {"q": "1"},
    "mass": {"q": "1"},
    "initial": {"q": 1.5},
    "parameters": {"d": {"value": "0.05", "uncertainty": 0.001}, "f": "0.2"},
    "forces": {"spring": {"potential": "q**4/4 - q**2/2"}, "drag": {"q": "-d*v_q"}, "push": {"q": "f*cos(t)"}},
    "events": {"right": {"function": "q - 1", "direction": "rising"}},
    "contacts": {"wall": {"gap": "q + 2", "restitution": 0.5}},
    "figure": {"section": "2*pi"},
    "validation": {"start": {"quantity": "q", "expression": "1.5", "bound": "10", "times": ["0", "1"]}},
    "run": {"method": "rk4", "step": "0.05", "until": "20"},
}
BALL: dict[str, Any] = {
    "name": "Ball",
    "time": {"unit": "1"},
    "coordinates": {"y": "1", "x": "1"},
    "mass": {"y": "1", "x": "1"},
    "forces": {"weight": {"potential": "y"}},
    "contacts": {"floor": {"gap": "y", "restitution": 0.5}},
    "initial": {"y": 1, "x": 0, "v_x": 1},
    "figure": {"plane": ["x", "y"]},
    "events": {"end": {"function": "x - 4", "direction": "rising", "action": "stop"}},
    "run": {"method": "dop853", "rtol": 1e-8, "until": "9"},
}
MODELS = {"lotka": LOTKA, "duffing": DUFFING, "ball": BALL}
# a number with seconds behind it, a unit that has them, an axis of them
SECOND = re.compile(r"(?<=[0-9]) s\b(?!')|\(s\)|\bs-[0-9]|\bs⁻|\[s\]|\bseconds\b|'s'")


def texts_of(found: xr.Dataset) -> Iterator[str]:
    """Yield all that a record says: units, long names, attributes, texts that are values."""
    for name, variable in found.variables.items():
        if str(name).startswith(("case_", "ledger_")):
            continue  # the method's own closed forms, which have units
        units = str(variable.attrs.get("units", "1"))
        assert "s" not in units.split(), f"{name} is in {units}"
        yield from (f"{name}: {key}: {value}" for key, value in variable.attrs.items() if isinstance(value, str))
        if variable.dtype.kind in "UO" and name not in ("force_source", "model_toml"):
            yield from map(str, np.atleast_1d(variable.values).ravel())
    circumstances = ("source", "history", "Conventions")
    yield from (
        f"{key}: {value}" for key, value in found.attrs.items() if isinstance(value, str) and key not in circumstances
    )


def drawn(figure: Any) -> Iterator[str]:
    """Yield every text of a figure."""
    from matplotlib.text import Text

    yield from (one.get_text() for one in figure.findobj(Text))


def check(texts: Iterator[str], where: str) -> None:
    """Refuse a second."""
    wrong = [text for text in texts if SECOND.search(text)]
    assert not wrong, f"{where}: {wrong[:5]}"


def stages(model: xd.Model, kind: str, run: xr.Dataset) -> dict[str, Any]:
    """Every stage that takes the model."""
    name, event, axis, values = "q", "right", "d", "0.05, 0.1"
    other = xd.simulate(model, method="rk4", step=0.01)
    refinement = xd.refine(model, method="rk4", steps=["0.1", "0.05", "0.025"], at=["1"])
    if kind != "duffing":  # its stages are those of the others; here are states without coordinates, and impacts
        return {
            "comparison": xd.compare(run, other),
            "refinement": refinement,
            "diagnosis": xd.diagnose(run),
            "modes": xd.modes(model),
        }
    found = {
        "companion": xd.companion(run),
        "comparison": xd.compare(run, other),
        "diagnosis": xd.diagnose(run),
        "refinement": refinement,
        "time tolerances": xd.refine(model, time_tolerances=["1e-3", "1e-4", "1e-5"], at=["1"]),
        "modes": xd.modes(model),
        "at": xd.sample(run, "0:3:7", companion=True),
        "sweep": xd.sweep(
            model,
            {axis: values, "step": ["0.1", "0.05"]},
            keep=["end", f"event_time_{event}", f"maximum_{name}"],
            method="rk4",
        ).compute(),
        "times": xd.sweep(model, {axis: values}, keep=[name], times=["1", "2"]).compute(),
        "drawn": xd.sweep(
            model,
            {"draw": xd.Draws(8, {axis: ("0.9", "1.1")}, seed=1)},
            keep=["end", name],
            times=["1", "2"],
            until="3",
        ).compute(),
    }
    if kind == "duffing":
        found["ledger"] = xd.validate(model=model)
        found["budget"] = xd.error_budget(model, name, at="1")
        found["time"] = xd.error_budget(model, "t", event=event)
        found["limit"] = xd.limiting(model, axis, [0.03, 0.02, 0.01], 0.0, at=["1"])
    return found


@pytest.mark.dear
@pytest.mark.parametrize("kind", MODELS)
def test_no_stage_has_a_second(kind: str, tmp_path: Path) -> None:
    """Assert units, words, figures and what the command shows, of the run and of every stage."""
    model = xd.Model(**MODELS[kind])
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model)
    for what, found in {"run": run, **stages(model, kind, run)}.items():
        check(texts_of(found), f"{kind}, {what}")
        if what not in ("run", "modes", "at"):
            assert found.attrs["evidence"]
        elif what != "run":
            continue  # plain data: no archive
        path = xd.save(found, tmp_path / f"{what.replace(' ', '_')}.nc")
        check(iter(call("show", path).output.splitlines()), f"{kind}, show {what}")
        try:
            figure = xd.plot(found)
        except xd.InputError as error:
            assert "nothing to draw" in str(error) or "no figure" in str(error)  # noqa: PT017 - what has no figure
        else:
            check(drawn(figure), f"{kind}, figure of {what}")


@pytest.mark.dear
def test_no_line_of_the_command_has_a_second(tmp_path: Path) -> None:
    """Assert check, run, extend, sample, compare, diagnose, refine, validate, modes and animate of a model without units."""
    from xdynamics.figures.animation import scene_figure
    from xdynamics.figures.scenes import scene_of

    model, path = xd.Model(**DUFFING), tmp_path / "duffing.toml"
    path.write_text(model.to_toml())
    run, fine, data = tmp_path / "run.nc", tmp_path / "fine.nc", tmp_path / "bench.csv"
    data.write_text("time [1],q [1],u(q) [1]\n0,1.5,0.01\n1,1.2,0.01\n2,0.9,0.01\n")
    verbs: list[list[Any]] = [
        ["check", path],
        ["run", path, "-o", run, "--times", "0:3:4"],
        ["run", path, "-o", fine, "--step", "0.02"],
        ["extend", run, "--until", "22", "-o", tmp_path / "longer.nc"],
        ["sample", run, "--times", "0:2:3"],
        ["compare", run, fine, "--at", "1"],
        ["compare", run, data],
        ["diagnose", run, "--reference", "6.28"],
        ["refine", path, "--step", "0.1", "--levels", "3", "--at", "1"],
        ["validate", path],
        ["plot", run, "-o", tmp_path / "p.png", "--with", data],
        ["budget", path, "--quantity", "q", "--at", "1"],
        ["sweep", path, "--axis", "d=0.01:0.05:2", "-o", tmp_path / "s"],
    ]
    for verb in verbs:
        done = call(*verb)
        assert done.exit_code in (0, 1), done.output
        check(iter(done.output.splitlines()), " ".join(map(str, verb)))
    ball = xd.simulate(xd.Model(**BALL))
    scene = scene_of(ball, 0.5)
    assert scene is not None
    figure, frame_at = scene_figure(ball, scene, np.array([0.0, 1.0]), 90)
    frame_at(1)
    check(drawn(figure), "film")


@pytest.mark.parametrize(
    "asked",
    [
        {"until": "-1"},
        {"step": "-1"},
        {"nodes": ["99"]},
        {"min_step": -1.0, "rtol": 1e-6},
        {"times": ["99"]},
        {"times": "0:1:0"},
        {"time_tolerance": "-1"},
        {"step": [0.1, 0.1]},
    ],
)
def test_no_refusal_has_a_second(asked: dict[str, Any]) -> None:
    """Assert that what is refused is said in the model's own unit of time."""
    with pytest.raises(xd.InputError) as told:
        xd.simulate(xd.Model(**DUFFING), **asked)
    check(iter([str(told.value)]), str(asked))


@pytest.mark.dear
def test_a_certificate_has_no_second(tmp_path: Path) -> None:
    """Assert that a certificate and the page of it say no second."""
    found = xd.certify(xd.Model(**LOTKA), "x", at="2", draws=100)
    check(texts_of(found), "certificate")
    xd.save(found, tmp_path / "c.nc")
    check(iter(call("show", tmp_path / "c.nc").output.splitlines()), "show certificate")


@pytest.mark.dear
def test_no_study_of_a_sweep_has_a_second(tmp_path: Path) -> None:
    """Assert what is computed from sweeps, of parameters and of steps; the relations of impacts; a fit."""
    model, ball = xd.Model(**DUFFING), xd.Model(**BALL)
    swept = xd.sweep(
        model, {"d": "0.04, 0.05, 0.06", "f": "0.1, 0.2, 0.3"}, keep=["end", "maximum_q"], until="3"
    ).compute()
    steps = xd.sweep(model, {"step": ["0.1", "0.05", "0.025"]}, keep=["end"], until="2").compute()
    data = tmp_path / "bench.csv"
    data.write_text("time [1],q [1]\n" + "".join(f"{t / 4},{1.5 - t * t / 50}\n" for t in range(1, 9)))
    studies = {
        "contrast": xd.contrast(swept, "d"),
        "sensitivities": xd.sensitivities(swept),
        "influences": xd.influences(swept),
        "convergence": xd.convergence(steps, "step"),
        "precision": xd.precision(steps),
        "indices": xd.sobol_indices(model, {"d": ("0.04", "0.06"), "f": ("0.1", "0.3")}, "end_q", draws=16, until="1"),
        "ledger": xd.validate(["dop853"], model=ball),
        "fit": xd.fit(model, data, ["d"], until="2"),
        "extreme": xd.error_budget(model, "maximum_q", until="3"),
    }
    check(texts_of(xd.ragged(steps)), "ragged")
    for what, found in studies.items():
        check(texts_of(found), what)
        path = xd.save(found, tmp_path / f"{what}.nc")
        check(iter(call("show", path).output.splitlines()), f"show {what}")


def test_steps_that_are_given_and_a_state_that_has_seconds() -> None:
    """Assert that given steps have the unit of time, and that a state of the model keeps its own."""
    model = xd.Model(
        **LOTKA
        | {
            "states": LOTKA["states"] | {"clock": {"unit": "s", "rate": "2*second"}},
            "initial": LOTKA["initial"] | {"clock": "0 s"},
        }
    )
    run = xd.simulate(model, method="rk4", step=[0.1] * 5, until="0.5")
    assert (run.given_step_size.attrs["units"], run.time.attrs["units"], run.step_size.attrs["units"]) == (
        "1",
        "1",
        "1",
    )
    assert (run.clock.attrs["units"], float(run.clock[-1])) == ("s", pytest.approx(1.0))
