"""The source text of a compiled march: one model, one method, one readable file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache

from xdynamics import schema
from xdynamics.expressions import Node, free_names, limits_domain
from xdynamics.kernels import estimates
from xdynamics.kernels.arithmetic import Arithmetic
from xdynamics.kernels.layout import EMBEDDED, NO_ESTIMATE, Layout
from xdynamics.kernels.stepping import Stepping
from xdynamics.kernels.text import CONTEXT, function_of, tuple_of
from xdynamics.methods import Method
from xdynamics.methods.method import read_lines
from xdynamics.model import Function, Model
from xdynamics.model.linearisation import force_derivatives, mass_derivatives
from xdynamics.units import CONSTANTS

PYTHON = "_python_"  # in front of the names of functions handed over
FEW_EVALUATIONS = 2  # up to which a step is small enough to stand in the loop itself
_HEADER = '''"""{title}

Written by xdynamics from the model and the method; not meant to be edited.
"""

from numpy import empty

from xdynamics.kernels.compiling import borrowed, compiled, shared, {entry}
from xdynamics.kernels.elementary import *
from xdynamics.kernels.elementary import greatest as _greatest, least as _least, positive as _positive, power as _power
from xdynamics.kernels.linear import solve_linear
from xdynamics.kernels.tables import find_piece as _find_piece, piece_after, slope_at as _slope_at, value_at as _value_at
from xdynamics.march.binding import all_finite, bind, lend_log, lend_plan

'''
_ENTRY = '''
ESTIMATES, EVENTFUL, DOMAIN_LIMITED, NO_ERROR = {facts}
march = bind("march", globals())


@{entry}
def run(_plan, _memory, _log, _base, _pause):
    """March until the log is full, a pause is due or the run ends."""
    _tables = {tables}
    return march(lend_plan(_plan, _tables), _memory, lend_log(_log), _base, _pause)
'''
_INSIDE = '''
@{entry}
def run(_starts, _ends, _steps, _times, _states, _p, _given, _found):
    """Evaluate the state at each time inside its step, by interpolation and by re-integration."""
    _tables = {tables}
    for _i in range(_times.shape[0]):
        t, t1, h, _time = _starts[_i], _ends[_i], _steps[_i], _times[_i]
        _pieces = pieces_at(t, _tables)
        _state, _ = begin(t, {initial}, {context}, 0, 0, 0)
        _inner = interpolate(t, t1, h, (_time - t)/h, _state, {context}, 0, 0, 0)
        _again, _, _, _ = propose(t, _time, _time - t, _state, {context}, 0, 0, 0)
        for _k in range({n}):
            _found[_k, _i] = {values}[_k]
            _found[{n} + _k, _i] = {again}[_k]
'''.replace("{context}", CONTEXT)


@lru_cache(maxsize=64)
def write_source(layout: Layout, method: Method, *, samples: bool) -> str:
    """Return the Python source of the march of a model by a method.

    Parameters
    ----------
    layout : Layout
        The model, with the estimator of the local error.
    method : Method
    samples : bool
        Whether every force evaluation of an accepted step is logged.
    """
    write, model = _Writer(layout), layout.model
    disk = not model.python_forces  # a function handed over has no file of its own in the cache
    parts = [
        # checked identifiers and numbers are all that a model gives to this text: its name and descriptions stay out
        _HEADER.format(title=f"A march by {method.name}.", entry="entry" if disk else "entry_in_memory"),
        write.forces(),
        write.linearised() if layout.implicit else "",
        write.sample(logged=samples),
        write.begin(),
        write.propose(method),
        estimates.judgement(layout),
        write.event_functions("detect", {name: model.expanded(one.function) for name, one in model.events.items()}),
        write.event_functions("slopes", {name: model.rate_of(one.function) for name, one in model.events.items()}),
        write.note(),
        write.pieces(),
        _ENTRY.format(entry="entry" if disk else "entry_in_memory", tables=write.tables(), facts=write.facts()),
    ]  # fmt: skip
    return "\n".join(parts)


@lru_cache(maxsize=64)
def write_interpolation(layout: Layout, method: Method, extension: str) -> str:
    """Return the Python source that evaluates states inside steps, by the dense output and by a shorter step.

    Parameters
    ----------
    layout : Layout
    method : Method
    extension : str
        Lines that give the state at t + s*h.
    """
    write = _Writer(layout)
    disk = not layout.model.python_forces
    parts = [
        _HEADER.format(title=f"Between the steps of {method.name}.", entry="entry" if disk else "entry_in_memory"),
        write.forces(),
        write.linearised() if layout.implicit else "",
        write.sample(logged=False),
        write.begin(),
        write.propose(method),
        write.interpolate(method, extension),
        write.pieces(),
        _INSIDE.format(
            entry="entry" if disk else "entry_in_memory",
            tables=write.tables("_given"),
            initial=tuple_of([f"_states[{i}, _i]" for i in range(len(layout.used))] + ["0.0"] * (len(layout.state) - len(layout.used))),
            values=tuple_of(f"_inner[{i}]" for i in range(len(layout.used))),
            again=tuple_of(f"_again[{i}]" for i in range(len(layout.used))),
            n=len(layout.used),
        ),
    ]  # fmt: skip
    return "\n".join(parts)


def constants_of(model: Model) -> tuple[str, ...]:
    """Return the names that stand in the parameter tuple: parameters, then the unit constants, then pi."""
    return (*model.parameters, *CONSTANTS, "pi")


class _Writer:
    """Writes the functions of one model, each from the names that it uses."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.model = layout.model

    def forces(self) -> str:
        """M a = F: drives, force terms, accelerations, rates."""
        lines = self._evaluated({})
        return function_of(f"forces(t, _y, {CONTEXT})", "Accelerations, rates, force components and drives.",
                         [*lines, f"return {tuple_of(self.layout.evaluation)}"])  # fmt: skip

    def linearised(self) -> str:
        """Write the forces with their exact derivatives, for Newton's method."""
        forces, masses = force_derivatives(self.model), mass_derivatives(self.model)
        trees = {f"_dF_{key}_{by}": tree for (key, by), tree in forces.items()}
        trees |= {f"_dM_{i}_{j}_{by}": tree for ((i, j), by), tree in masses.items()}
        lines = [*self._evaluated(trees), *self._acceleration_derivatives(set(forces), set(masses))]
        rates = set(self.layout.rates)
        names = [f"_dF_{one}_{by}" if one in rates else f"_da_{one}_{by}" for one, by in self.layout.jacobian]
        return function_of(f"linearised(t, _y, {CONTEXT})", "What `forces` returns, and its derivatives.",
                         [*lines, f"return {tuple_of(self.layout.evaluation)}, {tuple_of(names or ['0.0'])}"])  # fmt: skip

    def _evaluated(self, more: Mapping[str, Node]) -> list[str]:
        """Write the force terms, accelerations and rates, and more expressions that share parts with them."""
        model = self.model
        components = {
            f"force_{term}_{name}": one if isinstance(one, Function) else model.expanded(one)
            for term, parts in model.force_components.items()
            for name, one in parts.items()
        }
        masses = [[model.expanded(entry) for entry in row] for row in model.mass]
        rates = {schema.rate(name): model.expanded(state.rate) for name, state in model.states.items()}
        trees = [one for one in components.values() if not isinstance(one, Function)]
        trees += [entry for row in masses for entry in row] + list(rates.values()) + list(more.values())
        extra = {name for one in components.values() if isinstance(one, Function) for name in one.arguments}
        arithmetic = Arithmetic(trees)
        for name, one in components.items():
            if isinstance(one, Function):
                arithmetic.lines.append(f"{name} = float({PYTHON}{one.name}({', '.join(one.arguments)}))")
            else:
                arithmetic.assign(name, one)
        self._accelerations(arithmetic, masses)
        for name, tree in (rates | dict(more)).items():
            arithmetic.assign(name, tree)
        used = self._names(trees) | extra | set(self.layout.drives)
        return [*self._unpacked(self.layout.used, "_y", used), *self._looked_up(used), *arithmetic.lines]

    def _acceleration_derivatives(
        self, forces: set[tuple[str, str]], masses: set[tuple[tuple[int, int], str]]
    ) -> list[str]:
        """Differentiate M a = F: M da = dF - dM a, for every name that the forces or the mass read."""
        names, lines = self.layout.coordinates, []
        for by in self.layout.used:
            right = []
            for i, name in enumerate(names):
                terms = [f"_dF_force_{name}_{by}"] if (f"force_{name}", by) in forces else ["0.0"]
                terms += [f"_dM_{i}_{j}_{by}*a_{other}" for j, other in enumerate(names) if ((i, j), by) in masses]
                right.append(" - ".join(terms))
            if self.model.mass_is_full:
                lines += self._substituted([f"_da_{name}_{by}" for name in names], right)
            else:
                needed = set(self.layout.jacobian)
                lines += [
                    f"_da_{name}_{by} = ({right[i]})/_m{i}" for i, name in enumerate(names) if (name, by) in needed
                ]
        return lines

    def sample(self, *, logged: bool) -> str:
        """Log one force evaluation, with the time and the state that it used."""
        if not logged:
            return function_of("sample(_log, _at, t, _step, _stage, _y, _f)", "Samples are off.", ["return _at"])
        n, first = len(self.layout.used), len(self.layout.accelerations) + len(self.layout.rates)
        lines = ["_log.samples[0, _at] = t", "_log.samples[1, _at] = _step", "_log.samples[2, _at] = _stage"]
        lines += [f"_log.samples[{3 + i}, _at] = _y[{i}]" for i in range(n)]
        rest = len(self.layout.evaluation) - first
        lines += [f"_log.samples[{3 + n + i}, _at] = _f[{first + i}]" for i in range(rest)]
        lines += ["return _at + 1"]
        return function_of("sample(_log, _at, t, _step, _stage, _y, _f)", "Log one force evaluation.", lines)

    def begin(self) -> str:
        """Evaluate the forces at a state anew: at the start, and after a node of a drive."""
        n, kept = len(self.layout.used), len(self.layout.state) - len(self.layout.used)
        lines = [
            f"_y = {tuple_of(f'_state[{i}]' for i in range(n))}",
            f"_f = forces(t, _y, {CONTEXT})",
            "_at = sample(_log, _at, t, _step, 0, _y, _f)",
            f"return {tuple_of([f'_y[{i}]' for i in range(n)] + [f'_f[{i}]' for i in range(kept)])}, _at",
        ]
        return function_of(f"begin(t, _state, {CONTEXT}, _log, _at, _step)", "Evaluate the forces at a state.", lines)

    def propose(self, method: Method) -> str:
        """One step of the method, with the estimate of its error."""
        if self.layout.estimator in (NO_ESTIMATE, EMBEDDED):
            return self._step("propose", method)
        return self._step("advance", method) + estimates.doubled(self.layout, method)

    def interpolate(self, method: Method, extension: str) -> str:
        """Write the state inside a step: the update, or where half steps went on what they led to; then the extension."""
        write, layout = Stepping(self.layout), self.layout
        lines = ["_evaluations, _iterations, _stage = 0, 0, 0", *self._unpacked_state()]
        if layout.estimator in (NO_ESTIMATE, EMBEDDED):
            lines += write.written(method.statements)
        else:
            end = [*write.state("1"), *write.rates("1"), *("_" for _ in layout.forces)]
            lines += [
                f"_end, _, _, _ = propose(t, t1, h, _state, {CONTEXT}, _log, _at, _step)",
                f"{tuple_of(end)} = _end",
            ]
        lines += write.written(read_lines(extension))
        signature = f"interpolate(t, t1, h, s, _state, {CONTEXT}, _log, _at, _step)"
        return function_of(signature, "The state at t + s*h.", [*lines, f"return {tuple_of(write.state('s'))}"])

    def _step(self, name: str, method: Method) -> str:
        """Write the lines of a method out."""
        write, layout = Stepping(self.layout), self.layout
        lines = [*self._unpacked_state(), *write.written(method.statements), "_end = _f"]
        embedded = layout.estimator == EMBEDDED
        if embedded:
            lines += write.written(read_lines(method.estimate))
        first = len(layout.accelerations) + len(layout.rates)
        state = [*write.state("1"), *write.rates("1"), *(f"_end[{first + i}]" for i in range(len(layout.forces)))]
        error = tuple_of(write.state("e") if embedded else ["0.0"])
        # in the loop itself where that is the only place, or where it is small
        once = method.evaluations <= FEW_EVALUATIONS or not self.model.events
        staged = ", _stage" if name == "advance" else ""
        begin = f"_evaluations, _iterations = {write.stage}, 0"
        begin += "" if staged else "; _stage = 0"
        return function_of(
            f"{name}(t, t1, h, _state, {CONTEXT}, _log, _at, _step{staged})", f"One step by {method.name}.",
            [begin, *lines, f"return {tuple_of(state)}, {error}, _at, (_evaluations, _iterations)"],
            "compiled" if once and not staged else "shared",
        )  # fmt: skip

    def _unpacked_state(self) -> list[str]:
        write = Stepping(self.layout)
        names = [*write.state(""), *write.rates("")]
        return [f"{tuple_of([*names, *('_' for _ in self.layout.forces)])} = _state"]

    def event_functions(self, name: str, trees: Mapping[str, Node]) -> str:
        """Evaluate the events' functions, or their time derivatives; a model without events has one that never is."""
        if not trees:
            return function_of(f"{name}(t, _state, {CONTEXT})", "No events.", ["return (1.0,)"])
        return function_of(f"{name}(t, _state, {CONTEXT})", "One number for each event.", self._returned(trees))

    def note(self) -> str:
        """Write one row of the log."""
        layout = self.layout
        lines = ["_log.rows[0, _row] = t", "_log.rows[1, _row] = h"]
        lines += [f"_log.rows[{2 + i}, _row] = _state[{i}]" for i in range(len(layout.state))]
        if layout.derived:
            derived = self._returned(layout.derived)
            lines += [*derived[:-1], f"_derived = {derived[-1].removeprefix('return ')}"]
            start = 2 + len(layout.state)
            lines += [f"_log.rows[{start + i}, _row] = _derived[{i}]" for i in range(len(layout.derived))]
        at = len(layout.row) - len(layout.errors) - len(layout.effort)
        if layout.estimates:
            lines += [f"_log.rows[{at}, _row] = _norm"]
            lines += [f"_log.rows[{at + 1 + i}, _row] = _error[{i}]" for i in range(len(layout.used))]
        if layout.implicit:
            lines += [f"_log.rows[{at + len(layout.errors)}, _row] = _iterations"]
        lines += ["_log.row_flags[0, _row] = _kind", "_log.row_flags[1, _row] = 0"]
        lines += ["return all_finite(_derived)" if layout.derived else "return True"]
        return function_of(
            f"note(_log, _row, t, h, _kind, _state, _norm, _error, _iterations, {CONTEXT})",
            "Write one row of the log; tell whether its energies and observables are finite.",
            lines,
        )

    def pieces(self) -> str:
        """Find the piece of every drive of time that a step from t goes through."""
        drives = self.layout.drives
        found = [f"piece_after(t, _tables[{drives.index(name)}])" for name in self.layout.time_drives]
        return function_of(
            "pieces_at(t, _tables)", "The piece of every drive of time, from t on.", [f"return {tuple_of(found)}"]
        )

    def facts(self) -> str:
        """Say what the loop takes for granted: estimates, limited domains, the error of a state no step led to."""
        trees = [*self._force_trees(), *(model_state.rate for model_state in self.model.states.values())]
        limited = any(limits_domain(self.model.expanded(tree)) for tree in trees)
        limited = limited or any(drive.outside == "error" for drive in self.model.drives.values())
        zeros = tuple_of(["0.0"] * (len(self.layout.used) if self.layout.estimator != NO_ESTIMATE else 1))
        return f"{self.layout.estimates}, {bool(self.model.events)}, {limited}, {zeros}"

    def _force_trees(self) -> list[Node]:
        parts = [one for terms in self.model.force_components.values() for one in terms.values()]
        return [one for one in parts if not isinstance(one, Function)] + [
            entry for row in self.model.mass for entry in row
        ]

    def tables(self, given: str = "_plan.tables") -> str:
        """Borrow the arrays of the measured tables."""
        pairs = [f"{given}[{i}]" for i in range(len(self.layout.drives))]
        return tuple_of(f"(borrowed({pair}[0]), borrowed({pair}[1]))" for pair in pairs)

    def _accelerations(self, arithmetic: Arithmetic, masses: list[list[Node]]) -> None:
        """Solve M a = F: by division where M is diagonal, else by its factors L D L^T, written out."""
        names = self.layout.coordinates
        totals = []
        for name in names:
            acting = [f"force_{term}_{name}" for term, parts in self.model.force_components.items() if name in parts]
            totals.append(" + ".join(acting) or "0.0")
        out, unknowns = arithmetic.lines, [schema.acceleration(name) for name in names]
        if not self.model.mass_is_full:
            for i, unknown in enumerate(unknowns):
                out.append(f"_m{i} = _positive({arithmetic.text(masses[i][i])})")
                out.append(f"{unknown} = ({totals[i]})/_m{i}")
            return
        for i in range(len(names)):
            for j in range(i):
                taken = "".join(f" - _l{i}_{k}*_l{j}_{k}*_d{k}" for k in range(j))
                out.append(f"_l{i}_{j} = ({arithmetic.operand(masses[i][j])}{taken})/_d{j}")
            taken = "".join(f" - _l{i}_{k}*_l{i}_{k}*_d{k}" for k in range(i))
            out.append(f"_d{i} = _positive({arithmetic.operand(masses[i][i])}{taken})")
        out += self._substituted(unknowns, totals)

    def _substituted(self, unknowns: list[str], right: list[str]) -> list[str]:
        """Solve L D L^T u = right, forward and back."""
        n = len(unknowns)
        taken = ["".join(f" - _l{i}_{k}*_z{k}" for k in range(i)) for i in range(n)]
        lines = [f"_z{i} = {right[i]}{taken[i]}" for i in range(n)]
        taken = ["".join(f" - _l{k}_{i}*{unknowns[k]}" for k in range(i + 1, n)) for i in range(n)]
        return lines + [f"{unknowns[i]} = _z{i}/_d{i}{taken[i]}" for i in reversed(range(n))]

    def _returned(self, trees: Mapping[str, Node]) -> list[str]:
        """Compute expressions of a whole state and return them as a tuple."""
        arithmetic = Arithmetic(trees.values())
        texts = [arithmetic.text(tree) for tree in trees.values()]
        used = self._names(trees.values())
        unpacked = [*self._unpacked(self.layout.state, "_state", used), *self._looked_up(used)]
        return [*unpacked, *arithmetic.lines, f"return {tuple_of(texts)}"]

    def _names(self, trees: Iterable[Node]) -> set[str]:
        return set().union(*(free_names(tree) for tree in trees))

    def _unpacked(self, order: tuple[str, ...], source: str, used: set[str]) -> list[str]:
        """Give the names that a function uses their values."""
        arguments = {self.model.drives[name].argument for name in self.layout.drives}
        lines = [f"{name} = {source}[{i}]" for i, name in enumerate(order) if name in used | arguments]
        return lines + [f"{name} = _p[{i}]" for i, name in enumerate(constants_of(self.model)) if name in used]

    def _looked_up(self, used: set[str]) -> list[str]:
        """Look up the drives, and their slopes, that a function uses."""
        lines = []
        for i, (name, drive) in enumerate(self.model.drives.items()):
            table = f"_tables[{i}]"
            if drive.argument == "t":
                piece = f"_pieces[{self.layout.time_drives.index(name)}]"
            else:
                piece = f"_find_piece({drive.argument}, {table})"
            for target, rule in ((name, "_value_at"), (f"_slope_{name}", "_slope_at")):
                if target in used:
                    lines.append(f"{target} = {rule}({drive.argument}, {table}, {piece})")
        return lines
