"""Runs whose numbers are sums of two floats, against closed forms and series of 60 digits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.verdicts import verified
from xdynamics.archive import segments
from xdynamics.archive.signatures import new_key
from xdynamics.elementary.piecewise import POLYNOMIALS
from xdynamics.faults import InputError
from xdynamics.kernels.double_double import PIECES
from xdynamics.model.drives import piece_coefficients

LONG = {"precision": "double_double"}
SERIES: dict[str, Any] = {"method": "taylor", "order": 30, "step": "0.1 s"}
# of x' = 10 (y - x), y' = 28 x - x z - y, z' = x y - 8/3 z from (1, 0, 0) at t = 40: what series of order 40 with steps of
# 0.02 and 60 digits, and of order 50 with steps of 0.025 and 70 digits, agree on
LORENZ_AT_40 = ("-0.1947314224187369656", "0.1811029909705402862", "17.23446569130643076")


class PowerCut(Exception):
    """Ends a run as nothing that it expects."""


def swing(**more: Any) -> xd.Model:
    """Return an oscillator in millimetres, with a frequency that is no float."""
    return xd.Model(
        name="swing",
        coordinates={"x": {"unit": "mm"}},
        parameters={"k": "0.1 N m-1", "m": "0.3 kg"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": "7.1 mm", "v_x": "0 mm s-1"},
        **more,
    )


def kepler(event: str) -> xd.Model:
    """Return an orbit of period 2 pi and eccentricity 0.6 from its nearest point."""
    return xd.Model(
        name="kepler",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "m"}},
        parameters={"m": "1 kg", "mu": "1 m3 s-2"},
        mass={"x": "m", "y": "m"},
        forces={"gravity": {"potential": "-m*mu/sqrt(x**2 + y**2)"}},
        events={"nearest": {"function": event, "direction": "rising"}},
        initial={"x": "0.4 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "2 m s-1"},
    )


def number(run: Any, name: str, i: int = -1) -> Any:
    """Return a number with its rest."""
    return mpmath.mpf(float(run[name].values[i])) + mpmath.mpf(float(run[f"rest_{name}"].values[i]))


def exact_x(t: str | Any) -> Any:
    """Return where the swing is, mm."""
    return mpmath.mpf("7.1") * mpmath.cos(mpmath.sqrt(mpmath.mpf(1) / 3) * mpmath.mpf(t))


@pytest.fixture(autouse=True)
def digits() -> Any:
    """Compute with 60 digits."""
    with mpmath.workdps(60):
        yield


def test_harmonic_motion() -> None:
    """Assert that numbers as they are written, in their units, give the cosine to 30 digits at times as they are written."""
    run = xd.simulate(swing(), until="1.05 s", **SERIES, **LONG)
    assert abs(number(run, "x") - exact_x("1.05")) < mpmath.mpf("3e-31")
    assert abs(number(run, "x", 3) - exact_x("0.3")) < mpmath.mpf("3e-31")
    assert abs(number(run, "time", 3) - mpmath.mpf("0.3")) < mpmath.mpf("3e-33")
    assert abs(float(run.rest_x[3])) <= np.spacing(float(run.x[3]))  # the float was converted to millimetres


def test_period_of_an_orbit() -> None:
    """Assert that two periods of Kepler's orbit are 2 pi and 4 pi to 28 digits."""
    run = xd.simulate(kepler("y"), until="13 s", method="taylor", rtol=1e-30, **LONG)
    for k in range(2):
        assert abs(number(run, "event_time", k) - 2 * (k + 1) * mpmath.pi) < mpmath.mpf("1e-28")


@pytest.mark.dear
def test_chaos() -> None:
    """Assert that the Lorenz system goes where series of 60 digits go, up to t = 40."""
    rates = {"x": "10*(y - x)", "y": "28*x - x*z - y", "z": "x*y - 8/3*z"}
    states = {name: {"unit": "1", "rate": f"({rate})/(1*second)"} for name, rate in rates.items()}
    model = xd.Model(name="Lorenz", states=states, initial={"x": "1", "y": "0", "z": "0"})
    run = xd.simulate(model, until="40 s", method="taylor", rtol=1e-30, force_samples="none", **LONG)
    for name, digits in zip("xyz", LORENZ_AT_40, strict=True):
        assert abs(number(run, name) - mpmath.mpf(digits)) < mpmath.mpf("1e-11")


def test_bouncing() -> None:
    """Assert that resets happen at the roots themselves: times of bounces and the state after them have 30 digits."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": {"unit": "m"}},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        events={"floor": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-0.9*v_y"}}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
    )
    run = xd.simulate(ball, until="3 s", method="rk4", step="0.01 s", **LONG)
    g = mpmath.mpf("9.81")
    speed, time = mpmath.sqrt(2 * g), mpmath.sqrt(2 / g)
    for k in range(run.sizes["event"]):
        assert abs(number(run, "event_time", k) - time) < mpmath.mpf("1e-30")
        speed *= mpmath.mpf("0.9")
        time += 2 * speed / g
    since = mpmath.mpf(3) - (time - 2 * speed / g)
    assert run.sizes["event"] == 4
    assert abs(number(run, "y") - (speed * since - g * since**2 / 2)) < mpmath.mpf("1e-30")


def test_long_numbers_are_kept(tmp_path: Path) -> None:
    """Assert that more digits than a float has count, of a literal, a start and the end, and are in the archive."""
    model = swing().replace(
        forces={"spring": {"x": "-1.00000000000000000001*k*x"}}, initial={"x": "7.10000000000000000001 mm"}
    )
    run = xd.simulate(model, until="1.00000000000000000001 s", **SERIES, **LONG)
    w = mpmath.sqrt(mpmath.mpf("1.00000000000000000001") / 3)
    t = mpmath.mpf("1.00000000000000000001")
    assert abs(number(run, "x") - mpmath.mpf("7.10000000000000000001") * mpmath.cos(w * t)) < mpmath.mpf("3e-31")
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_what_reads_a_run_reads_it(tmp_path: Path) -> None:
    """Assert that states between rows, longer runs and archives keep the digits."""
    run = xd.simulate(swing(), until="1 s", **SERIES, **LONG)
    between = xd.sample(run, ["0.33 s"])
    assert abs(number(between, "x") - exact_x("0.33")) < mpmath.mpf("3e-31")
    longer = xd.extend(run, until="1.7 s")
    assert xd.content_digest(longer) == xd.content_digest(
        xd.simulate(swing(), until="1.7 s", nodes=["1 s"], **SERIES, **LONG)
    )
    xd.save(run, tmp_path / "run.nc")
    assert verified(tmp_path / "run.nc")
    assert xd.open_run(tmp_path / "run.nc").attrs["precision"].startswith("double_double")


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what was kept of a run that broke off, behind a node, leads to the same digits."""

    def cut(_done: float, t: float, _rows: int) -> None:
        if t > 1.0:
            raise PowerCut

    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments, "SHARE", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 100)
    asked: dict[str, Any] = {"method": "rk4", "step": "3 ms", "until": "1.7 s", "nodes": ["0.7 s"]} | LONG
    with pytest.raises(PowerCut):
        xd.simulate(swing(), **asked, path=tmp_path / "run.nc", progress=cut)
    assert sorted(segments.segments_folder(tmp_path / "run.nc").glob("*"))
    run = xd.simulate(swing(), **asked, path=tmp_path / "run.nc", resume=True)
    whole = xd.simulate(swing(), **asked)
    assert xd.content_digest(run) == xd.content_digest(whole)
    assert run.rest_x.values.tobytes() == whole.rest_x.values.tobytes()


def test_a_signature_is_of_the_rests_too(tmp_path: Path) -> None:
    """Assert that a signed archive is verified, and another whose rests alone differ is not."""
    for name, more in (("run", ""), ("other", "000000000000000001")):
        start = {"x": f"7.100{more} mm"}
        xd.save(xd.simulate(swing().replace(initial=start), until="0.2 s", **SERIES, **LONG), tmp_path / f"{name}.nc")
    run, other = (xd.open_run(tmp_path / f"{name}.nc").load() for name in ("run", "other"))
    assert np.array_equal(run.x, other.x)
    assert not np.array_equal(run.rest_x, other.rest_x)
    new_key(tmp_path / "key.pem")
    xd.sign(tmp_path / "run.nc", tmp_path / "key.pem")
    xd.verify_signature(tmp_path / "run.nc", tmp_path / "key.public.pem")
    (tmp_path / "other.nc.sig").write_bytes((tmp_path / "run.nc.sig").read_bytes())
    with pytest.raises(xd.ArchiveError, match="is not what was signed"):
        xd.verify_signature(tmp_path / "other.nc", tmp_path / "key.public.pem")


def test_a_stranger_is_told(tmp_path: Path) -> None:
    """Assert that summaries, comparisons and variables of archives say what rests are, to xarray alone as well."""
    run, twin = (xd.simulate(swing(), until="0.2 s", **SERIES, **more) for more in ({}, LONG))
    xd.save(run, tmp_path / "run.nc")
    xd.save(twin, tmp_path / "twin.nc")
    assert "\nnumbers   of 31 digits, x + rest_x: " in call("show", tmp_path / "twin.nc").output
    assert "31 digits" not in call("show", tmp_path / "run.nc").output
    compared = call("compare", tmp_path / "run.nc", tmp_path / "twin.nc").output
    assert "\nrounding  the differences are the rounding error of the first run: " in compared
    with xr.open_dataset(tmp_path / "twin.nc") as archive:
        assert archive.rest_x.attrs["long_name"] == "what a float does not hold of x: the number is x + rest_x"
        assert archive.rest_x.attrs["units"] == "mm"
        assert archive.rest_time.attrs["units"] == "s"


def test_the_twin_shows_rounding() -> None:
    """Assert that a run less its twin is its rounding error, to far less than a spacing."""
    run, twin = (xd.simulate(swing(), until="1 s", **SERIES, **more) for more in ({}, LONG))
    difference = xd.compare(run, twin)
    expected = [float(number(twin, "x", i) - mpmath.mpf(float(run.x[i]))) for i in range(run.sizes["step"])]
    np.testing.assert_allclose(difference.difference_x.values, expected, rtol=1e-12, atol=1e-30)
    assert (
        difference.attrs["rounding"]
        == "the differences are the rounding error of the first run: the other is the same with 31 digits"
    )
    study = xd.refine(swing(), precisions=["float64", "double_double"], until="1 s", **SERIES)
    assert abs(float(study.difference_x[0, 0]) - expected[-1]) <= np.spacing(float(run.x[-1]))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            {"method": "rk4", "step": "0.1 s", "precision": "quadruple"},
            "precision is 'quadruple'; there are 'float64', 'double_double'",
        ),
        ({"method": "radau_iia", "rtol": 1e-6} | LONG, "method 'radau_iia', whose equations are solved in float64"),
        ({"method": "implicit_midpoint", "step": "0.1 s"} | LONG, "take an explicit one"),
        ({"method": "rk4", "step": "0.1 s", "scales": {"length": "2 m"}} | LONG, "scales, which are single floats"),
        ({"method": "rk4", "step": "0.1 s", "summation": "compensated"} | LONG, "a rest is carried of every number"),
        ({"method": "rk4", "rtol": 1e-6} | LONG, "estimator = 'step_doubling', a difference of single floats"),
        ({"method": "dop853", "rtol": 1e-40} | LONG, "rtol is 1e-40, needs a number from 10 eps = 4.93e-31"),
        ({"method": "dop853", "rtol": 1e-20}, "from 5e-31 on with precision = 'double_double'"),
    ],
)
def test_refusals(more: dict[str, Any], said: str) -> None:
    """Assert that what is of single floats is refused, with what to do."""
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        xd.simulate(swing(), until="1 s", **more)


def test_models_of_single_floats_are_refused() -> None:
    """Assert that contacts are refused, with what to do."""
    bouncing = swing(contacts={"floor": {"gap": "x", "restitution": 0.8}})
    with pytest.raises(InputError, match="write an impact as an event with action = 'reset'"):
        xd.simulate(bouncing, until="1 s", **SERIES, **LONG)


def test_events_that_are_nearer_than_floats_are_told_apart() -> None:
    """Assert the sign and the size of the difference of two events by the closed form: T/4 goes as 1/sqrt(k)."""
    runs = [
        xd.simulate(
            xd.Model(
                name="swing",
                coordinates={"x": "m"},
                parameters={"k": k, "m": "1 kg"},
                mass={"x": "m"},
                forces={"spring": {"x": "-k*x"}},
                events={"middle": {"function": "x"}},
                initial={"x": "1 m", "v_x": "0 m s-1"},
            ),
            until="2 s",
            **SERIES,
            **LONG,
        )
        for k in ("1 N m-1", "1.00000000000000000000002 N m-1")
    ]
    difference = float(xd.compare(*runs)["difference_event_time_middle"][0])
    assert difference == pytest.approx(-float(mpmath.pi) / 2.0 * 1e-23, rel=1e-6, abs=0.0)


def test_tables_are_read_with_all_digits() -> None:
    """Assert the root of a straight motion against a cubic spline, whose coefficients count as the floats that they are."""
    model = xd.Model(
        name="chase",
        coordinates={"y": "m"},
        parameters={"m": "1 kg"},
        mass={"y": "m"},
        drives={"d": {"table": "d.csv", "csv": "t [s],d [m]\n0,2\n1,1.7\n2,2.3\n3,2.1\n", "interpolation": "cubic"}},
        forces={"none": {"y": "0*newton"}},
        events={"met": {"function": "y - d"}},
        initial={"y": "0 m", "v_y": "1 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step="0.5 s", until="2.9 s", **LONG)
    origin, powers = piece_coefficients(np.arange(4.0), np.array([2.0, 1.7, 2.3, 2.1]), "cubic", "error")
    time = float(run.event_time[0])
    piece = np.searchsorted(origin, time, "right") - 1
    cubic = [mpmath.mpf(float(row[piece])) for row in powers]
    root = mpmath.findroot(lambda t: t - mpmath.polyval(cubic, t - mpmath.mpf(float(origin[piece]))), time)
    met = mpmath.mpf(time) + mpmath.mpf(float(run.rest_event_time[0]))
    assert abs(met - root) < mpmath.mpf("1e-30")
    assert abs(number(run, "y", int(run.event_row_before[0])) - root) < mpmath.mpf("1e-30")


@pytest.mark.parametrize("name", PIECES)
def test_pieces_are_the_polynomials_of_tables(name: str) -> None:
    """Assert that values, slopes and bends by Horner's scheme are those of single floats."""
    row, x, total = (0.25, 3.0, -2.0, 0.7, 1.3), 0.6, 0.0
    for coefficient, factor in PIECES[name]:
        total = total * (x - row[0]) + factor * float(POLYNOMIALS[coefficient](lambda k, _piece: row[k], x, 0))
    assert total == pytest.approx(float(POLYNOMIALS[name](lambda k, _piece: row[k], x, 0)), rel=1e-15, abs=0.0)


CHAIN = """
name = "chain"
[dimensions]
site = 4
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "mm", dims = ["site"] }
[parameters]
m = "0.3 kg"
k = "0.1 N m-1"
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[forces.walls]
potential = "k*(u[0]**2 + u[-1]**2)/2"
[initial]
u = { unit = "mm", value = [7.1, -0.3, 2.9, 1.7] }
"""
THREE = """
name = "three in a row"
[dimensions]
body = 3
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
G = "0.8 N m2 kg-2"
m = "1 kg"
[mass]
r = "m"
[forces.gravity]
over = "pair"
potential = "-G*m**2/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = { unit = "m", value = [[-1, 0], [0, 0], [1, 0]] }
v_r = { unit = "m s-1", value = [[0, -1], [0, 0], [0, 1]] }
"""


def test_masses_of_a_chain_have_31_digits() -> None:
    """Assert Verlet's discrete law in each mode of a chain, cos(n theta) with cos(theta) = 1 - (omega h)^2/2, of every mass."""
    run = xd.simulate(xd.Model.from_text(CHAIN), method="velocity_verlet", step="0.7 s", until="14 s", **LONG)
    start, size = [mpmath.mpf(text) for text in ("7.1", "-0.3", "2.9", "1.7")], range(4)
    modes = [
        [mpmath.sqrt(2 * mpmath.mpf("0.2")) * mpmath.sinpi(mpmath.mpf((i + 1) * (k + 1)) / 5) for i in size]
        for k in size
    ]
    squares = [mpmath.mpf(4) / 3 * mpmath.sinpi(mpmath.mpf(k + 1) / 10) ** 2 for k in size]  # of omega
    turned = [mpmath.cos(20 * mpmath.acos(1 - square * mpmath.mpf("0.7") ** 2 / 2)) for square in squares]
    for i in size:
        u = sum(mode[i] * turn * mpmath.fdot(mode, start) for mode, turn in zip(modes, turned, strict=True))
        assert abs(number(run.isel(site=i), "u") - u) < mpmath.mpf("1e-29")
        assert abs(mpmath.mpf(float(run.u[-1, i])) - u) > mpmath.mpf("1e-19")


@pytest.mark.dear
def test_bodies_that_attract_each_other_have_31_digits() -> None:
    """Assert Euler's three bodies in a row, which turn by one radian a second where G m (1 + 1/4) is 1."""
    run = xd.simulate(xd.Model.from_text(THREE), method="taylor", rtol=1e-30, until="2.3 s", **LONG)
    turned = mpmath.cos(mpmath.mpf("2.3")), mpmath.sin(mpmath.mpf("2.3"))
    for body, side in ((0, -1), (1, 0), (2, 1)):
        for axis in (0, 1):
            assert abs(number(run.isel(body=body, axis=axis), "r") - side * turned[axis]) < mpmath.mpf("2e-30")
