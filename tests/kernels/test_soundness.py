"""The judgement whether numbers are finite, of neighbours side by side."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from cases.array_programs import bound, in_python
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import AT, Compute, Load, Loop, Program, StoreTo, loop_element

UNSOUND = AT.index("unsound")
DOUBLED = Load("x", loop_element("y")), Compute("two", "add", ("x", "x")), StoreTo(loop_element("z"), "two")


def doubles(n: int) -> Program:
    """The doubles of n numbers, and whether they are finite."""
    return Program("doubles", "Doubles.", (Loop("i", n, DOUBLED),), sound=(0, n))


@pytest.mark.parametrize("wide", [1, 4, 8, 16])
def test_one_number_that_is_not_finite_is_found_anywhere(wide: int) -> None:
    """Assert that 37 numbers are sound, and none of them may be infinite or undefined, in machine code and in Python."""
    n = 37
    arrays = {"y": np.linspace(-1e308 / 2, 1e308 / 2, n), "z": np.zeros(n), "at": np.full(len(AT), 7.0)}
    for call in (bound(doubles(n), abreast=wide, **arrays), partial(in_python(doubles(n)), **arrays)):
        arrays["y"][:] = np.linspace(-1e308 / 2, 1e308 / 2, n)
        call()
        assert arrays["at"][UNSOUND] == 0.0
        for place in range(n):
            for value in (1e308, -np.inf, np.nan):
                arrays["y"][:] = 1.0
                arrays["y"][place] = value
                call()
                assert np.isnan(arrays["at"][UNSOUND])


def test_neighbours_are_judged_side_by_side() -> None:
    """Assert that the sum has four numbers a pass, where one after the other waits for each addition."""
    assert "fadd <4 x double>" in llvm_of([doubles(37)], abreast=4).split("@doubles.inner")[1].split("fsub")[1]
    assert "fsub <4 x double>" not in llvm_of([doubles(3)], abreast=4)
