"""Writes the tables of the elementary functions, from mpmath: python tests/elementary_tables.py > …/elementary/tables.py."""

from __future__ import annotations

from collections.abc import Callable

from mpmath import atan, floor, log, lu_solve, matrix, mp, mpf, nint, pi

mp.prec = 1400  # 2/pi is kept to 1232 bits
LIMB, PADDING, LIMBS = 28, 3, 44


def two_parts(x: mpf, kept: int = 53) -> tuple[float, float]:
    """Return a number to `kept` bits after the binary point or in all, and what is left, as doubles."""
    high = float(nint(x * 2**kept) / mpf(2) ** kept) if kept < 53 else float(x)
    return high, float(x - mpf(high))


def tables() -> dict[str, list[float] | list[int]]:
    """Return every table."""
    roots = [two_parts(mpf(2) ** (mpf(j) / 128)) for j in range(128)]
    centers = [1.0 + i / 128 for i in range(129)]
    inverse = [float(nint(512 / mpf(c)) / 512) for c in centers]  # of nine bits
    offsets = [float(mpf(c) * mpf(one) - 1) for c, one in zip(centers, inverse, strict=True)]
    logs = [two_parts(-log(mpf(c)), kept=42) for c in inverse]
    arcs = [two_parts(atan(mpf(j) / 16)) for j in range(17)]
    digits = int(floor(2 / pi * mpf(2) ** (LIMB * LIMBS)))
    limbs = [(digits >> (LIMB * (LIMBS - 1 - i))) & ((1 << LIMB) - 1) for i in range(LIMBS)]
    return {
        "root": [one for one, _ in roots],
        "root_tail": [float(mpf(two) / mpf(one)) for one, two in roots],
        "center": centers,
        "inverse": inverse,
        "offset": offsets,
        "log": [one for one, _ in logs],
        "log_tail": [two for _, two in logs],
        "arc": [one for one, _ in arcs],
        "arc_tail": [two for _, two in arcs],
        "two_over_pi": [0] * PADDING + limbs,
    }


def fitted(
    function: Callable[[mpf], mpf], degree: int, end: mpf, weight: Callable[[mpf], mpf]
) -> tuple[list[float], float]:
    """Fit a polynomial in u on [0, end] at Chebyshev's points; return it and its largest error over the weight."""
    from mpmath import cos

    nodes = [end / 2 * (1 - cos(pi * (2 * i + 1) / (2 * degree + 2))) for i in range(degree + 1)]
    rows = matrix([[(node / end) ** k for k in range(degree + 1)] for node in nodes])
    found = lu_solve(rows, matrix([function(node) for node in nodes]))
    powers = [float(found[k] / end**k) for k in range(degree + 1)]
    tries = [end * i / 500 for i in range(1, 501)]
    worst = max(abs(sum(mpf(c) * u**k for k, c in enumerate(powers)) - function(u)) / weight(u) for u in tries)
    return powers, float(worst)


def main() -> None:
    """Print the module."""
    print('"""Tables of the elementary functions, written by tests/elementary_tables.py."""\n')
    print("from __future__ import annotations\n")
    print("_NUMBERS = {")
    found = tables()
    for name, table in found.items():
        if isinstance(table[0], float):
            print(f'    "{name}": """')
            words = [one.hex() for one in table]
            for i in range(0, len(words), 4):
                print("        " + " ".join(words[i : i + 4]))
            print('    """,')
    print("}")
    print("_LIMBS = {")
    for name, table in found.items():
        if isinstance(table[0], int):
            print(f'    "{name}": """')
            words = [f"{one:07x}" for one in table]
            for i in range(0, len(words), 12):
                print("        " + " ".join(words[i : i + 12]))
            print('    """,')
    print("}")
    print("TABLES: dict[str, tuple[float, ...] | tuple[int, ...]] = {")
    print("    **{name: tuple(map(float.fromhex, text.split())) for name, text in _NUMBERS.items()},")
    print("    **{name: tuple(int(one, 16) for one in text.split()) for name, text in _LIMBS.items()},")
    print("}")


if __name__ == "__main__":
    main()
