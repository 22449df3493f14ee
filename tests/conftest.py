"""matplotlib without a screen; hypothesis without a clock; some of each class of random cases, or all."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer the whole of every class of random cases."""
    parser.addoption("--whole", action="store_true", help="all random cases of each class, not every 23rd")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give a test marked `cases(n)` the numbers of its random cases: every 23rd, or all with --whole.

    A prime, so that a test which goes by `case % 2`, or by another small number, meets all of its kinds.
    """
    marker = metafunc.definition.get_closest_marker("cases")
    if marker is not None:
        count = marker.args[0]
        metafunc.parametrize("case", range(0, count, 1 if metafunc.config.getoption("--whole") else 23))
