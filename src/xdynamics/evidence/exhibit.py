"""A piece of evidence as one Dataset: what it is, from which runs, and every number with its unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xdynamics import archive
from xdynamics.record.provenance import circumstances
from xdynamics.schema import AT_TIME, CONVENTIONS, EVIDENCE, RUNS, SCHEMA_VERSION

if TYPE_CHECKING:
    import xarray as xr


def exhibit(
    kind: str,
    title: str,
    runs: Sequence[str],
    variables: Mapping[str, Any],
    attributes: Mapping[str, Any],
    unchanged: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Put evidence together, ready to be saved.

    Parameters
    ----------
    kind : str
        One word for what it is: ``refinement``, ``comparison`` …
    title : str
    runs : sequence of str
        Content digests of the runs that it was made from.
    variables : mapping of str to (dims, values, attributes)
        Each with `units`, `long_name` and `role`.
    attributes : mapping
        What else is said of the whole.
    unchanged : mapping, optional
        For lazy variables what tells whether values came of them; see `archive.marched`.
    """
    import xarray as xr

    coordinates = [name for name in (AT_TIME, "time") if name in variables]
    found = xr.Dataset({name: xr.Variable(*one) for name, one in variables.items()}).set_coords(coordinates)
    about = {
        "Conventions": CONVENTIONS,
        "title": title,
        "source": f"{kind} by xdynamics",
        "schema_version": SCHEMA_VERSION,
        EVIDENCE: kind,
        RUNS: " ".join(runs),
    }
    found.attrs = about | dict(attributes) | circumstances(f"{kind} made")
    return archive.marched(found, unchanged)


def about(units: str, said: str, role: str) -> dict[str, Any]:
    """Return the attributes of a variable."""
    return {"units": units, "long_name": said, "role": role}
