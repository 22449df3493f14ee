"""Records that are no whole run: how one is known, and what is said of it."""

from __future__ import annotations

import re
from typing import Any

import pytest

from xdynamics.faults import InputError
from xdynamics.record.schemas import is_derived, is_selection, is_whole, kind_description, left_out_atols

DERIVED = {"derived": "halved", "derived_from": "0a"}
SELECTION = {"selection_of": "0b", "selection": "3 of 9 rows of 'step'"}


@pytest.mark.parametrize(
    ("attributes", "kinds", "said"),
    [
        ({"title": "a run"}, (False, False, True), ""),
        (DERIVED, (True, False, False), "derived data, no run: halved; from run 0a"),
        ({"derived": "halved"}, (True, False, False), "derived data, no run: halved; from run unknown"),
        (SELECTION, (False, True, False), "a selection of run 0b: 3 of 9 rows of 'step'"),
        ({"selection_of": "0b"}, (False, True, False), "a selection of run 0b: a part"),
        (SELECTION | DERIVED, (True, False, False), "derived data, no run: halved; from run 0a"),
    ],
)
def test_a_record_is_of_one_kind_and_says_so(attributes: Any, kinds: tuple[bool, ...], said: str) -> None:
    """Assert that derived data, selections and runs are told apart; what is both is derived."""
    assert (is_derived(attributes), is_selection(attributes), is_whole(attributes)) == kinds
    assert kind_description(attributes) == said


def test_tolerances_of_what_was_left_out_come_back() -> None:
    """Assert numbers and units by name, and none where nothing was left out."""
    assert left_out_atols({"selection_atol_si": '{"x": [1e-9, "m"], "w": [2, "rad s-1"]}'}) == {
        "x": (1e-9, "m"),
        "w": (2.0, "rad s-1"),
    }
    assert left_out_atols({}) == {}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"x": 1}', '{"x": [1]}', '{"x": ["much", "m"]}', 5, "[" * 100_000])
def test_tolerances_that_were_not_written_so_are_named(text: object) -> None:
    """Assert one error with the first 40 characters of the attribute."""
    said = f"attribute 'selection_atol_si' is {str(text)[:40]!r}, needs tolerances and units by name"
    with pytest.raises(InputError, match=f"^{re.escape(said)}$"):
        left_out_atols({"selection_atol_si": text})
