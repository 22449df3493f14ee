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
from xdynamics.kernels.interval_program import VARIABLE, enclosing_rows
from xdynamics.march.assembly.banded_factors import BY_T, CHANGE, ORDERS, WIDEST
from xdynamics.march.assembly.broad_phase import GROUP, ROWS, SLOTS, TALLIES
from xdynamics.march.assembly.closed_links import PATHS, VECTORS
from xdynamics.march.assembly.impact import MOST_LEMKE, NUMBERS
from xdynamics.march.assembly.lemke_path import MOST_UNKNOWNS
from xdynamics.march.run import ASSEMBLY, Run
from xdynamics.march.settings import EARLIEST_FIRST, ON_HERMITE, Settings
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, PatternInput, assemblies, max_simultaneous, slots_of
from xdynamics.model.motion import constants
from xdynamics.model.parts import IMPACT_LAWS, Contact
from xdynamics.units import TIME

IntArray = NDArray[np.int64]
Pose = Callable[[Model, Settings, Law], Run]

CANDIDATES_EACH, FEWEST_CANDIDATES = 8, 4096  # room for candidates, for each coordinate
_NOTHING: dict[str, NDArray[Any]] = {  # of a march without assemblies: no element to write to
    "assemblies": np.zeros(0, ASSEMBLY),
    "pattern_inputs": np.zeros((0, 5), np.int64),
    "handed": np.zeros((0, 3), np.int64),
    "candidates": np.zeros((0, 5), np.int64),
    "touching": np.zeros((0, NUMBERS)),
    "coordinate_indices": np.zeros((0, 0), np.int64),
    "closed_link_ends": np.zeros((0, 4), np.int64),
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
        name: np.zeros((0, 0))
        for name in ("normals", "unit_responses", "vectors", "paths", "release_functions", "stiffened", "changes")
    },
}


def arrays_of_assemblies(
    model: Model, settings: Settings, law: Law, pose: Pose
) -> tuple[dict[str, NDArray[Any]], list[Run]]:
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
    all_assemblies, layout = assemblies(model), law.layout
    if not all_assemblies:
        return _NOTHING | {"counters": np.zeros(TALLIES, np.int64), "spans": np.zeros(16)}, []
    _check_assembly_settings(law, settings)
    # links are looked for between states, whatever polynomial a step leaves
    bare = replace(settings, tolerances=None, nodes=(), event_root_method=ON_HERMITE)
    patterns = [_pattern_run(single, bare, pose) for assembly in all_assemblies for single in assembly.pattern]
    tables = [_AssemblyTables(assembly, law, settings) for assembly in all_assemblies]
    rows, pattern_inputs, members = _concatenate_tables(tables)
    n, max_touching, widest = layout.coordinates.size, max_simultaneous(model), max(row.coordinates for row in rows)
    slots, width = slots_of(model, layout.coordinates)
    rows_each = 2 if any(assembly.contact.slip is not None for assembly in all_assemblies) else 1
    counters = np.zeros(TALLIES, np.int64)
    counters[SLOTS], counters[ROWS] = width, rows_each
    room = min(sum(node.links for node in all_assemblies), max(FEWEST_CANDIDATES, CANDIDATES_EACH * n))
    arrays: dict[str, NDArray[Any]] = {
        "assemblies": rows,
        "pattern_inputs": pattern_inputs,
        "members": members,
        "slots": slots,
        "handed": np.array(_pattern_parameters(all_assemblies, model, settings), np.int64).reshape(-1, 3),
        "patterns": np.array(_pattern_addresses(patterns), np.int64),
        "counters": counters,
        "spans": np.zeros(16),
        "boxes": np.zeros((4, n)),
        "renewed": np.zeros(n, np.int64),
        "hulls": np.zeros((2, sum(row.groups * row.leaves for row in rows))),
        "grouped": np.zeros(sum(row.elements for row in rows), np.int64),
        "candidates": np.zeros((room, 5), np.int64),
        **{name: np.zeros(room, np.int64) for name in ("close", "meets")},
        "touching": np.zeros((max_touching, NUMBERS)),
        # twice the rows: links that touch have the first half, closed ones the second, see `closed_links`
        "normals": np.zeros((2 * rows_each * max_touching, widest)),
        "unit_responses": np.zeros((2 * rows_each * max_touching, widest)),
        "coordinate_indices": np.zeros((2 * rows_each * max_touching, widest), np.int64),
        "closed": np.zeros(1 + max_touching, np.int64),
        "greatest": np.zeros(1 + len(all_assemblies)),
        "closed_link_ends": np.zeros((max_touching, 4), np.int64),
        **{name: np.zeros(max_touching) for name in ("loads", "pulls", "remains")},
        "grips": np.zeros(max_touching if rows_each == 2 else 0, np.int64),
        "lifted": np.zeros(max_touching, np.int64),
        "release_functions": np.full((5, 2 * max_touching), -np.inf),
        "vectors": np.zeros((VECTORS, 2 * rows_each * max_touching)),
        "paths": np.zeros((2 * PATHS, 4 * max_touching) if rows_each == 2 else (0, 0)),
        "shares": np.zeros(2 * max_touching if rows_each == 2 else 0),
        "swing": np.zeros(n),
        "chains": np.zeros(n + 2 * max_touching * widest if rows_each == 2 else 0, np.int64),
        **_system_arrays(n, max_touching, rows_each, not law.scheme.method.stepper.locates),
    }
    return arrays, patterns


def _system_arrays(n: int, max_touching: int, rows_each: int, steps: bool) -> dict[str, NDArray[Any]]:
    """Return room for systems of links; where these have friction and are stepped over, for a band of n coordinates too."""
    unknowns = MOST_LEMKE if rows_each == 1 else max(MOST_LEMKE, min(4 * max_touching, MOST_UNKNOWNS))
    band = n if steps and rows_each == 2 else 0
    return _problem_arrays(unknowns) | {
        "solution": np.zeros(max(band, unknowns)),
        "stiffened": np.zeros((band, max(0, 2 * min(band, WIDEST) - 1))),
        "changes": np.zeros((BY_T + 1, CHANGE + band)),
        "ordering": np.zeros((ORDERS, band), np.int64),
    }


def _problem_arrays(unknowns: int) -> dict[str, NDArray[Any]]:
    """Return room for a complementarity problem."""
    shape = (unknowns, 2 * unknowns + 2)
    return {"problem": np.zeros(shape), "basis": np.zeros(3 * unknowns + 1, np.int64), "solution": np.zeros(unknowns)}


def _check_assembly_settings(law: Law, settings: Settings) -> None:
    """Refuse settings that contacts of many links do not allow."""
    if settings.locates_one_by_one:
        raise InputError(f"contacts of many links are located together; event_root_method = '{EARLIEST_FIRST}' does so")
    if any(detector.drive or detector.at_zero for detector in law.layout.switches):
        raise InputError("contacts of many links and switches hidden in forces cannot be combined; smooth the switches")


def _concatenate_tables(parts: Sequence[_AssemblyTables]) -> tuple[NDArray[Any], IntArray, IntArray]:
    """Return the row of each assembly, with where its numbers begin, the leafs and the members of all."""
    rows, pattern_inputs, members = np.zeros(len(parts), ASSEMBLY), list[tuple[int, ...]](), list[IntArray]()
    first_order, first_hull, first_link = 0, 0, 0
    for row, part in zip(rows, parts, strict=True):
        row.first_leaf, row.first_order, row.first_hull = len(pattern_inputs), first_order, first_hull
        row.first_link = first_link
        for name, value in part.numbers.items():
            setattr(row, name, value)
        pattern_inputs += part.pattern_input_rows(sum(len(places) for places in members))
        members += part.members
        first_order, first_hull = first_order + row.elements, first_hull + row.groups * row.leaves
        first_link += row.links
    return rows, np.array(pattern_inputs, np.int64).reshape(-1, 5), np.concatenate([*members, np.zeros(0, np.int64)])


class _AssemblyTables:
    """The arrays by which compiled code knows one contact of many links: columns, families, pattern inputs, tolerances."""

    def __init__(self, assembly: Assembly, law: Law, settings: Settings) -> None:
        self._assembly, self._law, self._settings = assembly, law, settings
        self._families = [_family(leaf) if assembly.paired else 0 for leaf in assembly.pattern_inputs]
        layout = settings.layout(assembly.pattern[0])
        rows = enclosing_rows(layout).rows.tolist()
        variable_targets = {
            leaf_index: (target, k) for k, (row, target, leaf_index, *_) in enumerate(rows) if row == VARIABLE
        }
        self._targets = [variable_targets.get(k, (-1, -1)) for k in range(len(assembly.pattern_inputs))]
        first = next(k for k, (target, _) in enumerate(self._targets) if target >= 0)
        size = assembly.model.shapes.extent(assembly.relation.source).size if assembly.relation else 0
        elements = size if assembly.paired else 0
        watched = [detector.name for detector in law.layout.watched]
        read = assembly.model.elements.reads(assembly.contact.gap)
        self.numbers: dict[str, Any] = {
            "tolerance": settings.located_within(assembly.contact.time_tolerance) / settings.scales.si_factor(TIME),
            "rest_height": _rest_height(assembly.contact, settings),
            "links": assembly.links,
            "elements": elements,
            "paired": int(assembly.paired),
            "rubs": int(assembly.contact.slip is not None),
            "leaves": len(assembly.pattern_inputs),
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
    def members(self) -> list[IntArray]:
        """The index of each leaf for every link, or element."""
        assembly, layout = self._assembly, self._law.layout
        of_constant = {name: i for i, name in enumerate(constants(assembly.model, self._settings.scales))}
        tables = []
        links = np.arange(assembly.links)
        elements = np.arange(self.numbers["elements"])
        for k, leaf in enumerate(assembly.pattern_inputs):
            if assembly.paired:
                numbers = assembly.elements(leaf, elements, elements, {})
            else:
                numbers = assembly.elements(leaf, *assembly.ends(links), assembly.numbers(links))
            start = assembly.model.shapes.first(leaf.quantity)
            first_index = layout.coordinates.index(start) if k < assembly.coordinates else of_constant[start]
            tables.append(first_index + numbers)
        return tables

    def pattern_input_rows(self, first: int) -> list[tuple[int, int, int, int, int]]:
        """Return the rows of the assembly's leaves, whose members begin at an index."""
        rows = []
        for k, leaf in enumerate(self._assembly.pattern_inputs):
            moves, end = int(k < self._assembly.coordinates), int(leaf.end == SECOND)
            rows.append((first, self._families[k], moves, self._targets[k][0], end))
            first += self.numbers["elements"] if self._assembly.paired else self._assembly.links
        return rows


def _rest_height(contact: Contact, settings: Settings) -> float:
    """Return how low bounces are that may be skipped; negative where that follows the highest one."""
    height = contact.rest_height
    return -1.0 if height is None else height.si / settings.scales.si_factor(height.unit.dimension)


def _family(leaf: PatternInput) -> int:
    return 2 if leaf.end == SECOND else 1


def _pattern_run(model: Model, settings: Settings, pose: Pose) -> Run:
    law = law_of(settings.layout(model), sampled=False)
    run = pose(model, settings, law)
    run.keepalive = (law,)  # its code lives as long as the run
    return run


def _pattern_addresses(patterns: Sequence[Run]) -> list[int]:
    return keys_of(patterns) if PLAINLY else [run.address for run in patterns]


def _pattern_parameters(
    all_assemblies: Sequence[Assembly], model: Model, settings: Settings
) -> list[tuple[int, int, int]]:
    """List the parameters of patterns: the pattern, their index there, their index in the run."""
    places = {name: i for i, name in enumerate(constants(model, settings.scales))}
    return [
        (2 * c + j, i, places[name])
        for c, assembly in enumerate(all_assemblies)
        for j, pattern_model in enumerate(assembly.pattern)
        for i, name in enumerate(constants(pattern_model, settings.scales))
        if name in places
    ]
