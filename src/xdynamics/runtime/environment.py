"""Settings of a process from its environment variables."""

from __future__ import annotations

import os


def megabytes(variable: str, default: float) -> float:
    """Return how many MB an environment variable allows, or the default if it is not set or no size."""
    try:
        limit = float(os.environ.get(variable, default))
    except ValueError:
        return default
    return limit if limit >= 0.0 else default
