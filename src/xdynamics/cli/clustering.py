"""Options of the verbs that march many runs: on which cluster, or on how many processes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from xdynamics.cli.command import progress

if TYPE_CHECKING:
    import xarray as xr


def clustered(verb: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a cluster; the verb receives `scheduler` and `workers`."""
    options = (
        click.option(
            "--scheduler", metavar="tcp://…", help="The dask cluster to march on; see `xdynamics help cluster`."
        ),
        click.option(
            "--workers",
            type=click.IntRange(1),
            metavar="N",
            help="Processes to start on this machine, and to march on.",
        ),
    )
    for option in reversed(options):
        verb = option(verb)
    return verb


def goes_on(folder: str) -> str:
    """Return what an interrupted command says of a folder of results."""
    return f"what is done is kept in '{folder}', and the same command goes on with it"


KEPT = click.option(
    "--keep",
    metavar="FOLDER",
    help="Keep each result in this folder as soon as it is known: the same command goes on with the others.",
)


def make_evidence(
    make: Callable[..., xr.Dataset], *arguments: Any, scheduler: str | None, workers: int | None, **options: Any
) -> xr.Dataset:
    """Make evidence here, or as a graph on a cluster, with progress.

    Raises
    ------
    InputError
        If the evidence cannot be made, or the cluster cannot be reached or is gone.
    """
    from xdynamics.evidence.cluster import cluster_of
    from xdynamics.evidence.stages import compute_datasets

    resume_hint = [goes_on(options["keep"])] if options.get("keep") else []
    with cluster_of(scheduler, workers) as client:
        if client is None:
            try:
                return make(*arguments, **options)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(*resume_hint) from None
        stage = make(*arguments, compute=False, **options)
        with progress("{count} tasks done") as tell:
            try:
                return compute_datasets(stage, tell=tell)[0]
            except KeyboardInterrupt:
                raise KeyboardInterrupt("the cluster was told to drop what was asked of it", *resume_hint) from None
