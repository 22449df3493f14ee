"""Terms of rates by name, which regimes list: a room with a heater against its closed form."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import xdynamics as xd

ROOM = """
name = "Room with a heater"
[states.T]
unit = "K"
terms = { loss = "-(T - T0)/tau", heater = "P/C" }
[parameters]
T0 = "280 K"
tau = "1 h"
P = "1 kW"
C = "100 kJ K-1"
[events.warm]
function = "T - 294*kelvin"
direction = "rising"
action = "switch"
to = "off"
[events.cold]
function = "T - 292*kelvin"
direction = "falling"
action = "switch"
to = "on"
[regimes.on]
terms = ["heater"]
[regimes.off]
[initial]
T = "285 K"
[run]
until = "4 h"
"""
WARMING, COOLING, AGAIN = (3600 * math.log(ratio) for ratio in (31 / 22, 14 / 12, 24 / 22))
CHOSEN = {"rtol": 1e-11}


@pytest.mark.parametrize(
    ("method", "settings", "tolerance"),
    [
        ("dop853", CHOSEN, 1e-6),
        ("taylor", CHOSEN, 1e-6),
        ("radau_iia", CHOSEN, 1e-5),
        ("rk4", {"step": "1 min"}, 1e-5),
    ],
)
def test_a_thermostat_switches_at_the_times_of_its_closed_form(
    method: str, settings: dict[str, object], tolerance: float
) -> None:
    """Assert the times of the first three switches, by methods of each kind."""
    run = xd.simulate(xd.Model.from_text(ROOM), method=method, **settings)
    assert run.attrs["run_outcome"] == "completed"
    times = [WARMING, WARMING + COOLING, WARMING + COOLING + AGAIN]
    assert run.event_time.values[:3] == pytest.approx(times, rel=0.0, abs=tolerance)
    assert run.T.values.max() == pytest.approx(294.0, rel=1e-12)


def test_where_both_regimes_drive_back_the_rate_slides() -> None:
    """Assert that with one threshold the temperature stays there, by the share that balances both rates."""
    run = xd.simulate(xd.Model.from_text(ROOM.replace("292*kelvin", "294*kelvin")), method="dop853", **CHOSEN)
    assert run.attrs["run_outcome"] == "completed"
    assert run.T.values[-1] == 294.0
    assert run.switch_share_warm.values[-1] == pytest.approx(1.0 - 14.0 / 36.0, rel=1e-12)


def test_it_is_archived_swept_and_budgeted_as_any_other(tmp_path: Path) -> None:
    """Assert the same bits from the file, the same model from its text, members of a sweep, and the slope of a budget."""
    model = xd.Model.from_text(ROOM)
    xd.save(xd.simulate(model, method="dop853", **CHOSEN), tmp_path / "room.nc")
    assert xd.reproduce(tmp_path / "room.nc").attrs["identical"] == 1
    assert xd.Model.from_text(model.to_toml()).digest == model.digest
    grid = xd.sweep(model, {"P": "0.8:1.2:3 kW"}, keep=["event_time_warm"], method="dop853", **CHOSEN)
    gained = [28.8, 36.0, 43.2]
    expected = [3600 * math.log((gain - 5) / (gain - 14)) for gain in gained]
    assert grid.event_time_warm.values.ravel() == pytest.approx(expected, rel=1e-9)
    uncertain = xd.Model.from_text(ROOM.replace('"1 kW"', '"1.00 ± 0.01 kW"'))
    budget = xd.error_budget(uncertain, "t", event="warm", method="dop853", **CHOSEN)
    slope = 3600 * 36 * (1 / 31 - 1 / 22)  # seconds by a part of P
    assert float(budget.total_rss) == pytest.approx(abs(slope) * 0.01, rel=1e-3)


def test_terms_beside_a_rate_and_of_two_states_are_one() -> None:
    """Assert that a rate stands beside terms, and that a term of two states is switched in both; no regime lists `loss`."""
    text = (
        ROOM.replace('terms = { loss = "-(T - T0)/tau", heater', 'rate = "-(T - T0)/tau"\nterms = { heater')
        + '[states.E]\nunit = "J"\nterms = { heater = "P" }\n'
    ).replace('T = "285 K"', 'T = "285 K"\nE = "0 J"')
    run = xd.simulate(xd.Model.from_text(text), method="dop853", until="25 min", **CHOSEN)
    assert run.T.values[-1] == pytest.approx(280.0 + 14.0 * math.exp(-(1500.0 - WARMING) / 3600.0), rel=1e-10)
    assert run.E.values[-1] == pytest.approx(1000.0 * WARMING, rel=1e-10)


def test_a_term_acts_in_each_of_the_regimes_that_list_it() -> None:
    """Assert a ramp that goes on in the first and third of three regimes, and rests in the second."""
    model = xd.Model(
        name="ramp",
        states={"s": {"unit": "m", "terms": {"up": "1*metre/second"}}},
        events={
            "wait": {"function": "t - 1*second", "direction": "rising", "action": "switch", "to": "still"},
            "on": {"function": "t - 3*second", "direction": "rising", "action": "switch", "to": "again"},
        },
        regimes={"first": {"terms": ["up"]}, "still": {}, "again": {"terms": ["up"]}},
        initial={"s": "0 m"},
    )
    run = xd.simulate(model, method="rk4", step="0.1 s", until="4 s")
    assert run.dynamics.at([0.5, 1.0, 2.0, 3.0, 4.0]).s.values == pytest.approx([0.5, 1.0, 1.0, 1.0, 2.0], rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('["heater"]', '["heatr"]', "regime 'on' has 'heatr', which is no term of a rate; there are: loss, heater"),
        ('"P/C"', '"P"', "term 'heater' of state 'T' has units 'kg m2 s-3"),
        ('"P/C"', '"P/D"', "term 'heater' of state 'T': name 'D'"),
        ('terms = { loss = "-(T - T0)/tau", heater = "P/C" }', "", "state 'T': key 'rate' is missing; write how fast"),
        ("terms = { loss", "term = { loss", "key 'term' is not known; did you mean 'terms'?"),
        ('["heater"]', '"heater"', "terms"),
        ('"P/C"', '"P/C +"', "heater"),
        ('heater = "P/C"', "heater = 3", "heater"),
    ],
)
def test_what_is_wrong_with_terms_is_named(old: str, new: str, said: str) -> None:
    """Assert one error that names the state, its term, and what is wrong."""
    with pytest.raises(xd.ModelError, match=said.replace("?", r"\?")):
        xd.Model.from_text(ROOM.replace(old, new))


@pytest.mark.parametrize("method", ["dop853", "taylor", "radau_iia"])
def test_each_term_is_a_variable_and_they_sum_to_the_rate(method: str) -> None:
    """Assert the closed form of each term, 0 where its regime is over, and that all together are the rate."""
    run = xd.simulate(xd.Model.from_text(ROOM), method=method, **CHOSEN)
    on = run.regime.values == 0
    assert run.term_heater_T.values == pytest.approx(on * 0.01, rel=1e-15)
    assert run.term_loss_T.values == pytest.approx(-(run.T.values - 280.0) / 3600.0, rel=1e-15)
    assert (run.term_heater_T + run.term_loss_T).values == pytest.approx(run.rate_T.values, rel=1e-15)
    assert run.term_heater_T.attrs["units"] == run.rate_T.attrs["units"]
    assert run.term_heater_T.attrs["role"] == "rate_term"


def test_terms_have_their_share_while_the_rate_slides(tmp_path: Path) -> None:
    """Assert that at the one threshold the heater gives what is lost, in the run and in its file."""
    run = xd.simulate(xd.Model.from_text(ROOM.replace("292*kelvin", "294*kelvin")), method="dop853", **CHOSEN)
    assert run.term_heater_T.values[-1] == pytest.approx(14.0 / 3600.0, rel=1e-12)
    assert run.term_loss_T.values[-1] == pytest.approx(-14.0 / 3600.0, rel=1e-12)
    xd.save(run, tmp_path / "room.nc")
    assert xd.reproduce(tmp_path / "room.nc").attrs["identical"] == 1


def test_terms_of_elements_stand_along_their_dimension() -> None:
    """Assert two terms of three sites against closed forms, in the order of their names."""
    text = """
    name = "Sites"
    [dimensions]
    site = 3
    [states.T]
    unit = "K"
    dims = ["site"]
    terms = { heat = "index(site)*kelvin/hour", loss = "-(T - 280*kelvin)/hour" }
    [initial]
    T = "300 K"
    [run]
    until = "2 h"
    """
    run = xd.simulate(xd.Model.from_text(text), method="dop853", **CHOSEN)
    assert run.term_heat_T.dims == ("step", "site")
    assert run.term_heat_T.values[-1] == pytest.approx([0.0, 1 / 3600.0, 2 / 3600.0], rel=1e-15)
    expected = [(280.0 + k + (20.0 - k) * math.exp(-2.0)) for k in range(3)]
    assert run.T.values[-1] == pytest.approx(expected, rel=1e-9)
    assert run.term_loss_T.values == pytest.approx(-(run.T.values - 280.0) / 3600.0, rel=1e-14)
