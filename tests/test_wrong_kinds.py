"""Every public verb given what it cannot use: a file's name for a run, nothing, a number, a mapping of nothing."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

import xdynamics as xd

VERBS = sorted(name for name in dir(xd) if inspect.isfunction(getattr(xd, name)))


@pytest.mark.parametrize("name", VERBS)
@pytest.mark.parametrize("given", ["run.nc", None, 3, {}], ids=repr)
@pytest.mark.filterwarnings("ignore")
def test_what_is_of_another_kind_is_refused_in_words(
    given: Any, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert an error of the package, or Python's own of an argument that is missing."""
    monkeypatch.chdir(tmp_path)
    verb = getattr(xd, name)
    needed = [
        parameter
        for parameter in inspect.signature(verb).parameters.values()
        if parameter.default is parameter.empty and parameter.kind is parameter.POSITIONAL_OR_KEYWORD
    ]
    if name == "validate" and given is None:
        return  # which is every method, as without an argument
    if name == "cluster" and given != {}:
        return  # a number of processes, none, and an address, which is asked when the cluster is entered
    with pytest.raises((xd.InputError, xd.ArchiveError, TypeError)) as caught:
        verb(*[given] * max(1, len(needed)))
    assert not isinstance(caught.value, TypeError) or "missing" in str(caught.value)
    assert not [*tmp_path.iterdir()]
