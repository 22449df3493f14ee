"""The arrays of assemblies in a run: what each link reads, its patterns, and room for links that meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.kernels import Law, law_of
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.interval_program import VARIABLE, enclosing
from xdynamics.march.assembly.banded_factors import CHANGE, MOST_CHANGES, ORDERS, WIDEST
from xdynamics.march.assembly.broad_phase import GROUP, ROWS, SLOTS, TALLIES
from xdynamics.march.assembly.closed_links import PATHS, VECTORS
from xdynamics.march.assembly.impact import MOST_LEMKE
from xdynamics.march.assembly.pivoting import MOST_UNKNOWNS
from xdynamics.march.assembly.touching import NUMBERS
from xdynamics.march.root_methods import EARLIEST_FIRST, ON_HERMITE
from xdynamics.march.run import ASSEMBLY, Run
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, Leaf, assemblies, slots_of, together
from xdynamics.model.motion import constants
from xdynamics.model.parts import IMPACT_LAWS, Contact
from xdynamics.units import TIME

Whole = NDArray[np.int64]
Pose = Callable[[Model, Settings, Law], Run]

CANDIDATES_EACH, FEWEST_CANDIDATES = 8, 4096  # room for candidates, for each coordinate
_NOTHING: dict[str, NDArray[Any]] = {  # of a march without assemblies: no element to write to
    "assemblies": np.zeros(0, ASSEMBLY),
    "leafs": np.zeros((0, 5), np.int64),
    "handed": np.zeros((0, 3), np.int64),
    "candidates": np.zeros((0, 5), np.int64),
    "touching": np.zeros((0, NUMBERS)),
    "reads": np.zeros((0, 0), np.int64),
    "held": np.zeros((0, 4), np.int64),
    "ordering": np.zeros((0, 0), np.int64),
    **{
        name: np.zeros(0, np.int64)
        for name in (
            "members",
            "slots",
            "patterns",
            "renewed",
            "grouped",
            "close",
            "meets",
            "closed",
            "lifted",
            "grips",
            "chains",
        )
    },
    **{name: np.zeros(0) for name in ("greatest", "loads", "pulls", "remains", "shares", "swing")},
    **{name: np.zeros((2, 0)) for name in ("boxes", "hulls")},
    **{
        name: np.zeros((0, 0)) for name in ("normals", "replies", "vectors", "paths", "margins", "stiffened", "changes")
    },
}


def assembled(model: Model, settings: Settings, law: Law, pose: Pose) -> tuple[dict[str, NDArray[Any]], list[Run]]:
    """Return the arrays of all assemblies, and the runs of their patterns, which have to live as long.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
        Of the model.
    pose : callable
        Makes the run of a pattern.

    Raises
    ------
    InputError
        If the model cannot have contacts of many links.
    """
    every, layout = assemblies(model), law.layout
    if not every:
        return _NOTHING | {"tallies": np.zeros(TALLIES, np.int64), "spans": np.zeros(16)}, []
    _check(law, settings)
    # links are looked for between states, whatever polynomial a step leaves
    bare = replace(settings, tolerances=None, nodes=(), event_root_method=ON_HERMITE)
    patterns = [_posed(own, bare, pose) for assembly in every for own in assembly.pattern]
    rows, leafs, members = _arranged([_AssemblyTables(assembly, law, settings) for assembly in every])
    n, most, widest = layout.coordinates.size, together(model), max(row.coordinates for row in rows)
    slots, width = slots_of(model, layout.coordinates)
    rows_each, tallies = (
        2 if any(assembly.contact.slip is not None for assembly in every) else 1,
        np.zeros(TALLIES, np.int64),
    )
    tallies[SLOTS], tallies[ROWS] = width, rows_each
    room = min(sum(node.links for node in every), max(FEWEST_CANDIDATES, CANDIDATES_EACH * n))
    arrays: dict[str, NDArray[Any]] = {
        "assemblies": rows,
        "leafs": leafs,
        "members": members,
        "slots": slots,
        "handed": np.array(_handed(every, model, settings), np.int64).reshape(-1, 3),
        "patterns": np.array(_addresses(patterns), np.int64),
        "tallies": tallies,
        "spans": np.zeros(16),
        "boxes": np.zeros((4, n)),
        "renewed": np.zeros(n, np.int64),
        "hulls": np.zeros((2, sum(row.groups * row.leaves for row in rows))),
        "grouped": np.zeros(sum(row.elements for row in rows), np.int64),
        "candidates": np.zeros((room, 5), np.int64),
        **{name: np.zeros(room, np.int64) for name in ("close", "meets")},
        "touching": np.zeros((most, NUMBERS)),
        "normals": np.zeros((2 * rows_each * most, widest)),
        "replies": np.zeros((2 * rows_each * most, widest)),
        "reads": np.zeros((2 * rows_each * most, widest), np.int64),
        "closed": np.zeros(1 + most, np.int64),
        "greatest": np.zeros(1 + len(every)),
        "held": np.zeros((most, 4), np.int64),
        **{name: np.zeros(most) for name in ("loads", "pulls", "remains")},
        "grips": np.zeros(most if rows_each == 2 else 0, np.int64),
        "lifted": np.zeros(most, np.int64),
        "margins": np.full((5, 2 * most), -np.inf),
        "vectors": np.zeros((VECTORS, 2 * rows_each * most)),
        "paths": np.zeros((2 * PATHS, 4 * most) if rows_each == 2 else (0, 0)),
        "shares": np.zeros(2 * most if rows_each == 2 else 0),
        "swing": np.zeros(n),
        "chains": np.zeros(n + 2 * most * widest if rows_each == 2 else 0, np.int64),
        **_systems(n, most, rows_each, not law.scheme.method.stepper.locates),
    }
    return arrays, patterns


def _systems(n: int, most: int, rows_each: int, steps: bool) -> dict[str, NDArray[Any]]:
    """Return room for systems of links; where these have friction and are stepped over, for a band of n coordinates too."""
    unknowns = MOST_LEMKE if rows_each == 1 else max(MOST_LEMKE, min(4 * most, MOST_UNKNOWNS))
    band = n if steps and rows_each == 2 else 0
    return _problem(unknowns) | {
        "solution": np.zeros(max(band, unknowns)),
        "stiffened": np.zeros((band, max(0, 2 * min(band, WIDEST) - 1))),
        "changes": np.zeros((MOST_CHANGES, CHANGE + band)),
        "ordering": np.zeros((ORDERS, band), np.int64),
    }


def _problem(unknowns: int) -> dict[str, NDArray[Any]]:
    """Return room for a complementarity problem."""
    shape = (unknowns, 2 * unknowns + 2)
    return {
        "problem": np.zeros(shape),
        "basis": np.zeros(3 * unknowns + 1, np.int64),
        "solution": np.zeros(unknowns),
    }


def _check(law: Law, settings: Settings) -> None:
    """Refuse what contacts of many links do not go with."""
    if settings.apart:
        raise InputError(f"contacts of many links are located together; event_root_method = '{EARLIEST_FIRST}' does so")
    if any(detector.drive or detector.at_zero for detector in law.layout.switches):
        raise InputError("contacts of many links and switches hidden in forces cannot be combined; smooth the switches")


def _arranged(parts: Sequence[_AssemblyTables]) -> tuple[NDArray[Any], Whole, Whole]:
    """Return the row of each assembly, with where its numbers begin, the leafs and the members of all."""
    rows, leafs, members = np.zeros(len(parts), ASSEMBLY), list[tuple[int, ...]](), list[Whole]()
    first_order, first_hull, first_link = 0, 0, 0
    for row, part in zip(rows, parts, strict=True):
        row.first_leaf, row.first_order, row.first_hull = len(leafs), first_order, first_hull
        row.first_link = first_link
        for name, value in part.numbers.items():
            setattr(row, name, value)
        leafs += part.leafs(sum(len(places) for places in members))
        members += part.members
        first_order, first_hull = first_order + row.elements, first_hull + row.groups * row.leaves
        first_link += row.links
    return rows, np.array(leafs, np.int64).reshape(-1, 5), np.concatenate([*members, np.zeros(0, np.int64)])


class _AssemblyTables:
    """One assembly as numbers."""

    def __init__(self, assembly: Assembly, law: Law, settings: Settings) -> None:
        self._assembly, self._law, self._settings = assembly, law, settings
        self._families = [_family(leaf) if assembly.paired else 0 for leaf in assembly.leaves]
        layout = settings.layout(assembly.pattern[0])
        rows = enclosing(layout).rows.tolist()
        own = {place: (target, k) for k, (row, target, place, *_) in enumerate(rows) if row == VARIABLE}
        self._targets = [own.get(k, (-1, -1)) for k in range(len(assembly.leaves))]
        first = next(k for k, (target, _) in enumerate(self._targets) if target >= 0)
        size = assembly.model.shapes.extent(assembly.relation.source).size if assembly.relation else 0
        elements = size if assembly.paired else 0
        watched = [detector.name for detector in law.layout.watched]
        read = assembly.model.reads(assembly.contact.gap)
        self.numbers: dict[str, Any] = {
            "tolerance": settings.located_within(assembly.contact.time_tolerance) / settings.scales.of(TIME),
            "rest_height": _height(assembly.contact, settings),
            "links": assembly.links,
            "elements": elements,
            "paired": int(assembly.paired),
            "rubs": int(assembly.contact.slip is not None),
            "leaves": len(assembly.leaves),
            "coordinates": assembly.coordinates,
            "row_leaf": first,
            "row": self._targets[first][1],
            "detector": watched.index(assembly.name),
            "law": IMPACT_LAWS.index(assembly.contact.law),
            "timed": int("t" in read),
            "groups": -(-elements // GROUP),
        }
        if assembly.paired and "t" in read:
            raise InputError(
                f"contact '{assembly.name}' over every two elements depends on t, and may depend on positions and parameters only"
            )

    @property
    def members(self) -> list[Whole]:
        """The place of each leaf for every link, or element."""
        assembly, layout = self._assembly, self._law.layout
        of_constant = {name: i for i, name in enumerate(constants(assembly.model, self._settings.scales))}
        tables = []
        links = np.arange(assembly.links)
        elements = np.arange(self.numbers["elements"])
        for k, leaf in enumerate(assembly.leaves):
            if assembly.paired:
                numbers = assembly.elements(leaf, elements, elements, {})
            else:
                numbers = assembly.elements(leaf, *assembly.ends(links), assembly.numbers(links))
            start = assembly.model.shapes.first(leaf.quantity)
            place = layout.coordinates.index(start) if k < assembly.coordinates else of_constant[start]
            tables.append(place + numbers)
        return tables

    def leafs(self, first: int) -> list[tuple[int, int, int, int, int]]:
        """Return the rows of its leaves, whose members begin at a place."""
        rows = []
        for k, leaf in enumerate(self._assembly.leaves):
            moves, end = int(k < self._assembly.coordinates), int(leaf.end == SECOND)
            rows.append((first, self._families[k], moves, self._targets[k][0], end))
            first += self.numbers["elements"] if self._assembly.paired else self._assembly.links
        return rows


def _height(contact: Contact, settings: Settings) -> float:
    """Return how low bounces are that may be skipped; negative where that follows the highest one."""
    height = contact.rest_height
    return -1.0 if height is None else height.si / settings.scales.of(height.unit.dimension)


def _family(leaf: Leaf) -> int:
    return 2 if leaf.end == SECOND else 1


def _posed(model: Model, settings: Settings, pose: Pose) -> Run:
    law = law_of(settings.layout(model), sampled=False)
    run = pose(model, settings, law)
    run.holds = (law,)  # its code lives as long as the run
    return run


def _addresses(patterns: Sequence[Run]) -> list[int]:
    return keys_of(patterns) if PLAINLY else [run.address for run in patterns]


def _handed(every: Sequence[Assembly], model: Model, settings: Settings) -> list[tuple[int, int, int]]:
    """List the parameters of patterns: the pattern, their place there, their place in the run."""
    places = {name: i for i, name in enumerate(constants(model, settings.scales))}
    return [
        (2 * c + j, i, places[name])
        for c, assembly in enumerate(every)
        for j, own in enumerate(assembly.pattern)
        for i, name in enumerate(constants(own, settings.scales))
        if name in places
    ]
