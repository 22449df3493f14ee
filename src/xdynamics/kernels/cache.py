"""Generated source in real files, so that numba keeps the machine code from one process to the next."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from xdynamics.faults import ModelError
from xdynamics.kernels.compiling import compiled
from xdynamics.kernels.writer import PYTHON

ENVIRONMENT = "XDYNAMICS_CACHE"


def source_digest(source: str) -> str:
    """sha256 of generated source: the revision of the force function."""
    return hashlib.sha256(source.encode()).hexdigest()


def compile_march(source: str, functions: Mapping[str, Callable[..., float]]) -> Callable[..., Any]:
    """Return the compiled `run` of generated source.

    Parameters
    ----------
    source : str
        What `write_source` wrote.
    functions : mapping of str to callable
        The Python functions that the source calls; with any, nothing is kept on disk.
    """
    digest = hashlib.sha256((source + _engine_digest()).encode()).hexdigest()
    name = f"xdynamics_march_{digest[:32]}"
    module = _from_memory(name, source, functions) if functions else sys.modules.get(name) or _from_file(name, source)
    run: Callable[..., Any] = module.run
    return run


def cache_folder() -> Path:
    """Return the folder of generated files: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if chosen := os.environ.get(ENVIRONMENT):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "xdynamics"


def _from_file(name: str, source: str) -> ModuleType:
    path = _written(cache_folder(), name, source) or _written(Path(tempfile.mkdtemp(prefix="xdynamics_")), name, source)
    assert path is not None  # noqa: S101 - a fresh temporary folder can be written
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None  # noqa: S101
    assert spec.loader is not None  # noqa: S101
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _written(folder: Path, name: str, source: str) -> Path | None:
    """Write the file unless it is there; None where the folder cannot be written."""
    path = folder / f"{name}.py"
    try:
        if path.exists() and path.read_text() == source:
            return path
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".part", delete=False) as part:
            part.write(source)
        Path(part.name).replace(path)
    except OSError:
        return None
    return path


def _from_memory(name: str, source: str, functions: Mapping[str, Callable[..., float]]) -> ModuleType:
    module = ModuleType(name)
    for key, function in functions.items():
        setattr(module, PYTHON + key, function if hasattr(function, "py_func") else compiled(function))
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)  # noqa: S102 - written by `writer`, from checked trees
    return module


@lru_cache
def _engine_digest() -> str:
    """sha256 of the rooms whose code is compiled into a march."""
    package = Path(__file__).parents[1]
    files = sorted([*(package / "kernels").glob("*.py"), *(package / "march").glob("*.py")])
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def missing_functions(names: list[str], functions: Mapping[str, Any]) -> None:
    """Refuse to march a model whose Python functions are not at hand.

    Raises
    ------
    ModelError
        Naming them.
    """
    missing = [name for name in names if name not in functions]
    if missing:
        raise ModelError(
            f"the forces call the Python functions {', '.join(missing)}; hand them over as functions={{name: function}}"
        )
