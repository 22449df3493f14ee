"""Bit digests of the golden archives and of every model of `data/models` by each method that takes it.

`python tests/cases/digests.py FILE` writes a line for each run: what is compared is made with the code of the parent
commit (`PYTHONPATH=.../src`), and `python tests/cases/digests.py --compare BEFORE AFTER` lists what changed.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

ROOT = Path(__file__).parents[2]
MOST_STEPS = 4000  # of a run, which then ends with what it has


def digest(run: xr.Dataset) -> str:
    """Return a digest of the numbers of a run: names, shapes and bytes, without attributes."""
    total = hashlib.sha256()
    for name in sorted(map(str, run.variables)):
        values = np.asarray(run[name].values)
        if values.dtype.kind in "biuf":
            total.update(f"{name} {values.dtype.str} {values.shape}".encode() + np.ascontiguousarray(values).tobytes())
    return total.hexdigest()


def marched(path: str, method: str) -> dict[str, Any]:
    """March a model by a method, with steps by tolerance where it has an estimate, and return what came of it."""
    import xdynamics as xd

    warnings.simplefilter("ignore")
    line: dict[str, Any] = {"model": Path(path).stem, "method": method}
    try:
        model = xd.Model.from_toml(path)
        settings = {"method": method, "max_steps": MOST_STEPS}
        if "step" not in model.run:
            settings["rtol"] = model.run.get("rtol", 1e-6)
        run = xd.simulate(model, **settings)
    except xd.InputError as error:
        return line | {"refused": str(error)[:200]}
    return line | {"outcome": run.attrs["run_outcome"], "rows": run.sizes["step"], "digest": digest(run)}


def reproduced(path: str) -> dict[str, Any]:
    """Reproduce an archive, and return whether its bits are the same."""
    import xdynamics as xd

    warnings.simplefilter("ignore")
    again = xd.reproduce(path)
    return {"archive": Path(path).stem, "identical": int(again.attrs["identical"])}


def lines() -> Iterator[dict[str, Any]]:
    """Yield a line for every archive, then for every model and method."""
    import xdynamics as xd

    archives = sorted((ROOT / "data/golden").glob("*/*.nc"))
    models = sorted((ROOT / "data/models").glob("*.toml"))
    with ProcessPoolExecutor(2) as pool:
        yield from pool.map(reproduced, map(str, archives))
        pairs = [(str(path), method) for path in models for method in sorted(xd.METHODS)]
        yield from pool.map(marched, *zip(*pairs, strict=True))


def key(line: dict[str, Any]) -> str:
    """Name the run of a line."""
    return line.get("archive") or f"{line['model']} {line['method']}"


def main(arguments: list[str]) -> None:
    """Write the digests, or compare two files of them."""
    if arguments[0] == "--compare":
        before, after = (
            {key(line): line for line in map(json.loads, Path(name).read_text().splitlines())} for name in arguments[1:]
        )
        changed = [name for name in before.keys() | after.keys() if before.get(name) != after.get(name)]
        for name in sorted(changed):
            print(f"{name}:\n  before {before.get(name)}\n  after  {after.get(name)}")
        print(f"{len(changed)} of {len(before)} changed")
        return
    with Path(arguments[0]).open("w") as file:
        for line in lines():
            file.write(json.dumps(line) + "\n")
            file.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
