"""Keywords that a verb does not have: the error names what was meant, or where it is said."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd

MODEL = xd.Model(
    name="swing",
    coordinates={"x": {"unit": "m"}},
    parameters={"m": "1 kg", "k": "4 N m-1"},
    mass={"x": "m"},
    forces={"spring": {"potential": "k*x**2/2"}},
    initial={"x": "1 m", "v_x": "0 m s-1"},
    run={"method": "rk4", "step": "10 ms", "until": "1 s"},
)


@pytest.mark.parametrize(
    ("verb", "keyword", "message"),
    [
        ("refine", "initial", r"^there is no setting 'initial'; a start stands in the model: model.replace\(initial="),
        ("refine", "parameters", r"^there is no setting 'parameters'; numbers stand in the model: model.replace\("),
        ("simulate", "dt", "^simulate has no 'dt'; did you mean 'step'"),
        ("simulate", "duration", "^simulate has no 'duration'; did you mean 'until'"),
        ("simulate", "rtoll", "^simulate has no 'rtoll'; did you mean 'rtol'"),
        ("sample", "variables", r"^sample has no 'variables'; take them from what comes back, as in result\[\['x', "),
        ("plot", "variables", "^plot has no 'variables'; did you mean 'only'"),
        ("modes", "state", "^modes has no 'state'; did you mean 'at'"),
        (
            "save",
            "zzz",
            "^save has no 'zzz'; there are run, path, derived, compress, creator, institution, license, id, references, comment$",
        ),
        ("error_budget", "initial", "^there is no setting 'initial'; a start stands in the model: model.replace"),
        ("refine", "dt", "^there is no setting 'dt'; did you mean 'step'"),
    ],
)
def test_an_unknown_keyword_is_named_with_what_was_meant(verb: str, keyword: str, message: str) -> None:
    """Assert one line for each, of the package's own kind of error."""
    run = xd.simulate(MODEL)
    given: dict[str, tuple[Any, ...]] = {"sample": (run, [0.5]), "plot": (run,), "save": (run, "run.nc")}
    more: dict[str, dict[str, Any]] = {
        "error_budget": {"quantity": "x", "at": "1 s"},
        "refine": {"rtols": [1e-3, 1e-4]},
    }
    with pytest.raises(xd.InputError, match=message):
        getattr(xd, verb)(*given.get(verb, (MODEL,)), **more.get(verb, {}), **{keyword: {"x": "2 m"}})


def test_a_missing_argument_stays_pythons_own() -> None:
    """Assert that what is no unknown keyword passes through."""
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        xd.sample(xd.simulate(MODEL))  # type: ignore[call-arg]


@pytest.mark.parametrize("given", [None, 3, {"k": 1}])
def test_parameters_of_a_fit_are_names(given: Any) -> None:
    """Assert that the value is shown, and a name that would do."""
    data = xd.sample(xd.simulate(MODEL), [0.2, 0.4, 0.6])
    with pytest.raises(xd.InputError, match=r"^parameters are .*, need names, like \['m'\]$"):
        xd.fit(MODEL, data, given)
