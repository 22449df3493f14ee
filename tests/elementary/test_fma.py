"""The fused multiply-add: one rounding, whether it is an instruction, whole numbers in machine code, or fractions."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from xdynamics.elementary.fma import fma, fma_definition
from xdynamics.kernels import machine

LEAST, LEAST_NORMAL, LARGEST = 5e-324, 2.0**-1022, 1.7976931348623157e308
ENTRY = """define void @called(ptr %a) {{
  %xs = load <{n} x double>, ptr %a, align 8
  %b = getelementptr double, ptr %a, i64 {n}
  %ys = load <{n} x double>, ptr %b, align 8
  %c = getelementptr double, ptr %b, i64 {n}
  %zs = load <{n} x double>, ptr %c, align 8
  %found = call <{n} x double> @fma.{n}(<{n} x double> %xs, <{n} x double> %ys, <{n} x double> %zs)
  store <{n} x double> %found, ptr %a, align 8
  ret void
}}"""
LANES = 4
KEPT: list[machine.Code] = []


def in_lanes(*, native: bool) -> Callable[[list[tuple[float, float, float]]], list[float]]:
    """Compile it for some lanes, as an instruction or in whole numbers."""
    parts = [fma_definition(lanes, native=native) for lanes in (1, LANES)]
    KEPT.append(machine.compiled("\n".join([*parts, ENTRY.format(n=LANES)]), ["called"]))
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(KEPT[-1].addresses["called"])

    def found(cases: list[tuple[float, float, float]]) -> list[float]:
        results: list[float] = []
        for i in range(0, len(cases), LANES):
            block = np.array((cases[i : i + LANES] + [(0.0, 0.0, 0.0)] * LANES)[:LANES]).T.copy()
            call(block.ctypes.data)
            results += block[0].tolist()
        return results[: len(cases)]

    return found


def cases(seed: int, count: int) -> list[tuple[float, float, float]]:
    """Triples of all sizes, most of which nearly cancel, lie near ties, or fall below the normal numbers."""
    random = np.random.default_rng(seed)
    special = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, LEAST, -LEAST, LEAST_NORMAL, LARGEST, -LARGEST]
    found = []
    for _ in range(count):
        kind, sizes = random.integers(5), random.uniform(-1.0, 1.0, 3)
        powers = random.integers(-1040, 1000, 3) if kind == 0 else random.integers(-8, 8, 3)
        if kind == 1:  # products about the least numbers
            powers = np.array([-540, -530, -1074]) + random.integers(-8, 8, 3)
        x, y, z = (math.ldexp(size, int(power)) for size, power in zip(sizes, powers, strict=True))
        if kind == 2:  # all but the last places cancel
            z = -x * y * (1.0 + float(random.integers(-2, 3)) * 2.0**-52)
        elif kind == 3:  # far apart, near ties of the larger
            z = math.ldexp(float(random.integers(1, 16)), int(random.integers(-120, 120)))
        x = float(random.choice(special)) if random.random() < 0.05 else x
        z = float(random.choice(special)) if random.random() < 0.05 else z
        found.append((x, y, z))
    return found


def same(one: float, other: float) -> bool:
    """Whether two numbers have the same bits, or none is a number."""
    return struct.pack("<d", one) == struct.pack("<d", other) or (math.isnan(one) and math.isnan(other))


@pytest.mark.parametrize("native", [False, True])
def test_it_is_rounded_once(*, native: bool) -> None:
    """Assert the bits of exact fractions rounded to nearest, signs of zero and what is infinite included."""
    if native and not machine.fuses():
        pytest.skip("this processor has no such instruction")
    given = cases(3, 4000)
    wrong = [
        (*one, got, fma(*one))
        for one, got in zip(given, in_lanes(native=native)(given), strict=True)
        if not same(got, fma(*one))
    ]
    assert not wrong


def test_in_python_it_is_the_nearest_float() -> None:
    """Assert that no float is nearer to the exact value than the one returned."""
    for x, y, z in cases(5, 500):
        got = fma(x, y, z)
        if not all(map(math.isfinite, (x, y, z, got))):
            continue
        exact = Fraction(x) * Fraction(y) + Fraction(z)
        for near in (math.nextafter(got, math.inf), math.nextafter(got, -math.inf)):
            assert math.isinf(near) or abs(Fraction(got) - exact) <= abs(Fraction(near) - exact)


@pytest.mark.parametrize(
    ("x", "y", "z", "wanted"),
    [
        (LARGEST, 2.0, -math.inf, -math.inf),
        (LARGEST, 2.0, -LARGEST, LARGEST),
        (-LEAST, 0.5, 0.0, -0.0),
        (LEAST, 0.5, LEAST, 2 * LEAST),
        (LEAST, 0.25, LEAST, LEAST),
        (1.0, -1.0, 1.0, 0.0),
        (0.0, -1.0, -0.0, -0.0),
        (1.0 + 2.0**-52, 1.0 - 2.0**-52, -1.0, -(2.0**-104)),
        (1.0 + 2.0**-30, 1.0 + 2.0**-30, 2.0**-200, (1.0 + 2.0**-30) ** 2),
        (2.0**27 - 1.0, 2.0**27 + 1.0, -(2.0**-200), 2.0**54 - 2.0),
        (2.0**27 - 1.0, 2.0**27 + 1.0, 2.0**-200, 2.0**54),
        (2.0**27 - 1.0, 2.0**27 + 1.0, LEAST, 2.0**54),
        (2.0**-300, 2.0**-300, 1.0, 1.0),
        (math.inf, 0.0, 1.0, math.nan),
    ],
)
def test_cases_that_other_ways_get_wrong(x: float, y: float, z: float, wanted: float) -> None:
    """Assert overflow and underflow that are rounded once, exact zeros, and ties that a tiny term decides."""
    assert same(fma(x, y, z), wanted)
    assert same(in_lanes(native=False)([(x, y, z)])[0], wanted)
