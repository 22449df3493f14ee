"""Elementary functions: against mpmath, special values, and one set of bits for floats, arrays and every kind of lane."""

from __future__ import annotations

import ctypes
import hashlib
import math
import struct
from collections.abc import Callable, Iterator

import mpmath
import numpy as np
import pytest
from llvmlite import binding as llvm
from numpy.typing import NDArray

from cases.elementary_loops import NAMES, loops
from cases.problems import arguments_of, true_value, ulps
from elementary_tables import fitted, tables
from xdynamics.elementary import FUNCTIONS, NAME, SETS, TOGETHER, circular, exponential, kept_set
from xdynamics.elementary.circular import reduce_exactly
from xdynamics.elementary.tables import TABLES
from xdynamics.kernels import machine

INF, NAN = math.inf, math.nan
CLOSE = {"sin": 0.8, "cos": 0.8, "exp": 0.8, "log": 0.8}  # ulp; 1 is what the others are held to
# sha256 of what 10**5 arguments give, hard ones among them
DIGESTS = {
    "acos": "7ff1b9b2cdfe0834",
    "asin": "ef4f19ee7dac11b0",
    "atan": "a2825a6bbd84b4c9",
    "atan2": "7e4cd650429d18c8",
    "cos": "130e4f2ea82a5254",
    "cosh": "483c1184c9b8564a",
    "exp": "3074473ece99a6fc",
    "hypot": "2711d4fd3a29a6c5",
    "log": "07edd4db580cad4c",
    "power": "0ec9ff96be8ef119",
    "sin": "3291fd820d474841",
    "sinh": "f6fee198acb80b88",
    "tan": "ef55be5111a47316",
    "tanh": "0e5e3485dd3effa5",
}
FIRST_DIGESTS = DIGESTS | {"tan": "e33afa2e3f2ad245"}  # of the set `xdynamics 1`


@pytest.fixture(autouse=True)
def _arithmetic_raises_nothing() -> Iterator[None]:
    """Let NumPy be silent about infinities, as floats and machine code are."""
    with np.errstate(all="ignore"):
        yield


def digest_of(found: NDArray[np.float64]) -> str:
    """The beginning of a sha256 of bits, of which what is no number has one kind."""
    return hashlib.sha256(np.where(np.isnan(found), NAN, found).tobytes()).hexdigest()[:16]


@pytest.mark.every(2)
@pytest.mark.parametrize("name", NAMES)
def test_against_mpmath(name: str) -> None:
    """Assert that no value is further from the true one than promised, over all magnitudes."""
    given = arguments_of(name, 400)
    found = FUNCTIONS[name](*given)
    worst = max(ulps(float(one), true_value(name, *map(float, at))) for one, *at in zip(found, *given, strict=True))
    assert worst <= CLOSE.get(name, 1.0)


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_angles_next_to_multiples(name: str) -> None:
    """Assert the worst of all angles, and doubles next to multiples of pi/2 of every size."""
    worst = float.fromhex("0x1.6ac5b262ca1ffp+849")  # the closest of all to a multiple (Muller 2016, table 11.1)
    with mpmath.workprec(1300):
        near = [float(mpmath.mpf(round(1.7**k)) * mpmath.pi / 2) for k in range(1, 600)]
    for x in [worst, *near]:
        assert ulps(FUNCTIONS[name](x), true_value(name, x)) <= 0.8


def test_reduction_is_one() -> None:
    """Assert that the exact reduction agrees with the true remainder to twice the digits, from 2 to 1e308."""
    with mpmath.workprec(1400):
        for x in np.exp(np.random.default_rng(3).uniform(0.5, 709, 300)):
            high, low, n = reduce_exactly(float(x))
            turns = mpmath.nint(mpmath.mpf(float(x)) * 2 / mpmath.pi)
            rest = mpmath.mpf(float(x)) - turns * mpmath.pi / 2
            assert n % 4 == int(turns) % 4
            assert abs(mpmath.mpf(high) + mpmath.mpf(low) - rest) <= abs(rest) * mpmath.mpf(2) ** -100


def test_exact_values() -> None:
    """Assert that what is a double comes out as that double."""
    f = FUNCTIONS
    assert [f["exp"](0.0), f["exp"](-0.0), f["log"](1.0), f["cos"](0.0), f["cosh"](0.0), f["acos"](1.0)] == [
        1,
        1,
        0,
        1,
        1,
        0,
    ]
    assert [f["atan2"](1.0, 0.0), f["atan2"](0.0, -1.0), f["asin"](1.0), f["acos"](-1.0)] == [
        math.pi / 2,
        math.pi,
        math.pi / 2,
        math.pi,
    ]
    assert all(f["power"](float(b), float(n)) == float(b**n) for b in range(-12, 13) if b for n in range(13))
    assert all(f["power"](2.0, float(n)) == 2.0**n for n in range(-1074, 1024))
    assert all(f["hypot"](3.0 * 2.0**k, 4.0 * 2.0**k) == 5.0 * 2.0**k for k in range(-1070, 1020))
    for name in ("sin", "tan", "asin", "atan", "sinh", "tanh"):
        for x in (0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-200):
            assert struct.pack("d", f[name](x)) == struct.pack("d", x), (name, x)


SPECIAL = {
    "sin": {INF: NAN, -INF: NAN, NAN: NAN},
    "cos": {INF: NAN, NAN: NAN},
    "tan": {-INF: NAN, NAN: NAN},
    "exp": {INF: INF, -INF: 0.0, NAN: NAN, 710.0: INF, -746.0: 0.0, 1e300: INF, -1e300: 0.0, -745.0: 5e-324},
    "log": {INF: INF, 0.0: -INF, -1.0: NAN, -INF: NAN, NAN: NAN, 5e-324: -744.4400719213812},
    "asin": {1.1: NAN, -1.1: NAN, INF: NAN, NAN: NAN},
    "acos": {1.1: NAN, -INF: NAN, NAN: NAN},
    "atan": {INF: math.pi / 2, -INF: -math.pi / 2, NAN: NAN, 1e308: math.pi / 2},
    "sinh": {INF: INF, -INF: -INF, NAN: NAN, 711.0: INF},
    "cosh": {INF: INF, -INF: INF, NAN: NAN, -711.0: INF},
    "tanh": {INF: 1.0, -INF: -1.0, NAN: NAN, 1e300: 1.0},
}


@pytest.mark.parametrize("name", sorted(SPECIAL))
def test_special_values(name: str) -> None:
    """Assert what IEEE 754 asks at infinities, poles, outside a domain and of what is no number."""
    for x, value in SPECIAL[name].items():
        assert struct.pack("d", FUNCTIONS[name](x)) == struct.pack("d", value) or (
            math.isnan(value) and math.isnan(FUNCTIONS[name](x))
        ), x


@pytest.mark.parametrize("name", ["power", "atan2", "hypot"])
def test_special_pairs(name: str) -> None:
    """Assert infinities, zeros of either sign and what is no number, each with each, against Python's own."""
    special = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        INF,
        -INF,
        NAN,
        5e-324,
        -5e-324,
        2.0,
        3.0,
        -3.0,
        0.5,
        2.5,
        2.0**53,
        -(2.0**53) - 2,
        1e300,
    ]
    own = {"power": math.pow, "atan2": math.atan2, "hypot": math.hypot}[name]
    for x in special:
        for y in special:
            try:
                value = own(x, y)
            except (ValueError, OverflowError):
                continue
            found = FUNCTIONS[name](x, y)
            same = found == pytest.approx(value, rel=3e-16, abs=0) and math.copysign(1, found) == math.copysign(
                1, value
            )
            assert same or (math.isnan(found) and math.isnan(value)), (x, y, found, value)
    if name == "power":
        beyond = [
            (-2.0, 0.5, NAN),
            (0.0, -1.0, INF),
            (-0.0, -1.0, -INF),
            (-0.0, -2.0, INF),
            (1e300, 3.0, INF),
            (-1e300, 3.0, -INF),
        ]
        for x, y, value in beyond:
            found = FUNCTIONS[name](x, y)
            assert found == value or (math.isnan(value) and math.isnan(found)), (x, y)


def test_pairs_have_the_bits_of_each() -> None:
    """Assert that a sine and a cosine computed together are those computed alone."""
    (x,) = arguments_of("sin", 3000)
    sine, cosine = TOGETHER["sin_cos"](x)
    assert sine.tobytes() == FUNCTIONS["sin"](x).tobytes()
    assert cosine.tobytes() == FUNCTIONS["cos"](x).tobytes()


def test_tables_are_what_mpmath_says() -> None:
    """Assert that the kept tables are those that their script makes."""
    assert {name: tuple(table) for name, table in tables().items()} == TABLES


@pytest.mark.parametrize(
    ("powers", "function", "end"),
    [
        (circular.ARCTANGENT, mpmath.atan, "0.0361"),
        (circular.ARCSINE, mpmath.asin, "0.25"),
        (exponential.SINH, mpmath.sinh, "1"),
        (exponential.TANH, mpmath.tanh, "0.0625"),
    ],
    ids=["atan", "asin", "sinh", "tanh"],
)
def test_polynomials_are_what_is_fitted(
    powers: tuple[float, ...], function: Callable[..., mpmath.mpf], end: str
) -> None:
    """Assert that a polynomial is that of f(x)/x - 1 over x**2 at Chebyshev's points, with an error below 2**-55."""
    with mpmath.workprec(400):
        found, worst = fitted(
            lambda u: (function(mpmath.sqrt(u)) / mpmath.sqrt(u) - 1) / u,
            len(powers) - 1,
            mpmath.mpf(end),
            lambda _: mpmath.mpf(1),
        )
    assert tuple(found) == powers
    assert worst < 2.0**-55


@pytest.mark.parametrize("name", NAMES)
def test_digests(name: str) -> None:
    """Assert that 10**5 arguments give the bits that they gave when the set was named."""
    found = FUNCTIONS[name](*arguments_of(name, 20_000))
    assert digest_of(found) == DIGESTS[name]


@pytest.mark.parametrize("name", NAMES)
def test_digests_of_the_first_set(name: str) -> None:
    """Assert that the functions of archives made with `xdynamics 1` have the bits that they had."""
    found = SETS["xdynamics 1"][name](*arguments_of(name, 20_000))
    assert digest_of(found) == FIRST_DIGESTS[name]


def test_a_set_that_is_not_there_is_the_newest() -> None:
    """Assert that a record's own set is taken, and the newest for the C library's and for what is not known."""
    assert [kept_set(name) for name in ("xdynamics 1", NAME, "libm", "xdynamics 99", None)] == [
        "xdynamics 1",
        *[NAME] * 4,
    ]


# ---------------------------------------------------------------------------------------------------- machine code


def applied(code: machine.Code, name: str, given: tuple[NDArray[np.float64], ...]) -> NDArray[np.float64]:
    """What machine code makes of arrays."""
    found = np.empty_like(given[0])
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, ctypes.c_int64)(code.addresses[f"run_{name}"])
    call(given[0].ctypes.data, given[-1].ctypes.data, found.ctypes.data, found.size)
    return found


PROCESSORS = {"x86-64": "", "haswell": "+avx2", "skylake-avx512": "+avx512f", "host": ""}


@pytest.mark.every(11)
@pytest.mark.parametrize("processor", PROCESSORS)
@pytest.mark.parametrize("lanes", [1, 2, 4, 8, 16])
def test_machine_code_has_the_bits_of_python(lanes: int, processor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert equal bits of floats, arrays and lanes, compiled for processors with and without wide vectors and fma."""
    flags = llvm.get_host_cpu_features()
    needed = PROCESSORS[processor].lstrip("+")
    if needed and not flags.get(needed):
        pytest.skip(f"this machine has no {needed}")
    if processor != "host":
        if not llvm.get_process_triple().startswith("x86_64"):
            pytest.skip("another architecture")
        monkeypatch.setattr(machine, "processor", lambda: ("", processor, ""))
    code = machine.Code(machine._object(loops(lanes)), [f"run_{name}" for name in NAMES])
    for name in NAMES:
        given = arguments_of(name, 640)
        arrays, found = FUNCTIONS[name](*given), applied(code, name, given)
        for one in (arrays, found):
            one[np.isnan(one)] = NAN
        assert found.tobytes() == arrays.tobytes(), name
        if lanes == 1 and processor == "host":
            singly = np.array([FUNCTIONS[name](*map(float, at)) for at in zip(*given, strict=True)])
            singly[np.isnan(singly)] = NAN
            assert singly.tobytes() == arrays.tobytes(), name


@pytest.mark.every(2)
@pytest.mark.parametrize("lanes", [1, 8])
def test_machine_code_of_the_first_set(lanes: int) -> None:
    """Assert that machine code of the set `xdynamics 1` has that set's bits where the sets differ."""
    names = ("tan", "atan2")
    code = machine.Code(machine._object(loops(lanes, "xdynamics 1")), [f"run_{name}" for name in names])
    for name in names:
        given = arguments_of(name, 640)
        given[0][::5] *= 1e-318  # where y is subnormal, and x is small, the sets differ
        given[-1][1::5] *= 1e-100
        given[0][1::5] *= 1e-318
        found = applied(code, name, given)
        found[np.isnan(found)] = NAN
        expected, newer = SETS["xdynamics 1"][name](*given), FUNCTIONS[name](*given)
        assert found.tobytes() == np.where(np.isnan(expected), NAN, expected).tobytes() != newer.tobytes()


@pytest.mark.dear
def test_text_compiles_for_other_processors() -> None:
    """Assert that the text, lanes included, is also machine code for AArch64."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("aarch64-unknown-linux-gnu").create_target_machine(opt=2)
    for lanes in (1, 8):
        module = llvm.parse_assembly(loops(lanes))
        module.triple = "aarch64-unknown-linux-gnu"
        module.verify()
        assert len(target.emit_object(module)) > 1000
