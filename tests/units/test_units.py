"""Units: spelling, exact conversion, hostile texts, scales."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import cf_units
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
    NUMBERS,
    PREFIX,
    SECONDS,
    SPELLING,
    Dimension,
    Quantity,
    Range,
    Scales,
    coherent,
    constant,
    is_range,
    parse_quantity,
    parse_time,
    parse_unit,
    spell,
    time_in,
    unit_suffix,
)
from xdynamics.units.names import NO_PREFIX

HOSTILE = [
    "9**9**9 m",
    "m#kg",
    "m\0",
    "(" * 5000,
    "m" * 5000,
    "kg m-",
    "",
    "  ",
    "m2 2",
    "m^99",
    "m**-17",
    "m0",
    "é",
    "m/",
    "__import__('os')",
    "m;s",
    "1e3 m",
    "lambda",
    "m..s",
    "degC",
    "furlong",
    "kg m-1\nrm",
    "m" + " m" * 150,
    "-m",
]


@pytest.mark.parametrize("text", HOSTILE, ids=lambda one: repr(one[:12]))
def test_hostile_unit_ends_in_one_error(text: str) -> None:
    """Assert that no text reaches pint's own parser: each ends in one InputError, with the text in it."""
    with pytest.raises(InputError, match="unit"):
        parse_unit(text)


@pytest.mark.dear
@given(st.text(max_size=60))
def test_any_text_is_a_unit_or_an_input_error(text: str) -> None:
    """Assert that nothing else is ever raised."""
    try:
        parse_unit(text)
    except InputError:
        return


@pytest.mark.parametrize(
    ("given_text", "spelled"),
    [
        ("kg m-1", "kg m-1"),
        ("m/s**2", "m s-2"),
        ("m s^-2", "m s-2"),
        ("N*s/m", "N s m-1"),
        ("rad", "rad"),
        ("deg", "degree"),
        ("1", "1"),
        ("1/s", "s-1"),
        ("metre.second-1", "m s-1"),
        ("km/h", "km h-1"),
        ("m m", "m2"),
        ("m m-1", "1"),
    ],
)
def test_spelling(given_text: str, spelled: str) -> None:
    """Assert that units come out in UDUNITS spelling, and the spelling reads as itself."""
    assert parse_unit(given_text).text == spelled
    assert parse_unit(spelled).text == spelled


@pytest.mark.parametrize(
    ("text", "si"),
    [
        ("10.8 g", 0.0108),
        ("1 ms", 1e-3),
        ("1e-3 s", 1e-3),
        ("20m s-1", 20.0),
        ("180 degree", 3.141592653589793),
        ("4.83 cm2", 4.83e-4),
        ("-2 km", -2000.0),
        (3, 3.0),
        ("7 uN", 7e-6),
        ("24 as", 24e-18),
        ("10 PW", 1e16),
        ("2 petajoule", 2e15),
        ("8.8 EHz", 8.8e18),
        ("3 Pa", 3.0),
        ("36 km/h", 10.0),
    ],
)
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


@cache
def registry() -> pint.UnitRegistry:
    """Pint's dictionary, by itself."""
    return pint.UnitRegistry(non_int_type=Fraction)


@pytest.mark.parametrize("name", CONSTANTS)
def test_unit_constants_agree_with_pint(name: str) -> None:
    """Assert that the factors known by heart are those of pint's dictionary."""
    factor, _ = registry().get_base_units(name)
    assert constant(name).factor == Fraction(factor)


@pytest.mark.dear
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
    assert scales.si_factor(parse_unit("N").dimension) == 1.0
    assert scales.si_factor(NONE) == 1.0


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


PINTS = {
    "m": "[length]",
    "kg": "[mass]",
    "s": "[time]",
    "A": "[current]",
    "K": "[temperature]",
    "mol": "[substance]",
    "cd": "[luminosity]",
}


@pytest.mark.parametrize(
    "text", ["N", "J", "W", "Pa", "Hz", "C", "V", "ohm", "F", "T", "rad", "N2 s-3", "V A-1", "km h-2"]
)
def test_dimensions_are_those_of_pint(text: str) -> None:
    """Assert the power of every base unit in named and composed units, by another library."""
    expected = (
        registry()
        .parse_units(
            " * ".join(
                f"{word.rstrip('-0123456789')}**{word[len(word.rstrip('-0123456789')) :] or 1}" for word in text.split()
            )
        )
        .dimensionality
    )
    assert [float(power) for power in parse_unit(text).dimension.powers] == [
        float(expected.get(PINTS[base], 0)) for base in BASE
    ]


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


@pytest.mark.parametrize(
    ("text", "start", "stop", "count", "unit"),
    [
        ("0:20:201 s", 0.0, 20.0, 201, "s"),
        ("1:2:3", 1.0, 2.0, 3, "1"),
        ("500ms:2s:4", 0.5, 2.0, 4, "s"),
        ("2s:500ms:4", 2000.0, 500.0, 4, "ms"),
        ("0:5s:2", 0.0, 5.0, 2, "s"),
        ("5mm:0:2", 5.0, 0.0, 2, "mm"),
        (" -1e3 : 2.5 : 10 N s m-1", -1e3, 2.5, 10, "N s m-1"),
    ],
)
def test_ranges_have_ends_and_a_unit(text: str, start: float, stop: float, count: int, unit: str) -> None:
    """Assert ends in the unit behind the count, or in that of the last end that has one."""
    assert is_range(text)
    found = Range.parse(text)
    assert (found.start, found.stop, found.count, found.unit.text) == (start, stop, count, unit)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0s:2s:3 s", "after its ends and after the count"),
        ("0s:2m:3", "from 's' to 'm'"),
        ("0:1", "needs start:stop:count"),
        ("0:1:2.5", "needs start"),
        ("0:1:2:3", "needs start"),
    ],
)
def test_ranges_that_are_none(text: str, said: str) -> None:
    """Assert one clear error for each, and that a number is no range."""
    assert not is_range(3.0)
    with pytest.raises(InputError, match=said):
        Range.parse(text)


@pytest.mark.dear
@given(st.lists(st.integers(-6, 6), min_size=3, max_size=3), st.lists(st.floats(0.01, 100.0), min_size=3, max_size=3))
def test_scales_of_any_dimension_are_products_of_powers(halves: list[int], sizes: list[float]) -> None:
    """Assert M**a L**b T**c, whole powers and halves, and 1 where nothing is scaled."""
    powers = [Fraction(half, 2) for half in halves]
    dimension = Dimension((*powers, *(Fraction(0),) * (len(BASE) - 3)))
    mass, length, time = sizes
    expected = mass ** float(powers[0]) * length ** float(powers[1]) * time ** float(powers[2])
    assert Scales(length=length, time=time, mass=mass).si_factor(dimension) == pytest.approx(expected, rel=1e-13)
    assert Scales().si_factor(dimension) == 1.0


def test_limits_of_scales_and_texts() -> None:
    """Assert the largest and least scale, the longest text, and the highest power that are read, and what is beyond."""
    for text in ("1e40 m", "1e-40 m"):
        assert Scales.parse({"length": text}).length == float(text.split()[0])
    for text in ("1.1e40 m", "0.9e-40 m"):
        with pytest.raises(InputError, match="1e-40 to 1e40"):
            Scales.parse({"length": text})
    with pytest.raises(InputError, match="need a table"):
        Scales.parse([1.0])  # type: ignore[arg-type]
    assert Scales.parse(None) == Scales()
    assert parse_unit("m16 s-16").dimension == parse_unit("m").dimension ** 16 / parse_unit("s").dimension ** 16
    for text in ("m17", "s-17"):
        with pytest.raises(InputError, match="needs 1 to 16 in size"):
            parse_unit(text)
    padded = "m" + " " * 199
    assert (parse_unit(padded).text, parse_quantity("1" + padded[1:]).unit.text) == ("m", "1")
    for read, text in ((parse_unit, padded + " "), (parse_quantity, "1" + "m" * 200)):
        with pytest.raises(InputError, match="has 201 characters, 200 at most"):
            read(text)


def test_dimensions_in_words_have_a_derived_name_where_there_is_one() -> None:
    """Assert base units with powers, a name behind, and 1 of none."""
    texts = {"N": "kg m s-2 (N)", "J": "kg m2 s-2 (J)", "m s-1": "m s-1", "1": "1", "V": "kg m2 s-3 A-1 (V)"}
    assert {text: str(parse_unit(text).dimension) for text in texts} == texts


def test_rates_in_a_time_without_a_unit_keep_theirs() -> None:
    """Assert the unit of a rate by seconds, twice over, and by a time that is a pure number."""
    assert parse_unit("km").per(SECONDS, 2).text == "km s-2"
    assert parse_unit("km").per(SECONDS).factor == 1000
    assert parse_unit("1").per(SECONDS, 2).text == "s-2"
    assert parse_unit("km").per(NUMBERS, 2).text == "km"
    assert parse_unit("km").per_second(2).dimension == parse_unit("m s-2").dimension
    assert (unit_suffix("1"), unit_suffix(parse_unit("N")), unit_suffix(NUMBERS)) == ("", " N", "")


def test_times_of_a_model_without_seconds_are_pure_numbers() -> None:
    """Assert bare and pure numbers, percents of 1, refusal of seconds, and a number as a text in the model's unit."""
    assert (time_in(NUMBERS, 3, "until"), time_in(NUMBERS, "3", "until"), time_in(NUMBERS, "50 percent", "until")) == (
        3.0,
        3.0,
        0.5,
    )
    assert (time_in(SECONDS, "2 min", "until"), time_in(SECONDS, 2, "until")) == (120.0, 2.0)
    with pytest.raises(InputError, match="until '3 s' has units 's', and the model's time is a pure number"):
        time_in(NUMBERS, "3 s", "until")
    assert time_in(SECONDS, "3", "until") == 3.0
    with pytest.raises(InputError, match="until '3 rad' has units '1', needs 's'"):
        time_in(SECONDS, "3 rad", "until")
    with pytest.raises(InputError, match="until: quantity 'x' does not start"):
        parse_time("x", "until")


@pytest.mark.parametrize(
    ("text", "power"), [("kilometre2", 6), ("uPa", -6), ("cm3", -6), ("MW", 6), ("hPa", 2), ("dL", -4), ("fs", -15)]
)
def test_prefixes_are_powers_of_ten(text: str, power: int) -> None:
    """Assert exact factors to SI units, with powers of the unit."""
    assert parse_unit(text).factor == Fraction(10) ** power


@pytest.mark.parametrize("text", ["kmin", "mdegree", "kmile", "Eday", "kilopound", "m" * 41, "parsec s", "Kim"])
def test_units_that_have_no_place_in_a_record(text: str) -> None:
    """Assert that prefixed minutes, other prefixes and other units are not known."""
    with pytest.raises(InputError, match="is not known"):
        parse_unit(text)


def test_a_number_beyond_all_is_none() -> None:
    """Assert that what overflows in SI units, or is no finite number, ends in one error."""
    assert Quantity(1e305, parse_unit("m")).si == 1e305
    with pytest.raises(InputError, match="1e\\+306 km is not finite in SI units"):
        _ = Quantity(1e306, parse_unit("km")).si
    for text in (10**400, "1e999 m"):
        with pytest.raises(InputError, match="no number with a unit|not finite|does not start"):
            parse_quantity(text)
    assert str(parse_quantity("0.5 km/h")) == "0.5 km h-1"


POWERS = dict(zip("QRYZEPTGMkh", (30, 27, 24, 21, 18, 15, 12, 9, 6, 3, 2), strict=True))
POWERS |= {"da": 1, "": 0} | dict(
    zip("dcmunpfazyrq", (-1, -2, -3, -6, -9, -12, -15, -18, -21, -24, -27, -30), strict=True)
)


def test_no_name_of_a_unit_reads_in_two_ways() -> None:
    """Assert that each prefix before each unit is that power of ten of it, by symbol and by name, as UDUNITS reads it too."""
    read = dict[str, tuple[str, str]]()
    for prefix, symbol in PREFIX.items():
        for unit, spelling in SPELLING.items():
            if prefix and unit in NO_PREFIX:
                continue
            own = symbol + spelling
            assert read.setdefault(own, (prefix, unit)) == (prefix, unit)
            dimension, factor = (
                parse_unit(spelling).dimension,
                parse_unit(spelling).factor * Fraction(10) ** POWERS[symbol],
            )
            for name in (own, prefix + unit):
                found = parse_unit(name)
                assert (found.text, found.dimension, found.factor) == (own, dimension, factor)
            assert coherent(parse_unit(own)).factor == 1
            assert coherent(parse_unit(own)).dimension == dimension
            size = (
                cf_units.Unit(own).convert(1.0, cf_units.Unit(spell(dimension).text))
                if dimension != NONE
                else float(factor)
            )
            assert size == pytest.approx(float(factor), rel=1e-15, abs=0.0)


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("1 light_year", 9_460_730_472_580_800),
        ("1 ly", 299_792_458 * 31_557_600),
        ("2.5 light-years", 23_651_826_181_452_000),
        ("1 pc", 3.0856775814913673e16),
        ("770 kpc", 2.3759717377483528e22),
        ("1 Mpc", 3.0856775814913673e22),
    ],
)
def test_astronomical_lengths_of_values(text: str, metres: float) -> None:
    """Assert lengths of the IAU, which are kept in m; a parsec's digits are those of its resolution of 2015."""
    quantity = parse_quantity(text)
    assert (quantity.si, quantity.unit.text) == (metres, "m")
    unit = text.split(maxsplit=1)[1]
    with pytest.raises(
        InputError, match=f"unit '{unit}' is for values alone, like '20 {unit}': they are kept in m; write 'm'"
    ):
        parse_unit(unit)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "3 Rm",
            "unit 'Rm' is not known: UDUNITS has no prefix ronna, 1e27, .*; write the number in 'm', or with a prefix",
        ),
        ("3 quectogram", "no prefix quecto, 1e-30, .*; write the number in 'g'"),
        (
            "70 km/s/Mpc",
            "unit 'Mpc' is not known here: .* like '20 parsec', and is kept in m; in a product write 'm', 'km' or",
        ),
        ("1 ly/year", "unit 'ly' is not known here"),
    ],
)
def test_what_records_cannot_spell_has_a_remedy(text: str, said: str) -> None:
    """Assert that prefixes and lengths that UDUNITS has not are refused with what to write."""
    with pytest.raises(InputError, match=said):
        parse_quantity(text)


@pytest.mark.parametrize(
    ("text", "same"),
    [("3 lightyears", "3 ly"), ("2 kiloparsec", "2 kpc"), ("1 megaparsec", "1 Mpc"), ("1 gigaparsecs", "1 Gpc")],
)
def test_lengths_by_their_full_names(text: str, same: str) -> None:
    """Assert that a length is read by its full name as by its symbol; a thousandth of a parsec is refused with what is read."""
    assert parse_quantity(text) == parse_quantity(same)
    with pytest.raises(
        InputError, match=r"unit 'mpc' is not known here: a value alone may be given in light_year \(ly\) or"
    ):
        parse_quantity("1 mpc")


@pytest.mark.parametrize(
    ("text", "spelled", "si"),
    [
        ("60 mph", "mile h-1", 26.8224),
        ("60 kph", "km h-1", 60.0 / 3.6),
        ("1 knot", "knot", 1852.0 / 3600.0),
        ("1 kWh", "kW h", 3.6e6),
        ("2 mAh", "mA h", 7.2),
        ("3 Nm", "N m", 3.0),
        ("1 psi", "psi", 6894.757293168361),
        ("1 kip", "kip", 4448.2216152605),
        ("1 kgf/cm2", "kgf cm-2", 98066.5),
        ("1 atm", "atm", 101325.0),
        ("1 mmHg", "mmHg", 133.322387415),
        ("1 kcal", "kthermochemical_calorie", 4184.0),
        ("1 yd", "yard", 0.9144),
        ("1 lbm", "lb", 0.45359237),
        ("1 cP", "mPa s", 1e-3),
        ("1 cSt", "mm2 s-1", 1e-6),
        ("3000 rpm", "rpm", 314.1592653589793),
        ("1 rev/s", "revolution s-1", 6.283185307179586),
        ("3000 RPM", "rpm", 314.1592653589793),
        ("5 ppm", "ppm", 5e-6),
        ("2 Newtons", "N", 2.0),
        ("2 Seconds", "s", 2.0),
        ("2 Feet", "foot", 0.6096),
        ("2 FEET", "foot", 0.6096),
        ("2 Ft", "foot", 0.6096),
        ("2 Kg", "kg", 2.0),
    ],
)
def test_units_that_engineers_type(text: str, spelled: str, si: float) -> None:
    """Assert sizes of NIST SP 811 (2008), appendix B, and that UDUNITS reads what a record says as the same."""
    quantity = parse_quantity(text)
    assert (quantity.unit.text, quantity.si) == (spelled, pytest.approx(si, rel=4e-16))
    assert parse_quantity(f"{quantity.value!r} {spelled}").si == quantity.si
    dimension = quantity.unit.dimension
    if dimension != NONE and "r" not in spelled[:3]:  # of angles UDUNITS keeps radians
        size = cf_units.Unit(spelled).convert(quantity.value, cf_units.Unit(spell(dimension).text))
        assert size == pytest.approx(si, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "kept", "si"),
    [
        ("1 hp", "W", 745.6998715822702),
        ("1 horsepower", "W", 745.6998715822702),
        ("1 slug", "kg", 14.593902937206364),
        ("16 oz", "lb", 0.45359237),
        ("760 torr", "Pa", 101325.0),
        ("1 eV", "J", 1.602176634e-19),
        ("1 MeV", "J", 1.602176634e-13),
    ],
)
def test_units_of_values(text: str, kept: str, si: float) -> None:
    """Assert exact sizes that UDUNITS has not, kept in a unit that it has, and the way on where a product has one."""
    quantity = parse_quantity(text)
    assert (quantity.unit.text, quantity.si) == (kept, pytest.approx(si, rel=2e-16))
    with pytest.raises(InputError, match=f"and is kept in {kept}; in a product write '{kept}'"):
        parse_unit(f"{text.split()[1]} s-1")


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("dB", r"unit 'dB' is not known here: a level is the logarithm of a ratio: write the ratio itself"),
        ("gallon", "3.785411784 L in the US"),
        ("BTU", "1055.05585262 J"),
        ("ton", "write 'tonne' for 1000 kg"),
        ("m2.5/s", "has the power 2.5, and a record spells whole powers alone"),
        ("m^0.5", "has the power 0.5"),
        ("Mpa", "unit 'Mpa' is not known"),  # not mPa
        ("Cal", "unit 'Cal' is not known"),  # of food it is 1000 cal
        ("G", "unit 'G' is not known"),
    ],
)
def test_units_of_several_sizes_have_a_remedy(unit: str, said: str) -> None:
    """Assert that nothing is guessed, and that the message says what to write."""
    with pytest.raises(InputError, match=said):
        parse_quantity(f"3 {unit}")
