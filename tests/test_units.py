"""Units: spelling, exact conversion, hostile texts, scales."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xdynamics.faults import InputError
from xdynamics.units import (
    BASE,
    CONSTANTS,
    ENERGY,
    NONE,
    Dimension,
    Scales,
    coherent,
    constant,
    parse_quantity,
    parse_time,
    parse_unit,
    spell,
)

HOSTILE = [
    "9**9**9 m", "m#kg", "m\0", "(" * 5000, "m" * 5000, "kg m-", "", "  ", "m2 2", "m^99", "m**-17", "m0", "é", "m/",
    "__import__('os')", "m;s", "1e3 m", "lambda", "m..s", "degC", "furlong", "kg m-1\nrm", "m" + " m" * 150, "-m",
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE, ids=lambda one: repr(one[:12]))
def test_hostile_unit_ends_in_one_error(text: str) -> None:
    """Assert that no text reaches pint's own parser: each ends in one InputError, with the text in it."""
    with pytest.raises(InputError, match="unit"):
        parse_unit(text)


@given(st.text(max_size=60))
def test_any_text_is_a_unit_or_an_input_error(text: str) -> None:
    """Assert that nothing else is ever raised."""
    try:
        parse_unit(text)
    except InputError:
        return


@pytest.mark.parametrize(
    ("given_text", "spelled"),
    [("kg m-1", "kg m-1"), ("m/s**2", "m s-2"), ("m s^-2", "m s-2"), ("N*s/m", "N s m-1"), ("rad", "rad"), ("deg", "degree"),
     ("1", "1"), ("1/s", "s-1"), ("metre.second-1", "m s-1"), ("km/h", "km h-1"), ("m m", "m2"), ("m m-1", "1")],
)  # fmt: skip
def test_spelling(given_text: str, spelled: str) -> None:
    """Assert that units come out in UDUNITS spelling, and the spelling reads as itself."""
    assert parse_unit(given_text).text == spelled
    assert parse_unit(spelled).text == spelled


@pytest.mark.parametrize(
    ("text", "si"),
    [("10.8 g", 0.0108), ("1 ms", 1e-3), ("1e-3 s", 1e-3), ("20m s-1", 20.0), ("180 degree", 3.141592653589793),
     ("4.83 cm2", 4.83e-4), ("-2 km", -2000.0), (3, 3.0), ("7 uN", 7e-6), ("36 km/h", 10.0)],
)  # fmt: skip
def test_conversion_is_correctly_rounded(text: str, si: float) -> None:
    """Assert the very float that the decimal means in SI."""
    assert parse_quantity(text).si == si


@pytest.mark.parametrize(
    "text", ["nan s", "inf m", "1e400 m", "m", "", None, True, [1], "1 2 m", "0x10 m", float("nan")]
)
def test_no_quantity(text: object) -> None:
    """Assert that what is no finite number with a unit is refused."""
    with pytest.raises(InputError, match="quantity|unit"):
        parse_quantity(text)


def test_pint_quantity_is_read() -> None:
    """Assert that a pint quantity counts as its text."""
    ureg = pint.UnitRegistry()
    assert parse_quantity(ureg.Quantity(3.0, "km/hour")).unit.text == "km h-1"


@pytest.mark.parametrize("name", CONSTANTS)
def test_unit_constants_agree_with_pint(name: str) -> None:
    """Assert that the factors known by heart are those of pint's dictionary."""
    registry = pint.UnitRegistry(non_int_type=Fraction)
    factor, _ = registry.get_base_units(name)
    assert constant(name).factor == Fraction(factor)


@given(st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3))
def test_spelled_dimension_reads_back(kilogram: int, metre: int, second: int) -> None:
    """Assert that any dimension is spelled so that it reads as itself."""
    dimension = (
        parse_unit("kg").dimension ** kilogram
        * parse_unit("m").dimension ** metre
        * parse_unit("s").dimension ** second
    )
    assert parse_unit(spell(dimension).text).dimension == dimension


def test_torque_and_energy_are_spelled_apart() -> None:
    """Assert N m for a torque, J for an energy, and no spelling for a fractional power."""
    assert spell(ENERGY).text == "J"
    assert spell(ENERGY, angle=True).text == "N m"
    with pytest.raises(InputError, match="fractional power"):
        spell(parse_unit("m").dimension ** Fraction(1, 2))


def test_rate_units() -> None:
    """Assert the unit of a rate: of metres and of a pure number."""
    assert parse_unit("m").per_second(2).text == "m s-2"
    assert parse_unit("1").per_second().text == "s-1"


def test_scales_of_a_force() -> None:
    """Assert that the scale of a force is M L / T**2."""
    scales = Scales.parse({"length": "2 m", "time": "4 s", "mass": "8 kg"})
    assert scales.of(parse_unit("N").dimension) == 1.0
    assert scales.of(NONE) == 1.0


@pytest.mark.parametrize("scales", [{"length": "2 s"}, {"area": "1 m2"}, {"mass": "0 kg"}, {"time": "-1 s"}])
def test_wrong_scales(scales: dict[str, str]) -> None:
    """Assert that a scale of the wrong name, unit or sign is refused."""
    with pytest.raises(InputError, match="scale"):
        Scales.parse(scales)


def test_time_needs_seconds() -> None:
    """Assert that a time in metres is refused by name, and a bare number is seconds."""
    assert parse_time(2, "until") == 2.0
    with pytest.raises(InputError, match="step '1 m' has units 'm', needs 's'"):
        parse_time("1 m", "step")


PINTS = {"m": "[length]", "kg": "[mass]", "s": "[time]", "A": "[current]", "K": "[temperature]", "mol": "[substance]", "cd": "[luminosity]"}  # fmt: skip


@pytest.mark.parametrize(
    "text", ["N", "J", "W", "Pa", "Hz", "C", "V", "ohm", "F", "T", "rad", "N2 s-3", "V A-1", "km h-2"]
)
def test_dimensions_are_those_of_pint(text: str) -> None:
    """Assert the power of every base unit in named and composed units, by another library."""
    expected = pint.UnitRegistry().parse_units(" * ".join(f"{one.rstrip('-0123456789')}**{one[len(one.rstrip('-0123456789')):] or 1}" for one in text.split())).dimensionality  # fmt: skip
    assert [float(one) for one in parse_unit(text).dimension.powers] == [float(expected.get(PINTS[base], 0)) for base in BASE]  # fmt: skip


@pytest.mark.parametrize("case", range(20))
def test_dimensions_are_multiplied_and_divided_by_their_powers(case: int) -> None:
    """Assert that powers are added, subtracted and multiplied, zeros among them."""
    draw = np.random.default_rng(case)
    one, other = (Dimension(tuple(Fraction(int(k)) for k in draw.integers(-2, 3, len(BASE)))) for _ in range(2))
    pairs = list(zip(one.powers, other.powers, strict=True))
    assert (one * other).powers == tuple(a + b for a, b in pairs)
    assert (one / other).powers == tuple(a - b for a, b in pairs)
    assert (one**3).powers == tuple(3 * a for a in one.powers)


@pytest.mark.parametrize(
    "text", ["km2 h-1", "g cm-3", "degree s-2", "mN s2 m-1", "minute-2", "day", "kV2", "au2 day-3"]
)
def test_a_coherent_unit_has_the_same_dimension_and_no_factor(text: str) -> None:
    """Assert that the SI unit of a unit, powers among them, has its dimension and the factor 1."""
    unit = parse_unit(text)
    found = coherent(unit)
    assert (found.dimension, found.factor) == (unit.dimension, 1)
