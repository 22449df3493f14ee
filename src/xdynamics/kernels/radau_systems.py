"""The linear systems of Radau IIA written out for lanes: `march.implicit.transformed`, line by line."""

from __future__ import annotations

from xdynamics.kernels import elimination
from xdynamics.kernels.elimination import Columns, Entry
from xdynamics.kernels.formulas import Formulas
from xdynamics.kernels.program import H, Operand, Place, Program
from xdynamics.kernels.radau_memory import RadauMemory
from xdynamics.methods.radau import ALPHA, BETA, GAMMA

FACTORISE = "factorise"
_OF_FACTORS = """
alpha_f = a/factored
beta_f = b/factored
square_f = alpha_f*alpha_f + beta_f*beta_f
"""
_FACTORISED = {
    "factored": "where(unfactored > 0, where(sound > 0, h, 0), factored)",
    "factorisations": "factorisations + unfactored*sound",
    "open": "where(unfactored > 0, open*sound, open)",
    "vain": "where(unfactored > 0, where(sound > 0, vain, 1), vain)",
}


def factorisation(memory: RadauMemory) -> Program:
    """Assemble both matrices and factorise them: `transformed.factorise_both`."""
    f, n = memory.formulas("_"), memory.n
    h = f.load(Place("at", H))
    f.write("gamma = g/h\nalpha = a/h\nbeta = b/h\nsquare = alpha*alpha + beta*beta", g=GAMMA, a=ALPHA, b=BETA, h=h)
    real, both = _diagonal(memory, f.known["gamma"]), _diagonal(memory, f.known["alpha"], f.known["beta"])
    for k, (row, column) in enumerate(memory.layout.couplings):
        slope, j = f.load(memory.place("slopes", k)), column if column < n else column - n
        (m,), (re, im) = real[j][row], both[j][row]
        if column < n:
            real[j][row] = (f.of("m - slope/gamma", m=m, slope=slope),)
            re = f.of("m - slope*(alpha/square)", m=re, slope=slope)
            both[j][row] = re, f.of("m + slope*(beta/square)", m=im, slope=slope)
        else:
            real[j][row] = (f.of("m - slope", m=m, slope=slope),)
            both[j][row] = f.of("m - slope", m=re, slope=slope), im
    (pivots, one), (others, other) = elimination.factorise(f, real), elimination.factorise(f, both)
    f.write("sound = where(one > 0, other, 0)", one=one, other=other)
    planes = [[entry[part] for column in m for entry in column] for m, part in ((real, 0), (both, 0), (both, 1))]
    for k, value in enumerate([*planes[0], *planes[1], *planes[2], *pivots, *others]):
        place = memory.place("matrix", k)
        f.store(place, f.of("where(unfactored > 0, new, old)", new=value, old=f.load(place)))
    memory.update(f, _FACTORISED, h=h)
    return Program(FACTORISE, "The factors of both matrices for the step.", tuple(f.lines))


def _diagonal(memory: RadauMemory, *parts: Operand) -> Columns:
    """Return a matrix that has a number on its diagonal."""
    zero = (0.0,) * len(parts)
    return [[parts if i == j else zero for i in range(memory.size)] for j in range(memory.size)]


def solve_real(f: Formulas, memory: RadauMemory, vector: list[Operand]) -> list[Operand]:
    """Solve (gamma/h - J) d = r: `transformed.solve_real`."""
    n, gamma, (matrix, pivots) = memory.n, f.of("g/factored", g=GAMMA), _factors(f, memory, 0)
    right = vector[n:]
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope = f.load(memory.place("slopes", k))
            right[row] = f.of("r + slope*(v/gamma)", r=right[row], slope=slope, v=vector[column], gamma=gamma)
    entries: list[Entry] = [(number,) for number in right]
    elimination.substitute(f, matrix, pivots, entries)
    right = [number for number, *_ in entries]
    return [f.of("(v + w)/gamma", v=vector[i], w=right[i], gamma=gamma) for i in range(n)] + right


def solve_complex(
    f: Formulas, memory: RadauMemory, first: list[Operand], second: list[Operand]
) -> tuple[list[Operand], list[Operand]]:
    """Solve ((alpha + i beta)/h - J) d = r: `transformed.solve_complex`."""
    n, (matrix, pivots) = memory.n, _factors(f, memory, 1, 2)
    f.write(_OF_FACTORS, a=ALPHA, b=BETA)
    x, y = f.of("alpha_f/square_f"), f.of("-beta_f/square_f")
    u = [f.of("u*x - v*y", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    v = [f.of("u*y + v*x", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    right: list[Entry] = list(zip(first[n:], second[n:], strict=True))
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope, (re, im) = f.load(memory.place("slopes", k)), right[row]
            added = (f.of("r + slope*d", r=r, slope=slope, d=d) for r, d in ((re, u[column]), (im, v[column])))
            right[row] = next(added), next(added)
    elimination.substitute(f, matrix, pivots, right)
    for i in range(n):
        re, im = right[i]
        operands = {"u": re, "v": im, "x": x, "y": y}
        u[i], v[i] = f.of("d + (u*x - v*y)", d=u[i], **operands), f.of("d + (u*y + v*x)", d=v[i], **operands)
    return u + [re for re, _ in right], v + [im for _, im in right]


def _factors(f: Formulas, memory: RadauMemory, *planes: int) -> tuple[Columns, list[Operand]]:
    """Read the factors of a matrix, whose parts are in these planes, and its row exchanges."""
    size, square = memory.size, memory.size * memory.size
    parts = [[f.load(memory.place("matrix", p * square + k)) for k in range(square)] for p in planes]
    entries = list(zip(*parts, strict=True))
    first = 3 * square + size * (len(planes) - 1)
    pivots = [f.load(memory.place("matrix", first + k)) for k in range(size)]
    return [entries[j * size : (j + 1) * size] for j in range(size)], pivots
