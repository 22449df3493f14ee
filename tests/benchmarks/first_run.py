"""What a model costs when it is simulated for the first time: its law is written and compiled, the engine is at hand.

python tests/benchmarks/first_run.py [folder]

Compiled code is kept in the folder, which is to be a private one; without it in a new one, and the engine is compiled
there first. Every case is a process of its own: seconds of its first short simulation, less those of its second. Once
with no law in the folder and once with the law of the process before, which leaves writing the law and loading code.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import xdynamics as xd
from xdynamics.faults import InputError
from xdynamics.kernels import machine
from xdynamics.march.configuration import settings_for
from xdynamics.methods import METHODS

MODELS = Path(__file__).parents[2] / "data" / "models"
MASSES = 100
CHAIN = "chain"
CHAIN_METHODS = ("velocity_verlet", "dop853")
PENDULUM = "double_pendulum"
STEP, UNTIL = "0.1 ms", "1 ms"  # all start at 0 s


def chain() -> xd.Model:
    """Return masses on springs between two walls, the first displaced; each force is an expression by component."""
    names = [f"u{i}" for i in range(MASSES)]
    ends = ["0", *names, "0"]
    pulls = {
        name: f"k*(({right}) - {name}) - k*({name} - ({left}))"
        for left, name, right in zip(ends[:-2], names, ends[2:], strict=True)
    }
    start = dict.fromkeys(names, "0 m") | {f"v_{name}": "0 m s-1" for name in names} | {"u0": "0.1 m"}
    return xd.Model(
        name="chain of masses on springs",
        coordinates={name: {"unit": "m"} for name in names},
        parameters={"m": "1 kg", "k": "100 N m-1"},
        mass=dict.fromkeys(names, "m"),
        forces={"springs": pulls},
        initial=start,
    )


def model_of(name: str) -> xd.Model:
    """Return a model by the name of its file, or the chain."""
    return chain() if name == CHAIN else xd.Model.from_toml(MODELS / f"{name}.toml")


def asked_of(method: str) -> dict[str, Any]:
    """Return the keywords of a short simulation; an empty method is the model's own."""
    return {"step": STEP, "until": UNTIL} | ({"method": method} if method else {})


def cases() -> list[tuple[str, str]]:
    """Return models and methods: each model with its own, the double pendulum with all explicit ones that take it."""
    found = [(path.stem, "") for path in sorted(MODELS.glob("*.toml"))]
    pendulum = model_of(PENDULUM)
    for method in METHODS.values():
        if method.solves:
            continue
        try:
            settings_for(pendulum, **asked_of(method.name))
        except InputError:
            continue
        found.append((PENDULUM, method.name))
    return found + [(CHAIN, method) for method in CHAIN_METHODS]


def simulated(name: str, method: str) -> dict[str, Any]:
    """Simulate twice in this process; return the seconds of both and the method."""
    model, seconds = model_of(name), []
    for _ in range(2):
        begin = time.perf_counter()
        xd.simulate(model, **asked_of(method))
        seconds.append(time.perf_counter() - begin)
    return {"seconds": seconds, "method": settings_for(model, **asked_of(method)).method.name}


def measured(name: str, method: str) -> dict[str, Any]:
    """Simulate in a process of its own."""
    words = [sys.executable, str(Path(__file__).resolve()), "--as-case", name, method]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1]) | {"warnings": done.stderr.strip()}


def kept_laws() -> list[Path]:
    """Return the files of laws in the folder."""
    return [path for kind in ("law", "form") for path in machine.folder().glob(f"{kind}-*.o")]


def remove_laws() -> None:
    """Remove every law that is kept in the folder, by its text or by its form; the engine stays."""
    for path in kept_laws():
        path.unlink()


def rows() -> list[str]:
    """Measure all cases; return a line for each."""
    lines = [f"{'':22} {'':20} {'no law kept':>12} {'law kept':>9} {'second run':>11} {'law':>8}"]
    for name, method in cases():
        remove_laws()
        new, kept = measured(name, method), measured(name, method)
        first, again = (one["seconds"][0] - one["seconds"][1] for one in (new, kept))
        size = sum(path.stat().st_size for path in kept_laws())
        second = min(new["seconds"][1], kept["seconds"][1])
        lines.append(
            f"  {name:20} {new['method']:20} {first:10.3f} s {again:7.3f} s {1e3 * second:8.1f} ms {size / 1024:4.0f} KiB"
            f"{'  (' + new['warnings'] + ')' if new['warnings'] else ''}"
        )
    return lines


def main() -> None:
    """Print the table."""
    if sys.argv[1:2] == ["--as-case"]:
        print(json.dumps(simulated(*sys.argv[2:4])))
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ[machine.ENVIRONMENT] = sys.argv[1] if len(sys.argv) > 1 else folder
        begin = time.perf_counter()
        measured(PENDULUM, "heun")  # compiles the engine where it is not at hand
        print(f"a whole process before, which leaves the engine in the folder: {time.perf_counter() - begin:.1f} s")
        print("seconds of the first simulation of a process, less those of its second")
        print(*rows(), sep="\n")


if __name__ == "__main__":
    main()
