"""Polynomials whose coefficients are intervals, at an interval, by Horner's rule."""

from __future__ import annotations

import numpy as np

from xdynamics.kernels.program import Compute, Line, Load, Location, Loop, Program, StoreTo, loop_element
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.enclosed_programs import PARTS, EnclosedProgram


class Polynomials:
    """Some polynomials at once.

    Parameters
    ----------
    degree : int
        The highest that one has.
    count : int
        The most polynomials.
    """

    def __init__(self, degree: int, count: int) -> None:
        body: list[Line] = [Load(f"value{degree}", loop_element("w", degree * count))]
        for k in range(degree - 1, -1, -1):
            body += [
                Load(f"coefficient{k}", loop_element("w", k * count)),
                Compute(f"product{k}", "multiply", (f"value{k + 1}", "x")),
                Compute(f"value{k}", "add", (f"coefficient{k}", f"product{k}")),
            ]
        body.append(StoreTo(loop_element("z"), "value0"))
        lines = (Load("x", Location("p")), Loop("i", count, tuple(body)))
        program = Program("horner", f"Polynomials to degree {degree} at an interval.", lines)
        self._program = EnclosedProgram(program, {"p": 1, "w": (degree + 1) * count, "z": count})
        arrays = self._program.arrays
        self._x, self._values = arrays["p"][0], arrays["z"]
        self._coefficients = arrays["w"].reshape(degree + 1, count, len(PARTS))

    def values_at(self, x: Box, coefficients: Box) -> Box:
        """Return the values at an interval; infinite where none is known.

        Parameters
        ----------
        x : ndarray, shape (2,)
        coefficients : ndarray, shape (2, degree + 1 or fewer, count or fewer)
        """
        orders, count = coefficients.shape[1:]
        self._x[:2] = x
        self._coefficients[...] = 0.0
        self._coefficients[:orders, :count, :2] = coefficients.transpose(1, 2, 0)
        self._program.run()
        stored_values = self._values[:count]
        return np.where(stored_values[:, 2] == 0.0, stored_values[:, :2].T, [[-np.inf], [np.inf]])
