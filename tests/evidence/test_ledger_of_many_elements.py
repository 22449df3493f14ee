"""The validation ledger of quantities of many elements: one line for each closed form, with the worst element named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.evidence.validating import case_runs, ledger
from xdynamics.evidence.validating.ledger_rows import MOST_ALONE, ledger_lines
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
