"""What each verb costs on models with dimensions as they grow: processor seconds of a chain and of bodies.

python tests/benchmarks/shaped_verbs.py [chain|bodies [N ...]] [--verb NAME]...

Chains of springs, and bodies that all attract each other, marched for eleven rows with all columns. Each size is a process of
its own, in which every verb was called once on three elements before, so that what is loaded once is not counted; laws that
no cache holds are. A verb that takes longer than a minute is stopped.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from many_bodies import CHAIN, CLUSTER

import xdynamics as xd

SIZES = {"chain": (10, 100, 1000, 10_000), "bodies": (10, 100, 1000)}
ELEMENT = {"chain": "u[1]", "bodies": "r[1, x]"}
START = {"chain": "v_u[1]", "bodies": "v_r[1, x]"}
SECONDS = 60
VIBRATION = """[initial]
u = "0.1*metre*cos(pi*(index(site) + 0.5)/size(site))"
[validation.u]
expression = "0.1*metre*cos(pi*(index(site) + 0.5)/size(site))*cos(2*sqrt(k/m)*sin(pi/(2*size(site)))*t)"
bound = "1 cm"
"""
METHOD: dict[str, Any] = {"method": "velocity_verlet", "step": "0.1 s", "until": "1 s"}
AT = ["0.43 s", "1 s"]


def text_of(kind: str, n: int) -> str:
    """Return a model as text; one parameter is uncertain."""
    if kind == "chain":
        text = CHAIN.format(n=n).replace('k = "4 N m-1"', 'k = { value = 4.0, unit = "N m-1", uncertainty = 0.1 }')
        text = text[: text.index("[initial]")] + VIBRATION
    else:
        text = CLUSTER.format(n=n, start=(np.random.default_rng(n).uniform(-1.0, 1.0, (n, 3)) * n).tolist())
    return text + "\n[run]\n" + "\n".join(f'{key} = "{value}"' for key, value in METHOD.items())


class Case:
    """A model with its run, which every verb is called on."""

    def __init__(self, kind: str, n: int, folder: Path) -> None:
        self.kind, self.n, self.folder = kind, n, folder
        self.model = xd.Model.from_text(text_of(kind, n))
        self.run = xd.simulate(self.model, **METHOD, log="full")

    def data(self) -> Any:
        """Return measurements of one element."""
        element = ELEMENT[self.kind]
        rows = (f"{time},{0.1 * time},0.01" for time in np.linspace(0.1, 1.0, 6).tolist())
        path = self.folder / "measured.csv"
        path.write_text("\n".join([f'time [s],"{element} [m]","u({element}) [m]"', *rows]))
        return path


VERBS: dict[str, Callable[[Case], Any]] = {
    "simulate": lambda case: xd.simulate(case.model, **METHOD, log="full"),
    "save": lambda case: xd.save(case.run, case.folder / "run.nc"),
    "verify": lambda case: xd.verify(case.folder / "run.nc"),
    "reproduce": lambda case: xd.reproduce(case.folder / "run.nc"),
    "sample": lambda case: xd.sample(case.run, [0.43, 1.0]),
    "companion": lambda case: xd.companion(case.run),
    "compare": lambda case: xd.compare(
        case.run, xd.simulate(case.model, **METHOD | {"step": "0.05 s"}, log="full"), times=[0.43, 1.0]
    ),
    "refine": lambda case: xd.refine(case.model, method="velocity_verlet", steps=["0.1 s", "0.05 s", "0.025 s"], at=AT),
    "diagnose": lambda case: xd.diagnose(case.run),
    "validate": lambda case: xd.validate(methods=["velocity_verlet"], model=case.model),
    "budget": lambda case: xd.error_budget(case.model, quantity=ELEMENT[case.kind], at="1 s", **METHOD),
    "sweep": lambda case: xd.sweep(
        case.model, {"step": ["0.1 s", "0.05 s"]}, keep=["end", "log"], times=[0.43, 1.0], path=case.folder / "sweep"
    ),
    "fit": lambda case: xd.fit(case.model, case.data(), [START[case.kind]]),
    "modes": lambda case: xd.modes(case.model) if case.kind == "chain" else None,
    "plot": lambda case: xd.plot(case.run, case.folder / "run.png"),
    "report": lambda case: xd.report(case.folder / "report", run=case.run),
    "animate": lambda case: case.run.dynamics.animate(case.folder / "run.gif"),
}


def stopped(*_: object) -> None:
    """Stop a verb."""
    raise TimeoutError


def measured(kind: str, n: int, names: list[str]) -> None:
    """Print what each verb takes, as it ends."""
    signal.signal(signal.SIGALRM, stopped)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "few").mkdir()
        few, case = Case(kind, 3, Path(folder) / "few"), Case(kind, n, Path(folder))
        for needed in (few, case):
            xd.save(needed.run, needed.folder / "run.nc")
        for name in names:
            with suppress(Exception):
                VERBS[name](few)
            begin = time.process_time()
            signal.alarm(SECONDS)
            try:
                VERBS[name](case)
            except TimeoutError:
                note = f"> {SECONDS}"
            except Exception as error:  # noqa: BLE001 - whatever a verb says goes into the table
                note = f"{type(error).__name__}: {error}"[:200]
            else:
                note = f"{time.process_time() - begin:.3f}"
            finally:
                signal.alarm(0)
            print(json.dumps([name, note]), flush=True)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[:1] == ["--measure"]:
        measured(arguments[1], int(arguments[2]), arguments[3:])
        raise SystemExit
    names = [*VERBS]
    while "--verb" in arguments:
        place = arguments.index("--verb")
        names = [*(names if len(names) < len(VERBS) else []), arguments[place + 1]]
        del arguments[place : place + 2]
    kinds = arguments[:1] or [*SIZES]
    for kind in kinds:
        for n in [int(text) for text in arguments[1:]] or SIZES[kind]:
            print(f"{kind} of {n}")
            subprocess.run([sys.executable, __file__, "--measure", kind, str(n), *names], check=False)
