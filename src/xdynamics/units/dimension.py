"""Dimensions: powers of the SI base units, and the derived units that are spelled by a name."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

BASE = ("kg", "m", "s", "A", "K", "mol", "cd")


@dataclass(frozen=True)
class Dimension:
    """Powers of the SI base units, in the order of `BASE`; an angle has none."""

    powers: tuple[Fraction, ...] = (Fraction(0),) * len(BASE)

    def __mul__(self, factor: Dimension) -> Dimension:
        return Dimension(tuple(a + b if b else a for a, b in zip(self.powers, factor.powers, strict=True)))

    def __truediv__(self, divisor: Dimension) -> Dimension:
        return Dimension(tuple(a - b if b else a for a, b in zip(self.powers, divisor.powers, strict=True)))

    def __pow__(self, exponent: Fraction | int) -> Dimension:
        return Dimension(tuple(power * exponent for power in self.powers))

    def __str__(self) -> str:
        """In base units, with the derived unit's name where there is one: ``kg m s-2 (N)``."""
        parts = [
            base + ("" if power == 1 else str(power)) for base, power in zip(BASE, self.powers, strict=True) if power
        ]
        name = DERIVED.get(self)
        return (" ".join(parts) or "1") + (f" ({name})" if name else "")


NONE = Dimension()


def base_powers(**powers: int) -> Dimension:
    """Return the dimension with these powers of base units: ``base_powers(m=1, s=-2)``."""
    return Dimension(tuple(Fraction(powers.get(base, 0)) for base in BASE))


TIME = base_powers(s=1)
ENERGY = base_powers(kg=1, m=2, s=-2)
COHERENT = {
    **{base: base_powers(**{base: 1}) for base in BASE}, "rad": NONE, "N": base_powers(kg=1, m=1, s=-2), "J": ENERGY,
    "W": base_powers(kg=1, m=2, s=-3), "Pa": base_powers(kg=1, m=-1, s=-2), "Hz": base_powers(s=-1), "C": base_powers(A=1, s=1),
    "V": base_powers(kg=1, m=2, s=-3, A=-1), "ohm": base_powers(kg=1, m=2, s=-3, A=-2), "F": base_powers(kg=-1, m=-2, s=4, A=2),
    "T": base_powers(kg=1, s=-2, A=-1),
}  # fmt: skip
DERIVED: dict[Dimension, str] = {COHERENT[name]: name for name in ("N", "J", "W", "Pa", "C", "V")}
