"""What every lazy stage has to do: describe itself without marching, march once, and give the bits of the eager one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import xarray as xr

from xdynamics.evidence.stage_tasks import REMEMBERED
from xdynamics.march import March

KNOWN_LATER = {
    *("runs", "companion_digest", "result", "linear_apart", "draws_needed", "extreme_rule", "extreme_time"),
    *("summary", "proven_until", "outcome", "outcome_text", "solver_steps", "solver_parts", "events_text"),
}
CIRCUMSTANCES = {"date_created", "history"}


def without_dates(result: xr.Dataset) -> xr.Dataset:
    """Return a result without what differs each time that it is made."""
    return result.assign_attrs(dict.fromkeys((*CIRCUMSTANCES, "volatile_digest"), ""))


@contextmanager
def marches() -> Iterator[list[str]]:
    """List the model and step of every march that begins, with nothing remembered of before."""
    REMEMBERED.shrink(0.0)
    begun: list[str] = []
    blocks = March.blocks

    def noted(march: March, *arguments: Any, **keywords: Any) -> Any:
        begun.append(f"{march.model.name} {march.settings.method.name} {march.settings.step}")
        return blocks(march, *arguments, **keywords)

    with mock.patch.object(March, "blocks", noted):
        yield begun


@contextmanager
def no_march() -> Iterator[None]:
    """Fail where a march begins."""

    def refused(march: March, *_: Any, **__: Any) -> Any:
        raise AssertionError(f"'{march.model.name}' is computed")

    with mock.patch.object(March, "blocks", refused):
        yield


def assert_described(stage: xr.Dataset, eager: xr.Dataset) -> None:
    """Assert names, dims, sizes, kinds and attributes of a lazy stage, which computes nothing for it."""
    assert list(stage.variables) == list(eager.variables)
    for name, variable in eager.variables.items():
        lazy = stage.variables[name]
        assert (lazy.dims, lazy.shape, lazy.dtype.kind) == (variable.dims, variable.shape, variable.dtype.kind), name
        assert repr(lazy.attrs) == repr(variable.attrs), name
    attributes = {**stage.attrs, **eager.attrs}
    apart = {name for name in attributes if repr(stage.attrs.get(name)) != repr(eager.attrs.get(name))}
    assert apart <= KNOWN_LATER | CIRCUMSTANCES


def assert_same_bits(stage: xr.Dataset, eager: xr.Dataset) -> None:
    """Assert every value of a lazy stage, computed at once, against the eager one's."""
    computed = stage.compute()
    for name, variable in eager.variables.items():
        values = computed.variables[name].values
        assert values.dtype == variable.dtype or values.dtype.kind == variable.dtype.kind == "U", name
        if values.dtype.kind in "UOT":
            assert values.tolist() == variable.values.tolist(), name
        else:
            assert values.tobytes() == variable.values.tobytes(), name
