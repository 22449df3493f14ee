"""The source text of a compiled march: one model, one method, one readable file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from xdynamics.expressions import Name, Node, expand, free_names
from xdynamics.kernels.arithmetic import Arithmetic
from xdynamics.kernels.layout import Layout
from xdynamics.methods import Evaluation, Method, Statement
from xdynamics.model import Function, Model
from xdynamics.units import CONSTANTS

_CONTEXT = "_p, _tables, _pieces"
PYTHON = "_python_"  # in front of the names of functions handed over
_HEADER = '''"""{title}

Written by xdynamics from the model and the method; not meant to be edited.
"""

from xdynamics.kernels.compiling import borrowed, compiled, {entry}
from xdynamics.kernels.elementary import *
from xdynamics.kernels.elementary import greatest as _greatest, least as _least, positive as _positive, power as _power
from xdynamics.kernels.tables import find_piece as _find_piece, piece_after, slope_at as _slope_at, value_at as _value_at
from xdynamics.march.binding import all_finite, bind, lend_log, lend_plan

'''
_ENTRY = '''
march = bind("march", globals())


@{entry}
def run(_plan, _memory, _log, _base, _pause):
    """March until the log is full, a pause is due or the run ends."""
    _tables = {tables}
    return march(lend_plan(_plan, _tables), _memory, lend_log(_log), _base, _pause)
'''


def write_source(model: Model, method: Method, *, samples: bool) -> str:
    """Return the Python source of the march of a model by a method.

    Parameters
    ----------
    model : Model
    method : Method
    samples : bool
        Whether every force evaluation of an accepted step is logged.
    """
    layout = Layout(model)
    write = _Writer(layout)
    disk = not model.python_forces  # a function handed over has no file of its own in the cache
    parts = [
        # checked identifiers and numbers are all that a model gives to this text: its name and descriptions stay out
        _HEADER.format(title=f"A march by {method.name}.", entry="entry" if disk else "entry_in_memory"),
        write.forces(),
        write.sample(logged=samples),
        write.begin(),
        write.propose(method),
        write.event_functions("detect", {name: model.expanded(one.function) for name, one in model.events.items()}),
        write.event_functions("slopes", {name: model.rate_of(one.function) for name, one in model.events.items()}),
        write.note(),
        write.pieces(),
        _ENTRY.format(entry="entry" if disk else "entry_in_memory", tables=write.tables()),
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
        model = self.model
        components = {
            f"force_{term}_{name}": one if isinstance(one, Function) else model.expanded(one)
            for term, parts in model.force_components.items()
            for name, one in parts.items()
        }
        masses = [[model.expanded(entry) for entry in row] for row in model.mass]
        rates = {f"rate_{name}": model.expanded(state.rate) for name, state in model.states.items()}
        trees = [one for one in components.values() if not isinstance(one, Function)]
        trees += [entry for row in masses for entry in row] + list(rates.values())
        extra = {name for one in components.values() if isinstance(one, Function) for name in one.arguments}
        arithmetic = Arithmetic(trees)
        for name, one in components.items():
            if isinstance(one, Function):
                arithmetic.lines.append(f"{name} = float({PYTHON}{one.name}({', '.join(one.arguments)}))")
            else:
                arithmetic.assign(name, one)
        self._accelerations(arithmetic, masses)
        for name, tree in rates.items():
            arithmetic.assign(name, tree)
        used = self._names(trees) | extra | set(self.layout.drives)
        body = [*self._unpacked(self.layout.used, "_y", used), *self._looked_up(used), *arithmetic.lines]
        return _function(f"forces(t, _y, {_CONTEXT})", "Accelerations, rates, force components and drives.",
                         [*body, f"return {_tuple(self.layout.evaluation)}"])  # fmt: skip

    def sample(self, *, logged: bool) -> str:
        """Log one force evaluation, with the time and the state that it used."""
        if not logged:
            return _function("sample(_log, _at, t, _step, _stage, _y, _f)", "Samples are off.", ["return _at"])
        n, first = len(self.layout.used), len(self.layout.accelerations) + len(self.layout.rates)
        lines = ["_log.samples[0, _at] = t", "_log.samples[1, _at] = _step", "_log.samples[2, _at] = _stage"]
        lines += [f"_log.samples[{3 + i}, _at] = _y[{i}]" for i in range(n)]
        rest = len(self.layout.evaluation) - first
        lines += [f"_log.samples[{3 + n + i}, _at] = _f[{first + i}]" for i in range(rest)]
        lines += ["return _at + 1"]
        return _function("sample(_log, _at, t, _step, _stage, _y, _f)", "Log one force evaluation.", lines)

    def begin(self) -> str:
        """Evaluate the forces at a state anew: at the start, and after a node of a drive."""
        n, kept = len(self.layout.used), len(self.layout.state) - len(self.layout.used)
        lines = [
            f"_y = {_tuple(f'_state[{i}]' for i in range(n))}",
            f"_f = forces(t, _y, {_CONTEXT})",
            "_at = sample(_log, _at, t, _step, 0, _y, _f)",
            f"return {_tuple([f'_y[{i}]' for i in range(n)] + [f'_f[{i}]' for i in range(kept)])}, _at",
        ]
        return _function(f"begin(t, _state, {_CONTEXT}, _log, _at, _step)", "Evaluate the forces at a state.", lines)

    def propose(self, method: Method) -> str:
        """One step of the method, every vector statement written out by component."""
        layout = self.layout
        names = _components(layout, ("q", layout.coordinates), ("v", layout.velocities), ("x", layout.states),
                            ("a", layout.accelerations), ("r", layout.rates))  # fmt: skip
        lines = [f"{_tuple([*names, *('_' for _ in layout.forces)])} = _state"]
        stage = 0
        for statement in method.statements:
            if isinstance(statement, Evaluation):
                stage += 1
                lines += self._evaluation(statement, stage)
            else:
                lines += self._statement(statement)
        names = _components(layout, ("q1", layout.coordinates), ("v1", layout.velocities), ("x1", layout.states),
                            ("a1", layout.accelerations), ("r1", layout.rates))  # fmt: skip
        first = len(layout.accelerations) + len(layout.rates)
        names += [f"_f[{first + i}]" for i in range(len(layout.forces))]
        return _function(f"propose(t, t1, h, _state, {_CONTEXT}, _log, _at, _step)", f"One step by {method.name}.",
                         [*lines, f"return {_tuple(names)}, _at"])  # fmt: skip

    def event_functions(self, name: str, trees: Mapping[str, Node]) -> str:
        """Evaluate the events' functions, or their time derivatives; a model without events has one that never is."""
        if not trees:
            return _function(f"{name}(t, _state, {_CONTEXT})", "No events.", ["return (1.0,)"])
        return _function(f"{name}(t, _state, {_CONTEXT})", "One number for each event.", self._returned(trees))

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
        lines += ["_log.row_flags[0, _row] = _kind", "_log.row_flags[1, _row] = 0"]
        lines += ["return all_finite(_derived)" if layout.derived else "return True"]
        return _function(
            f"note(_log, _row, t, h, _kind, _state, {_CONTEXT})",
            "Write one row of the log; tell whether its energies and observables are finite.",
            lines,
        )

    def pieces(self) -> str:
        """Find the piece of every drive of time that a step from t goes through."""
        drives = self.layout.drives
        found = [f"piece_after(t, _tables[{drives.index(name)}])" for name in self.layout.time_drives]
        return _function(
            "pieces_at(t, _tables)", "The piece of every drive of time, from t on.", [f"return {_tuple(found)}"]
        )

    def tables(self) -> str:
        """Borrow the arrays of the measured tables."""
        pairs = [f"_plan.tables[{i}]" for i in range(len(self.layout.drives))]
        return _tuple(f"(borrowed({pair}[0]), borrowed({pair}[1]))" for pair in pairs)

    def _accelerations(self, arithmetic: Arithmetic, masses: list[list[Node]]) -> None:
        """Solve M a = F: by division where M is diagonal, else by its factors L D L^T, written out."""
        names = self.layout.coordinates
        totals = []
        for name in names:
            acting = [f"force_{term}_{name}" for term, parts in self.model.force_components.items() if name in parts]
            totals.append(" + ".join(acting) or "0.0")
        if not self.model.mass_is_full:
            for i, name in enumerate(names):
                arithmetic.lines.append(f"a_{name} = ({totals[i]})/_positive({arithmetic.text(masses[i][i])})")
            return
        n = len(names)
        out = arithmetic.lines
        for i in range(n):
            for j in range(i):
                taken = "".join(f" - _l{i}_{k}*_l{j}_{k}*_d{k}" for k in range(j))
                out.append(f"_l{i}_{j} = ({arithmetic.operand(masses[i][j])}{taken})/_d{j}")
            taken = "".join(f" - _l{i}_{k}*_l{i}_{k}*_d{k}" for k in range(i))
            out.append(f"_d{i} = _positive({arithmetic.operand(masses[i][i])}{taken})")
        for i in range(n):
            out.append(f"_z{i} = {totals[i]}" + "".join(f" - _l{i}_{k}*_z{k}" for k in range(i)))
        for i in reversed(range(n)):
            out.append(f"a_{names[i]} = _z{i}/_d{i}" + "".join(f" - _l{k}_{i}*a_{names[k]}" for k in range(i + 1, n)))

    def _evaluation(self, one: Evaluation, stage: int) -> list[str]:
        layout = self.layout
        used = _components(layout, (one.position, layout.coordinates), (one.velocity, layout.velocities),
                           (one.state, layout.states))  # fmt: skip
        lines = [
            f"_y = {_tuple(used)}",
            f"_f = forces({one.time}, _y, {_CONTEXT})",
            f"_at = sample(_log, _at, {one.time}, _step, {stage}, _y, _f)",
        ]
        results = _components(layout, (one.acceleration, layout.accelerations), (one.rate, layout.rates))
        return lines + [f"{name} = _f[{i}]" for i, name in enumerate(results)]

    def _statement(self, one: Statement) -> list[str]:
        """Write a vector statement out, one line for each component."""
        suffixes = self.layout.states if one.of_states else self.layout.coordinates
        lines = []
        for suffix in suffixes:
            named = _renamed(one.expression, {name: f"{name}_{suffix}" for name in one.vectors})
            lines.append(f"{one.target}_{suffix} = {Arithmetic([named]).text(named)}")
        return lines

    def _returned(self, trees: Mapping[str, Node]) -> list[str]:
        """Compute expressions of a whole state and return them as a tuple."""
        arithmetic = Arithmetic(trees.values())
        texts = [arithmetic.text(tree) for tree in trees.values()]
        used = self._names(trees.values())
        unpacked = [*self._unpacked(self.layout.state, "_state", used), *self._looked_up(used)]
        return [*unpacked, *arithmetic.lines, f"return {_tuple(texts)}"]

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


def _components(layout: Layout, *vectors: tuple[str, tuple[str, ...]]) -> list[str]:
    """Name every component of vectors: ``q1`` of y is ``q1_y``."""
    bare = {**dict.fromkeys(layout.coordinates), **dict.fromkeys(layout.states)}
    names = []
    for symbol, components in vectors:
        for one in components:
            owner = one if one in bare else one.split("_", 1)[1]
            names.append(f"{symbol}_{owner}")
    return names


def _renamed(node: Node, names: Mapping[str, str]) -> Node:
    return expand(node, {old: Name(new) for old, new in names.items()})


def _tuple(items: Iterable[str]) -> str:
    listed = list(items)
    return f"({listed[0]},)" if len(listed) == 1 else f"({', '.join(listed)})"


def _function(signature: str, docstring: str, lines: list[str]) -> str:
    body = "\n".join(f"    {line}" for line in lines)
    return f'\n@compiled\ndef {signature}:\n    """{docstring}"""\n{body}\n'
