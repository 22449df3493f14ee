"""One matplotlib without a screen, and one run of each archived model for all tests."""

from __future__ import annotations

import os

os.environ.setdefault("MPLBACKEND", "Agg")
