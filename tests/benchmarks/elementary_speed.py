"""Elementary functions: largest error in ulp against mpmath, and time beside the C library's, alone and in lanes.

python tests/benchmarks/elementary_speed.py [arguments]

The error is sought over so many arguments of each function, 5,000 unless told otherwise. Times are nanoseconds a value
over arrays of 4,096 ordinary arguments, the least of many repeats, with vectorisation of the loop switched off: one
value after the other. Then whole steps of models by methods, in lanes.
"""

from __future__ import annotations

import ctypes
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding as llvm

sys.path.insert(0, str(Path(__file__).parents[1]))
import xdynamics as xd
from cases.bench import Bench
from cases.elementary_loops import NAMES, count, loops
from cases.problems import MODELS, arguments_of, true_value, ulps
from xdynamics.elementary import FUNCTIONS
from xdynamics.kernels import law_of, layout_of, machine
from xdynamics.methods.scheme import Scheme

LANES = (1, 2, 4, 8, 16)
WITHIN = {"asin": (-1, 1), "acos": (-1, 1), "log": (0.01, 100), "power": (0.1, 10), "exp": (-10, 10)}
SIZE = 4096
STEPS = (("kepler", "dop853"), ("double_pendulum", "dop853"), ("pendulum", "dop853"))


def unvectorised(text: str) -> bytes:
    """Compile without making vectors of loops."""
    module = llvm.parse_assembly(text)
    module.triple = llvm.get_process_triple()
    target = machine._target_machine()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = options.slp_vectorization = options.loop_unrolling = False
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(module, builder)
    return bytes(target.emit_object(module))


def library() -> str:
    """The same loops over the C library's functions."""
    text = loops(1)
    for name in NAMES:
        own = "pow" if name == "power" else name
        text = text.replace(f"call double @elementary_{name}(", f"call double @{own}(").replace(
            f"@run_{name}(", f"@library_{name}("
        )
        text += f"\ndeclare double @{own}({', '.join(['double'] * count(name))})"
    return text


def nanoseconds(address: int, given: list[Any]) -> float:
    """Time one pass over arrays."""
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, ctypes.c_int64)(address)
    found = np.empty(SIZE)
    best = np.inf
    for _ in range(100):
        begin = time.perf_counter()
        call(given[0].ctypes.data, given[-1].ctypes.data, found.ctypes.data, SIZE)
        best = min(best, time.perf_counter() - begin)
    return best / SIZE * 1e9


def per_call(address: int, given: list[int]) -> float:
    """Seconds of one call of a program, the least of some rounds."""
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(address)
    best = np.inf
    for _ in range(20):
        begin = time.perf_counter()
        for _ in range(2000):
            call(*given)
        best = min(best, time.perf_counter() - begin)
    return best / 2000


def step_times(model_name: str, method: str) -> list[float]:
    """Nanoseconds a step of one run, with 1 to 16 lanes."""
    chosen = xd.METHODS[method]
    law = law_of(
        layout_of(
            xd.Model.from_toml(MODELS / f"{model_name}.toml"), Scheme(chosen, "embedded" if chosen.estimate else "none")
        ),
        sampled=False,
    )
    initial = np.array([law.layout.model.initial[name].si for name in law.layout.used])
    found = []
    for lanes in LANES:
        states = initial[:, None] * (1 + 1e-3 * np.arange(lanes))
        bench = Bench(law, lanes, states, np.full(lanes, 1e-3))
        code = law.compiled(lanes)
        given = [one.ctypes.data for one in (bench.table, bench.y, bench.z, bench.samples)]
        # a program that computes nothing tells what a call costs from here
        step, call = (per_call(code.addresses[name], given) for name in ("propose", "detect"))
        found.append((step - call) / lanes * 1e9)
    return found


def main() -> None:
    """Print the tables."""
    each = int(sys.argv[1]) // 5 if len(sys.argv) > 1 else 1000
    random = np.random.default_rng(1)
    codes = {lanes: machine.Code(unvectorised(loops(lanes)), [f"run_{name}" for name in NAMES]) for lanes in LANES}
    other = machine.Code(unvectorised(library()), [f"library_{name}" for name in NAMES])
    print(f"{'':8s}{'ulp':>7s}   ns: libm   1 lane       " + "".join(f"{lane:8d}" for lane in LANES[1:]) + " lanes")
    for name in NAMES:
        with np.errstate(all="ignore"):
            hard = arguments_of(name, each)
            found = FUNCTIONS[name](*hard)
        worst = max(ulps(float(one), true_value(name, *map(float, at))) for one, *at in zip(found, *hard, strict=True))
        given = [random.uniform(*WITHIN.get(name, (-10, 10)), SIZE), random.uniform(-5, 5, SIZE)][: count(name)]
        own = [nanoseconds(codes[lanes].addresses[f"run_{name}"], given) for lanes in LANES]
        libm = nanoseconds(other.addresses[f"library_{name}"], given)
        print(
            f"{name:8s}{worst:7.3f}{libm:11.2f}{own[0]:9.2f} ({own[0] / libm:.2f})"
            + "".join(f"{one:8.2f}" for one in own[1:]),
            flush=True,
        )
    print("\nns a step of one run, in lanes" + "".join(f"{lane:9d}" for lane in LANES))
    for model, method in STEPS:
        times = step_times(model, method)
        print(
            f"{model + ', ' + method:30s}"
            + "".join(f"{one:9.1f}" for one in times)
            + f"   1 to 16: {times[0] / times[-1]:.1f} times"
        )


if __name__ == "__main__":
    main()
