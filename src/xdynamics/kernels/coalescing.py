"""Copies of vectors that machine code need not make: a vector stands where its copy goes, if nothing tells the difference.

The lines of a method give every vector a name of its own, and the last of them copy some to the new state. As text that is
what a reader wants; for large models a step is as fast as its numbers come from memory, and half of them were copies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from xdynamics.kernels.array_effects import LineEffect, Part, Spans, effects_of, line_effect_of, part_root, spans_of
from xdynamics.kernels.program import Instruction, Loop, Program

Link = tuple[str, int, str, int, int]  # two arrays with the first elements of parts alike, and how many there are


def coalesce_copies(program: Program, callees: Mapping[str, Program], lengths: Mapping[str, int]) -> Program:
    """Return a program with fewer copies and the same results.

    Parameters
    ----------
    program : Program
    callees : mapping of str to Program
        Those that it may call.
    lengths : mapping of str to int
        Of given arrays that results go to, and of `y`. None of them overlap.
    """
    effects = effects_of(program.body, callees, {})
    if effects is None or program.spread:
        return program
    current, sizes = program, {**lengths, **program.local}
    for effect in effects:
        if not effect.copies:
            continue
        spans = spans_of(current, sizes)
        (source, first), (target, begin) = (part_root(part, spans) for part in (*effect.reads, *effect.writes))
        if source not in current.local or target not in sizes or target in (source, "y"):
            continue
        distance, size = begin - first, current.local[source]
        if distance < 0 or distance + size > sizes[target]:
            continue
        # lines that know neither of the two find what they found
        pair = {name: sizes[name] for name in (source, target)}
        parts = [
            (number, line)
            for number, line in enumerate(effects)
            if any(part[0] in spans and spans[part[0]][0] in pair for part in (*line.reads, *line.writes))
        ]
        candidate, link = _merge_array(current, source, target, distance), (source, 0, target, distance, size)
        seen = [
            _contents_read(
                parts, {name: span for name, span in spans_of(version, sizes).items() if span[0] in pair}, pair, link
            )
            for version in (current, candidate)
        ]
        if seen[0] == seen[1]:
            current = candidate
    spans = spans_of(current, sizes)
    body = tuple(line for line in current.body if not _is_idle(line, spans))
    return replace(current, body=body)


def _merge_array(program: Program, source: str, target: str, distance: int) -> Program:
    """Let a local array be a part of another one."""
    views = {
        name: (target, first + distance, count) if array == source else (array, first, count)
        for name, (array, first, count) in program.views.items()
    }
    views[source] = (target, distance, program.local[source])
    return replace(program, views=views, local={name: n for name, n in program.local.items() if name != source})


def _is_idle(line: Instruction, spans: Spans) -> bool:
    """Whether a line copies a vector to where it stands."""
    effect = line_effect_of(line, {}) if isinstance(line, Loop) else None
    return (
        effect is not None and effect.copies and part_root(effect.reads[0], spans) == part_root(effect.writes[0], spans)
    )


# ------------------------------------------------------------------------------------------ what its lines find there


def _contents_read(
    effects: Sequence[tuple[int, LineEffect]], spans: Spans, sizes: Mapping[str, int], link: Link
) -> list[Any]:
    """Return what every line finds in the arrays that it reads, by the line that wrote it, and what is left in the end.

    Two programs of the same lines that find the same everywhere compute the same, wherever their arrays stand. A line
    that reads where it writes by another name is noted, too: its passes may not be made in any order.
    """
    cuts = _cuts(effects, spans, sizes, link)
    contents: dict[tuple[str, int], Any] = {}
    values_found: list[Any] = []

    def atoms(part: Part) -> list[tuple[str, int, int]]:
        """Return array, first element, and the same from the beginning of the part's name, piece by piece."""
        if part[0] not in spans:
            return []
        array, first = spans[part[0]]
        low, high = (0, sizes[array]) if part[1] < 0 else (first + part[1], first + part[2])
        return [(array, cut, cut - first) for cut in cuts[array][:-1] if low <= cut < high]

    for number, effect in effects:
        read = [(array, cut) for part in effect.reads for array, cut, _ in atoms(part)]
        values = [contents.get(atom, atom) for atom in read]
        values_found.append(values)
        written_values: list[tuple[tuple[str, int], Any]] = [
            (atom[:2], (number, part[0], atom[2])) for part in effect.writes for atom in atoms(part)
        ]
        crossing = _overlapping_names(effect, atoms)
        if crossing:
            values_found.append(crossing)
        if effect.copies and len(written_values) == len(values):
            written_values = [(atom, value) for (atom, _), value in zip(written_values, values, strict=True)]
        elif not effect.is_complete:
            written_values = [(atom, (value, contents.get(atom, atom))) for atom, value in written_values]
        contents.update(written_values)
    results = [name for name in sizes if spans.get(name) == (name, 0) and name in ("z", "e")]
    return [
        values_found,
        [(cut, contents.get((name, cut), (name, cut))) for name in results for cut in cuts[name][:-1]],
    ]


def _overlapping_names(effect: LineEffect, atoms: Any) -> list[tuple[str, str]]:
    """Return pairs of names by which a line reads, or writes twice, and writes the same elements."""
    places = [(part[0], {atom[:2] for atom in atoms(part)}) for part in effect.writes]
    read_names = [(part[0], {atom[:2] for atom in atoms(part)}) for part in effect.reads]
    return [
        (name, second_name)
        for i, (name, elements) in enumerate(places)
        for second_name, second_elements in (*read_names, *places[:i])
        if elements & second_elements and not (effect.copies and elements == second_elements)
    ]


def _cuts(
    effects: Sequence[tuple[int, LineEffect]], spans: Spans, sizes: Mapping[str, int], link: Link
) -> dict[str, list[int]]:
    """Return the elements at which parts of arrays begin or end, those of copies wherever their originals have one.

    `link` is of two arrays that may become one.
    """
    cuts: dict[str, set[int]] = {name: {0, size} for name, size in sizes.items()}
    links = [link]
    for _, effect in effects:
        known_parts = [part for part in (*effect.reads, *effect.writes) if part[0] in spans]
        for name, low, high in known_parts:
            if low >= 0:
                array, first = spans[name]
                cuts[array] |= {first + low, first + high}
        if effect.copies and len(known_parts) == 2:
            (source, begin), (target, end) = (part_root(part, spans) for part in known_parts)
            links.append((source, begin, target, end, known_parts[0][2] - known_parts[0][1]))
    changed = True
    while changed:
        changed = False
        for source, begin, target, end, count in links:
            for first_array, first, second_array, second in (
                (source, begin, target, end),
                (target, end, source, begin),
            ):
                new = {cut - first + second for cut in cuts[first_array] if first <= cut <= first + count} - cuts[
                    second_array
                ]
                cuts[second_array] |= new
                changed |= bool(new)
    return {name: sorted(array_cuts) for name, array_cuts in cuts.items()}
