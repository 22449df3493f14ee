"""Digits of sentences: those that a number's uncertainty bears, and that tell it from others; records keep all."""

from __future__ import annotations

import re
from math import floor, log10
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from xdynamics.units.digits import MOST, digits, known_part, with_uncertainty


@pytest.mark.cases(400)
def test_digits_end_where_the_uncertainty_begins(case: int) -> None:
    """Assert that the last digit is no coarser than the uncertainty and no finer than a hundredth, and that neighbours differ."""
    random = np.random.default_rng(case)
    value = float(random.choice([-1, 1]) * 10.0 ** random.uniform(-20, 20))
    doubt = abs(value) * 10.0 ** random.uniform(-12, -0.5)
    for shown in (digits(value, uncertainty=doubt), digits(value, relative=doubt / abs(value))):
        place = 10.0 ** (floor(log10(abs(value))) - shown + 1)
        assert doubt / 100 < place * (1 + 1e-9)
        assert place <= doubt * (1 + 1e-9)
        assert abs(float(f"{value:.{shown}g}") - value) <= doubt
    near = abs(value) * 10.0 ** random.uniform(-12, -1)
    shown = digits(value, uncertainty=doubt, spacing=near)
    assert f"{value:.{shown}g}" != f"{value + 1.5 * near:.{shown}g}"
    assert shown == max(digits(value, uncertainty=doubt), digits(value, spacing=near))


def test_what_has_no_digits() -> None:
    """Assert 0, what is below its uncertainty, what nothing is known of, and what is not finite."""
    assert (digits(0.0, uncertainty=1e-3), digits(1e-17, uncertainty=1e-9), digits(3.7), digits(np.inf)) == (
        1,
        1,
        MOST,
        1,
    )
    assert known_part(1e-6, []) == 1e-6
    assert known_part(None, [(0.0, 1.0)]) == 1e-9
    assert known_part(1e-6, [(35.0, 1.0), (2.0, 1.0)]) == pytest.approx(0.1 / 35)


@pytest.mark.parametrize(
    ("value", "doubt", "text"),
    [
        (0.000294891463964, 7e-5, "0.000295 ± 0.000070"),
        (0.5, 2e6, "0 ± 2000000"),
        (12.0, 13.0, "12 ± 13"),
        (9.96, 0.0999, "9.96 ± 0.10"),
        (0.5, 2e-13, "0.50000000000000 ± 2.0e-13"),
        (0.5, 2e-16, "0.5 ± 2.0e-16"),
        (-3e-14, 1.5e-11, "(0.0 ± 1.5)e-11"),
        (9.87654e12, 6.4e8, "(9.87654 ± 0.00064)e12"),
        (9.87654321e12, 6.4e5, "9.87654321e12 ± 6.4e5"),
        (3.71119880, 5.3e-7, "3.71119880 ± 5.3e-7"),
        (-13.709027, 1.44e-5, "-13.709027 ± 1.4e-5"),
        (0.00029512, 7.04e-7, "0.00029512 ± 7.0e-7"),
        (0.00029512345, 7.04e-8, "0.000295123 ± 7.0e-8"),
        (12.345, 9.96e-5, "12.34500 ± 0.00010"),
        (0.5, np.inf, "0.5 ± inf"),
        (np.nan, 0.1, "nan"),
    ],
)
def test_a_number_is_written_with_its_uncertainty(value: float, doubt: float, text: str) -> None:
    """Assert two digits of the uncertainty, the value to the same place, and powers of ten outside."""
    assert with_uncertainty(value, doubt) == text


def test_a_fall_with_an_uncertain_speed_has_few_digits(tmp_path: Path) -> None:
    """Assert three or four digits of t beside vt = 35 ± 1 in outcome and lines, ten without, and all in the record."""
    sharp, vague = (
        xd.simulate(
            xd.Model(
                name="ball",
                coordinates={"y": "m"},
                parameters={"g": "9.80665 m s-2", "vt": vt},
                mass={"y": "1*kilogram"},
                initial={"y": "0 m", "v_y": "20 m s-1"},
                forces={"fall": {"y": "-1*kilogram*g*(1 + v_y*abs(v_y)/vt**2)"}},
                events={"ground": {"function": "y", "direction": "falling", "action": "stop"}},
            ),
            method="rk4",
            step="1 ms",
            until="9 s",
        )
        for vt in ("35 m s-1", {"value": "35 m s-1", "uncertainty": 1})
    )
    assert float(sharp.event_time[-1]) == float(vague.event_time[-1])
    texts = [re.search(r"at t = ([0-9.]+) s$", run.attrs["run_outcome_text"])[1] for run in (sharp, vague)]
    counts = [len(text.replace(".", "")) for text in texts]
    assert 8 <= counts[0] <= 10  # a zero at the end is not written
    assert counts[1] <= 4
    assert float(texts[1]) == pytest.approx(float(vague.event_time[-1]), abs=1e-3)
    xd.save(vague, tmp_path / "run.nc")
    line = next(
        line for line in call("show", tmp_path / "run.nc").output.splitlines() if line.startswith("event     ground")
    )
    assert re.search(r"at t = [0-9.]{5} s, located within", line)
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_events_next_to_each_other_are_told_apart(tmp_path: Path) -> None:
    """Assert as many digits as two events 2e-11 s apart need, though the tolerance bears fewer."""
    fall = xd.Model(
        name="two lines",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        initial={"y": "0 m", "v_y": "1 m s-1"},
        events={"first": {"function": "y - 1.5*metre"}, "second": {"function": "y - 1.50000000002*metre"}},
    )
    xd.save(xd.simulate(fall, method="dop853", rtol=1e-4, until=2.0), tmp_path / "run.nc")
    times = re.findall(r"at t = ([0-9.]+) s, located", call("show", tmp_path / "run.nc").output)
    assert len(set(times)) == 2
    assert float(times[1]) - float(times[0]) == pytest.approx(2e-11, rel=0.5)
