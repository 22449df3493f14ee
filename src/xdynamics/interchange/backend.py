"""`xarray.open_dataset(path, engine="xdynamics")`: an archive as `open_run` opens it, verified."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar

from xarray.backends import BackendEntrypoint

if TYPE_CHECKING:
    import xarray as xr


class ArchiveBackend(BackendEntrypoint):
    """Opens archives of xdynamics; it is used by name only, and does not guess."""

    description = "Archives of xdynamics, verified against their seals and digests"
    url = "https://docs.xarray.dev/en/stable/internals/how-to-add-new-backend.html"
    open_dataset_parameters: ClassVar[tuple[str, ...]] = ("filename_or_obj", "drop_variables", "group")

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None, group: str | None = None
    ) -> xr.Dataset:
        """Open an archive, or a node of its tree: ``group="events"``.

        Raises
        ------
        InputError, ArchiveError
            As of `open_run`; or if there is no such node.
        """
        import xdynamics.interchange.accessor  # noqa: F401 - `run.dynamics`
        from xdynamics.archive import open_run

        if group is not None and group.strip("/"):
            from xdynamics.interchange.tree import tree_node

            return tree_node(self.open_datatree(filename_or_obj, drop_variables=drop_variables), group)
        run = open_run(filename_or_obj)
        left_out = [drop_variables] if isinstance(drop_variables, str) else [*(drop_variables or ())]
        return run.drop_vars(left_out, errors="ignore") if left_out else run

    def open_datatree(self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None) -> xr.DataTree:
        """Open an archive as a tree of plain tables; see `xdynamics.interchange.tree`.

        Raises
        ------
        InputError, ArchiveError
            As of `open_run`.
        """
        from xdynamics.interchange.tree import tree

        return tree(self.open_dataset(filename_or_obj, drop_variables=drop_variables))

    def guess_can_open(self, filename_or_obj: Any) -> bool:  # noqa: ARG002 - xarray's own signature
        """Guess at nothing: a netCDF file is opened by its own engine where none is named."""
        return False
