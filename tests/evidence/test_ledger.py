"""The validation ledger: exact cases, models' own closed forms, manufactured solutions, limiting cases, planted defects."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.evidence.enclosing.enclosure import enclosure_request
from xdynamics.evidence.validating import ledger as ledger_room
from xdynamics.evidence.validating.case_runs import CaseRuns, times_in_words
from xdynamics.evidence.validating.ledger import validate
from xdynamics.evidence.validating.ledger_rows import FAILED, PASSED, REFUSED, VERDICTS, LedgerRow, ledger_lines
from xdynamics.expressions import parse
from xdynamics.model.parts import Validation
from xdynamics.record.flag_words import words_of_flag

# one of each kind; by all with --whole
KINDS = [
    "forward_euler",
    "midpoint",
    "velocity_verlet",
    "moreau_jean",
    "dormand_prince",
    "implicit_midpoint",
    "radau_iia",
    "taylor",
]
WITHOUT_IMPACTS = {"moreau_jean", "implicit_midpoint", "implicit_velocity_verlet"}


@pytest.fixture(scope="module")
def ledger(request: pytest.FixtureRequest) -> Any:
    """Every case by methods of every kind."""
    return xd.validate([*xd.METHODS] if request.config.getoption("--whole") else KINDS)


def test_every_method_passes_or_refuses(ledger: Any) -> None:
    """Assert that no case fails, that every method has most of its cases passed, and every refusal a reason."""
    assert not [line for line in ledger_lines(ledger) if line.startswith("failed")]
    methods = set(map(str, ledger.case_method.values))
    for method in methods:
        mine = ledger.case_method == method
        words = words_of_flag(ledger.verdict[mine])
        assert words.count("passed") >= 25, method
        notes = ledger.case_note[mine].values[np.array(words) == "refused"]
        assert all(notes)
    struck = np.array([".impacts" in str(one) for one in ledger.case_name.values])
    assert (~struck).sum() == 36 * len(methods)
    passed = ledger.verdict.values == 0
    located = set(ledger.case_method.values[passed & (ledger.case_name.values == "impact.velocity")])
    assert located == methods - WITHOUT_IMPACTS
    counts = {name: int((struck & passed & (ledger.case_method.values == name)).sum()) for name in methods}
    assert counts == {name: 5 if name in located else 0 for name in methods}


def test_stages_are_those_of_the_text(ledger: Any) -> None:
    """Assert the order in which cases stand, and that each says relation, place, norm, unit and bound."""
    names = list(dict.fromkeys(str(one).partition(".")[0] for one in ledger.case_name.values))
    assert names == [
        "zero_force",
        "constant_acceleration",
        "linear_drag",
        "linear_oscillator",
        "long_oscillation",
        "zero_coupling",
        "slow_mode",
        "fast_mode",
        "both_modes",
        "drive",
        "impact",
        "resting_contact",
        "dry_friction",
        "unit_scaling",
        "proven_motion",
    ]
    assert (np.diff(ledger.case_stage) >= 0).all()
    for name in ("case_relation", "case_observable", "case_where", "case_norm", "case_bound_rule", "case_units"):
        assert all(str(one) for one in ledger[name].values), name
    passed = np.array(words_of_flag(ledger.verdict)) == "passed"
    assert (ledger.residual.values[passed] <= ledger.bound.values[passed]).all()
    assert all(len(str(one)) == 64 for one in ledger.case_run.values[passed])


def test_exact_limits_are_exact(ledger: Any) -> None:
    """Assert that what rests stays at rest to the bit, and quadratics are met to rounding from order two on."""
    names = ledger.case_name.values
    still = np.isin(names, ["zero_coupling.at_rest", "zero_coupling.at_rest_too", "resting_contact.y"]) & (
        ledger.verdict.values == 0
    )
    assert (ledger.residual.values[still] == 0.0).all()
    quadratic = names == "constant_acceleration.position"
    high = np.array([xd.METHODS[str(one)].order > 1 for one in ledger.case_method.values])
    assert (ledger.residual.values[quadratic & high] < 1e-12).all()
    euler = quadratic & np.isin(ledger.case_method.values, ["forward_euler", "euler_cromer"])
    assert ledger.residual.values[euler] == pytest.approx(2.5 * 4.0 * 0.005 / 2, rel=1e-10)  # their own law: a t h/2


PENDULUM = """
name = "swing"
coordinates = { q = "rad" }
parameters = { J = "1 kg m2", M = "1 N m" }
mass = { q = "J" }
initial = { q = "2 rad", v_q = "0 rad s-1" }
[forces.weight]
q = "-M*sin(q)"
[run]
method = "rk4"
step = "0.0625 s"
until = "1 s"
"""


def test_a_model_is_compared_with_proven_bounds() -> None:
    """Assert that its run comes to them by its order, that one beside the bounds of another model fails, and what is refused."""
    swing = xd.Model.from_text(PENDULUM)
    found = xd.validate(model=swing, proven=True)
    assert found.case_name.values.tolist() == ["q", "v_q"]
    assert {*found.case_relation.values.tolist()} == {"proven bounds"}
    assert words_of_flag(found.verdict) == ["passed"] * 2
    assert (found.residual.values > 1e-9).all()  # the bounds are far narrower than what the method errs by
    other = enclosure_request(swing.replace(parameters={"J": "1 kg m2", "M": "1.0001 N m"}), at=np.arange(1, 9) / 8)
    with mock.patch.object(ledger_room, "enclosure_request", return_value=other):
        assert words_of_flag(xd.validate(model=swing, proven=True).verdict) == ["failed"] * 2
    early = swing.replace(forces={"weight": {"q": "-M*(1 + abs(q - 1.8))"}})
    refused = xd.validate(model=early, proven=True)
    assert words_of_flag(refused.verdict) == ["refused"] * 2
    assert "no bounds are proven after t = " in str(refused.case_note.values[0])
    stage = xd.validate(model=swing, proven=True, compute=False)
    assert stage.residual.compute().values.tolist() == found.residual.values.tolist()


DEFECTS = {
    "wrong update order": (
        "euler_cromer",
        "broken('euler_cromer', xd.METHODS['forward_euler'].update)",
        "long_oscillation.energy",
    ),
    "stale force": (
        "velocity_verlet",
        "broken('velocity_verlet', xd.METHODS['velocity_verlet'].update.replace('h/2*(a + a1)', 'h*a'))",
        "linear_oscillator.position",
    ),
    "midpoint drive at the wrong time": (
        "midpoint",
        "broken('midpoint', xd.METHODS['midpoint'].update.replace('t + h/2', 't'))",
        "drive.position",
    ),
    "restitution of the wrong velocity": (
        "rk4",
        "Model.rate_of = lambda self, node: derivative(self.expanded(node), {k: v for k, v in self.rates.items() if k != 't'})",
        "impact.velocity",
    ),
    "energy with half a mass": (
        "rk4",
        "whole = Layout._energies.function; Layout._energies = property(lambda self: {k: multiply(Number(0.5), v) if k == 'kinetic_energy' else v for k, v in whole(self).items()})",
        "linear_oscillator.kinetic_energy_at_the_start",
    ),
}


PLANTING = """
import os, sys
from dataclasses import replace
import xdynamics as xd
from xdynamics.expressions import Number
from xdynamics.expressions.calculus import derivative, multiply
from xdynamics.kernels import law
from xdynamics.kernels.layout import Layout
from xdynamics.model import Model

def broken(name, update):
    assert update != xd.METHODS[name].update
    xd.METHODS[name] = replace(xd.METHODS[name], update=update)

law.read, law.write = lambda _key: None, lambda *_: None  # laws are kept by what they are printed from
for method, defect in zip(sys.argv[1::2], sys.argv[2::2]):
    child = os.fork()
    if not child:
        exec(defect)
        found = xd.validate([method])
        print(*[str(one) for one in found.case_name.values[found.verdict.values == 1]], flush=True)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.dear
def test_planted_defects_are_named(request: pytest.FixtureRequest) -> None:
    """Assert that the ledger fails where it should, in processes of their own that are broken first; two in five, or all."""
    planted = (
        [*DEFECTS.items()]
        if request.config.getoption("--whole")
        else [*DEFECTS.items()][::5] + [*DEFECTS.items()][2::5]
    )
    told = [word for _, (method, broken, _) in planted for word in (method, broken)]
    done = subprocess.run([sys.executable, "-c", PLANTING, *told], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    for (defect, (_, _, case)), failed in zip(planted, done.stdout.splitlines(), strict=True):
        assert case in failed.split(), defect


OWN = """
name = "falling"
[coordinates]
y = { unit = "mm" }
[parameters]
m = "2 kg"
g = "9.81 m s-2"
h = "1 m"
[mass]
y = "m"
[forces.gravity]
potential = "m*g*y"
[initial]
y = "1000 mm"
v_y = "0 mm s-1"
[events.ground]
function = "y"
action = "stop"
[validation.y]
expression = "h - g*t**2/2"
times = ["0.1 s", "0.25 s"]
bound = "1e-9 mm"
[validation.landing]
event = "ground"
quantity = "t"
expression = "sqrt(2*h/g)"
bound = "1 ns"
[validation.wrong]
quantity = "v_y"
expression = "-g*t*1.001"
bound = "1 um s-1"
description = "a thousandth too fast"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "1 s"
"""


def test_a_model_says_its_own_closed_forms(tmp_path: Path) -> None:
    """Assert passed and failed lines of a model file, in the record's units, and the file's round trip."""
    model = xd.Model.from_text(OWN)
    assert xd.Model.from_text(model.to_toml()) == model
    found = xd.validate(model=model)
    assert found.case_name.values.tolist() == ["y", "landing", "wrong"]
    assert words_of_flag(found.verdict) == ["passed", "passed", "failed"]
    assert found.case_units.values.tolist() == ["mm", "s", "mm s-1"]
    assert found.bound.values == pytest.approx([1e-9, 1e-9, 1e-3], rel=1e-12)
    assert float(found.residual[2]) == pytest.approx(9810 * 0.4515 * 1e-3, rel=1e-3)
    assert found.case_where.values.tolist()[0] == "t = 0.1, 0.25 s"
    xd.save(found, tmp_path / "l.nc")
    assert xd.open_run(tmp_path / "l.nc").case_method.values.tolist() == ["velocity_verlet"] * 3
    assert xd.validate(["rk4", "dop853"], model).sizes["case"] == 6


EPS = float(np.finfo(float).eps)


def falling_from(second: float) -> CaseRuns:
    """A fall of 1 m that begins at some time, by Verlet's method, which is exact: y = h - g (t - t0)**2/2, in mm."""
    text = OWN.replace("[events.ground]", f't = "{second!r} s"\n[events.ground]').replace(
        'until = "1 s"', f'until = "{second + 1!r} s"'
    )
    return CaseRuns(xd.Model.from_text(text), "velocity_verlet", is_ledger_case=False)


def closed(
    expression: str,
    quantity: str = "y",
    times: tuple[float, ...] = (),
    bound: Any = "rounding",
    event: str = "",
    occurrence: int = 1,
) -> Validation:
    """A closed form of a fall."""
    return Validation(parse(expression), quantity, times, bound, event, occurrence)


def test_rounding_is_of_the_steps_and_at_an_event_of_its_location() -> None:
    """Assert roundings of the largest values of y over the span, and what the location of the landing is uncertain by at the rate of each."""
    fall = falling_from(2.0)
    run, steps, span = fall.run, fall.run.sizes["step"], float(fall.run.time[-1] - 2.0)
    assert steps > 5
    once = (xd.METHODS["velocity_verlet"].evaluations + 2) * steps * EPS
    largest = {name: float(np.abs(run[name]).max()) for name in ("y", "v_y", "kinetic_energy")}
    size = largest | {"y": largest["y"] + span * largest["v_y"], "t": float(run.time[-1])}
    doubt, row = float(run.event_time_uncertainty[0]), int(run.event_row_after[0]) - 1
    rates = {"y": abs(float(run.v_y[row])), "v_y": 9810.0, "kinetic_energy": 0.0, "t": 1.0}
    assert doubt > 0.0
    assert abs(float(run.v_y[row])) > 4000.0
    for name in size:
        assert fall.rounding(closed("h", name, event="ground")) == pytest.approx(
            once * size[name] + doubt * rates[name], rel=1e-9
        )
        if name != "t":
            assert fall.rounding(closed("h", name)) == pytest.approx(once * size[name], rel=1e-12)


def test_residuals_are_taken_where_they_are_asked_for() -> None:
    """Assert sizes of residuals from wrong closed forms at times, at the landing and at all states, and what is expected there."""
    fall, landed = falling_from(2.0), 2.0 + float(np.sqrt(2 / 9.81))
    run = fall.run
    late = closed("h - g*(t - 2*second)**2/2 + 3*metre", times=(2.1, 2.25))
    assert fall.residual(run, late) == pytest.approx([3000.0, 3000.0], rel=1e-9)
    assert fall.expected(run, late) == pytest.approx(4000.0 - 4905.0 * np.array([0.01, 0.0625]), rel=1e-9)
    assert fall.true(run, late) == pytest.approx(fall.expected(run, late))
    every = closed("0*metre")
    assert fall.residual(run, every) == pytest.approx(np.abs(run.y.values), abs=1e-12)
    assert fall.true(run, every).shape == fall.expected(run, every).shape == run.y.shape
    for name, wrong, residual, expected in (
        ("y", "2*metre", 2000.0, 2000.0),
        ("v_y", "1*metre/second", 1000.0 + 9810.0 * (landed - 2.0), 1000.0),
        ("t", "5*second", 5.0 - landed, 3.0),
    ):
        one = closed(wrong, name, event="ground")
        assert fall.residual(run, one) == pytest.approx([residual], rel=1e-7)
        assert fall.expected(run, one) == pytest.approx([expected], rel=1e-12)
        assert fall.residual(run, one).shape == (1,)
    with pytest.raises(LookupError, match="ground was met 1 times"):
        fall.residual(run, closed("h", event="ground", occurrence=2))


def test_what_is_no_observable_is_compared_at_accepted_times_alone() -> None:
    """Assert the row of each time, also a rounding beside it, and what is said of one between."""
    fall = falling_from(2.0)
    times = np.array([2.2, 2.3 * (1 - 2e-16), 2.0])
    assert fall._values_at(fall.run, "step_size", times) == pytest.approx([0.1, 0.1, 0.0], abs=1e-12)
    counted = fall.run.assign(step_size=("step", np.arange(fall.run.sizes["step"])))
    assert fall._values_at(counted, "step_size", times).tolist() == [2.0, 3.0, 0.0]
    assert fall._values_at(fall.run, "y", np.array([2.05])) == pytest.approx([1000 - 4905 * 0.0025], rel=1e-9)
    for off in (2.2 + 1e-9, 2.2 - 1e-9):
        with pytest.raises(xd.InputError, match="'step_size' is known at accepted states alone"):
            fall._values_at(fall.run, "step_size", np.array([off]))


def test_bounds_are_given_derived_or_of_two_runs() -> None:
    """Assert a bound in the record's unit, that of the unscaled run, and of an order that the method has or has not."""
    fall = falling_from(0.0)
    good, bad = "h - g*t**2/2", "h - g*t**2/2 + 4*metre"
    assert fall.bound(closed(good, bound=xd.units.parse_quantity("3 um"))) == pytest.approx(3e-3)
    assert fall.bound(closed(good, bound="unscaled")) == 2.0 * fall.rounding(closed(good))
    assert fall.bound(closed(good, bound="rounding from order 2")) == fall.rounding(closed(good))
    by_order = closed(bad, bound="rounding from order 3")
    capped = 0.5 * float(np.abs(fall.true(fall.run, by_order)).max())
    assert fall.bound(by_order) == pytest.approx(min(4000.0 / 2**1.5, capped) + fall.rounding(by_order), rel=1e-9)
    small = closed("h - g*t**2/2 + 10*metre", bound="order")
    assert fall.bound(small) == pytest.approx(10000.0 / 2**1.5 + fall.rounding(small), rel=1e-9)
    assert float(fall.coarse.attrs["solver_step"]) == 0.2


@pytest.mark.parametrize(
    ("more", "verdict"),
    [
        ({"residual": 1.0, "bound": 1.0}, PASSED),
        ({"residual": 1.1, "bound": 1.0}, FAILED),
        ({"residual": np.nan, "bound": 1.0}, FAILED),
        ({}, FAILED),
        ({"note": "no"}, REFUSED),
        ({"note": "no", "residual": np.inf, "bound": 0.0}, FAILED),
        ({"note": "no", "residual": 0.0, "bound": 0.0}, PASSED),
    ],
)
def test_a_row_has_passed_at_its_bound(more: dict[str, Any], verdict: int) -> None:
    """Assert the verdict of a row: what has no bound and a note is refused, what is no number has failed."""
    assert LedgerRow("a", "rk4", 0, "", "", "", "", **more).verdict == verdict


def test_methods_refuse_what_they_do_not_claim() -> None:
    """Assert who refuses bands, events and models, and with which steps the ledger's own cases are marched."""
    model = xd.Model.from_text(OWN)
    for name, case, said in (
        ("velocity_verlet", closed("h", bound="band"), ""),
        ("rk4", closed("h", bound="band"), "it claims no band"),
        ("rk4", closed("h"), ""),
        ("rk4", closed("h", event="ground"), ""),
        ("moreau_jean", closed("h", event="ground"), "the method locates no events"),
        ("moreau_jean", closed("h"), ""),
    ):
        refusal = CaseRuns(model, name, is_ledger_case=False).refusal(case)
        assert refusal.endswith(said)
        assert bool(refusal) is bool(said)
    for name, part in (("forward_euler", 20), ("velocity_verlet", 4), ("rk4", 1)):
        assert CaseRuns(model, name, is_ledger_case=True).march_settings["step"] == pytest.approx(0.1 / part)
        assert "step" not in CaseRuns(model, name, is_ledger_case=False).march_settings
    assert times_in_words(closed("h", times=(0.5, 1.25)), model) == "t = 0.5, 1.25 s"
    assert times_in_words(closed("h"), model) == "accepted states up to 1 s"
    assert times_in_words(closed("h", bound="band"), model) == "the last tenth of accepted states up to 1 s"


def test_a_ledger_in_words() -> None:
    """Assert what failed with figures and scale, what was refused and why, and counts."""
    texts = {
        "name": ["a", "b", "c", "d"],
        "method": ["rk4"] * 3 + ["heun"],
        "observable": ["y"] * 4,
        "where": ["t = 1 s"] * 4,
        "units": ["mm"] * 4,
        "note": ["", "late", "never", "own"],
    }
    found = xr.Dataset({f"case_{name}": ("case", np.array(text)) for name, text in texts.items()})
    numbers = {
        "residual": [2.0, np.inf, np.nan, np.nan],
        "bound": [1.0, 0.0, np.nan, np.nan],
        "residual_scale": [4.0, np.nan, np.nan, np.nan],
        "scaled_residual": [0.5, np.nan, np.nan, np.nan],
    }
    found = found.assign({name: ("case", np.array(number)) for name, number in numbers.items()})
    found["case_stage"] = ("case", np.array([0, 0, 0, 3]))
    found["verdict"] = (
        "case",
        np.array([1, 1, 2, 2]),
        {"flag_values": np.arange(3), "flag_meanings": "passed failed refused"},
    )
    assert list(ledger_lines(found)) == [
        "failed    a by rk4: y, t = 1 s: residual 2 mm, bound 1 mm, scaled 0.5 by 4 mm",
        "failed    b by rk4: y, t = 1 s: residual inf mm, bound 0 mm; late",
        "refused   c by rk4: never",
        "refused   d by heun: own",
        "ledger    4 cases of 2 methods: 0 passed, 2 failed, 2 refused",
    ]


def test_scaled_residuals_are_over_the_largest_expected_size() -> None:
    """Assert scale and scaled residual of a model's own closed forms, and of a landing from the start of its time."""
    text = OWN.replace("[events.ground]", 't = "2 s"\n[events.ground]').replace('until = "1 s"', 'until = "3 s"')
    text = (
        text.replace('"h - g*t**2/2"', '"4*metre"')
        .replace('"0.1 s", "0.25 s"', '"2.1 s", "2.25 s"')
        .replace('"sqrt(2*h/g)"', '"6*second"')
    )
    found = validate(xd.Model.from_text(text))
    landed = float(np.sqrt(2 / 9.81))
    assert found.residual.values[:2] == pytest.approx([3000 + 4905 * 0.0625, 4.0 - landed], rel=1e-9)
    assert found.residual_scale.values[:2] == pytest.approx([4000.0, 4.0])
    assert found.scaled_residual.values[:2] == pytest.approx(found.residual.values[:2] / [4000.0, 4.0])
    assert found.case_where.values.tolist() == [
        "t = 2.1, 2.25 s",
        "at ground 1",
        f"accepted states up to {2 + landed:.9g} s",
    ]
    assert found.case_bound_rule.values.tolist() == ["given"] * 3


def test_an_event_that_was_not_met_has_failed() -> None:
    """Assert that a landing which does not come is no pass."""
    model = xd.Model.from_text(OWN.replace('until = "1 s"', 'until = "0.3 s"'))
    found = xd.validate(model=model)
    assert words_of_flag(found.verdict)[1] == "failed"
    assert found.case_note.values[1] == "ground was met 0 times"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('bound = "1 ns"', "", "validation 'landing': key 'bound' is missing"),
        ('bound = "1 ns"', 'bound = "1 mm"', "bound '1.0 mm' has units 'm', needs 's'"),
        ('bound = "1 ns"', 'bound = "soon"', "bound is 'soon', needs a quantity like '1 mm', or one of 'rounding'"),
        ('bound = "1 ns"', 'bound = "-1 ns"', "needs a positive one"),
        ('event = "ground"', 'event = "sky"', "event 'sky' is none of the model's; there are ground"),
        ('event = "ground"', 'event = "ground"\noccurrence = 0', "occurrence is 0, needs a whole number from 1 on"),
        ('event = "ground"', 'event = "ground"\ntimes = ["1 s"]', "event and times are both given"),
        ('"sqrt(2*h/g)"', '"2*h/g"', "has units 's2', needs 's' of 't'"),
        ('"h - g*t**2/2"', '"y"', "reads 'y', which is what is computed"),
        ('"h - g*t**2/2"', '"h - q"', "q"),
        ('quantity = "v_y"', "quantity = 3", "quantity is 3, needs the name of one"),
        ("description", "remark", "key 'remark' is not known"),
    ],
)
def test_wrong_closed_forms(old: str, new: str, said: str) -> None:
    """Assert what a model says of each."""
    assert old in OWN
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(OWN.replace(old, new))


def test_wrong_questions() -> None:
    """Assert what is said of unknown methods, models without closed forms or methods, and quantities that no run has."""
    with pytest.raises(
        xd.InputError, match=r"method 'rk5' is not known; did you mean 'dormand_prince'\? there are forward_euler"
    ):
        xd.validate(["rk4", "rk5"])
    with pytest.raises(xd.InputError, match=r"method 'rk5' is not known; did you mean 'dormand_prince'\?"):
        xd.validate(model=xd.Model.from_text(OWN.replace('method = "velocity_verlet"', 'method = "rk5"')))
    with pytest.raises(xd.InputError, match="has no closed form, and no contacts; write one as .validation"):
        xd.validate(model=xd.Model.from_toml(MODELS / "kepler.toml"))
    with pytest.raises(xd.InputError, match="has no method in its .run.; give methods"):
        xd.validate(model=xd.Model.from_text(OWN.replace('method = "velocity_verlet"', "")))
    with pytest.raises(xd.InputError, match="quantity 'speed' is not recorded along 'step'"):
        xd.validate(model=xd.Model.from_text(OWN.replace('quantity = "v_y"', 'quantity = "speed"')))
    adaptive = (
        OWN.replace('step = "0.1 s"', "rtol = 1e-6")
        .replace("velocity_verlet", "dop853")
        .replace('"1 um s-1"', '"order"')
    )
    with pytest.raises(xd.InputError, match="needs a fixed step in .run."):
        xd.validate(model=xd.Model.from_text(adaptive))
    with pytest.raises(xd.InputError, match="model is 'ball.toml', needs a Model"):
        xd.validate(model="ball.toml")


# ------------------------------------------------------------------------------------------------ manufactured solutions


@pytest.mark.every(3)
@pytest.mark.parametrize("method", ["midpoint", "rk4", "dop853", "kahan_li6", "radau_iia"])
def test_manufactured_solutions_have_the_order(method: str) -> None:
    """Assert that a pendulum made to follow a wanted angle does so with the order of the method."""
    pendulum = xd.Model.from_toml(MODELS / "pendulum.toml")
    known = xd.manufactured(pendulum, {"theta": "radian*(sin(2*t/second) + 0.2*cos(3*t/second))"})
    assert [*known.validation] == ["theta", "v_theta"]
    assert words_of_flag(xd.validate([method], known).verdict) == ["passed", "passed"]
    study = xd.refine(known, method=method, steps=[0.2, 0.1, 0.05], until=2.0, at=[2.0])
    true = np.sin(4.0) + 0.2 * np.cos(6.0)
    assert abs(float(study.theta[-1, 0]) - true) <= float(study.uncertainty_theta[0]) + 1e-15


@pytest.mark.dear
def test_manufactured_solutions_of_full_masses_and_states() -> None:
    """Assert a double pendulum, whose mass matrix is full, and a first-order state that drives back."""
    double = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    known = xd.manufactured(double, {"th1": "radian*sin(t/second)", "th2": "radian*cos(2*t/second)"})
    run = xd.simulate(known, method="dop853", rtol=1e-11, atol=1e-12, until=3.0)
    assert run.th1.values == pytest.approx(np.sin(run.time.values), abs=1e-9)
    from cases.problems import damped

    warm = xd.manufactured(damped().model, {"x": "metre*cos(t/second)", "s": "kelvin*exp(-t/second)"})
    run = xd.simulate(warm, method="dop853", rtol=1e-11, atol=1e-12, until=3.0)
    assert run.s.values == pytest.approx(np.exp(-run.time.values), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "trajectory", "said"),
    [
        ("pendulum", {}, "'theta' has no trajectory"),
        ("pendulum", {"theta": "radian", "x": "metre"}, "'x' is no coordinate or state; there are theta"),
        ("pendulum", {"theta": "metre"}, "'theta': 'metre' has units 'm', needs"),
        ("pendulum", {"theta": "theta"}, "reads 'theta'; a trajectory is of t and parameters"),
        ("bouncing_ball", {"y": "metre"}, "has contacts; a manufactured solution is of a model without"),
        ("cart_spring", {"x": "metre"}, "is of 'x'; a manufactured solution takes drives of time alone"),
    ],
)
def test_wrong_trajectories(name: str, trajectory: dict[str, str], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.manufactured(xd.Model.from_toml(MODELS / f"{name}.toml"), trajectory)


# ------------------------------------------------------------------------------------------------------- limiting cases


def test_a_coupling_that_goes() -> None:
    """Assert that coordinates come to what they are alone, in proportion to the coupling."""
    model = xd.Model.from_toml(MODELS / "coupled_masses.toml")
    found = xd.limiting(
        model, "kc", ["1 N m-1", "0.1 N m-1", "10 mN m-1"], 0, at=["1 s", "2 s"], method="dop853", rtol=1e-11, until=2.0
    )
    assert found.approached_x1.values.tolist() == [1, 1]
    assert found.order_x1.values[-1] == pytest.approx(1.0, abs=0.05)
    assert found.parameter_value.attrs["units"] == "N m-1"
    assert found.limit_x2.attrs["units"] == "m"
    assert len(found.attrs["runs"].split()) == 4


def test_drag_that_vanishes() -> None:
    """Assert that a thrown ball comes to its parabola as 1/vt**2 vanishes."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml").replace(parameters={"vt": "300 m s-1"})
    found = xd.limiting(
        model,
        "vt",
        ["3e2 m s-1", "3e3 m s-1", "3e4 m s-1"],
        "3e7 m s-1",
        at=1.0,
        observables=["y"],
        method="dop853",
        rtol=1e-12,
    )
    assert float(found.limit_y[0]) == pytest.approx(20 - 9.80665 / 2, rel=1e-10)
    away = np.abs(found.distance_y.values[:, 0])
    assert away[:-1] / away[1:] == pytest.approx(100.0, rel=0.01)
    # drag goes with 1/vt**2, and the distance from what stands for infinity is that of the inverse
    assert found.attrs["order_in"] == "1/vt"
    assert np.isnan(found.order_y.values[0]).all()
    assert found.order_y.values[1:, 0] == pytest.approx(2.0, abs=0.002)
    with pytest.raises(xd.InputError, match="there is no figure of a limiting case"):
        xd.plot(found)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("q", [1, 0.1], 0), "'q' is no parameter; there are m, k, kc"),
        (("kc", [0.1, 1], 0), "need 2 or more that come closer to 0"),
        (("kc", [0.1], 0), "need 2 or more"),
        (("kc", [0.1, 0.0], 0), "need 2 or more that come closer"),
        (("kc", ["1 kg", "0.1 kg"], 0), "kc '1 kg' has units 'kg', needs 'N m-1'"),
    ],
)
def test_wrong_limits(asked: tuple[Any, ...], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.limiting(
            xd.Model.from_toml(MODELS / "coupled_masses.toml"), *asked, at=[1.0], method="rk4", step=0.1, until=1.0
        )


def test_verdicts_have_the_words_of_the_contract() -> None:
    """Assert the three words."""
    assert VERDICTS == ("passed", "failed", "refused")


# ------------------------------------------------------------------------------------------- what a ledger must not pass

SWING = """
name = "swing"
[coordinates]
x = "m"
[parameters]
k = "1 N m-1"
[mass]
x = "1*kilogram"
[forces.spring]
potential = "k*x**2/2"
[initial]
x = "1 m"
v_x = "0 m s-1"
[observables]
h = "x"
[validation.x]
expression = "EXPRESSION"
bound = "BOUND"
[run]
method = "METHOD"
step = "STEP"
until = "30 s"
"""


def swing(expression: str, bound: str, method: str, step: str) -> xd.Model:
    """An oscillator of 1 s-1 with a closed form."""
    words = {"EXPRESSION": expression, "BOUND": bound, "METHOD": method, "STEP": step}
    text = SWING
    for word, value in words.items():
        text = text.replace(word, value)
    return xd.Model.from_text(text)


@pytest.mark.parametrize(
    ("expression", "bound", "method", "step"),
    [
        ("5*metre*cos(3*t/second)", "band", "velocity_verlet", "0.1 s"),
        ("5*metre*cos(3*t/second)", "order", "forward_euler", "0.9 s"),
        ("metre*cos(1.02*t/second)", "order", "rk4", "0.1 s"),
    ],
)
def test_wrong_closed_forms_fail(expression: str, bound: str, method: str, step: str) -> None:
    """Assert that no derived bound is so wide that what is plainly wrong goes through."""
    assert words_of_flag(xd.validate(model=swing(expression, bound, method, step)).verdict) == ["failed"]
    assert words_of_flag(xd.validate(model=swing("metre*cos(t/second)", "order", "rk4", "0.1 s")).verdict) == ["passed"]


def test_a_run_that_died_has_failed() -> None:
    """Assert that a run which ends in nan a third of the way is no pass, and the note says when."""
    text = SWING.replace('potential = "k*x**2/2"', 'x = "0*newton*sqrt((10*second - t)/second)"')
    model = xd.Model.from_text(
        text.replace("EXPRESSION", "metre")
        .replace("BOUND", "rounding")
        .replace("METHOD", "rk4")
        .replace("STEP", "0.1 s")
    )
    found = xd.validate(model=model)
    assert words_of_flag(found.verdict) == ["failed"]
    assert "the run ended before" in found.case_note.values[0]


def test_other_units_are_refused() -> None:
    """Assert that metres are not held against seconds, of an observable neither."""
    text = (
        SWING.replace("[validation.x]", "[validation.h]")
        .replace("EXPRESSION", "cos(t/second)*second")
        .replace("BOUND", "1 s")
    )
    model = xd.Model.from_text(text.replace("METHOD", "rk4").replace("STEP", "0.1 s"))
    with pytest.raises(xd.InputError, match="has units 's', needs 'm' of 'h'"):
        xd.validate(model=model)


@pytest.mark.filterwarnings("ignore:no step of")
@pytest.mark.parametrize(
    ("bound", "method", "step"),
    [
        ("band", "velocity_verlet", "0.1 s"),
        ("band", "velocity_verlet", "0.6 s"),
        ("order", "rk4", "0.2 s"),
        ("order", "forward_euler", "0.3 s"),
        ("rounding", "heun", "0.1 s"),
    ],
)
def test_bounds_are_what_the_notes_say(bound: str, method: str, step: str) -> None:
    """Assert residual and bound of the closed form of a swing from the run's own rows, by each rule, its caps among them."""
    model = swing("metre*cos(t/second)", bound, method, step)
    found = xd.validate(model=model)
    run, coarse = (xd.simulate(model, step=float(step[:-2]) * k) for k in (1, 2))
    off, off_coarse = (np.abs(one.x.values - np.cos(one.time.values)) for one in (run, coarse))
    size = float(np.abs(run.x).max()) + 30.0 * float(np.abs(run.v_x).max())
    rounding = (xd.METHODS[method].evaluations + 2) * run.sizes["step"] * float(np.finfo(float).eps) * size
    part, order = off.size // 10, xd.METHODS[method].order
    wanted = {
        "band": min(1.5 * off[:part].max(), 0.2 * float(np.abs(run.x).max())),
        "rounding": 0.0,
        "order": min(off_coarse.max() / 2 ** (order - 0.5), 0.5),
    }[bound] + rounding
    assert found.bound.values == pytest.approx([wanted], rel=1e-9)
    assert found.residual.values == pytest.approx([off[-part:].max() if bound == "band" else off.max()], rel=1e-9)
    assert found.residual_scale.values == pytest.approx([1.0], rel=0.2)


def test_a_model_is_marched_as_it_is_asked() -> None:
    """Assert a step in the place of a tolerance and the other way, another end, and that the ledger's own cases have their own."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    ledger = xd.validate(model, step="5 ms", until="1 s")
    assert str(ledger.case_where[0].item()).startswith("1 impact")
    assert xd.validate(["dop853"], model, rtol=1e-8, until="1 s").case_method[0] == "dop853"
    for wrong, words in (
        ({"step": "-1 ms"}, "step is"),
        ({"rtol": "abc"}, "rtol is 'abc'"),
        ({"until": "1 kg"}, "has units 'kg'"),
    ):
        with pytest.raises(xd.InputError, match=words):
            xd.validate(model, **wrong)
    with pytest.raises(xd.InputError, match="step and rtol are for a model, and none is given"):
        xd.validate(["heun"], step="1 ms", rtol=1e-3)
