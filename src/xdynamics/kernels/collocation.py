"""A step of Radau IIA in every lane, solved as `march.implicit.radau` solves the equations of a single run.

Each line here performs the operations of one there, or in `march.implicit.transformed` and `kernels.linear`, in order.
A lane whose iteration has ended waits for the others; one whose iteration fails is left to the single march.
"""

from __future__ import annotations

from xdynamics.kernels import radau_lines
from xdynamics.kernels.formulas import Formulas
from xdynamics.kernels.program import (
    AT,
    REGIME,
    Compute,
    H,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    ProgramCall,
    StoreTo,
    T,
    loop_element,
)
from xdynamics.kernels.radau_memory import RadauMemory
from xdynamics.kernels.radau_systems import factorisation, solve_complex_lanes, solve_real_lanes
from xdynamics.kernels.step_polynomial import POLYNOMIAL, curve_size
from xdynamics.kernels.step_programs import polynomial_program
from xdynamics.methods import radau
from xdynamics.methods.radau import ALPHA, BETA, ERROR, GAMMA, NODES, T_INVERSE
from xdynamics.methods.radau import T as T_MATRIX

LINEARISE, CORRECT, ESTIMATE = "linearise", "correct", "estimate"

_RECALL = """
moved = where(since == 2, 1, 0)
starts = where(since == 0, 1, 0)
used_up = moved*where(turns > few_turns, where(theta > slow, 1, 0), 0)
known = where(starts > 0, 0, where(used_up > 0, 0, linearised))
newest = where(since == 1, fresh, 0)
of_step = where(starts > 0, 0, factored)
last_step = where(starts > 0, 0, where(moved > 0, h, before))
last_norm = where(starts > 0, 0, where(moved > 0, max(least_norm, norm), norm_before))
last_eta = where(starts > 0, 1, eta)
least_eta = max(last_eta, eps)
damped_eta = sqrt(least_eta)*sqrt(sqrt(least_eta))
lacks = ready*where(known > 0, 0, 1)
refactors = ready*where(lacks > 0, 1, where(abs(width - of_step) <= same_step*width, 0, 1))
"""
_RECALLED = {
    "linearised": "where(lacks > 0, 1, known)",
    "fresh": "where(lacks > 0, 1, newest)",
    "factored": "of_step",
    "before": "last_step",
    "norm_before": "last_norm",
    "eta": "last_eta",
    "eta_tried": "damped_eta",
    "theta": "0",
    "since": "1",
    "missing": "lacks",
    "unfactored": "refactors",
    "jacobians": "jacobians + lacks",
    "open": "ready",
    "vain": "0",
    "turn": "0",
}
_VERDICT = """
stalls = where(size <= rounding, where(ratio_now >= stalled, 1, 0), 0)
converges = where(theta_now < diverging, where(lacking > max(tolerance, rounding), 2, 0), 2)
later = where(stalls > 0, 1, converges)
so_far = where(turn_now > 1.5, later, 0)
passes = where(size - size == 0, where(so_far == 0, 1, 0), 0)
eta_then = where(turn_now > 1.5, eta_now, eta_tried)
close = where(eta_then*size <= tolerance, 1, where(turn_now == most_turns, where(size <= rounding, 1, 2), 0))
verdict = where(size - size == 0, where(so_far == 0, close, so_far), 2)
"""


class CollocationStep:
    """The parts of a Radau IIA step in lanes.

    Parameters
    ----------
    memory : RadauMemory
    atol : int
        Where in `w` a lane's absolute tolerances begin.
    follows : bool
        Whether some tolerances follow their variables.
    """

    def __init__(self, memory: RadauMemory, atol: int, *, follows: bool) -> None:
        self._memory, self._atol, self._follows = memory, atol, follows
        self._layout, self._used, self._n = memory.layout, memory.used, memory.n
        self._body: list[Instruction] = []

    @property
    def programs(self) -> tuple[Program, ...]:
        """The programs that the step calls, each after those that it calls itself."""
        polynomials: tuple[Program, ...] = ()
        if curve_size(self._layout):
            places = (self._memory.vector_location(name, 0).offset for name in ("curve", "reached"))
            polynomials = (polynomial_program(self._layout, *places),)
        return (self._linearise(), factorisation(self._memory), self._correct(), self._estimate_again(), *polynomials)

    def begin(self, operands: dict[str, Operand]) -> tuple[Instruction, ...]:
        """Write what precedes the iteration: what is kept of the previous step, and the starting values."""
        f, u = self._memory.formulas("_begin_", operands), self._used
        f.write(_RECALL)
        f.write("relative = where(last_step > 0, width/last_step, 0)")
        stages, past = self._memory.load_vectors(f, "stages"), self._memory.load_vectors(f, "past")
        guessed: list[list[Operand]] = [[], [], []]
        for i in range(u):
            f.write(radau_lines.RADAU_POLYNOMIAL, **{f"z{k}": stages[k][i] for k in range(3)})
            for k, name in enumerate(("first", "second", "third")):
                f.write(f"{name} = where(moved > 0, {name}, before)", before=past[k][i])
                f.store(self._memory.vector_location("past", k * u + i), f.known[name])
            for k, c in enumerate(NODES):
                f.write(radau_lines.GUESS, c=c)
                guessed[k].append(f.known["guess"])
        self._memory.store_vectors(f, "stages", guessed)
        self._memory.store_vectors(f, "turned", _transformed(f, guessed))
        self._memory.update_numbers(f, _RECALLED)
        return tuple(f.lines)

    def end_state_lines(self) -> tuple[Instruction, ...]:
        """Write the state at the end of the step, which is its third stage."""
        return (self._write_stage_state(2, loop_element("z")),)

    def curve(self) -> tuple[Instruction, ...]:
        """Write the states at the stages, and call for the polynomial through them, where the search for events needs it."""
        if not curve_size(self._layout):
            return ()
        places = [self._memory.vector_location("reached", k * self._used).offset for k in range(3)]
        loops = [self._write_stage_state(k, loop_element("w", offset)) for k, offset in enumerate(places)]
        return (*loops, ProgramCall(POLYNOMIAL, "at", "y", "z"))

    def _write_stage_state(self, stage: int, target: Location) -> Loop:
        """Write the state at a stage."""
        body = (
            Load("_y", loop_element("y")),
            Load("_stage", loop_element("w", self._memory.vector_location("stages", stage * self._used).offset)),
            Compute("_sum", "add", ("_y", "_stage")),
            StoreTo(target, "_sum"),
        )
        return Loop("i", self._used, body)

    def error_lines(self) -> tuple[Instruction, ...]:
        """Write the estimate of the error, to `e`."""
        f = self._memory.formulas("_estimated_")
        slopes = [f.load(Location("y", self._slope_index(i))) for i in range(self._used)]
        self._write_error_estimate(f, slopes)
        return tuple(f.lines)

    def _slope_index(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is: `march.force_evaluation.state_slope`."""
        return self._n + i if i < self._n else self._used + i - self._n

    def _flushed(self, f: Formulas) -> None:
        self._body += f.lines
        f.lines.clear()

    def _evaluate_forces(self, f: Formulas, name: str, time: Operand, values: list[Operand]) -> list[Operand]:
        """Evaluate the forces at a state; return its slopes."""
        for i, value in enumerate(values):
            f.store(Location(name, i), value)
        f.store(Location(f"at_{name}", T), time)
        f.store(Location(f"at_{name}", REGIME), f.load(Location("at", REGIME)))
        self._flushed(f)
        self._body.append(ProgramCall("forces", f"at_{name}", name, name))
        return [
            values[self._n + i] if i < self._n else f.load(Location(name, self._slope_index(i)))
            for i in range(self._used)
        ]

    def _finish_program(self, name: str, about: str, f: Formulas, **local: int) -> Program:
        self._flushed(f)
        body, self._body = tuple(self._body), []
        return Program(name, about, body, {}, local)

    def _linearise(self) -> Program:
        """Evaluate the derivatives at the state in lanes that lack them: `radau.refresh_derivatives`."""
        f, record, entries = self._memory.formulas("_"), self._layout.record.size, len(self._layout.couplings)
        self._body = [
            Loop("i", record, (Load("_state", loop_element("y")), StoreTo(loop_element("state"), "_state"))),
            ProgramCall("linearised", "at", "state", "state", "found"),
        ]
        for k in range(entries):
            location = self._memory.vector_location("slopes", k)
            derivative = f.formula(
                "where(new - new == 0, new, 0)", new=f.load(Location("found", k))
            )  # derivatives.or_none
            new = f.formula("where(missing > 0, new, old)", new=derivative, old=f.load(location))
            f.store(location, new)
        return self._finish_program(LINEARISE, "Derivatives at the state.", f, state=record, found=max(1, entries))

    def _correct(self) -> Program:
        """Correct the stages of every open lane once, and judge: `radau.correct_stages`, `radau.judge_iteration`."""
        f, u = self._memory.formulas("_"), self._used
        t, h = f.load(Location("at", T)), f.load(Location("at", H))
        y = [f.load(Location("y", i)) for i in range(u)]
        stages, transformed = self._memory.load_vectors(f, "stages"), self._memory.load_vectors(f, "turned")
        slopes = []
        for k, c in enumerate(NODES):
            time = f.formula("t + c*h" if k < 2 else "t + h", t=t, c=c, h=h)
            values = [f.formula("y + z", y=y[i], z=stages[k][i]) for i in range(u)]
            slopes.append(self._evaluate_forces(f, f"stage{k}", time, values))
        f.write("gamma = g/h\nalpha = a/h\nbeta = b/h", g=GAMMA, a=ALPHA, b=BETA, h=h)
        defects = _transformed(f, slopes)
        for i in range(u):
            w0, w1, w2 = (transformed[k][i] for k in range(3))
            defects[0][i] = f.formula("d - gamma*w", d=defects[0][i], w=w0)
            defects[1][i] = f.formula("d - (alpha*w1 - beta*w2)", d=defects[1][i], w1=w1, w2=w2)
            defects[2][i] = f.formula("d - (beta*w1 + alpha*w2)", d=defects[2][i], w1=w1, w2=w2)
        changes = [
            solve_real_lanes(f, self._memory, defects[0]),
            *solve_complex_lanes(f, self._memory, defects[1], defects[2]),
        ]
        new = [[f.formula("w + d", w=transformed[k][i], d=changes[k][i]) for i in range(u)] for k in range(3)]
        new_stages = _back_transformed(f, new)
        f.write("size = one", one=self._correction(f, y, new_stages, changes))
        for name, vectors, old in (("turned", new, transformed), ("stages", new_stages, stages)):
            open_values = [
                [f.formula("where(open > 0, a, b)", a=vectors[k][i], b=old[k][i]) for i in range(u)] for k in range(3)
            ]
            self._memory.store_vectors(f, name, open_values)
        self._judge_iteration(f)
        local = {f"stage{k}": self._layout.record.size for k in range(3)} | {f"at_stage{k}": len(AT) for k in range(3)}
        return self._finish_program(CORRECT, "One simplified Newton iteration.", f, **local)

    def _correction(
        self, f: Formulas, y: list[Operand], stages: list[list[Operand]], changes: list[list[Operand]]
    ) -> Operand:
        """Return the largest ratio of a last correction to its tolerance: `corrections.largest_correction`."""
        largest: Operand = 0.0
        for i in range(self._used):
            scale = f.formula("atol + rtol*abs(y)", atol=f.load(Location("w", self._atol + i)), y=y[i])
            if self._follows:
                size = f.formula("max(abs(a), abs(b), abs(c))", a=stages[0][i], b=stages[1][i], c=stages[2][i])
                scale = f.formula("where(scale == 0, rtol*size, scale)", scale=scale, size=size)
            for k in range(3):
                change = f.formula("abs(d)", d=changes[k][i])
                operands = {"change": change, "scale": scale, "largest": largest}
                largest = f.formula("where(change != 0, max(largest, change/scale), largest)", **operands)
        return largest

    def _judge_iteration(self, f: Formulas) -> None:
        """Judge the iterations by their corrections: `radau.judge_iteration`."""
        f.write("turn_now = turn + 1")
        f.write(f"{radau_lines.CONVERGENCE}lacking = eta_now*size")
        for remaining in range(1, int(radau.MOST_TURNS) - 1):  # one for each remaining iteration
            f.write(f"lacking = where(turn_now <= {int(radau.MOST_TURNS) - remaining}, lacking*theta_now, lacking)")
        f.write(
            "rounding = ten*eps/rtol\ntolerance = max(share*rounding, min(most_share, sqrt(rtol)))",
            ten=10.0,
            share=0.05,
            most_share=radau.SHARE,
        )
        f.write(_VERDICT)
        updates = {
            "turn": "turn_now",
            "theta": "where(turn_now > 1.5, theta_now, theta)",
            "ratio": "where(turn_now > 1.5, ratio_now, ratio)",
            "eta_tried": "where(passes > 0, eta_then, eta_tried)",
            "change": "where(passes > 0, max(size, eps), change)",
            "turns": "where(passes > 0, turn_now, turns)",
            "vain": "where(verdict == 2, 1, vain)",
            "open": "where(verdict == 0, open, 0)",
        }
        self._memory.update_numbers(f, {name: f"where(open > 0, {text}, {name})" for name, text in updates.items()})

    def _write_error_estimate(self, f: Formulas, slopes: list[Operand], only: str = "") -> None:
        """Write the error by the embedded formula, with the given slopes, to `e`: `radau.estimate_error`."""
        stages, h = self._memory.load_vectors(f, "stages"), f.load(Location("at", H))
        e1, e2, e3 = ERROR
        components = [
            dict(zip(("a", "b", "c"), (stages[k][i] for k in range(3)), strict=True)) for i in range(self._used)
        ]
        defects = [
            f.formula("(e1*a + e2*b + e3*c)/h", h=h, e1=e1, e2=e2, e3=e3, **component) for component in components
        ]
        errors = solve_real_lanes(
            f, self._memory, [f.formula("d + s", d=d, s=s) for d, s in zip(defects, slopes, strict=True)]
        )
        for i, error in enumerate(errors):
            stored_error = (
                f.formula(f"where({only} > 0, new, old)", new=error, old=f.load(Location("e", i))) if only else error
            )
            f.store(Location("e", i), stored_error)

    def _estimate_again(self) -> Program:
        """Estimate again, with the slopes that the first estimate leads to."""
        f, u = self._memory.formulas("_"), self._used
        values = [f.formula("y + e", y=f.load(Location("y", i)), e=f.load(Location("e", i))) for i in range(u)]
        self._write_error_estimate(f, self._evaluate_forces(f, "beside", f.formula("t"), values), "again")
        about, record = "The error by the slopes that the first estimate leads to.", self._layout.record.size
        return self._finish_program(ESTIMATE, about, f, beside=record, at_beside=len(AT))


def _transformed(f: Formulas, vectors: list[list[Operand]]) -> list[list[Operand]]:
    """Multiply by T**-1."""
    rows = [dict(zip("abc", row, strict=True)) for row in T_INVERSE]
    return [
        [f.formula("a*x + b*y + c*z", x=x, y=y, z=z, **row) for x, y, z in zip(*vectors, strict=True)] for row in rows
    ]


def _back_transformed(f: Formulas, vectors: list[list[Operand]]) -> list[list[Operand]]:
    """Multiply by T."""
    rows = [dict(zip("abc", row, strict=True)) for row in T_MATRIX[:2]]
    products = [
        [f.formula("a*x + b*y + c*z", x=x, y=y, z=z, **row) for x, y, z in zip(*vectors, strict=True)] for row in rows
    ]
    last = T_MATRIX[2][0]
    return [*products, [f.formula("a*x + y", a=last, x=x, y=y) for x, y, _ in zip(*vectors, strict=True)]]
