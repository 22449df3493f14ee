"""How much memory a process can have, and sizes in words."""

from __future__ import annotations

from pathlib import Path

UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
ROOM = 0.8  # of the free memory, which may be asked for


def free_memory() -> float:
    """Return how many bytes of memory this process can have: what the system says is available, or its own limit."""
    available = float("inf")
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        available = next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError):  # no Linux: nothing is known
        pass
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        used = 4096.0 * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        available = min(available, limit - used) if limit != resource.RLIM_INFINITY else available
    except (ImportError, OSError, ValueError):
        pass
    return max(available, 0.0)


def size_text(size: float) -> str:
    """Write a size in words.

    Examples
    --------
    >>> size_text(1.5e9), size_text(3.2e15), size_text(12.0)
    ('1.5 GB', '3200 TB', '12 B')
    """
    unit = next((name for name in reversed(UNITS) if size >= UNITS[name]), "B")
    return f"{float(f'{size / UNITS[unit]:.2g}'):g} {unit}"
