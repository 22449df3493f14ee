"""When and on what machine something was done: recorded, and in no digest of content."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pass


@lru_cache
def _versions_and_processor() -> dict[str, str]:
    """Return versions and processor: volatile, and in no digest of content."""
    import platform
    from importlib.metadata import version

    from llvmlite import binding

    from xdynamics.march.engine import engine_origin

    features = binding.get_host_cpu_features()
    versions = {f"{name}_version": version(name) for name in ("numpy", "numba", "llvmlite", "xarray", "xdynamics")}
    return versions | {
        "engine_origin": engine_origin(),
        "python_version": platform.python_version(),
        "cpu_name": binding.get_host_cpu_name(),
        "cpu_features": " ".join(sorted(name for name, enabled in features.items() if enabled)),
    }


def xdynamics_version() -> str:
    """Return the version of this program."""
    return _versions_and_processor()["xdynamics_version"]


def circumstances(done: str) -> dict[str, Any]:
    """Return when and on what machine something was done; no digest of content includes it."""
    from datetime import UTC, datetime

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    machine = _versions_and_processor()
    history = f"{now} {done} by xdynamics {machine['xdynamics_version']}"
    return {"date_created": now, "history": history} | machine
