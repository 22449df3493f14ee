"""What a step of Radau IIA keeps in a lane, and the lines that read and write it."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping

from xdynamics.kernels import radau_lines
from xdynamics.kernels.formulas import Formulas
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import Location, Operand
from xdynamics.kernels.step_polynomial import curve_size

# Further numbers of a lane: those of `march.run.KEPT`; iterations of its last step, and counts since it was entered;
# of the current trial whether its iteration is open or failed, how many corrections it had, and whether its
# derivatives, its factors and its estimate have to be computed.
Lasting = namedtuple(
    "Lasting",
    "factored theta eta before norm_before linearised fresh since turns iterations evaluations jacobians factorisations",
)
LASTING, PLACES = Lasting._fields, Lasting(*range(len(Lasting._fields)))
KEPT = (*LASTING, "open", "vain", "turn", "eta_tried", "change", "ratio", "missing", "unfactored", "again")


class RadauMemory:
    """Where a lane keeps the numbers and vectors of its step.

    Parameters
    ----------
    layout : Layout
    places : mapping of str to Place
        Where a lane keeps its other numbers.
    first : int
        Where in `w` this memory begins.
    """

    def __init__(self, layout: Layout, places: dict[str, Location], first: int) -> None:
        self.layout = layout
        self.used, self.n = layout.used.size, layout.coordinates.size
        self.size = self.used - self.n
        self.places = places | {name: Location("w", first + i) for i, name in enumerate(KEPT)}
        self._first: dict[str, int] = {}
        first += len(KEPT)
        for name, length in lengths(layout).items():
            self._first[name] = first
            first += length

    def formulas(self, prefix: str, operands: Mapping[str, Operand] | None = None) -> Formulas:
        """Begin lines whose names are those of the lane, of constants, or known."""
        return Formulas(self.places, prefix, {**radau_lines.CONSTANTS, **(operands or {})})

    def vector_location(self, name: str, i: int) -> Location:
        """Return the place of an element of a vector."""
        return Location("w", self._first[name] + i)

    def load_vectors(self, f: Formulas, name: str) -> list[list[Operand]]:
        """Read three vectors, stored one after the other."""
        return [[f.load(self.vector_location(name, k * self.used + i)) for i in range(self.used)] for k in range(3)]

    def store_vectors(self, f: Formulas, name: str, vectors: list[list[Operand]]) -> None:
        """Write three vectors."""
        for k, vector in enumerate(vectors):
            for i, value in enumerate(vector):
                f.store(self.vector_location(name, k * self.used + i), value)

    def update_numbers(self, f: Formulas, updates: Mapping[str, str], **operands: Operand) -> None:
        """Write numbers of the lane, each from what it had before."""
        values = {name: f.formula(text, **operands) for name, text in updates.items()}
        for name, value in values.items():
            f.store(self.places[name], value)


def lengths(layout: Layout) -> dict[str, int]:
    """Return the length of each part of a lane's memory after `KEPT`; row exchanges follow the matrices."""
    used, size = layout.used.size, layout.used.size - layout.coordinates.size
    matrix = 3 * size * size + 2 * size
    lasting = {
        "slopes": len(layout.couplings),
        "stages": 3 * used,
        "past": 3 * used,
        "matrix": matrix,
        "turned": 3 * used,
    }
    curve = curve_size(layout)
    return lasting | {"reached": 3 * used if curve else 0, "curve": curve}


def memory_width(layout: Layout) -> int:
    """Return the length of that memory in all."""
    return len(KEPT) + sum(lengths(layout).values())
