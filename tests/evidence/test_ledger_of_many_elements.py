"""The validation ledger of quantities of many elements: one line for each closed form, with the worst element named.

The ledger of impacts: that true runs pass, and that every wrong number in a record is found by the line that it belongs to.
"""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.contacts import ball, cradle
from cases.impacts import random_rod
from xdynamics.evidence.validating import case_runs, ledger
from xdynamics.evidence.validating.impacts import checks_of
from xdynamics.evidence.validating.ledger_rows import MOST_ALONE, ledger_lines
from xdynamics.model.parts import IMPACT_LAWS
from xdynamics.record.flag_words import words_of_flag

# links are one fewer
FEW, MANY = MOST_ALONE + 2, 4 * MOST_ALONE
CHAIN = """
name = "chain"
[dimensions]
site = {n}
[relations.link]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "mm", dims = ["site"] }}
[parameters]
k = "4 N m-1"
m = "1 kg"
one = {{ dims = ["site"], value = "1 + 0*index(site)" }}
A = "0.1 m"
[mass]
u = "m"
[definitions]
shape = "one*A*sin(pi*(index(site) + 1)/(size(site) + 1))"
rate = "2*sqrt(k/m)*sin(pi/(2*(size(site) + 1)))"
[forces.springs]
u = "k*(shift(u, site, 1, 0*metre) - 2*u + shift(u, site, -1, 0*metre))"
[observables]
stretch = "(second(u, link) - first(u, link))/A"
[events.start]
function = "t - 0.15*second"
[initial]
u = "A*sin(pi*(index(site) + 1)/(size(site) + 1))"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "0.4 s"
scales = {{ length = "3 mm" }}
"""
FORM = '[validation.form]\nquantity = "{quantity}"\nexpression = "{expression}"\nbound = "{bound}"\n{more}'
MOTION, SPEED = "shape*cos(rate*t)", "-shape*rate*sin(rate*t)"
STRETCH = "(second(shape, link) - first(shape, link))*cos(rate*t)/A"
TIMES, EVENT = 'times = ["0.13 s", "0.3 s"]', 'event = "start"'
CASES = {
    "order": ("u", MOTION, "order", ""),
    "order of velocities": ("v_u", SPEED, "order", ""),
    "rounding": ("u", MOTION, "rounding", ""),
    "band": ("u", MOTION, "band", ""),
    "unscaled": ("u", MOTION, "unscaled", ""),
    "given": ("u", MOTION, "0.05 nm", ""),
    "at times": ("u", MOTION, "order", TIMES),
    "at an event": ("u", MOTION, "rounding", EVENT),
    "velocities at an event": ("v_u", SPEED, "rounding", EVENT),
    "of links": ("stretch", STRETCH, "order", ""),
    "of links at times": ("stretch", STRETCH, "order", TIMES),
}


def model_of(n: int, case: str) -> xd.Model:
    """Return a chain with a closed form."""
    quantity, expression, bound, more = CASES[case]
    form = FORM.format(quantity=quantity, expression=expression, bound=bound, more=more)
    return xd.Model.from_text(CHAIN.format(n=n) + form)


def one_by_one(model: xd.Model, monkeypatch: pytest.MonkeyPatch) -> xr.Dataset:
    """Validate a model with a line for each element."""
    with monkeypatch.context() as patch:
        for module in (ledger, case_runs):
            patch.setattr(module, "MOST_ALONE", 10**6)
        return xd.validate(model)


@pytest.mark.parametrize("case", CASES)
def test_a_line_is_that_of_the_worst_element(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a line has the digits of its worst element alone, fails where any does, and counts those that do."""
    model = model_of(FEW, case)
    every, line = one_by_one(model, monkeypatch), xd.validate(model)
    assert (line.sizes["case"], every.sizes["case"]) == (1, FEW - (CASES[case][0] == "stretch"))
    (worst,) = line.case_worst_element.values
    (k,) = np.flatnonzero(every.case_observable.values == worst)
    for name in ("residual", "bound", "residual_scale", "scaled_residual", "verdict", "case_run", "case_units"):
        assert line[name][0].item() == every[name][k].item(), name
    failed = np.array(words_of_flag(every.verdict)) == "failed"
    assert int(line.case_elements_failed[0]) == failed.sum()
    assert words_of_flag(line.verdict) == ["failed" if failed.any() else "passed"]
    parts = np.where(failed | ~failed.any(), np.nan_to_num((every.residual / every.bound).values), -1.0)
    assert parts[k] == parts.max()
    assert int(line.case_elements[0]) == every.sizes["case"]


def test_some_cases_pass_and_some_fail() -> None:
    """Assert that the cases above tell both verdicts apart, and that a failure names the worst of how many."""
    verdicts = {
        case: words_of_flag(xd.validate(model_of(FEW, case)).verdict)[0] for case in ("order", "rounding", "given")
    }
    assert set(verdicts.values()) == {"passed", "failed"}
    found = xd.validate(model_of(FEW, "given"))
    assert int(found.case_elements_failed[0]) < FEW
    (said, _) = ledger_lines(found)
    worst, count = found.case_worst_element.values[0], int(found.case_elements_failed[0])
    assert f"form by velocity_verlet: u ({count} of {FEW} elements; worst {worst})" in said


def test_as_many_elements_as_have_lines_of_their_own() -> None:
    """Assert that few elements have a line each."""
    found = xd.validate(model_of(MOST_ALONE, "given"))
    assert found.sizes["case"] == MOST_ALONE
    assert set(found.case_worst_element.values) == {""}
    assert set(found.case_elements.values) == {1}


def test_lines_are_known_before_marching() -> None:
    """Assert that a ledger that is not computed has the same lines and types."""
    model = model_of(FEW, "order")
    lazy = xd.validate(model, compute=False)
    assert lazy.sizes["case"] == 1
    xr.testing.assert_equal(lazy.compute(), xd.validate(model))


def test_a_method_that_refuses_counts_the_elements() -> None:
    """Assert that a refusal is one line, too."""
    found = xd.validate(["forward_euler"], model_of(FEW, "band"))
    assert words_of_flag(found.verdict) == ["refused"]
    assert (int(found.case_elements[0]), found.case_worst_element.values[0]) == (FEW, "")


@pytest.mark.parametrize("case", ["order", "at times", "of links at times"])
def test_work_does_not_grow_with_elements(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that closed forms are evaluated as often for many elements as for few."""
    counted: list[int] = []
    original = case_runs.evaluate_elements

    def counting(*given: Any) -> Any:
        counted.append(1)
        return original(*given)

    monkeypatch.setattr(case_runs, "evaluate_elements", counting)
    monkeypatch.setattr(case_runs, "evaluate_over_states", None)
    counts = []
    for n in (FEW, MANY):
        counted.clear()
        xd.validate(model_of(n, case))
        counts.append(len(counted))
    assert counts[0] == counts[1] > 0


def test_proven_bounds_of_many_elements_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a line has the digits of its worst element's own line, and names it and how many there are."""
    model = xd.Model.from_text(CHAIN.format(n=3))
    every = xd.validate(model, proven=True)
    monkeypatch.setattr(ledger, "MOST_ALONE", 2)
    found = xd.validate(model, proven=True)
    assert found.case_observable.values.tolist() == ["u", "v_u"]
    assert found.case_elements.values.tolist() == [3, 3]
    assert every.sizes["case"] == 6
    for i, worst in enumerate(found.case_worst_element.values.tolist()):
        (k,) = np.flatnonzero(every.case_observable.values == worst)
        for name in ("residual", "bound", "residual_scale", "scaled_residual", "verdict", "case_run", "case_units"):
            assert found[name][i].item() == every[name][k].item(), name
        parts = (every.residual / every.bound).values[3 * i : 3 * i + 3]
        assert 0.0 < parts[k - 3 * i] == parts.max()
    lazy = xd.validate(model, proven=True, compute=False)
    assert lazy.case_elements.values.tolist() == [3, 3]


LONG = 2000  # sites: of those near the end the sine at the start, and in the closed form, is rounded by more than the bound


def long_chain(planted: str = "") -> xd.Model:
    """Return a chain whose motion is so slow that rounding of its expressions is all there is, without its event."""
    expression = f"{MOTION}{planted}"
    text = CHAIN.replace('[events.start]\nfunction = "t - 0.15*second"\n', "").format(n=LONG)
    return xd.Model.from_text(text + FORM.format(quantity="u", expression=expression, bound="order", more=""))


def test_a_bound_counts_what_rounding_does_to_expressions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a chain passes only with the parts of its bound that are for closed form and start, which are derived."""
    found = xd.validate(long_chain())
    assert words_of_flag(found.verdict) == ["passed"]
    for part in (found.bound_closed_form, found.bound_start):
        # three roundings of the argument, which is near pi, by half a spacing: times the amplitude of 100 mm
        assert 0.0 < float(part[0]) < 100.0 * 1.5 * np.spacing(np.pi)
    few = xd.validate(model_of(9, "rounding"))
    monkeypatch.setattr(case_runs.CaseRuns, "rounding_of_expressions", lambda *_: (0.0, 0.0))
    bare, bare_few = xd.validate(long_chain()), xd.validate(model_of(9, "rounding"))
    assert words_of_flag(bare.verdict) == ["failed"]
    assert int(bare.case_elements_failed[0]) < LONG // 100
    parts = few.bound_closed_form + few.bound_start
    np.testing.assert_allclose(few.bound - bare_few.bound, parts, rtol=1e-6)
    assert min(few.bound_closed_form.max(), few.bound_start.max()) > 0.0


def test_an_error_of_ten_times_the_bound_fails() -> None:
    """Assert that a closed form that is off by ten times the bound is told, in either direction."""
    bound = float(xd.validate(long_chain()).bound[0])
    for sign in "+-":
        found = xd.validate(long_chain(f" {sign} {0.01 * bound!r}*metre"))
        assert words_of_flag(found.verdict) == ["failed"]
        assert int(found.case_elements_failed[0]) > 0


def test_a_start_of_numbers_is_not_carried() -> None:
    """Assert that a start without an expression adds nothing to a bound, and a closed form by itself does."""
    model = model_of(FEW, "order")
    numbers = [model.initial[name].value for name in model.shapes.elements("u")]
    found = xd.validate(model.replace(initial={"u": {"unit": "mm", "value": numbers}}))
    assert found.bound_start.values.tolist() == [0.0]
    assert found.bound_closed_form[0] > 0.0


WITH_JUMPS = {  # and how many elements are not at 0
    "sign(sin(pi*index(site)))*A": FEW - 1,
    "A*atan2(sin(pi*index(site)), -1)": FEW,
    "A*floor(index(site)*sin(pi/6)*2)": FEW - 2,
}


@pytest.mark.parametrize("shape", WITH_JUMPS)
def test_another_side_of_a_jump_is_no_rounding(shape: str) -> None:
    """Assert that a closed form with 31 digits on another side of a jump leaves a bound of rounding, which tells errors."""
    text = CHAIN.format(n=FEW).replace(
        '"k*(shift(u, site, 1, 0*metre) - 2*u + shift(u, site, -1, 0*metre))"', '"0*k*u"'
    )
    start = 'u = "A*sin(pi*(index(site) + 1)/(size(site) + 1))"'
    text = text.replace(start, f'u = "{shape}"')
    for wrong, verdict in (("", "passed"), ("*(1 + 1e-9)", "failed")):
        form = FORM.format(quantity="u", expression=shape + wrong, bound="rounding", more="")
        found = xd.validate(xd.Model.from_text(text + form))
        assert words_of_flag(found.verdict) == [verdict]
        assert int(found.case_elements_failed[0]) == (WITH_JUMPS[shape] if wrong else 0)
        largest = 100.0 * FEW * np.pi
        assert (found.bound_closed_form + found.bound_start < 4.0 * np.spacing(largest)).all()


def test_a_pole_of_a_closed_form_is_no_rounding() -> None:
    """Assert that a closed form next to a pole, of meters in floats and of 10^15 m with 31 digits, does not pass."""
    pole = f"{MOTION} + 1e-15*A/sin(pi*(t/(0.1*second) + 1))"
    form = FORM.format(quantity="u", expression=pole, bound="rounding", more="")
    found = xd.validate(xd.Model.from_text(CHAIN.format(n=FEW) + form))
    assert int(found.case_elements_failed[0]) == FEW


RESTING = """
name = "resting"
[coordinates]
y = { unit = "m" }
[parameters]
m = "1 kg"
g = "10 m s-2"
[mass]
y = "m"
[forces.weight]
y = "-m*g"
[initial]
y = "sin(pi/5)*metre"
[contacts.floor]
gap = "y - sin(pi/5)*metre"
restitution = "0"
[validation.y]
quantity = "y"
expression = "sin(pi/5)*metre"
bound = "rounding"
[run]
method = "rk4"
step = "0.1 s"
until = "1 s"
"""


def test_a_start_that_cannot_be_moved_is_not_carried() -> None:
    """Assert that a body at rest on a floor, which a moved start would be inside of, is judged without that part."""
    found = xd.validate(xd.Model.from_text(RESTING))
    assert words_of_flag(found.verdict)[0] == "passed"
    assert found.bound_start.values[0] == 0.0


def failed(run: Any, model: xd.Model) -> set[str]:
    """The names of the relations that a run breaks."""
    return {check.name for check in checks_of(run, model) if not check.note and not check.residual <= check.bound}


@pytest.mark.cases(200)
@pytest.mark.filterwarnings("ignore:.*energy was created")
def test_rods_of_every_law_pass(case: int) -> None:
    """Assert that impulses, rates, friction and energies of a rod's impact are those of its law, by any law."""
    rod, law = random_rod(case), IMPACT_LAWS[case % len(IMPACT_LAWS)]
    found = list(checks_of(rod.struck(law), rod.model(law)))
    assert [one.name for one in found] == [
        "impulse_x",
        "impulse_y",
        "impulse_theta",
        "kinetic_energy",
        "floor.direction",
        "floor.restitution",
        "floor.friction",
        "floor.energy_lost",
    ]
    assert all(bool(one.note) == (law in ("poisson", "energetic") and one.name == "floor.restitution") for one in found)
    assert not {one.name for one in found if not one.note and not one.residual <= one.bound}


WRONG = {
    "an impulse along x that is too large": (
        "event_impulse_x",
        1.0 + 1e-6,
        {"impulse_x", "kinetic_energy", "floor.direction", "floor.energy_lost"},
    ),
    "one of the other sign": (
        "event_impulse_y",
        -1.0,
        {"impulse_y", "kinetic_energy", "floor.direction", "floor.energy_lost"},
    ),
    "an energy of the other sign": ("event_energy_lost", -1.0, {"floor.energy_lost"}),
    "an energy without its half": ("event_energy_lost", 2.0, {"floor.energy_lost"}),
    "no energy": ("event_energy_lost", 0.0, {"floor.energy_lost"}),
    "a kinetic energy without its half": ("kinetic_energy", 2.0, {"kinetic_energy"}),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_number_is_found(wrong: str) -> None:
    """Assert that a factor or sign in the record breaks the relations that it is in."""
    rod, (name, factor, broken) = random_rod(3), WRONG[wrong]
    run = rod.struck("newton")
    changed = run.assign({name: run[name] * factor})
    changed[name].attrs = run[name].attrs
    assert failed(changed, rod.model("newton")) == broken
    assert not failed(run, rod.model("newton"))


@pytest.mark.parametrize(
    ("changed", "broken"),
    [({"restitution": "e/2 + 0.1"}, {"floor.restitution"}), ({"friction": "mu/3"}, {"floor.friction"})],
)
def test_another_law_than_the_models_is_found(changed: dict[str, str], broken: set[str]) -> None:
    """Assert that a run is not that of another coefficient."""
    rod = random_rod(0)
    assert failed(rod.struck("newton"), rod.model("newton", **changed)) == broken


def test_velocities_behind_an_impact_are_looked_at() -> None:
    """Assert that a velocity of another row breaks impulse, restitution and energies."""
    model = ball(0.5)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=1.0)
    speeds = run.v_y.copy()
    speeds[int(run.event_row_after[0])] *= 1.0 + 1e-9
    assert failed(run.assign(v_y=speeds), model) == {
        "impulse_y",
        "kinetic_energy",
        "floor.restitution",
        "floor.energy_lost",
    }


def test_a_model_with_contacts_is_validated_by_its_own_run() -> None:
    """Assert the lines of a model that has no closed form, each with relation, unit, event, bound and verdict."""
    table = tomllib.loads(ball(0.5).to_toml()) | {"run": {"method": "dop853", "rtol": 1e-9, "until": "2 s"}}
    found = xd.validate(model=xd.Model(**table))
    assert found.case_name.values.tolist() == [
        f"impacts.{name}"
        for name in ("impulse_y", "kinetic_energy", "floor.direction", "floor.restitution", "floor.energy_lost")
    ]
    assert set(words_of_flag(found.verdict)) == {"passed"}
    assert found.case_units.values.tolist() == ["kg m s-1", "J", "1", "m s-1", "J"]
    assert all("impacts, worst at event" in str(one) for one in found.case_where.values)
    assert (found.bound.values > 0.0).all()
    assert (found.bound.values < 1e-9).all()
    table["run"]["until"] = "0.1 s"
    none = xd.validate(model=xd.Model(**table))
    assert (none.case_note.values.tolist(), words_of_flag(none.verdict)) == (["the run has no impact"], ["refused"])


def test_a_method_that_locates_nothing_is_refused() -> None:
    """Assert that Moreau's steps, whose impulses are of whole steps, are no case."""
    table = tomllib.loads(ball(0.5).to_toml()) | {"run": {"method": "moreau_jean", "step": "1 ms", "until": "1 s"}}
    found = xd.validate(model=xd.Model(**table))
    assert found.case_note.values.tolist() == ["the method locates no events"]
    assert not np.isfinite(found.bound.values).any()


@pytest.mark.parametrize("tolerance", [None, "1e-9 s", "1e-14 s"])
def test_bounds_are_rounding_and_what_is_located(tolerance: str | None) -> None:
    """Assert the bounds of one impact of a ball: 256 roundings of all terms, and what acts within the time tolerance."""
    table = tomllib.loads(ball(0.5).to_toml())
    if tolerance:
        table["contacts"]["floor"]["time_tolerance"] = tolerance
    model = xd.Model(**table)
    run = xd.simulate(model, method="rk4", step=0.01, until=0.6)
    assert run.sizes["event"] == 1
    rows, share = [int(run[f"event_row_{side}"][0]) for side in ("before", "after")], 256 * np.finfo(float).eps
    time = max([float(run.attrs["solver_time_tolerance"])] + ([float(tolerance.split()[0])] if tolerance else []))
    m = float(run.event_impulse_y[0]) / float(run.v_y[rows[1]] - run.v_y[rows[0]])
    speeds, pulls = (sum(abs(float(run[name][row])) for row in rows) for name in ("v_y", "a_y"))
    impulse = abs(float(run.event_impulse_y[0]))
    bound = share * (m * speeds + impulse) + time * m * pulls
    found = {check.name: check for check in checks_of(run, model)}
    rate = 2.0 * share * speeds + time * pulls
    wanted = {
        "impulse_y": bound,
        "kinetic_energy": bound * speeds,
        "floor.direction": share,
        "floor.restitution": rate,
        "floor.energy_lost": impulse * rate,
    }
    assert {name: value.bound for name, value in found.items()} == pytest.approx(wanted, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("law", ["newton", "sequential", "poisson"])
def test_balls_that_are_struck_together_pass(law: str) -> None:
    """Assert that of contacts beside one another none is held to its coefficient alone, and that parting balls are no fault."""
    model = cradle(law, 0.5)
    run = xd.simulate(model, method="rk4", step=0.05, until=1.5)
    assert run.sizes["event"] >= 1
    found = {check.name: check for check in checks_of(run, model)}
    assert not failed(run, model)
    notes = {name for name, value in found.items() if value.note}
    assert notes == ({"first.energy_lost", "second.energy_lost"} if law == "sequential" else set())
    assert all(value.residual >= 0.0 for name, value in found.items() if name not in notes)


def test_a_contact_that_is_struck_alone_is_held_to_its_energy_by_every_law() -> None:
    """Assert that a ball by sequential impacts is compared, and a wrong energy found."""
    model = ball(0.5, law="sequential")
    run = xd.simulate(model, method="rk4", step=0.05, until=0.6)
    assert not failed(run, model)
    wrong = run.assign(event_energy_lost=run.event_energy_lost * 1.001)
    wrong.event_energy_lost.attrs = run.event_energy_lost.attrs
    assert failed(wrong, model) == {"floor.energy_lost"}
