"""matplotlib without a screen; hypothesis without a clock, on machines that are shared."""

from __future__ import annotations

import os

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")
