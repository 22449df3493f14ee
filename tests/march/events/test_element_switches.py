"""Switches hidden in forces of elements: which element passes, against closed forms."""

import math

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.model.switches import smooth_switches, switches
from xdynamics.record import unfold

BLOCKS = """
name = "Blocks on springs with dry friction"
[dimensions]
site = 4
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
m = "1 kg"
k = { dims = ["site"], value = "(1 + 0.9*index(site))*newton/metre" }
mu = "0.02 N"
[relations.pair]
of = "site"
neighbours = 1
[mass]
u = "m"
[forces.spring]
u = "-k*u"
[forces.friction]
u = "-mu*sign(v_u)"
[initial]
u = "1 m"
[run]
method = "dormand_prince"
rtol = 1e-9
until = "5 s"
"""
LINKED = '[forces.friction]\nover = "pair"\nu = "mu*sign(second(v_u, pair) - first(v_u, pair))"'
OWN = '[forces.friction]\nu = "-mu*sign(v_u)"'


def names(text: str) -> list[str]:
    return [switch.name for switch in switches(xd.Model.from_text(text))]


def test_which_block_turns() -> None:
    """Assert that each block turns at whole multiples of pi over its own frequency, and the record says which it is."""
    run = xd.simulate(xd.Model.from_text(BLOCKS))
    halves = [math.pi / math.sqrt(1.0 + 0.9 * site) for site in range(4)]
    expected = sorted((n * half, site) for site, half in enumerate(halves) for n in (1, 2, 3) if n * half < 5.0)
    assert run.event_detector.attrs["flag_meanings"] == "friction.sign"
    assert run.event_site.values.tolist() == [site for _, site in expected]
    np.testing.assert_allclose(run.event_time, [time for time, _ in expected], rtol=1e-8)
    rows, sites = run.event_row_after.values, run.event_site.values
    sides = run.side_friction_sign.values
    assert (sides[rows, sites] == -sides[run.event_row_before.values, sites]).all()
    assert run.side_friction_sign.dims == ("step", "site")
    assert run.side_friction_sign.attrs["function"] == "v_u"
    assert "friction.sign·3" in unfold(run).event_detector.attrs["flag_meanings"].split()


def test_switch_of_a_link() -> None:
    """Assert that friction between neighbours switches for a link, at pi over the frequency of two masses against each other."""
    text = BLOCKS.replace(OWN, LINKED).replace("site = 4", "site = 2").replace("0.9*index", "0*index")
    text = text.replace('u = "1 m"', 'u = { value = [1.0, -1.0], unit = "m" }')
    run = xd.simulate(xd.Model.from_text(text))
    assert run.event_pair.values.tolist() == [0]
    assert [run.event_first.values.tolist(), run.event_second.values.tolist()] == [[0], [1]]
    np.testing.assert_allclose(run.event_time, [math.pi], rtol=1e-8)


def test_numbers_are_those_of_the_force() -> None:
    """Assert that several switches of one function have the same number for each element, also where one has fewer."""
    twice = OWN.replace("sign(v_u)", "(sign(v_u) + sign(shift(u, site, 1, 2*metre) - 1*metre))")
    expected = ["friction.sign·0"]
    expected += [f"friction.{word}·{site}" for site in (1, 2, 3) for word in ("sign", "sign_2")]
    assert names(BLOCKS.replace(OWN, twice)) == expected


@pytest.mark.parametrize(
    ("force", "expected"),
    [
        ("-mu*max(u, site)/metre", [f"friction.max·{site}" for site in range(3)]),
        ("-mu*sign(u[2])", ["friction.sign"]),
        ("-mu*where(t > 1*second, 1, 0)", ["friction.where"]),
        ("-mu*sum(abs(u), site)/metre", [f"friction.abs·{site}" for site in range(4)]),
        ("-mu*where(index(site) > 1, floor(u/metre), 0)", ["friction.floor·2", "friction.floor·3"]),
    ],
)
def test_names_along_dimensions(force: str, expected: list[str]) -> None:
    """Assert that a reduction's switches are of what is compared, and that what all share is of no element."""
    assert names(BLOCKS.replace("-mu*sign(v_u)", force)) == expected


def test_kink_of_a_potential() -> None:
    """Assert that a derivative's switch is of the link whose potential has the kink."""
    text = BLOCKS.replace(
        OWN, '[forces.friction]\nover = "pair"\npotential = "mu*abs(second(u, pair) - first(u, pair))"'
    )
    assert names(text) == [f"friction.sign·{link}" for link in range(3)]


def test_rates_share_a_switch() -> None:
    """Assert that a flux between two cells that switches is one switch, not one for each of both rates."""
    flux = "(T - shift(T, cell, 1, 0*kelvin))*where(T > shift(T, cell, 1, 0*kelvin), 1, 2)"
    text = f"""
name = "Valves"
[dimensions]
cell = 3
[states.T]
unit = "K"
dims = ["cell"]
rate = "-{flux}/second + roll({flux}, cell, -1)/second"
[initial]
T = "(3 - index(cell))*kelvin"
"""
    assert names(text) == [f"T.where·{cell}" for cell in (0, 1, 2)]


def test_smooth_switches_are_named() -> None:
    """Assert that switches declared smooth are named by elements as well, and refined by levels that locate them."""
    model = xd.Model.from_text(BLOCKS.replace("[forces.friction]", "[forces.friction]\nsmooth = true"))
    assert [switch.name for switch in smooth_switches(model)] == [f"friction.sign·{site}" for site in range(4)]
    run = xd.simulate(model)
    assert run.smooth_switches_passed.attrs["names"].split() == [f"friction.sign[{site}]" for site in range(4)]
    study = xd.refine(
        model, method="rk4", steps=["40 ms", "20 ms", "10 ms"], until="3 s", at=["3 s"], observables=["u"]
    )
    rate = np.sqrt(1.0 + 0.9 * np.arange(4))
    turns, shift = np.floor(3.0 * rate / math.pi), 0.02 / rate**2
    exact = (-1.0) ** turns * shift + (1.0 - (2.0 * turns + 1.0) * shift) * np.cos(3.0 * rate)
    errors = np.abs(study.u.values[-1, 0] - exact)
    assert (errors > 1e-9).all()
    assert (errors < study.uncertainty_u.values[0]).all()
    assert (study.verdict_u.values == study.verdict_u.attrs["flag_meanings"].split().index("event_limited")).all()


def test_sweep_keeps_times_of_elements() -> None:
    """Assert that a sweep keeps the first passage of each block's switch along its dimension."""
    sweep = xd.sweep(xd.Model.from_text(BLOCKS), axes={"m": ["1 kg", "4 kg"]}, keep=["event_time_friction.sign"])
    expected = np.sqrt([1.0, 4.0])[:, None] * math.pi / np.sqrt(1.0 + 0.9 * np.arange(4))
    expected[expected > 5] = np.nan
    np.testing.assert_allclose(sweep["event_time_friction.sign"].values.reshape(2, 4), expected, rtol=1e-8)


def test_elements_without_a_switch_are_elsewhere() -> None:
    """Assert that sides of a largest element are signs of what is compared, and that the last, with none after it, has none."""
    run = xd.simulate(xd.Model.from_text(BLOCKS.replace("-mu*sign(v_u)", "-mu*max(u, site)/metre")))
    sides, u = run.side_friction_max.values, run.u.values
    for site in range(3):
        above = u[:, site] - u[:, site + 1 :].max(axis=1)
        clear = np.abs(above) > 1e-6
        assert {*sides[clear, site].tolist()} == {-1, 1}
        assert (sides[clear, site] == np.sign(above[clear])).all()
    words = run.side_friction_max.attrs
    assert (sides[:, 3] == words["flag_values"][words["flag_meanings"].split().index("elsewhere")]).all()
