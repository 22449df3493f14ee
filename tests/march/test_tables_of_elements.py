"""Tables with a column for each element: what observables, potentials and events read of them, their units, by Taylor too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd

TIMES = [0.0, 0.7, 1.6, 2.5]
BATHS = [[290.0, 291.0, 292.0, 293.0, 294.0, 295.0], [291.0, 297.0, 288.0, 296.0, 293.0, 299.0]]
BATHS += [[290.0, 285.0, 289.0, 292.0, 299.0, 293.0], [296.0, 292.0, 298.0, 293.0, 291.0, 290.0]]


def table(units: tuple[str, ...] = ("K",) * 6) -> str:
    """The text of a table with a column for each bead, in one unit each."""
    head = ",".join(f"bath_{i} [{unit}]" for i, unit in enumerate(units))
    per = [{"K": 1.0, "mK": 1000.0}[unit] for unit in units]
    rows = (
        ",".join(map(repr, [t, *(value * factor for value, factor in zip(row, per, strict=True))]))
        for t, row in zip(TIMES, BATHS, strict=True)
    )
    return "\n".join([f"t [s],{head}", *rows, ""])


@lru_cache
def beads(units: tuple[str, ...] = ("K",) * 6) -> xd.Model:
    """Six beads in baths of their own, one of which a spring follows, watched for when either is as warm as its bath."""
    return xd.Model.from_text(f"""
name = "beads in baths"
[dimensions]
bead = 6
[parameters]
T_0 = "291 K"
k = "2 N m-1"
l = "1 m K-1"
[drives.bath]
table = "bath.csv"
dims = ["bead"]
outside = "hold"
csv = '''
{table(units)}'''
[coordinates]
x = {{ unit = "m", dims = ["bead"] }}
[mass]
x = "1*kilogram"
[forces.spring]
potential = "0.5*k*(x - l*(bath - T_0))**2"
[states.T]
unit = "K"
dims = ["bead"]
rate = "(bath - T)/(0.5*second)"
[initial]
T = "292 K"
x = "0.1*metre*index(bead)"
[events.even]
function = "T - bath"
[observables]
lag = "bath - T"
hottest = "max(bath, bead)"
of_two = "bath[2] + mean(bath, bead)"
[run]
method = "dop853"
rtol = 1e-9
until = "2.5 s"
""")


@lru_cache
def marched(method: str = "dop853") -> xr.Dataset:
    """A run of the beads."""
    return xd.simulate(beads(), method=method)


def baths(times: xr.DataArray) -> np.ndarray:
    """The baths at some times."""
    columns = np.transpose(BATHS)
    return np.stack([np.interp(times, TIMES, column) for column in columns], axis=1)


def test_observables_and_energies_read_tables_of_elements() -> None:
    """Assert that they are made of the straight lines between the points, at every row."""
    run = marched()
    bath = baths(run.time)
    np.testing.assert_allclose(run.lag, bath - run["T"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.hottest, bath.max(axis=1), rtol=1e-15)
    np.testing.assert_allclose(run.of_two, bath[:, 2] + bath.mean(axis=1), rtol=1e-15)
    np.testing.assert_allclose(run.potential_energy, ((run.x - (bath - 291)) ** 2).sum("bead"), rtol=1e-13)


def test_events_of_elements_read_tables_of_elements() -> None:
    """Assert that every passage of a temperature through its bath is found, and no other."""
    run = marched()
    at = baths(run.event_time)[np.arange(run.sizes["event"]), run.event_bead]
    after = run["T"].values[run.event_row_after, run.event_bead]
    np.testing.assert_allclose(after, at, rtol=1e-13)
    lag = run.lag.values  # rows are at every event, and there alone does its sign change
    passages = [int((np.diff(np.sign(lag[np.abs(lag[:, i]) > 1e-9, i])) != 0).sum()) for i in range(6)]
    assert np.bincount(run.event_bead, minlength=6).tolist() == passages
    assert sum(passages) >= 6


@pytest.mark.parametrize("method", ["taylor", "radau_iia"])
def test_methods_agree_on_tables_of_elements(method: str) -> None:
    """Assert that methods that expand or differentiate forces in loops end where an explicit one ends."""
    run, given = marched(method), marched()
    for name, size in (("x", 10.0), ("T", 300.0)):
        np.testing.assert_allclose(run[name][-1], given[name][-1], rtol=0, atol=1e-8 * size)
    assert run.sizes["step"] < 1000


def test_columns_in_several_units_are_recorded_in_the_first() -> None:
    """Assert that samples of a table in mK and K are all in mK, and move the beads as in K."""
    run = xd.simulate(beads(("mK", "K", "K", "mK", "K", "K")))
    assert run.sample_bath.attrs["units"] == "mK"
    np.testing.assert_allclose(run.sample_bath, 1000 * marched().sample_bath, rtol=1e-13)
    np.testing.assert_allclose(run["T"], marched()["T"], rtol=1e-12)


LIMITS = """t [s],limit_0 [m],limit_1 [m],limit_2 [m]
0,0.05,0.02,-0.1
1,0.3,0.5,0.2
2,-0.2,-0.4,0.3
3,0.1,0.6,-0.6
4,0.2,0.1,0.4
"""


def limited(argument: str, ends: dict[str, str]) -> xd.Model:
    """Blocks on springs, watched for when each passes a limit that moves: `ends` of their names, and the number of each."""
    blocks = "".join(
        f"""
coordinates.u{end}.unit = "m"
mass.u{end} = "1*kilogram"
forces.spring.u{end} = "-9*u{end}*newton/metre"
drives.limit{end}.table = "limits.csv"
drives.limit{end}.csv = '''{LIMITS}'''
drives.limit{end}.argument = "{argument}"
drives.limit{end}.interpolation = "cubic"
initial.u{end} = "0.1*metre*(1 + {number})"
events.over{end} = {{ function = "u{end} - limit{end}", time_tolerance = "1 ms" }}
observables.product{end} = "limit{end}*u{end}"
"""
        + (f'drives.limit{end}.column = "limit{end}"' if end else 'drives.limit.dims = ["block"]')
        for end, number in ends.items()
    )
    more = "" if len(ends) > 1 else 'dimensions.block = 3\ncoordinates.u.dims = ["block"]'
    return xd.Model.from_text(f"""
name = "limits"
run = {{ method = "velocity_verlet", step = "20 ms", until = "1.9 s" }}
{more}{blocks}""")


@pytest.mark.parametrize("argument", ["t", "2*t", "t**2/(1*second)"])
def test_events_know_how_fast_tables_of_elements_move(argument: str) -> None:
    """Assert that times, residuals and uncertainties of events are, to the bit, those of the same model written out."""
    run = xd.simulate(limited(argument, {"": "index(block)"}))
    apart = xd.simulate(limited(argument, {f"_{i}": str(i) for i in range(3)}))
    names = ["event_time", "event_residual", *(name for name in run if str(name).startswith("event_time_uncertainty"))]
    assert run.sizes["event"] >= 5
    assert len(names) == 6
    for name in names:
        np.testing.assert_array_equal(run[name], apart[name], err_msg=str(name))
    for i in range(3):
        np.testing.assert_array_equal(run.event_product_uncertainty[:, i], apart[f"event_product_{i}_uncertainty"])
