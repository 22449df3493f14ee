"""Rounding of expressions with dimensions: they less the same with 31 digits, against numbers of 40 digits."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp, mpf

import xdynamics as xd
from xdynamics.shapes.evaluation import evaluate_elements, rounding_errors

N = 7
MODEL = f"""
name = "chain"
[dimensions]
site = {N}
axis = 3
[relations.link]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "1", dims = ["site"] }}
[mass]
u = "1"
[initial]
u = "0 1"
[definitions]
value = "VALUE"
"""


def wave(i: int) -> mpf:
    """Return the sine of a part of pi."""
    return mp.sin(mp.pi * (i + 1) / (N + 1))


def crossed(a: list[mpf], b: list[mpf], c: list[mpf]) -> mpf:
    """Return the determinant of three vectors, the third times the cross product of the others."""
    return mp.det(mp.matrix([a, b, c]))


SINES = "sin(pi*(index(site) + 1)/(size(site) + 1))"
CASES = {
    SINES: wave,
    f"{SINES}**3 - 1/3": lambda i: wave(i) ** 3 - mpf(1) / 3,
    f"-sqrt({SINES}) + abs(1/(index(site) - 9))": lambda i: -mp.sqrt(wave(i)) + abs(mpf(1) / (i - 9)),
    f"shift({SINES}, site, 1, 1/3) - {SINES}": lambda i: (wave(i - 1) if i else mpf(1) / 3) - wave(i),
    f"roll({SINES}, site, -1)*exp(1/7)": lambda i: wave((i + 1) % N) * mp.exp(mpf(1) / 7),
    f"{SINES}*sum({SINES}, site)": lambda i: wave(i) * sum(map(wave, range(N))),
    f"{SINES} + mean({SINES}, site)": lambda i: wave(i) + sum(map(wave, range(N))) / N,
    f"{SINES}/norm({SINES}, site)": lambda i: wave(i) / mp.sqrt(sum(wave(k) ** 2 for k in range(N))),
    f"{SINES}*dot({SINES}, index(site)/3, site)": lambda i: wave(i) * sum(wave(k) * k for k in range(N)) / 3,
    f"{SINES} - max({SINES} - 1/3, site)": lambda i: wave(i) - (wave(3) - mpf(1) / 3),
    f"where({SINES} < 0.5, min({SINES}, 0.1), {SINES}/3)": lambda i: (
        min(wave(i), mpf(0.1)) if i in (0, 6) else wave(i) / 3
    ),
    f"norm(second({SINES}, link) - first({SINES}, link), link)*{SINES}": (
        lambda i: wave(i) * mp.sqrt(sum((wave(k + 1) - wave(k)) ** 2 for k in range(N - 1)))
    ),
    f"dot(cross({SINES}*(index(axis) + 1/3)**2, cos({SINES} + index(axis)), axis), 1/(index(axis) + 3), axis)": (
        lambda i: crossed(
            [wave(i) * (k + mpf(1) / 3) ** 2 for k in range(3)],
            [mp.cos(wave(i) + k) for k in range(3)],
            [mpf(1) / (k + 3) for k in range(3)],
        )
    ),
}


@pytest.mark.parametrize("text", CASES)
def test_rounding_is_known_to_its_own_digits(text: str) -> None:
    """Assert that what rounding did is known to 12 digits of a spacing."""
    model = xd.Model.from_text(MODEL.replace("VALUE", text))
    tree, shapes = model.shaped.definitions["value"], model.shapes
    found = evaluate_elements(tree, ("site",), {"pi": np.pi}, shapes)
    errors = rounding_errors(tree, ("site",), {"pi": np.pi}, shapes, found)
    with mp.workdps(40):
        true = [float(mpf(float(value)) - CASES[text](i)) for i, value in enumerate(found)]
    assert np.abs(errors).max() > 0.0
    np.testing.assert_allclose(errors, true, rtol=0.0, atol=1e-28)
