"""When a motion first comes to an event or a contact, as its start lets one expect."""

import math

import pytest

import xdynamics as xd
from xdynamics.documenting.plain_text import model_lines
from xdynamics.methods import METHODS
from xdynamics.model.linearisation import initial_state
from xdynamics.stability import stable_step_of
from xdynamics.stability.first_events import first_event
from xdynamics.stability.spectrum import Spectrum, StepLimits, checked_linearisation


def ball(y: str, v_y: str, **parts: object) -> xd.Model:
    return xd.Model(
        name="ball",
        coordinates={"y": {"unit": "m"}},
        parameters={"m": "57 g", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": y, "v_y": v_y},
        **parts,
    )


def expected(model: xd.Model) -> tuple[str, float]:
    start = initial_state(model)
    return first_event(model, start, checked_linearisation(model, start))


FLOOR = {"floor": {"gap": "y", "restitution": "0.75"}}


@pytest.mark.parametrize("y", ["5 nm", "1 mm", "1 m", "1 km", "1 light_year", "1e9 light_year"])
def test_free_fall_is_told_exactly(y: str) -> None:
    model = ball(y, "0 m s-1", contacts=FLOOR)
    height = initial_state(model)["y"]
    assert expected(model) == ("floor", pytest.approx(math.sqrt(2 * height / 9.81), rel=1e-6))


def test_events_count_in_their_direction_and_the_first_one_is_told() -> None:
    events = {
        "apex": {"function": "v_y", "direction": "falling"},
        "upward": {"function": "y - 2*metre", "direction": "rising"},
        "downward": {"function": "y - 2*metre", "direction": "falling"},
        "late": {"function": "t - 0.001*second"},
    }
    for names, first, time in (
        (["apex", "upward", "downward", "late"], "upward", (5 - math.sqrt(25 - 2 * 9.81)) / 9.81),
        (["apex", "downward", "late"], "apex", 5 / 9.81),
        (["downward"], "downward", (5 + math.sqrt(25 - 2 * 9.81)) / 9.81),
        (["late"], "", math.inf),
    ):
        model = ball("1 m", "5 m s-1", events={name: events[name] for name in names})
        assert expected(model) == (first, pytest.approx(time, rel=1e-6))


def test_a_ball_that_lies_meets_nothing() -> None:
    assert expected(ball("0 m", "0 m s-1", contacts=FLOOR)) == ("", math.inf)


def test_check_proposes_a_step_that_resolves_the_first_contact() -> None:
    lines = list(model_lines(ball("7 m", "0 m s-1", contacts=FLOOR)))
    assert "scales    at the start: nothing turns or decays; floor after about 1.19 s" in lines
    assert "step      0.24 s to begin with" in lines


@pytest.mark.parametrize("name", ["double_pendulum", "coupled_masses", "impact_oscillator", "quarter_car", "heat"])
def test_a_search_that_stops_early_gives_the_same_suggestion(name: str) -> None:
    """Assert that the suggested step is the lesser of T/20 and half of the largest step that a whole search finds."""
    model = xd.Model.from_toml(f"data/models/{name}.toml")
    spectrum = Spectrum.of(model, checked_linearisation(model, initial_state(model)))
    found = StepLimits.of(model, spectrum).suggested
    for method, step in zip(METHODS.values(), found, strict=True):
        whole = stable_step_of(spectrum.system, method, model, growth=0.01 / spectrum.resolved)
        whole = min(spectrum.resolved / 20, whole / 2) if whole == whole else whole
        assert step == pytest.approx(whole, rel=1e-15, nan_ok=True)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_pendulum_meets_its_lowest_point_within_a_period_or_not_at_all(size: float) -> None:
    """Assert an event of a swing at any time scale, and none that constant acceleration would lead to after a turn."""
    for at, word in (("0.5", "inside"), ("-5", "")):
        model = xd.Model(
            name="swing",
            coordinates={"x": {"unit": "m"}},
            parameters={"k": f"{1 / size**2!r} N m-1", "m": "1 kg"},
            mass={"x": "m"},
            forces={"spring": {"x": "-k*x"}},
            initial={"x": "1 m", "v_x": "0 m s-1"},
            events={"inside": {"function": f"x - {at}*metre"}},
        )
        start = initial_state(model)
        linearisation = checked_linearisation(model, start)
        within = Spectrum.of(model, linearisation).resolved
        found, time = first_event(model, start, linearisation, within=within / 2 if not word else within)
        assert found == word
        assert not word or time == pytest.approx(size, rel=1e-6)  # sqrt(2*0.5/(k*1))
