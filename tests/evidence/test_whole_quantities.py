"""Verbs read whole quantities: no element is told apart, and each element has the bits that it has alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.evidence.refining.convergence import UNCERTAINTY_RULES, judge
from xdynamics.evidence.refining.refinement import refinement_lines
from xdynamics.faults import DOT
from xdynamics.kernels import law_of
from xdynamics.march.configuration import settings_for
from xdynamics.march.settings import Settings
from xdynamics.march.simd_ensemble import lanes_for, log_of_many
from xdynamics.methods import METHODS
from xdynamics.model.elements import Elements
from xdynamics.sweeping.ensemble_records import MemberRuns
from xdynamics.sweeping.members import LOG_BYTES

CHAIN = """
name = "chain"
[dimensions]
site = ["a", "b", "c", "d"]
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = { dims = ["spring"], value = [4, 5, 6], unit = "N m-1" }
m = { dims = ["site"], value = [1, 2, 1, 3], unit = "kg" }
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[observables]
stretch = "second(u, spring) - first(u, spring)"
[events.passed]
function = "u"
direction = "falling"
action = "record"
[initial]
u = { value = [1, 0, 0.2, -0.3], unit = "m" }
[run]
method = "rk4"
step = "20 ms"
until = "1 s"
"""
STEPS = ["40 ms", "20 ms", "10 ms", "5 ms"]


@pytest.fixture(scope="module")
def chain() -> xd.Model:
    return xd.Model.from_text(CHAIN)


def untold(*_given: object) -> xr.Dataset:
    raise AssertionError("elements were told apart")


def test_no_element_is_told_apart(chain: xd.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that verbs come to their results from whole quantities alone."""
    monkeypatch.setattr("xdynamics.record.unfolding._split_elements", untold)
    run, finer = (xd.simulate(chain, step=step) for step in STEPS[1:3])
    assert xd.companion(run, 0.5).global_error_u.dims == ("at", "site")
    assert xd.compare(run, finer, times=[0.5]).difference_stretch.dims == ("at", "spring")
    assert xd.refine(chain, steps=STEPS[1:3]).limit_u.dims == ("at", "site")
    found = xd.sweep(chain, {"step": STEPS[1:3]}, keep=["end", "u", "log"], times=[0.5], path=tmp_path)
    np.testing.assert_array_equal(xd.member(found, step="20 ms").u[-1], run.u[-1])
    np.testing.assert_array_equal(found.u[0], xd.sample(run, 0.5).u)


def test_each_element_has_the_bits_that_it_has_alone(chain: xd.Model) -> None:
    """Assert all that is said of a quantity's element against what is said where that alone is asked for."""
    at = ["0.43 s", "1 s"]
    whole = xd.refine(chain, steps=STEPS, at=at, observables=["u", "stretch"])
    for name, place in (("u", {"site": "c"}), ("stretch", {"spring": 1})):
        label = next(iter(place.values()))
        alone = xd.refine(chain, steps=STEPS, at=at, observables=[f"{name}[{label}]"], occurrences=0)
        names = [str(key) for key in alone.data_vars if str(key).endswith(f"_{name}") or key == name]
        assert len(names) == 11
        for key in names:
            np.testing.assert_array_equal(whole[key].sel(place), alone[key].sel(place), key)


def test_elements_in_their_quantity_are_not_asked_for_twice(chain: xd.Model) -> None:
    """Assert that an element beside its quantity is in it, in studies and in sweeps."""
    study = xd.refine(chain, steps=STEPS[:2], observables=["u[b]", "u"])
    assert study.u.dims == ("level", "at", "site")
    assert study.u.notnull().all()
    kept = xd.sweep(chain, {"step": STEPS[:2]}, keep=["end_u[b]", "end_u"]).compute()
    assert kept.end_u.notnull().all()


def test_states_after_events_are_named_before_their_element(chain: xd.Model) -> None:
    """Assert that lines of a refinement name a state after the event of an element as its variable, then the element."""
    study = xd.refine(chain, steps=STEPS[:3], observables=["u", "v_u"])
    named = [line.partition(" [")[0] for line in refinement_lines(study) if line.startswith("after_")]
    assert named == [f"after_passed_{name}[{site}]" for name in ("u", "v_u") for site in "ac"]
    assert "after_passed_v_u" in study


def test_changes_of_one_element_are_awaited(chain: xd.Model) -> None:
    """Assert that levels are added until one element changes little enough, whichever others change more."""
    study = xd.refine(chain, steps=STEPS[:1], observables=["u"], until_change={"u[b]": "10 nm"})
    changes = np.abs(study.difference_u.sel(site="b")).values
    assert changes[-2] <= 1e-8 < changes[-3]
    assert study.attrs["stopped"].startswith("every change under its tolerance")


def test_states_after_an_elements_event_are_those_of_the_element(chain: xd.Model) -> None:
    """Assert that each site is compared where it passed zero itself, under the quantity's name, and not its neighbours."""
    study = xd.refine(chain, steps=STEPS[2:], observables=["u", "v_u"])
    run = xd.simulate(chain, step=STEPS[-1])
    assert study.after_passed_v_u.dims == ("level", "occurrence", "site")
    assert not [name for name in study.variables if DOT in str(name)]
    for site in np.unique(run.event_site):
        rows = run.event_row_after.values[run.event_site.values == site]
        there = study.after_passed_v_u[-1, : len(rows), site]
        np.testing.assert_array_equal(there, run.v_u.values[rows, site])


def test_a_difference_is_of_a_named_element(chain: xd.Model) -> None:
    """Assert that the first difference names the element of a parameter too, which has no rows."""
    other = chain.replace(parameters={"m[c]": "1.5 kg"}, initial={"u[c]": "0.3 m"})
    first, second = (xd.simulate(model) for model in (chain, other))
    found = xd.compare(first, second, times=[0.5])
    assert found.attrs["first_difference"].startswith("variable 'u[c]', row 0: 0.2 | 0.3")
    masses = xd.compare(first[["m"]].merge(first.drop_vars("m")).assign_attrs(first.attrs), first, times=[0.5])
    assert masses.same.all()
    only = xd.compare(first, xd.simulate(chain.replace(parameters={"m[d]": "3.5 kg"})), times=[0.5])
    row = {str(name): int(k) for name, k in zip(only.name.values, only.first_row.values, strict=True)}
    assert row["m"] == 0


def test_runs_of_other_sizes_are_compared_by_elements(chain: xd.Model) -> None:
    """Assert the difference of what both chains have, where one has a site less."""
    shorter = xd.Model.from_text(
        CHAIN.replace(', "d"]', "]").replace("[4, 5, 6]", "[4, 5]").replace("1, 3]", "1]").replace(", -0.3]", "]")
    )
    found = xd.compare(xd.simulate(chain), xd.simulate(shorter), times=[0.5])
    assert found.difference_u.sel(site=["a", "b", "c"]).notnull().all()
    assert (np.abs(found.difference_u.sel(site="c")) > 1e-3).all()


def test_descriptions_compute_nothing(chain: xd.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what is described has dimensions and units, and that nothing was marched for it."""
    asked = {"step": "25 ms", "until": "0.9 s"}  # which no other test marches: results are remembered
    run = xd.simulate(chain, compute=False, sizes={"step": 60}, **asked)
    monkeypatch.setattr("xdynamics.march.runner.March.blocks", untold)
    lazy = [
        xd.companion(run, 0.5, compute=False).global_error_u,
        xd.compare(run, run, times=[0.5], occurrences=0, compute=False).difference_u,
        xd.refine(chain, steps=["25 ms", "5 ms"], at=["0.9 s"], until="0.9 s", occurrences=0, compute=False).limit_u,
    ]
    for found in lazy:
        assert found.dims == ("at", "site")
        assert found.attrs["units"] == "m"
        with pytest.raises(AssertionError, match="told apart"):
            found.compute()
    kept = xd.sweep(chain, {"step": STEPS}, keep=["end_u", "u"], times=[0.5])
    assert kept.u.dims == ("solver_step", "at", "site")
    assert kept.end_u.chunks is not None


def test_many_numbers_are_judged_as_each_alone() -> None:
    """Assert verdict, limit, uncertainty and rule of numbers side by side, of every rule, against each by itself."""
    rng, found = np.random.default_rng(7), set[str]()
    steps = 0.1 * 0.5 ** np.arange(5)
    orders = rng.choice([4.0, 4.02, 5.0, 2.0, 0.0, -1.0], (90, 1))
    values = 1.0 + rng.normal(size=(90, 1)) * (steps / 0.1) ** orders * rng.choice([1.0, 1e-15], (90, 1))
    values += rng.normal(size=values.shape) * rng.choice([0.0, 1e-4], (90, 1), p=[0.8, 0.2])
    values[::17, -1] = np.nan
    rounding, inside, events = (rng.choice([0.0, 1e-12, 1e-3], 90, p=[0.7, 0.2, 0.1]) for _ in range(3))
    kinks, estimated = rng.choice([np.inf, 1.0], 90, p=[0.8, 0.2]), rng.choice([0.0, 1e-2], 90, p=[0.9, 0.1])
    for smooth in (True, False):
        asked = {"smooth": smooth, "accepted": 50, "order": 4.0}
        many = judge(values, steps, 4.0, rounding, inside, events, kink=kinks, estimated=estimated, **asked)
        for i in range(90):
            own = (values[i], steps, 4.0, rounding[i], inside[i], events[i])
            one = judge(*own, kink=kinks[i], estimated=estimated[i], **asked)
            assert repr((one.verdict, one.limit, one.uncertainty, one.rule)) == repr(
                (
                    int(many.verdict[i]),
                    float(many.limit[i]),
                    float(many.uncertainty[i]),
                    UNCERTAINTY_RULES[many.rule[i]],
                )
            )
            found.add(one.rule)
    assert found == {*UNCERTAINTY_RULES}


def test_a_judgement_names_its_rules_by_number() -> None:
    """Assert that verdict, limit, uncertainty and rule take 18 bytes of each of many numbers, and that rules differ."""
    values = 1.0 + np.array([[0.1, 0.01, 0.001], [0.1, 0.2, 0.0], [np.nan] * 3])
    judged = judge(values, 0.5 ** np.arange(3.0), 4.0, 0.0, 0.0, 0.0)
    found = judged.verdict, judged.limit, judged.uncertainty, judged.rule
    assert sum(part.nbytes for part in found) == 18 * len(values)
    assert len(set(judged.rule.tolist())) > 1


def test_logs_of_many_wide_runs_are_short(chain: xd.Model) -> None:
    """Assert that rows of 40,000 numbers take some megabytes, and that narrow ones are as many as ever."""
    wide = xd.Model.from_text(
        CHAIN.replace('["a", "b", "c", "d"]', "10000")
        .replace("value = [4, 5, 6], ", "value = 1, ")
        .replace("value = [1, 2, 1, 3], ", "value = 1, ")
        .replace("[1, 0, 0.2, -0.3]", "0")
        .split("[events")[0]
        + '[initial]\nu = "0*metre"\n'
    )
    settings = Settings(METHODS["rk4"], 1.0)
    assert log_of_many(settings.layout(wide), settings).rows.nbytes < 1 << 26
    assert log_of_many(settings.layout(chain), settings).rows.shape[1] > 1 << 14


@pytest.mark.parametrize(
    "verb",
    ["companion", "diagnose", "complete", "compare", "sample", "extend", "save", "plot"],
)
@pytest.mark.parametrize("cut", [{"site": [0]}, {"site": 0}, {"spring": [1, 2]}, {"site": [0], "step": slice(0, 5)}])
def test_a_run_that_was_cut_is_refused(chain: xd.Model, tmp_path: Path, verb: str, cut: dict[str, Any]) -> None:
    """Assert that no verb computes with some elements of a run: it says which dimension was cut, and what is needed."""
    more: dict[str, Any] = {"sample": (0.5,), "compare": (xd.simulate(chain),)}
    more |= {"save": (tmp_path / "run.nc",), "plot": (tmp_path / "run.png",)}
    until = {"until": "2 s"} if verb == "extend" else {}
    dim, kept = next((dim, kept) for dim, kept in cut.items() if dim != "step")
    said = f"cut: it has {len(kept) if isinstance(kept, list) else 'a single one'} of its . elements along '{dim}', .*whole run"
    with pytest.raises(xd.InputError, match=said):
        getattr(xd, verb)(xd.simulate(chain).isel(cut), *more.get(verb, ()), **until)


@pytest.mark.parametrize("verb", ["companion", "diagnose", "complete", "compare", "sample", "save"])
def test_a_run_that_was_cut_is_refused_without_labels(tmp_path: Path, verb: str) -> None:
    """Assert that one element of a run without labels or events, which nothing in it names, is refused likewise."""
    text = CHAIN[: CHAIN.index("[events")] + CHAIN[CHAIN.index("[initial]") :]
    run = xd.simulate(xd.Model.from_text(text.replace('["a", "b", "c", "d"]', "4")))
    more = {"sample": (0.5,), "compare": (run,), "save": (tmp_path / "run.nc",)}
    with pytest.raises(xd.InputError, match="cut: it has a single one of its 4 elements along 'site'"):
        getattr(xd, verb)(run.isel(site=0), *more.get(verb, ()))


def test_closed_forms_are_checked_and_read_without_their_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a model with a closed form of every element is read without one of them, and knows each."""
    made: list[str] = []
    monkeypatch.setattr(Elements, "_closed_form", lambda _, form, place: made.append(form.quantity) or (form, place))
    forms = '[validation.end]\nquantity = "u"\nexpression = "1*metre*index(site)"\nbound = "1 m"\n'
    model = xd.Model.from_text(CHAIN + forms)
    assert [*model.elements.validation] == [f"end{DOT}{label}" for label in "abcd"]
    assert made == []
    assert model.elements.validation[f"end{DOT}c"][1] == {"site": 2}


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ('expression = "1*second*index(site)"', "validation 'u': has units 's', needs 'm' of 'u'"),
        ('expression = "u"', "validation 'u': reads 'u', which is what is computed"),
        ('expression = "1*metre"\nquantity = "u[e]"', r"validation 'u': 'u\[e\]': dimension 'site' has no element e"),
        ('expression = "1*metre"\nevent = "passed"', "event 'passed' is one of each site; name one, like 'passed.a.'"),
        (
            'expression = "1*metre"\nevent = "passed[e]"',
            r"validation 'u': 'passed\[e\]': dimension 'site' has no element e",
        ),
        (
            'expression = "1*metre"\nevent = "arrived[a]"',
            r"event 'arrived\[a\]' is none of the model's; there are passed",
        ),
        ('expression = "1*metre"\nbound = "1 s"', "bound '1.0 s' has units 's', needs 'm'"),
    ],
)
def test_closed_forms_of_all_elements_that_cannot_be(form: str, said: str) -> None:
    """Assert that a closed form of all elements is refused once, with what is wrong."""
    bound = "" if "bound" in form else '\nbound = "1 m"'
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(f"{CHAIN}[validation.u]\n{form}{bound}")


def test_long_rows_are_held_a_few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a sweep of a model with many elements never holds more rows than the limit, and runs go alone."""
    n, held = 1000, list[int]()
    text = CHAIN[: CHAIN.index("[observables]")] + CHAIN[CHAIN.index("[initial]") :]
    text = text.replace('["a", "b", "c", "d"]', str(n)).replace("[4, 5, 6]", "5").replace("[1, 2, 1, 3]", "1")
    model = xd.Model.from_text(text.replace("[1, 0, 0.2, -0.3]", "0"))

    def harvest(*given: Any) -> MemberRuns:
        held.append(8 * len(given[2].columns) * int(given[2].rows.sum()))
        return MemberRuns(*given)

    monkeypatch.setattr("xdynamics.sweeping.members.MemberRuns", harvest)
    starts = {"u[3]": [f"{i} mm" for i in range(1, 41)]}
    kept = xd.sweep(model, starts, keep=["u[3]"], times=[0.1], until="0.1 s", members_per_task=40).compute()
    assert len(held) > 1
    assert max(held) <= 2 * LOG_BYTES
    np.testing.assert_array_equal(kept.u.sel(site=3).squeeze() > 0, True)
    settings = settings_for(model)
    assert lanes_for(law_of(settings.layout(model), sampled=False), settings, 1000, None) == 1
