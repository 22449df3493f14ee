"""Years and months in expressions are Julian, and a model's own names come before them."""

import numpy as np

import xdynamics as xd

YEAR = 365.25 * 86400.0


def _decay(**more: object) -> xd.Model:
    sections = {
        "parameters": {"tau": "3 year"},
        "states": {"n": {"unit": "1", "rate": "-n/tau"}},
        "initial": {"n": "1"},
        "events": {"mark": {"function": "t - year - 6*month"}},
    }
    return xd.Model(name="Decay", **(sections | more))


def test_years_and_months_are_julian() -> None:
    """Assert that a zero of `t - year - 6*month` is a year and a half of 365.25 days after the start."""
    run = xd.simulate(_decay(), method="dop853", until="2 year")
    assert np.isclose(float(run["event_time"][0]), 1.5 * YEAR, rtol=1e-12)


def test_a_parameter_of_that_name_comes_first() -> None:
    """Assert that a model with a parameter `year` marches by its value, bit for bit as under another name."""
    states = {"n": {"unit": "1", "rate": "-n/year"}}
    model = _decay(parameters={"year": "3 s"}, states=states, events={"mark": {"function": "t - year/2"}})
    other = _decay(
        parameters={"q": "3 s"}, states={"n": {"unit": "1", "rate": "-n/q"}}, events={"mark": {"function": "t - q/2"}}
    )
    run, twin = (xd.simulate(each, method="dop853", until="2 s") for each in (model, other))
    assert run["n"].values.tobytes() == twin["n"].values.tobytes()
    assert np.isclose(float(run["event_time"][0]), 1.5, rtol=1e-12)


def test_a_coordinate_of_that_name_comes_first() -> None:
    """Assert that a coordinate `month`, with its velocity, is the one that forces and events read."""
    model = xd.Model(
        name="Spring",
        coordinates={"month": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"month": "m"},
        forces={"spring": {"month": "-k*month"}},
        events={"through": {"function": "month", "action": "stop"}},
        initial={"month": "1 m"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s")
    assert np.isclose(float(run["time"][-1]), np.pi / 4.0, rtol=1e-8)
    assert np.isclose(float(run["v_month"][-1]), -2.0, rtol=1e-8)


def test_a_unit_that_is_no_name_is_told() -> None:
    """Assert that a symbol of a unit in an expression leads to the constant that is the unit."""
    faults = []
    for symbol in ("h", "cm"):
        try:
            _decay(events={"mark": {"function": f"t - 2*{symbol}"}})
        except xd.InputError as error:
            faults.append(str(error).split("; ")[-1])
    assert faults == ["as a unit it is written hour", "as a unit it is written 0.01*metre"]
