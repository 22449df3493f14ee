"""The same bits of whole runs on other machines: another C library, processors with and without wide vectors."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from llvmlite import binding as llvm

from cases.problems import ROOT

# a model that uses every function of the language, another by two methods; constraints, a body, a controller, links
PROGRAM = """
import xdynamics as xd
every = xd.Model(
    name="every function", coordinates={"x": "1", "y": "1"}, states={"w": {"unit": "1", "rate": "c*(log(2 + cosh(x)) - w**1.7/3 + min(x, y, 0) + max(x, 0.1) + where(x > y, sqrt(abs(x)), 1))"}}, parameters={"k": "1 s-2", "c": "1 s-1"},
    mass={"x": "1", "y": "1"},
    forces={
        "first": {"x": "-k*(sin(x) + tanh(y) + 0.1*tan(y/2) + atan2(x, 2 + y) + sign(x)*hypot(x, y)/9)"},
        "second": {"y": "-k*(asin(x/9) + acos(y/9) - 1.5 + atan(y) + sinh(x/3)*exp(-x**2) + abs(y)**(1/3)*cos(3*y))"},
    },
    initial={"x": "1.1", "y": "0.3", "v_x": "0 s-1", "v_y": "-0.7 s-1", "w": "1"},
)
runs = [xd.simulate(every, method=one, until="20 s", **how) for one, how in (("dop853", {"rtol": 1e-9, "atol": 1e-9}), ("rk4", {"step": "10 ms"}), ("taylor", {"rtol": 1e-9, "atol": 1e-9}))]
for name in ("double_pendulum",):
    model = xd.Model.from_toml(f"data/models/{name}.toml")
    runs += [xd.simulate(model, method="dormand_prince", rtol=1e-8, atol=1e-8), xd.simulate(model, method="midpoint")]
for name, until in (("four_bar", "0.3 s"), ("heavy_top", "0.1 s"), ("cart_pid", "1 s")):  # constraints, a body, a controller
    runs.append(xd.simulate(xd.Model.from_toml(f"data/models/{name}.toml"), until=until))
cluster = xd.Model(
    name="every two of 18 bodies",
    dimensions={"body": 18, "axis": 2},
    coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
    parameters={"k": "1 N m2", "m": {"dims": ["body"], "unit": "kg", "value": [1 + i / 7 for i in range(18)]}},
    mass={"r": "m"},
    relations={"pair": {"of": "body"}},
    forces={"pull": {"over": "pair", "potential": "-k/norm(second(r, pair) - first(r, pair), axis)"}},
    initial={"r": "(index(body) + 1)*(index(body)*index(axis) + 1)*metre"},
)
runs.append(xd.simulate(cluster, method="taylor", rtol=1e-9, atol=1e-9, until="1 s"))
import hashlib
import numpy as np
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for
told = settings_for(every, method="dop853", rtol=1e-9, atol=1e-9, until="9 s", force_samples="none")
abreast = march_many(every, told, initial={"x": np.linspace(0.9, 1.3, 40)}, lanes=8)
print(*map(xd.content_digest, runs), hashlib.sha256(abreast.log_block.log.rows.tobytes() + abreast.ends.tobytes()).hexdigest())
"""
# together by default; each alone, which tells them apart, with --whole
ELSEWHERE = {
    "any x86-64, with a C library without AVX2 and fma": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
        "TARGET": "x86-64",
    },
    "a C library without AVX2 and fma": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"},
    "any x86-64": {"TARGET": "x86-64"},
    "AVX2": {"TARGET": "haswell"},
}
AT_A_TARGET = """
import os
from xdynamics.kernels import machine
if os.environ.get("TARGET"):
    machine.processor = lambda: ("", os.environ["TARGET"], "")
"""


def digests(**environment: str) -> str:
    """Digests of the runs, marched in a process of its own; code is kept by its processor."""
    done = subprocess.run(
        [sys.executable, "-c", AT_A_TARGET + PROGRAM],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, **environment},
    )
    return done.stdout


@pytest.fixture(scope="module")
def here() -> str:
    """What this machine gives, in this process."""
    with contextlib.chdir(ROOT), contextlib.redirect_stdout(io.StringIO()) as told:
        exec(PROGRAM, {})
    return told.getvalue()


@pytest.mark.every(2)
@pytest.mark.parametrize("where", ELSEWHERE)
def test_digests_are_the_same(where: str, here: str, request: pytest.FixtureRequest) -> None:
    """Assert equal digests of models with every function of the language, constraints, a body, a controller, and links side by side."""
    if len(ELSEWHERE[where]) == 1 and not request.config.getoption("--whole"):
        pytest.skip("with --whole: one difference alone")
    if not llvm.get_process_triple().startswith("x86_64"):
        pytest.skip("another architecture")
    if where == "AVX2" and not llvm.get_host_cpu_features().get("avx2"):
        pytest.skip("this machine has no AVX2")
    assert len(here.split()) == 10
    assert digests(**ELSEWHERE[where]) == here


CERTIFIED = """
import sys
import xdynamics as xd
ball = xd.Model.from_toml("data/models/ball_drag.toml")
if len(sys.argv) > 2:
    xd.recheck(sys.argv[1])
else:
    xd.save(xd.certify(ball, "y", at="1 s", draws=200, method="dop853", rtol=1e-6), sys.argv[1])
"""
NARROW = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR AVX2 FMA3 AVX512F AVX512_SKX",
} | ELSEWHERE["a C library without AVX2 and fma"]


@pytest.mark.dear
def test_a_certificate_comes_out_again_elsewhere(tmp_path: Path) -> None:
    """Assert every bit of a budget, draws and verdicts where numpy, BLAS and the C library have no wide vectors."""
    for more in ([], ["again"]):
        environment = {**os.environ, **(NARROW if more else {})}
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", CERTIFIED, str(tmp_path / "c.nc"), *more],
            check=True,
            cwd=ROOT,
            env=environment,
        )
