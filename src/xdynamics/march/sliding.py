"""Marches along switches and between regimes: along which the motion slides, by whose forces it goes on, when it leaves.

At an event at which a force drives the motion back, or at which the forces along a switch change, the march waits. From
the rates of the functions of all switches that it stands on, by the forces of either side, follows how it goes on: each
is left to a side into which it moves, or slid along with a share between 0 and 1. Exactly one way has to be right.
Events between two regimes are such switches, whose sides are the regimes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.kernels.program import REGIME
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import Log
from xdynamics.march.outcomes import COMPLETED, RUNNING
from xdynamics.march.run import AFTER_EVENT, CHANGING, ENDS_THERE, Run
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states
from xdynamics.model.regime_model import RegimeModel, watched_by
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.sliding import MOST_AT_ONCE, Surface, arm_rates, sliding_model, surfaces
from xdynamics.model.switches import switch_side
from xdynamics.schema import SLIDE, SLIDES, share_of
from xdynamics.units import TIME, Scales


class Marching(Protocol):
    """What of a `March` is needed here."""

    law: Law
    settings: Settings
    layout: Layout

    @property
    def run(self) -> Run:
        """Return its state."""

    def empty_log(self) -> Log:
        """Return a log of no row."""


Floats = NDArray[np.float64]

NEAR = 1e-9  # of the span of a march: how long the motion would take to a switch that it counts as standing on
SLIDING = 0  # beside the sides -1 and 1
OF_MEMBERS = (
    "first_step",
    "step_size",
    "rtol",
    "floor",
)  # numbers of a plan that members of an ensemble have their own of
ADDS_UP = 1e-9  # of the sizes of rates: by which those of several sides may differ from a sum
_UNCERTAIN = 1e-12  # of the sizes of rates: below it one says nothing


class Sliding:
    """What a march slides along, and the runs by the forces there.

    Parameters
    ----------
    march : Marching
    """

    def __init__(self, march: Marching) -> None:
        self.march, self.along = march, tuple[Surface, ...]()
        self.fault = ""  # why no motion goes on along switches, once one ended there
        self._runs: dict[tuple[Surface, ...], tuple[Run, Law]] = {}

    def go_on(self) -> None:
        """Decide how the march that waits at an event goes on, and let it.

        Its run is another one where it slides along other switches than before.
        """
        run = self.march.run
        candidates = self._candidates()
        ways = [*self._ways(candidates)] if len(candidates) <= MOST_AT_ONCE else []
        stands = candidates or self.along
        if len(ways) != 1 or not stands or not self._adds_up(tuple(candidates)):
            self.fault = _fault(candidates, len(ways)) if candidates else ""
            run.now["status"], run.plan["resumes"] = RUNNING, ENDS_THERE
            return
        (way,) = ways
        self._note(way)
        for surface, side in way.items():
            self._take_side(surface, side)
        self.enter(tuple(surface for surface, side in way.items() if side == SLIDING))
        run = self.march.run
        run.plan["resumes"] = AFTER_EVENT
        run.now["status"] = RUNNING if run.now["t"][0] < run.plan["end"][0] else COMPLETED

    def _candidates(self) -> list[Surface]:
        """Return the surfaces that the motion stands on, of which one that has the switches of another stands for both."""
        found = [surface for surface in surfaces(self._model) if self._is_slid_on(surface) or self._is_met(surface)]
        watched = {surface: {i for i, _ in surface.detectors(self._model)} for surface in found}
        return [surface for surface in found if not any(watched[surface] < of_other for of_other in watched.values())]

    def recall(self, modes: Floats, regime: int) -> None:
        """March on along the switches that a march of these modes and this regime slid along."""
        self.enter(tuple(surface for surface in surfaces(self._model) if self._is_slid_along(surface, modes, regime)))

    def _is_slid_along(self, surface: Surface, modes: Floats, regime: int) -> bool:
        if surface.regimes:
            return surface.number == regime
        first, _ = surface.detectors(self._model)[0]
        return bool(modes[self.march.run.detectors[first]["to"]] == SLIDES)

    def _take_side(self, surface: Surface, side: int) -> None:
        """Set forces to one side of a switch, or to sliding along it."""
        run, watches = self.march.run, self.march.run.watches
        leaves = surface in self.along and side != SLIDING
        if surface.regimes:
            run.now["regime"] = surface.number if side == SLIDING else surface.regimes[(1 + side) // 2]
        for i, factor in surface.detectors(self._model):
            is_switch = self.march.layout.watched[i].is_switch
            watches["guard"][i] = side * factor if is_switch or leaves else 0  # an event is to be armed on this side
            if is_switch:
                run.modes[run.detectors[i]["to"]] = side * factor if side != SLIDING else SLIDES

    def enter(self, along: tuple[Surface, ...]) -> None:
        """March on with the forces along some switches, or away from all."""
        if along == self.along:
            return
        left, self._runs[self.along] = self.march.run, (self.march.run, self.march.law)
        entered, _ = self._runs.get(along) or self._made(along)
        for name in (*CHANGING, "p", "atol"):
            source, target = getattr(left, name), getattr(entered, name)
            if source.shape == target.shape:
                target[...] = source
        entered.at[REGIME] = left.now["regime"][0]
        for name in OF_MEMBERS:
            entered.plan[name] = left.plan[name]
        entered.put(base=left.base, **{name: getattr(left, name) for name in vars(left) if name.startswith("log_")})
        self.along = along
        vars(self.march)["run"] = entered

    def _made(self, along: tuple[Surface, ...]) -> tuple[Run, Law]:
        march = self.march
        model = sliding_model(self._model, along)
        law = law_of(march.settings.layout(model), sampled=march.settings.samples, unread=march.law.unread)
        return pose_run(model, march.settings, law, march.empty_log(), addresses_of(law)), law

    @property
    def _model(self) -> RegimeModel:
        model = self.march.layout.model
        assert isinstance(model, RegimeModel)  # noqa: S101 - others have no switches
        return model

    def _is_slid_on(self, surface: Surface) -> bool:
        """Whether the motion slid along a switch, and no event has led to a regime elsewhere."""
        between = surface.regimes is None or int(self.march.run.now["regime"][0]) in (surface.number, *surface.regimes)
        return surface in self.along and between

    def _is_met(self, surface: Surface) -> bool:
        """Whether its function has an event here and, where forces act on the rate of this alone, the rate is zero, too."""
        hits = self.march.run.watches["hit"]
        own_detectors = surface.detectors(self._model)[: len(surface.events) + len(surface.switches)]
        met = any(hits[i] for i, _ in own_detectors)
        if not met or surface.rate is None:
            return met
        rates, matrix, values = self._rates((surface,))
        return bool(abs(values[0]) <= self._soon * _sizes(rates, matrix)[0])

    @property
    def _soon(self) -> float:
        """The time within which the motion would come to a switch that it counts as standing on."""
        return NEAR * float(self.march.run.plan[0]["end"] - self.march.run.plan[0]["start"])

    def _ways(self, candidates: Sequence[Surface]) -> Iterator[dict[Surface, int]]:
        """Yield the ways in which the motion may go on: the side of each switch, or 0 where it slides."""
        if not candidates:
            yield {}
            return
        along = tuple(candidates)
        rates, matrix, values = self._rates(along)
        sizes = _sizes(rates, matrix)
        fixed = {k: self._left_side(surface) for k, surface in enumerate(along) if self._is_left(surface)}
        for k, value in enumerate(values):
            # an event has set the state elsewhere
            if along[k] in self.along and abs(value) > self._soon * sizes[k]:
                fixed[k] = 1 if value > 0.0 else -1
        for sides in product((-1, SLIDING, 1), repeat=len(along)):
            if any(sides[k] != side for k, side in fixed.items()):
                continue
            shares = np.array([(1.0 + side) / 2.0 for side in sides])
            slid = [k for k, side in enumerate(sides) if side == SLIDING]
            if slid:
                block = matrix[np.ix_(slid, slid)]
                shares[slid] = 0.0
                known = rates + matrix @ shares
                # sizes are nan where a rate is not known
                if not (sizes[slid] > 0.0).all() or abs(np.linalg.det(block / sizes[slid, None])) <= _UNCERTAIN:
                    continue
                shares[slid] = np.linalg.solve(block, -known[slid])
            going = rates + matrix @ shares
            if all(
                (0.0 <= shares[k] <= 1.0 and matrix[k, k] < 0.0)
                if side == SLIDING
                else k in fixed or side * going[k] > _UNCERTAIN * sizes[k]
                for k, side in enumerate(sides)
            ):
                yield dict(zip(along, sides, strict=True))

    def _is_left(self, surface: Surface) -> bool:
        """Whether the share of a switch that the motion slid along has come to one of its bounds."""
        first, _ = surface.detectors(self._model)[0]
        return surface in self.along and bool(self.march.run.watches["hit"][first])

    def _left_side(self, surface: Surface) -> int:
        place = self.march.layout.row.offset_of(share_of(surface.name))
        run = self.march.run
        row = int(run.now["rows"][0] - run.base["rows"][0]) - 1
        return 1 if run.log_rows[place, row] > 0.5 else -1

    def _rates(self, along: tuple[Surface, ...]) -> tuple[Floats, Floats, Floats]:
        """Return the rates of sliding variables with all sides negative, what each positive side adds, and their values."""
        model, n = self._model, len(along)
        trees = [*arm_rates(model, along, ())]
        for surface in along:
            trees += arm_rates(model, along, (surface,))
        values = self._values([*trees, *(surface.sliding_variable for surface in along)])
        rates, beyond, functions = np.split(values, [n, n + n * n])
        return rates, (beyond.reshape(n, n) - rates).T, functions

    def _adds_up(self, candidates: tuple[Surface, ...]) -> bool:
        """Whether what several switches change adds up: of a product of two, shares do not follow from rates alone."""
        several = [positive for n in range(2, len(candidates) + 1) for positive in combinations(candidates, n)]
        if not several:
            return True
        rates, matrix, _ = self._rates(candidates)
        sizes = _sizes(rates, matrix)
        together = self._values([tree for positive in several for tree in arm_rates(self._model, candidates, positive)])
        sums = [rates + matrix @ [float(surface in positive) for surface in candidates] for positive in several]
        return bool((np.abs(together.reshape(len(several), -1) - sums) <= ADDS_UP * sizes).all())

    def _values(self, trees: Sequence[Node]) -> Floats:
        """Return the values of expressions where the march waits, in SI units."""
        march, run = self.march, self.march.run
        row = np.concatenate([run.now["t"], [0.0], run.y[: march.layout.used.size]])[:, np.newaxis]
        return np.concatenate(values_in_rows(self._model, march.layout, march.settings.scales, run, trees, row))

    def _note(self, way: Mapping[Surface, int]) -> None:
        """Write into the rows of the events at this instant what they are: the begin of sliding."""
        run = self.march.run
        last = int(run.now["events"][0] - run.base["events"][0]) - 1
        members = {
            i: side
            for surface, side in way.items()
            for i, _ in surface.detectors(self._model)
            if surface not in self.along
        }
        row = run.log_events["row_before"][last] if last >= 0 else -1
        while last >= 0 and run.log_events["row_before"][last] == row:
            if members.get(int(run.log_events["detector"][last])) == SLIDING:
                run.log_events["kind"][last] = SLIDE
            last -= 1


def values_in_rows(
    model: Model, layout: Layout, scales: Scales, run: Run, trees: Sequence[Node], rows: Floats
) -> list[Floats]:
    """Return values of expressions in rows of time, step and state, SI, with the run's own parameters and sides of switches."""
    state: dict[str, Any] = {"t": rows[0] * scales.si_factor(TIME), REGIME_NUMBER: float(run.now["regime"][0])}
    sizes = layout.sizes(scales).tolist()
    state |= {name: row * size for name, row, size in zip(layout.used, rows[2:], sizes, strict=True)}
    known = dict(constants(model))
    run_values = zip(known, run.p.tolist(), strict=False)
    parameters, dimensions = model.elements.statement.parameters, model.elements.dimensions
    known |= {name: value * scales.si_factor(dimensions[name]) for name, value in run_values if name in parameters}
    first = len(layout.watched) - len(layout.switches)
    for i, switch in enumerate(watched_by(model)):
        if not switch.drive:
            known[switch_side(i)] = float(run.modes[run.detectors["to"][first + i]])
    values = evaluate_over_states(model, list(trees), state, known, drive_pieces(model))
    return [np.broadcast_to(np.asarray(numbers, float), rows.shape[1]) for numbers in values]


def _sizes(rates: Floats, matrix: Floats) -> Floats:
    """Return the sizes of rates, by which they count as zero."""
    sizes: Floats = np.abs(rates) + np.abs(matrix).sum(axis=1)
    return sizes


def _fault(candidates: Sequence[Surface], ways: int) -> str:
    names = " and ".join(f"'{surface.name}'" for surface in candidates)
    if len(candidates) > MOST_AT_ONCE:
        return f"the motion meets {len(candidates)} switches at once, {names}, and {MOST_AT_ONCE} are as many as it slides along"
    if not ways:
        return f"at the switch {names} no motion goes on, along it or to a side"
    if ways == 1:
        return f"at the switches {names} forces jump by a product of both, and Filippov's combination is not one alone"
    return f"at the switch {names} {ways} motions go on, along it or to a side: forces do not decide which"
