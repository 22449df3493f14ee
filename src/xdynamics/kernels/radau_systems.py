"""The linear systems of Radau IIA written out for lanes: `march.implicit.transformed`, line by line."""

from __future__ import annotations

from xdynamics.kernels import elimination
from xdynamics.kernels.elimination import Columns, Entry
from xdynamics.kernels.formulas import Formulas
from xdynamics.kernels.program import H, Location, Operand, Program
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
    h = f.load(Location("at", H))
    f.write("gamma = g/h\nalpha = a/h\nbeta = b/h\nsquare = alpha*alpha + beta*beta", g=GAMMA, a=ALPHA, b=BETA, h=h)
    real, both = _diagonal(memory, f.known["gamma"]), _diagonal(memory, f.known["alpha"], f.known["beta"])
    for k, (row, column) in enumerate(memory.layout.couplings):
        slope, j = f.load(memory.vector_location("slopes", k)), column if column < n else column - n
        (m,), (re, im) = real[j][row], both[j][row]
        if column < n:
            real[j][row] = (f.formula("m - slope/gamma", m=m, slope=slope),)
            re = f.formula("m - slope*(alpha/square)", m=re, slope=slope)
            both[j][row] = re, f.formula("m + slope*(beta/square)", m=im, slope=slope)
        else:
            real[j][row] = (f.formula("m - slope", m=m, slope=slope),)
            both[j][row] = f.formula("m - slope", m=re, slope=slope), im
    (pivots, real_sound), (complex_pivots, complex_sound) = (
        elimination.factorise_columns(f, real),
        elimination.factorise_columns(f, both),
    )
    f.write("sound = where(one > 0, other, 0)", one=real_sound, other=complex_sound)
    planes = [[entry[part] for column in m for entry in column] for m, part in ((real, 0), (both, 0), (both, 1))]
    for k, value in enumerate([*planes[0], *planes[1], *planes[2], *pivots, *complex_pivots]):
        location = memory.vector_location("matrix", k)
        f.store(location, f.formula("where(unfactored > 0, new, old)", new=value, old=f.load(location)))
    memory.update_numbers(f, _FACTORISED, h=h)
    return Program(FACTORISE, "The factors of both matrices for the step.", tuple(f.lines))


def _diagonal(memory: RadauMemory, *parts: Operand) -> Columns:
    """Return a matrix that has a number on its diagonal."""
    zero = (0.0,) * len(parts)
    return [[parts if i == j else zero for i in range(memory.size)] for j in range(memory.size)]


def solve_real_lanes(f: Formulas, memory: RadauMemory, vector: list[Operand]) -> list[Operand]:
    """Solve (gamma/h - J) d = r: `transformed.solve_real_system`."""
    n, gamma, (matrix, pivots) = memory.n, f.formula("g/factored", g=GAMMA), _load_factors(f, memory, 0)
    right = vector[n:]
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope = f.load(memory.vector_location("slopes", k))
            right[row] = f.formula("r + slope*(v/gamma)", r=right[row], slope=slope, v=vector[column], gamma=gamma)
    entries: list[Entry] = [(number,) for number in right]
    elimination.substitute_columns(f, matrix, pivots, entries)
    right = [number for number, *_ in entries]
    return [f.formula("(v + w)/gamma", v=vector[i], w=right[i], gamma=gamma) for i in range(n)] + right


def solve_complex_lanes(
    f: Formulas, memory: RadauMemory, first: list[Operand], second: list[Operand]
) -> tuple[list[Operand], list[Operand]]:
    """Solve ((alpha + i beta)/h - J) d = r: `transformed.solve_complex_system`."""
    n, (matrix, pivots) = memory.n, _load_factors(f, memory, 1, 2)
    f.write(_OF_FACTORS, a=ALPHA, b=BETA)
    x, y = f.formula("alpha_f/square_f"), f.formula("-beta_f/square_f")
    u = [f.formula("u*x - v*y", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    v = [f.formula("u*y + v*x", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    right: list[Entry] = list(zip(first[n:], second[n:], strict=True))
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope, (re, im) = f.load(memory.vector_location("slopes", k)), right[row]
            added = (f.formula("r + slope*d", r=r, slope=slope, d=d) for r, d in ((re, u[column]), (im, v[column])))
            right[row] = next(added), next(added)
    elimination.substitute_columns(f, matrix, pivots, right)
    for i in range(n):
        re, im = right[i]
        operands = {"u": re, "v": im, "x": x, "y": y}
        u[i], v[i] = f.formula("d + (u*x - v*y)", d=u[i], **operands), f.formula("d + (u*y + v*x)", d=v[i], **operands)
    return u + [re for re, _ in right], v + [im for _, im in right]


def _load_factors(f: Formulas, memory: RadauMemory, *planes: int) -> tuple[Columns, list[Operand]]:
    """Read the factors of a matrix, whose parts are in these planes, and its row exchanges."""
    size, square = memory.size, memory.size * memory.size
    parts = [[f.load(memory.vector_location("matrix", p * square + k)) for k in range(square)] for p in planes]
    entries = list(zip(*parts, strict=True))
    first = 3 * square + size * (len(planes) - 1)
    pivots = [f.load(memory.vector_location("matrix", first + k)) for k in range(size)]
    return [entries[j * size : (j + 1) * size] for j in range(size)], pivots
