"""The layout of a march's arrays: the index of each number in the state, a force evaluation, a row of the log.

The polynomial that a step leaves, for the search for events or for delayed values, has its degree and its room here
too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from xdynamics import reaction_names, schema
from xdynamics.expressions import Node, Number, free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.methods.scheme import DOUBLE_DOUBLE, Scheme
from xdynamics.methods.steppers import DIFFERENCES
from xdynamics.model import Model, linearisation
from xdynamics.model.body_sections import unit_quaternions
from xdynamics.model.constraints import conditions
from xdynamics.model.controllers import TickChange, tick_changes
from xdynamics.model.detectors import Detector, detectors
from xdynamics.model.elementwise import Lazy, own_mass
from xdynamics.model.joints import joint_reactions
from xdynamics.model.motion import energies, forces_by_coordinate, has_diagonal_mass
from xdynamics.model.reactions import NORMAL, reactions
from xdynamics.model.sliding import SlidingModel, surfaces
from xdynamics.model.switches import Switch, smooth_switches
from xdynamics.reaction_names import PROJECTION, RANK
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import at_element
from xdynamics.shapes.blocks import Blocks
from xdynamics.units import Dimension, Scales

Floats = NDArray[np.float64]
REGIME_FLAG = 1  # in a row of the log, after the kind
NO_SHARE = -1.0  # in a row of the log, whose numbers are finite


@lru_cache(maxsize=64)
def layout_of(model: Model, scheme: Scheme | None = None) -> Layout:
    """Return the layout of a model and a scheme, made once."""
    return Layout(model, scheme)


@dataclass(frozen=True)
class Layout:
    """The order of names in the arrays of a march.

    A state is one array: coordinates, velocities, first-order states, then what the force evaluation at that state
    gave: accelerations, rates, force components, drives. It is all that the next step needs.
    """

    model: Model
    scheme: Scheme | None = None

    @property
    def is_doubled(self) -> bool:
        """Whether every number has a rest."""
        return self.scheme is not None and self.scheme.precision == DOUBLE_DOUBLE

    @property
    def estimates(self) -> bool:
        """Whether a step comes with an estimate of its local error."""
        return self.scheme is not None and self.scheme.estimates

    @cached_property
    def coordinates(self) -> Blocks:
        """Generalised coordinates q in the order of the model, in its SI units over the scales."""
        return self._blocks("coordinate", self.model.statement.coordinates)

    def _blocks(self, role: str, names: Iterable[str]) -> Blocks:
        return Blocks.from_names(role, names, self.model.shapes)

    @cached_property
    def velocities(self) -> Blocks:
        """Their time derivatives, in the same order."""
        return self.coordinates.renamed("velocity", schema.velocity)

    @cached_property
    def states(self) -> Blocks:
        """First-order states x, in the order of the model."""
        return self._blocks("state", self.model.statement.states)

    @cached_property
    def accelerations(self) -> Blocks:
        """Second time derivatives of the coordinates, in the same order."""
        return self.coordinates.renamed("acceleration", schema.acceleration)

    @cached_property
    def rates(self) -> Blocks:
        """Time derivatives of the first-order states, in the same order."""
        return self.states.renamed("rate", schema.rate)

    @cached_property
    def terms(self) -> Mapping[str, Blocks]:
        """The coordinates that every force term acts on."""
        return {term: self._blocks("force", parts) for term, parts in forces_by_coordinate(self.model).items()}

    @cached_property
    def forces(self) -> Blocks:
        """The force components, term by term."""
        renamed = (parts.renamed("force", partial(schema.force, term)) for term, parts in self.terms.items())
        return Blocks(block for parts in renamed for block in parts.blocks)

    @cached_property
    def reactions(self) -> Blocks:
        """The forces of contacts and friction elements."""
        return self._blocks("reaction", (reaction.name for reaction in reactions(self.model)))

    @cached_property
    def constraint_diagnostics(self) -> Blocks:
        """Rank and projection of constraints, where there are any."""
        return Blocks.from_names("constraint", (RANK.name, PROJECTION.name) if self.model.constraints else ())

    @cached_property
    def multipliers(self) -> Blocks:
        """Lagrange multipliers of constraints: forces or torques in the unit of the condition's dual."""
        return self._blocks("multiplier", map(reaction_names.constraint_force, self.model.elements.constraints))

    @cached_property
    def applied_forces(self) -> Blocks:
        """The forces in a record: components, multipliers of constraints, forces of contacts and friction elements."""
        return self.forces + self.multipliers + self.reactions

    @cached_property
    def drives(self) -> Blocks:
        """Values of measured drives, in the order of the model."""
        return self._blocks("drive", self.model.statement.drives)

    @cached_property
    def used(self) -> Blocks:
        """The arguments of a force evaluation besides time: coordinates, velocities, states."""
        return self.coordinates + self.velocities + self.states

    @cached_property
    def kinds(self) -> NDArray[np.int16]:
        """A number for the kind of each used variable: coordinates of one dimension share a kind, and so on."""
        blocks = self.used.blocks
        kinds = [(block.role, self.model.dimensions[block.name]) for block in blocks]
        numbers = {kind: number for number, kind in enumerate(dict.fromkeys(kinds))}
        return np.repeat(np.array([numbers[kind] for kind in kinds], np.int16), [block.size for block in blocks])

    def sizes(self, scales: Scales) -> Floats:
        """Return the size in SI units of 1 in the march of everything that a force evaluation uses besides time."""
        size_array = self._sizes.get(scales)
        if size_array is None:
            blocks = self.used.blocks
            sizes = [float(scales.si_factor(self.model.dimensions[block.name])) for block in blocks]
            size_array = self.used.spread(sizes)
            self._sizes.clear()
            self._sizes[scales] = size_array
        return size_array

    def divide_by_sizes(self, numbers: Floats, scales: Scales) -> None:
        """Divide the numbers of a state in SI units by the sizes of their units, in place."""
        first = 0
        for block in self.used.blocks:
            numbers[first : first + block.size] /= scales.si_factor(self.model.dimensions[block.name])
            first += block.size

    @cached_property
    def _sizes(self) -> dict[Scales, Floats]:  # those of the last scales that were asked for
        return {}

    @cached_property
    def state(self) -> Blocks:
        """The numbers of a state in a row of the log, from which the next step starts."""
        return self.used + self.accelerations + self.rates + self.constraint_diagnostics + self.applied_forces

    @cached_property
    def evaluation(self) -> Blocks:
        """The results of a force evaluation."""
        return self.accelerations + self.rates + self.constraint_diagnostics + self.applied_forces + self.drives

    @cached_property
    def compensation(self) -> Blocks:
        """Names of rounding errors of coordinates, velocities and states, where they are carried along."""
        if self.is_doubled:
            return (self.used + self.evaluation).renamed("rest", "_rest_{}".format)
        carried = self.used if self.scheme and self.scheme.compensated else Blocks(())
        return carried.renamed("carried", "_carried_{}".format)

    @cached_property
    def record(self) -> Blocks:
        """All numbers in a state of the march: the state, its force evaluation, and compensations of rounding."""
        return self.used + self.evaluation + self.compensation

    @cached_property
    def derived(self) -> Mapping[str, Node]:
        """Energies, observables, terms of rates and gaps, computed when a row is logged."""
        observables = {name: partial(self._observed, name) for name in self.model.elements.observables}
        return Lazy(
            {name: partial(self._energy, name) for name in self._energies}
            | observables
            | self._rate_terms_of_elements
            | self.gaps
            | self.constraint_outputs
            | self.shares
        )

    def _observed(self, name: str) -> Node:
        return self.model.elements.expanded(self.model.elements.observables[name])

    @cached_property
    def computed(self) -> Blocks:
        """The blocks of `derived`."""
        observed = self._blocks("derived", (*self._energies, *self.model.statement.observables))
        others = (*self.gaps, *self.constraint_outputs, *self.shares)
        return observed + self.rate_terms + self._blocks("derived", others)

    @cached_property
    def rate_terms(self) -> Blocks:
        """The terms of the rates of first-order states, in the shapes of these."""
        blocks = [
            Blocks((block,)).renamed("derived", partial(schema.rate_term, term))
            for block in self.states.blocks
            for term in self.model.statement.states[block.name].terms
        ]
        return Blocks(part for parts in blocks for part in parts.blocks)

    @property
    def _rate_terms_of_elements(self) -> dict[str, partial[Node]]:
        return {
            schema.rate_term(term, name): partial(self._rate_term, name, term)
            for block in self.states.blocks
            for term in self.model.statement.states[block.name].terms
            for name in block.elements()
        }

    def _rate_term(self, name: str, term: str) -> Node:
        return self.model.elements.expanded(self.model.elements.statement.states[name].acting[term])

    @cached_property
    def gaps(self) -> dict[str, Node]:
        """The gap of each contact."""
        return {
            reaction_names.contact_gap(reaction.owner): reaction.gap
            for reaction in reactions(self.model)
            if reaction.sort == NORMAL
        }

    @cached_property
    def constraint_outputs(self) -> dict[str, Node]:
        """Residuals of positions and rates, which are zero where constraints hold; forces and torques in joints."""
        residuals = {
            reaction_names.constraint_residual(condition.name): condition.residual
            for condition in conditions(self.model)
            if condition.residual != ZERO
        }
        rates = {reaction_names.constraint_rate(condition.name): condition.rate for condition in conditions(self.model)}
        return residuals | rates | joint_reactions(self.model.joints)

    @cached_property
    def shares(self) -> dict[str, Node]:
        """The shares of the switches that the motion may slide along, `NO_SHARE` where it does not."""
        weights = self.model.weights if isinstance(self.model, SlidingModel) else {}
        return {
            schema.share_of(surface.name): weights.get(surface, Number(NO_SHARE)) for surface in surfaces(self.model)
        }

    @cached_property
    def sliding_flags(self) -> dict[str, tuple[int, int]]:
        """The flag of each of `shares` in a row of the log that tells whether the motion slides, and its value there."""
        return {
            schema.share_of(surface.name): (REGIME_FLAG, surface.number)
            if surface.regimes
            else (self._flag_of_switch(surface.switches[0][0]), schema.SLIDES)
            for surface in surfaces(self.model)
        }

    def _flag_of_switch(self, number: int) -> int:
        return 2 + self.reactions.size + sum(3 if switch.drive else 1 for switch in self.switches[:number])

    @cached_property
    def watched(self) -> tuple[Detector, ...]:
        """Everything whose zeros a march looks for."""
        return detectors(self.model)

    @cached_property
    def switches(self) -> tuple[Detector, ...]:
        """Those of `watched` that are switches in forces."""
        return tuple(detector for detector in self.watched if detector.is_switch)

    @cached_property
    def flags(self) -> int:
        """Number of flags in a row of the log: kind, regime, modes of reactions, the side of each switch.

        For the points of a table the side is a piece, which takes three flags.
        """
        return 2 + self.reactions.size + sum(3 if switch.drive else 1 for switch in self.switches)

    @property
    def smooth(self) -> tuple[Switch, ...]:
        """The switches declared smooth: each has a side, a number of passages, and the time of the first."""
        return smooth_switches(self.model)

    @cached_property
    def resets(self) -> tuple[tuple[str, str], ...]:
        """Pairs of an event and a name that it sets."""
        return tuple((name, target) for name, event in self.model.elements.events.items() for target in event.reset)

    @cached_property
    def ticking(self) -> tuple[TickChange, ...]:
        """The changes by controllers' actions, all of one tick from the values just before it."""
        return tick_changes(self.model.elements.controllers)

    @cached_property
    def tracked(self) -> tuple[str, ...]:
        """The drives with located points whose argument is an expression: it is computed beside rates of events."""
        drives = dict.fromkeys(switch.drive for switch in self.watched if switch.drive)
        if not drives:  # names of a million elements would be made in vain
            return ()
        variables = {*self.coordinates, *self.velocities}
        places = self.model.elements.looked_up_at
        return tuple(name for name in drives if getattr(places[name], "name", "") not in variables)

    @cached_property
    def followed(self) -> Blocks:
        """The observables whose time derivatives events need; of those that depend on accelerations they are unknown."""
        if not self.watched:
            return Blocks(())
        model = self.model
        unknown = {*map(schema.acceleration, model.statement.coordinates)}
        trees = {name: model.expanded(tree) for name, tree in model.statement.observables.items()}
        return self._blocks("followed", [name for name, tree in trees.items() if not free_names(tree) & unknown])

    @cached_property
    def row(self) -> Blocks:
        """The float columns of a logged row."""
        return (
            Blocks.from_names("step", ("time", "step_size"))
            + self.state
            + self.computed
            + self.errors
            + self.effort
            + self.deviations
            + self.low_parts
        )

    @property
    def errors(self) -> Blocks:
        """The norm of the local error and the error of everything a force evaluation uses, where it is estimated."""
        if not self.estimates:
            return Blocks(())
        return Blocks.from_names("error", ("error_norm",)) + self.used.renamed("error", schema.error)

    @property
    def low_parts(self) -> Blocks:
        """The rests of time and state beside their nearest floats, where numbers are sums of two floats."""
        if not self.is_doubled:
            return Blocks(())
        return Blocks.from_names("rest", (schema.rest_name("time"),)) + self.used.renamed("rest", schema.rest_name)

    @cached_property
    def attitudes(self) -> tuple[tuple[int, ...], ...]:
        """The places among the used variables of the four parts of every unit quaternion."""
        return tuple(
            tuple(self.used.offset_of(part) for part in parts)
            for parts in unit_quaternions(self.model.statement.bodies, self.model.shapes)
        )

    @property
    def deviations(self) -> Blocks:
        """How far the length of a quaternion was from 1 before it was brought back."""
        return Blocks.from_names("deviation", (schema.DEVIATION.name,) if self.attitudes else ())

    @property
    def effort(self) -> Blocks:
        """Newton iterations, where a step solves equations."""
        solves = self.scheme is not None and self.scheme.method.solves
        return Blocks.from_names("effort", ("newton_iterations",) if solves else ())

    def argument(self, letter: str, owner: str) -> str:
        """Name the component of q, v or x that belongs to a coordinate or state."""
        return schema.velocity(owner) if letter == "v" else owner

    @cached_property
    def jacobian(self) -> tuple[tuple[str, str], ...]:
        """Dependencies: pairs of a coordinate (for its acceleration) or a rate, and a name that it depends on."""
        return tuple(linearisation.jacobian_names(self.model))

    @cached_property
    def couplings(self) -> tuple[tuple[int, int], ...]:
        """Row and column of each derivative: among velocities and states, and among all that is used.

        Exact ones are the entries of `jacobian`; by differences it is all of them, column by column.
        """
        if self.scheme is not None and self.scheme.jacobian == DIFFERENCES:
            height = self.used.size - self.coordinates.size
            return tuple((row, column) for column in range(self.used.size) for row in range(height))
        rows = {name: i for i, name in enumerate((*self.coordinates, *self.rates))}
        columns = {name: i for i, name in enumerate(self.used)}
        return tuple((rows[name], columns[variable]) for name, variable in self.jacobian)

    @cached_property
    def sample(self) -> Blocks:
        """The float columns of a logged force sample."""
        evaluated = self.used + self.applied_forces + self.drives
        return Blocks.from_names("step", ("time", "step", "stage")) + evaluated

    @property
    def sample_width(self) -> int:
        """Numbers that a step keeps of one evaluation: those of `sample` but for step and stage."""
        return self.sample.size - 2

    @property
    def energy_dimension(self) -> Dimension | None:
        """The dimension of kinetic energy, if the terms of all coordinates share one."""
        from xdynamics.expressions import dimension_of

        known_dimensions, mass = self.model.elements.dimensions, self.model.elements.mass
        dimensions = {
            dimension_of(own_mass(mass, self.coordinates.offset_of(block.first)), known_dimensions)
            * known_dimensions[velocity.first] ** 2
            for block, velocity in zip(self.coordinates.blocks, self.velocities.blocks, strict=True)
        }
        return dimensions.pop() if len(dimensions) == 1 else None

    @cached_property
    def derived_quantities(self) -> dict[str, tuple[tuple[str, ...], Node]]:
        """The dimensions and trees of the quantities in `derived`, of a model with dimensions."""
        model = self.model
        observables = {name: model.expanded(tree) for name, tree in model.statement.observables.items()}
        dims = model.shapes.dims
        observed = {name: (dims.get(name, ()), tree) for name, tree in (self._energies | observables).items()}
        return observed | {
            schema.rate_term(term, name): (dims.get(name, ()), model.expanded(tree))
            for name, state in model.statement.states.items()
            for term, tree in state.acting.items()
        }

    @cached_property
    def _energies(self) -> dict[str, Node]:
        """Kinetic energy and, where a potential is known, potential and total energy."""
        return {} if self.energy_dimension is None else energies(self.model)

    def _energy(self, name: str) -> Node:
        """Return an energy with its sums over elements written out."""
        tree = self._energies[name]
        return at_element(tree, {}, self.model.shapes) if has_diagonal_mass(self.model) else tree


POLYNOMIAL = "polynomial"  # name of the program that writes it


def curve_degree(layout: Layout) -> int:
    """Return the degree of the polynomial that a step leaves for the search for events; 0 if it leaves none.

    Contacts of many links are searched for by the states alone.
    """
    scheme = layout.scheme
    if scheme is None or not scheme.leaves_polynomial or not layout.watched or layout.model.assemblies:
        return 0
    return scheme.interpolant.degree


def past_degree(layout: Layout) -> int:
    """Return the degree of the polynomial of every accepted step for delayed values; 0 without any."""
    return layout.scheme.interpolant.degree if layout.scheme is not None and layout.model.delays else 0


def curve_size(layout: Layout) -> int:
    """Return how many coefficients the polynomial of a step has, of all components."""
    degree = max(curve_degree(layout), past_degree(layout))
    return (degree + 1) * layout.used.size if degree else 0
