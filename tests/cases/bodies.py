"""Bodies that turn, for tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import xdynamics as xd

FRAME: dict[str, Any] = {
    "mass": "2 kg",
    "inertia": ["1 kg m2", "2 kg m2", "2.5 kg m2"],
    "points": {"tip": ["0 m", "0 m", "0.3 m"]},
}


def of_body(more: Mapping[str, Any] | None = None, **sections: Any) -> xd.Model:
    """Make a model of one body, with other keys of it and other sections; a key that is None is left out."""
    frame = {key: value for key, value in (FRAME | dict(more or {})).items() if value is not None}
    return xd.Model(name="body", bodies={"frame": frame}, **sections)
