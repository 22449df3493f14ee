"""Symplectic compositions of kicks and drifts, for forces of position and time."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction
from typing import TypedDict

from xdynamics.methods.method import Method
from xdynamics.model import Trait

REFUSES = (Trait.VELOCITY_DEPENDENT, Trait.COUPLED_MASS, Trait.COUPLED_STATES, Trait.NO_COORDINATES)
OF_HIGHER_ORDER = (*REFUSES, Trait.PRESSED, Trait.HELD_LINKS)  # of which order 2 would be left

_HLW = "Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd ed., section V.3.2"
_WORDS = (
    "drifts with the newest velocity and kicks with the force at the newest position in turn, {} first, time with the"
    " drifts"
)


class Composition(TypedDict):
    """The lines of a composition, for models without constraints and with them."""

    update: str
    constrained_update: str


def composed(text: str) -> Composition:
    """Write rows of ``kick`` and ``drift`` coefficients as lines, for models without constraints and with them."""
    return {"update": update_of(text), "constrained_update": update_of(text, keeping=True)}


def update_of(text: str, *, keeping: bool = False) -> str:
    """Write rows of ``kick`` and ``drift`` coefficients as update lines, beginning with the row that comes first.

    A kick moves v and x with the newest forces, a drift moves q and the time with the newest velocity. Forces are
    evaluated after each drift; the last ones, at the end of the step, serve the next step. With `keeping`, each drift ends
    where constraints hold.

    Examples
    --------
    >>> print(update_of('''
    ...     drift  1/2  1/2
    ...     kick    1
    ... '''))
    q2 = q + 1/2*h*v
    a2, r2 = f(t + 1/2*h, q2, v, x)
    v1 = v + h*a2
    x1 = x + h*r2
    q1 = q2 + 1/2*h*v1
    a1, r1 = f(t1, q1, v1, x1)
    """
    rows = {name: numbers for name, *numbers in (line.split() for line in text.splitlines() if line.strip())}
    counts = {name: len(numbers) for name, numbers in rows.items()}
    newest, lines, time = {"q": "q", "v": "v", "a": "a", "x": "x", "r": "r"}, [], Fraction(0)
    for i in range(max(counts.values())):
        for name in rows:
            if i == counts[name]:
                break
            number = "1" if i + 1 == counts[name] else str(i + 2)
            if name == "drift":
                time += Fraction(rows[name][i])
                lines += _drift_lines(newest, number, rows[name][i], time, keeping=keeping)
            else:
                lines += _kick_lines(newest, number, rows[name][i])
    return "\n".join(lines)


def _kick_lines(newest: dict[str, str], number: str, part: str) -> list[str]:
    """Move v and x."""
    lines = [
        f"{letter}{number} = {_vector_plus_slope(newest[letter], part, newest[slope])}"
        for letter, slope in ("va", "xr")
    ]
    newest |= {letter: letter + number for letter in "vx"}
    return lines


def _drift_lines(newest: dict[str, str], number: str, part: str, time: Fraction, *, keeping: bool) -> list[str]:
    """Move q, then evaluate the forces there."""
    velocity_lines = ["v0 = v"] if keeping and newest["v"] == "v" else []  # which impulses of constraints change
    newest |= {"v": "v0"} if velocity_lines else {}
    distance = "h" if part == "1" else f"{part}*h"
    keep_lines = [f"keep q{number}, {newest['v']} at {_time_text(number, time)} over {distance}"] if keeping else []
    lines = [
        *velocity_lines,
        f"q{number} = {_vector_plus_slope(newest['q'], part, newest['v'])}",
        *keep_lines,
        f"a{number}, r{number} = f({_time_text(number, time)}, q{number}, {newest['v']}, {newest['x']})",
    ]
    newest |= {letter: letter + number for letter in "qar"}
    return lines


def _vector_plus_slope(value: str, part: str, slope: str) -> str:
    """``v + 7/24*h*a``."""
    step = "h" if part == "1" else f"{part}*h"
    return f"{value} + {step}*{slope}".replace("+ -", "- ")


def _time_text(number: str, time: Fraction) -> str:
    """``t + 0.25*h``; the last drift ends at t1 even if the digits of the coefficients do not sum to 1 exactly."""
    if number == "1":
        return "t1"
    return f"t + {_exact_number(time)}*h".replace("+ -", "- ") if time else "t"


def _exact_number(number: Fraction) -> str:
    """Print a number exactly: as a fraction if it is simple, else as a decimal."""
    if number.denominator < 100:
        return str(number)
    with localcontext(prec=60):  # more digits than the coefficients have
        return format(Decimal(number.numerator) / number.denominator, "f")


def verlet_composed(text: str) -> Composition:
    """Write out composed steps of velocity Verlet, from the first half of a symmetric sequence and its middle.

    The last kick of one step and the first of the next are merged: one force evaluation for each.
    """
    half = [Fraction(coefficient) for coefficient in text.split()]
    coefficients = [*half, *half[-2::-1]]
    kicks = [
        (coefficient + next_coefficient) / 2
        for coefficient, next_coefficient in zip(
            [Fraction(0), *coefficients], [*coefficients, Fraction(0)], strict=True
        )
    ]
    return composed(f"kick {' '.join(map(_exact_number, kicks))}\ndrift {' '.join(map(_exact_number, coefficients))}")


POSITION_VERLET = Method(
    name="position_verlet",
    synonyms=("leapfrog, drift-kick-drift", "Stoermer-Verlet in position form"),
    order=2,
    symplectic=True,
    symmetric=True,
    evaluations=2,
    **composed("""
        drift  1/2  1/2
        kick    1
    """),
    words=(
        "half a drift with the old velocity, a kick with the force there at t + h/2, half a drift with the new"
        " velocity, then the force"
    ),
    reference=(
        "Tuckerman, Berne, Martyna 1992, J. Chem. Phys. 97, 1990, doi:10.1063/1.463137; Hairer, Lubich, Wanner, section"
        " I.1.4"
    ),
    refuses=REFUSES,
)

RUTH3 = Method(
    name="ruth3",
    synonyms=("Ruth's third-order method",),
    order=3,
    symplectic=True,
    evaluations=3,
    update=update_of("""
        kick   7/24   3/4  -1/24
        drift  2/3   -2/3    1
    """),
    words=_WORDS.format("kick"),
    reference=(
        "Ruth 1983, IEEE Trans. Nucl. Sci. 30, 2669, doi:10.1109/TNS.1983.4332919; Hairer, Norsett, Wanner I, section"
        " II.16"
    ),
    refuses=(*OF_HIGHER_ORDER, Trait.CONSTRAINTS),
)

# theta = 1/(2 - 2**(1/3)) and 1 - 2 theta
FOREST_RUTH = Method(
    name="forest_ruth",
    synonyms=("Forest-Ruth in velocity form", "Yoshida's fourth-order method", "triple jump of velocity Verlet"),
    order=4,
    symplectic=True,
    symmetric=True,
    evaluations=3,
    **verlet_composed("""
         1.351207191959657634047688
        -1.702414383919315268095376
    """),
    words=_WORDS.format("kick"),
    reference=(
        "Forest, Ruth 1990, Physica D 43, 105, doi:10.1016/0167-2789(90)90019-L; Yoshida 1990, Phys. Lett. A 150, 262,"
        " doi:10.1016/0375-9601(90)90092-3; Hairer, Lubich, Wanner, section II.4, eq. (4.4)"
    ),
    refuses=OF_HIGHER_ORDER,
)

# xi, chi, 1 - 2 (xi + chi) and 1/2 - lambda, lambda, of lambda = -0.2123418310626054
PEFRL = Method(
    name="pefrl",
    synonyms=("position extended Forest-Ruth like",),
    order=4,
    symplectic=True,
    symmetric=True,
    evaluations=5,
    update=update_of("""
        drift  0.1786178958448091  -0.06626458266981849  0.77529337365001878  -0.06626458266981849  0.1786178958448091
        kick   0.7123418310626054  -0.2123418310626054  -0.2123418310626054    0.7123418310626054
    """),
    words=_WORDS.format("drift") + ", then the force",
    reference="Omelyan, Mryglod, Folk 2002, Comput. Phys. Commun. 146, 188, doi:10.1016/S0010-4655(02)00451-4",
    refuses=(*OF_HIGHER_ORDER, Trait.CONSTRAINTS),
)

YOSHIDA6 = Method(
    name="yoshida6",
    synonyms=("Yoshida's sixth-order solution A",),
    order=6,
    symplectic=True,
    symmetric=True,
    evaluations=7,
    **verlet_composed("""
         0.78451361047755726381949763
         0.23557321335935813368479318
        -1.17767998417887100694641568
         1.31518632068391121888424973
    """),
    words=_WORDS.format("kick"),
    reference=f"Yoshida 1990, Phys. Lett. A 150, 262, doi:10.1016/0375-9601(90)90092-3; {_HLW}, eq. (3.11)",
    refuses=OF_HIGHER_ORDER,
)

KAHAN_LI6 = Method(
    name="kahan_li6",
    synonyms=("s9odr6a",),
    order=6,
    symplectic=True,
    symmetric=True,
    evaluations=9,
    **verlet_composed("""
         0.39216144400731413927925056
         0.33259913678935943859974864
        -0.70624617255763935980996482
         0.08221359629355080023149045
         0.79854399093482996339895035
    """),
    words=_WORDS.format("kick"),
    reference=f"Kahan, Li 1997, Math. Comp. 66, 1089, doi:10.1090/S0025-5718-97-00873-9; {_HLW}, eq. (3.12)",
    refuses=OF_HIGHER_ORDER,
)

YOSHIDA8 = Method(
    name="yoshida8",
    synonyms=(
        "eighth-order composition of Yoshida's kind with the coefficients of Suzuki and Umeno, and of McLachlan",
    ),
    order=8,
    symplectic=True,
    symmetric=True,
    evaluations=15,
    **verlet_composed("""
         0.74167036435061295344822780
        -0.40910082580003159399730010
         0.19075471029623837995387626
        -0.57386247111608226665638773
         0.29906418130365592384446354
         0.33462491824529818378495798
         0.31529309239676659663205666
        -0.79688793935291635401978884
    """),
    words=_WORDS.format("kick"),
    reference=(
        "Suzuki, Umeno 1993, Springer Proc. Phys. 76, 74, doi:10.1007/978-3-642-78448-4_7; McLachlan 1995, SIAM J."
        f" Sci. Comput. 16, 151, doi:10.1137/0916010; {_HLW}, eq. (3.13); the 15-stage form: Yoshida 1990, Phys. Lett."
        " A 150, 262, doi:10.1016/0375-9601(90)90092-3"
    ),
    refuses=OF_HIGHER_ORDER,
)

KAHAN_LI8 = Method(
    name="kahan_li8",
    synonyms=("s17odr8a",),
    order=8,
    symplectic=True,
    symmetric=True,
    evaluations=17,
    **verlet_composed("""
         0.13020248308889008087881763
         0.56116298177510838456196441
        -0.38947496264484728640807860
         0.15884190655515560089621075
        -0.39590389413323757733623154
         0.18453964097831570709183254
         0.25837438768632204729397911
         0.29501172360931029887096624
        -0.60550853383003451169892108
    """),
    words=_WORDS.format("kick"),
    reference=f"Kahan, Li 1997, Math. Comp. 66, 1089, doi:10.1090/S0025-5718-97-00873-9; {_HLW}, eq. (3.14)",
    refuses=OF_HIGHER_ORDER,
)

METHODS = (POSITION_VERLET, RUTH3, FOREST_RUTH, PEFRL, YOSHIDA6, KAHAN_LI6, YOSHIDA8, KAHAN_LI8)
