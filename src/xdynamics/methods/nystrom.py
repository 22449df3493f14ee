"""Runge-Kutta-Nystroem pairs, for q'' = f(t, q), with stages for the coordinates only."""

from __future__ import annotations

from xdynamics.methods.lines import Interpolant
from xdynamics.methods.method import Method
from xdynamics.methods.tableau import Weights, weighted_sum
from xdynamics.model import Trait

# R is sqrt(8581). Stages 1 to 6, the last at the end of the step; b for positions, db for velocities, ^ embedded.
_ROWS = """
    c   | 0 | (209 - R)/900 | (209 - R)/450 | (209 + R)/450 | 9/10 | 1

    a2  | (26131 - 209*R)/810000
    a3  | (26131 - 209*R)/607500                     |  (26131 - 209*R)/303750
    a4  | (980403512254 + 7781688431*R)/11694469921875 | -(1262884486208 + 15385481287*R)/11694469921875 | (7166233891441 + 78694563299*R)/46777879687500
    a5  | -9*(329260 + 3181*R)/27040000              |  27*(35129 + 3331*R)/13520000 | -27*(554358343 + 31040327*R)/464060480000  | 153*(8555257 - 67973*R)/2745920000

    b   | 329/4212           |  0                    | (84119543 + 366727*R)/409622616    | (84119543 - 366727*R)/409622616    | 200/17901  |  0
    b^  | (2701 + 23*R)/4563 | -(9829 + 131*R)/9126  | 5*(1798 + 17*R)/9126               | 0                                  | 0          |  0
    db  | 329/4212           |  0                    | (389225579 + 96856*R)/1024056540   | (389225579 - 96856*R)/1024056540   | 2000/17901 |  1/20
    db^ | 115/2106           |  0                    | (84119543 + 366727*R)/256014135    | (84119543 - 366727*R)/256014135    | 6950/17901 | -1/10
"""

# The weights of the extension as functions of s: pb for positions, pv for velocities.
_EXTENSION = """
    pb  | (2106 - s*(5244 - s*(6386 - s*(3819 - 900*s))))/4212
        | 0
        | s*(18*(81356461 + 25954829*R) + s*(22190560391 - 1109665151*R - s*(6*(4929647204 - 156109769*R) - 1800*s*(5860823 - 152228*R))))/22529243880
        | s*(18*(81356461 - 25954829*R) + s*(22190560391 + 1109665151*R - s*(6*(4929647204 + 156109769*R) - 1800*s*(5860823 + 152228*R))))/22529243880
        | 200*s*(195 - s*(620 - s*(651 - 225*s)))/17901
        | -s*(1 - s)*(234 - s*(523 - 300*s))/220
    pv  | (4212 - s*(15732 - s*(25544 - s*(19095 - 5400*s))))/4212
        | 0
        | s*(27*(81356461 + 25954829*R) + s*(2*(22190560391 - 1109665151*R) - s*(15*(4929647204 - 156109769*R) - 5400*s*(5860823 - 152228*R))))/11264621940
        | s*(27*(81356461 - 25954829*R) + s*(2*(22190560391 + 1109665151*R) - s*(15*(4929647204 + 156109769*R) - 5400*s*(5860823 + 152228*R))))/11264621940
        | 1000*s*(117 - s*(496 - s*(651 - 270*s)))/17901
        | -s*(702 - s*(3028 - s*(4115 - 1800*s)))/220
"""

_STAGES = ("", "2", "3", "4", "5", "1")  # suffixes of a and r: the last stage is the first of the next step


def _read_weight_rows(text: str) -> dict[str, Weights]:
    """Read ``name | weight | weight`` rows; a row without a name continues the one above."""
    rows: dict[str, list[str]] = {}
    for line in text.replace("R", "sqrt(8581)").splitlines():
        name, *weights = (cell.strip() for cell in line.split("|"))
        if weights:
            rows.setdefault(name or list(rows)[-1], []).extend(weights)
    return {name: tuple(weights) for name, weights in rows.items()}


def _stage_sum(weights: Weights, slope: str) -> str:
    """``329/4212*a + 200/17901*a5``."""
    return weighted_sum(weights, [slope + stage for stage in _STAGES[: len(weights)]])


def _weight_difference(weight: str, embedded: str) -> str:
    """Write one weight minus another, unevaluated and so exact."""
    if embedded == "0":
        return weight
    minus = f"-{embedded}".removeprefix("--") if embedded.startswith("-") else f"-{embedded}"
    return minus if weight == "0" else f"({weight} - {embedded})".replace("- -", "+ ")


def _update_lines(rows: dict[str, Weights]) -> str:
    """Write the update: the positions of the stages, then both weighted sums."""
    lines = []
    for number, c in zip("2345", rows["c"][1:], strict=False):
        lines += [
            f"q{number} = q + {c}*h*v + h**2*({_stage_sum(rows['a' + number], 'a')})",
            f"a{number}, r{number} = f(t + {c}*h, q{number}, v, x)",
        ]
    lines += [
        f"q1 = q + h*v + h**2*({_stage_sum(rows['b'], 'a')})",
        "a1, r1 = f(t1, q1, v, x)",
        f"v1 = v + h*({_stage_sum(rows['db'], 'a')})",
        f"x1 = x + h*({_stage_sum(rows['db'], 'r')})",
    ]
    return "\n".join(lines)


def _estimate_lines(rows: dict[str, Weights]) -> str:
    """Write the difference from the embedded formula."""
    position = tuple(map(_weight_difference, rows["b"], rows["b^"]))
    velocity = tuple(map(_weight_difference, rows["db"], rows["db^"]))
    return f"qe = h**2*({_stage_sum(position, 'a')})\nve = h*({_stage_sum(velocity, 'a')})\nxe = h*({_stage_sum(velocity, 'r')})"


def _extension_lines(rows: dict[str, Weights]) -> str:
    """Write the continuous extension."""
    return (
        f"qs = q + s*h*v + (s*h)**2*({_stage_sum(rows['pb'], 'a')})\n"
        f"vs = v + s*h*({_stage_sum(rows['pv'], 'a')})\n"
        f"xs = x + s*h*({_stage_sum(rows['pv'], 'r')})"
    )


DPRKN6 = Method(
    name="dprkn6",
    synonyms=("RKN6(4)6FD", "Dormand-Prince Runge-Kutta-Nystroem 6(4) triple"),
    order=6,
    symplectic=False,
    evaluations=5,
    update=_update_lines(_read_weight_rows(_ROWS)),
    words=(
        "forces at four positions inside the step, each from those before, the position with their weighted sum, the"
        " force there, the velocity with the weighted sum of all"
    ),
    reference=(
        'Dormand, Prince 1987, "Runge-Kutta-Nystrom triples", Comput. Math. Appl. 13, 937,'
        " doi:10.1016/0898-1221(87)90066-6"
    ),
    refuses=(
        Trait.CONSTRAINTS,
        Trait.VELOCITY_DEPENDENT,
        Trait.COUPLED_MASS,
        Trait.COUPLED_STATES,
        Trait.NO_COORDINATES,
        Trait.PRESSED,
        Trait.HELD_LINKS,
    ),
    estimate=_estimate_lines(_read_weight_rows(_ROWS)),
    estimate_order=4,
    interpolant=Interpolant(
        _extension_lines(_read_weight_rows(_EXTENSION)),
        "the triple's own, without further evaluations: degree 6 in the coordinates, 5 in velocities and states",
        order=5,
    ),
)

METHODS = (DPRKN6,)
