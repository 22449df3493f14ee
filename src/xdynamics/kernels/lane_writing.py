"""Lines of text in all lanes: their names are numbers of a lane, or values of earlier lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

from xdynamics.kernels import radau_lines, step_control
from xdynamics.kernels.formulas import Formulas, split_assignments
from xdynamics.kernels.lane_numbers import LANE, of_collocation
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import AT, Instruction, Load, Location, Loop, Operand, Reduction, StoreTo, loop_element

STRETCH = 1.01  # of a step that would end just before a node


class LaneWriter:
    """Writes lines of text, whose names are those of a lane or of earlier lines."""

    def __init__(self, layout: Layout, adaptive_atol: tuple[bool, ...], memory: int) -> None:
        self.body: list[Instruction] = []
        self.known: dict[str, Operand] = {
            "stretch": STRETCH,
            "fits": 1.0,
            **step_control.CONSTANTS,
            **radau_lines.CONSTANTS,
        }
        self.layout = layout
        self.adaptive_atol = adaptive_atol
        self._memory = memory
        self._curve = 0  # where in `w` the step's polynomial begins, if it leaves one
        self.places = {name: Location("w", i) for i, name in enumerate(LANE)}
        self._parts = 0

    def lines(self, text: str, **operands: Operand) -> None:
        """Write lines, some of whose names are given."""
        write = self.begin_formulas()
        write.write(text, **operands)
        self.body += write.lines

    def keep(self, text: str) -> None:
        """Write lines whose values go to the lane; each line sees what the lane had before."""
        write = self.begin_formulas()
        stores = [
            StoreTo(self.places[target], write.formula(expression)) for target, expression in split_assignments(text)
        ]
        self.body += [*write.lines, *stores]

    def component(self, text: str, places: dict[str, Location], **operands: Operand) -> Formulas:
        """Write lines for one component of vectors, named by where they begin."""
        component_operands = {name: value for name, value in self.known.items() if name not in places}
        write = Formulas(self.places | places, "_", component_operands | operands)
        write.write(text)
        return write

    def write_components(
        self, count: int, text: str, places: dict[str, Location], name: str, **operands: Operand
    ) -> None:
        """Write lines for every component of vectors; store what they compute for one of them."""
        write = self.component(text, places, **operands)
        write.store(places[name], write.known[name])
        self.body.append(Loop("i", count, tuple(write.lines)))

    def greatest_values(
        self,
        starts: Sequence[Operand],
        count: int,
        text: str,
        places: dict[str, Location],
        names: Sequence[str],
        **operands: Operand,
    ) -> Sequence[str]:
        """Write lines for every component of vectors; return the greatest values of names in them, or earlier ones."""
        write = self.component(text, places, **operands)
        self._parts += 1
        totals = tuple(f"greatest{self._parts}_{k}" for k in range(len(names)))
        terms = tuple(write.known[name] for name in names)
        self.body.append(Reduction("i", count, tuple(write.lines), terms, totals, "greatest", tuple(starts)))
        return totals

    def begin_formulas(self) -> Formulas:
        """Begin the next lines, with names of their own."""
        self._parts += 1
        return Formulas(self.places, f"_{self._parts}_", self.known)

    def compute(self, name: str, operation: str, argument: str) -> None:
        """Name the result of an operation that has no word in texts."""
        write = self.begin_formulas()
        self.known[name] = write.compute(operation, self.known[argument])
        self.body += write.lines

    def power(self, name: str, base: str, exponent: int) -> None:
        """Name a power."""
        write = self.begin_formulas()
        self.known[name] = write.power(self.known[base], Fraction(exponent))
        self.body += write.lines

    def load(self, name: str, location: Location) -> None:
        """Read a number that was written since it was last read."""
        # no underscore: printed Python writes names with one where they are used, after other lines
        self.known[name] = name
        self.body.append(Load(name, location))

    def store(self, array: str, values: dict[str, str]) -> None:
        """Write numbers to an array laid out as `at`."""
        write = self.begin_formulas()
        stores = [StoreTo(Location(array, AT.index(name)), write.operand_of(value)) for name, value in values.items()]
        self.body += [*write.lines, *stores]

    def slope_index(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is."""
        n, used = self.layout.coordinates.size, self.layout.used.size
        return n + i if i < n else used + i - n

    def pieces(self) -> list[tuple[int, int, int, bool]]:
        """Return neighbours of one kind: begin, end, kind, whether their tolerances follow; all as one if none do."""
        used = self.layout.used.size
        if not any(self.adaptive_atol):
            return [(0, used, 0, False)]
        traits = list(zip(self.layout.kinds.tolist(), self.adaptive_atol, strict=True))
        cuts = [i for i in range(used) if i == 0 or traits[i] != traits[i - 1]]
        return [(begin, end, *traits[begin]) for begin, end in pairwise([*cuts, used])]

    def tops(self, vector: Location) -> dict[int, Operand]:
        """Find the largest absolute value of each kind: `march.tolerance_sizes.tops_of`."""
        tops: dict[int, Operand] = {}
        for begin, end, kind, _ in self.pieces():
            places = {"value": loop_element(vector.array, vector.offset + begin)}
            (tops[kind],) = self.greatest_values(
                [tops.get(kind, 0.0)], end - begin, "size = abs(value)", places, ["size"]
            )
        return tops

    def norms(self, orders: Mapping[str, int]) -> None:
        """Find the largest ratios of a state, its slopes and coefficients of some orders to what is allowed as errors."""
        tops = self.tops(Location("y")) if any(self.adaptive_atol) else {}
        first, used, n = of_collocation(self.layout), self.layout.used.size, self.layout.coordinates.size
        names = ("size", "slope", *orders)
        totals: Sequence[Operand] = [0.0] * len(names)
        for start, stop, kind, follows in self.pieces():
            for begin, end in pairwise(sorted({start, min(max(n, start), stop), stop})):  # slopes stand in two parts
                places = {f"term_{name}": loop_element("w", first + k * used + begin) for name, k in orders.items()}
                places |= {"value": loop_element("y", begin), "slope": loop_element("y", self.slope_index(begin))}
                places |= {"term_size": places["value"], "term_slope": places["slope"]}
                places["atol" if follows else "allowed"] = loop_element("w", len(LANE) + begin)
                text = "\n".join([*([step_control.ALLOWED] if follows else []), step_control.WEIGHT])
                text += "".join(f"\n{step_control.TERM.format(name)}" for name in names)
                norm_names = [f"norm_{name}" for name in names]
                totals = self.greatest_values(totals, end - begin, text, places, norm_names, top=tops.get(kind, 0.0))
        self.known |= {f"norm_{name}": total for name, total in zip(names, totals, strict=True)}
