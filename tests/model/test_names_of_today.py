"""Names that records have since schema 2: no new model has them, and archives with them open and run as they did."""

from __future__ import annotations

import pytest

import xdynamics as xd

SPRING = """
name = "spring"
[coordinates]
x = "m"
[parameters]
m = "1 kg"
k = "4 N m-1"
{name} = "2 m"
[mass]
x = "m"
[forces.spring]
x = "-k*x"
[initial]
x = "1 m"
v_x = "0 m s-1"
"""
REFUSED = (
    "closed_time",
    "at_time",
    "document",
    "energy_balance",
    "energy_balance_verdict",
    "work_spring",
    "solver_mine",
    "switch_share_spring_abs",
)


@pytest.mark.parametrize("name", REFUSED)
def test_a_name_of_records_is_refused(name: str) -> None:
    """Assert one line that names it, in a file and from Python, and that a record with it is read."""
    text = SPRING.format(name=name)
    with pytest.raises(xd.ModelError, match=f"parameter '{name}': the record of a run has that name; rename it"):
        xd.Model.from_text(text)
    assert name in xd.Model.from_record(text).statement.parameters


@pytest.mark.parametrize("name", ["document", "point", "member"])
def test_a_dimension_of_records_is_refused(name: str) -> None:
    """Assert one line that names it."""
    with pytest.raises(xd.ModelError, match=f"dimension '{name}'"):
        xd.Model(
            name="two",
            dimensions={name: 2},
            states={"y": {"unit": "1", "rate": "-y/(1*second)", "dims": [name]}},
            initial={"y": "1"},
        )


@pytest.mark.parametrize("name", ["work_done", "step_length", "work_of_spring", "share"])
def test_names_beside_them_are_free(name: str) -> None:
    """Assert that what only resembles them is a name as every other."""
    assert name in xd.Model.from_text(SPRING.format(name=name)).statement.parameters


@pytest.mark.parametrize("value", ["3", "true", '["A", "B"]'])
def test_what_is_no_text_is_refused(value: str) -> None:
    """Assert one line for authors and descriptions that are numbers or lists, which were written as Python shows them."""
    with pytest.raises(xd.ModelError, match=r"about: .* is no text; write it in quotes"):
        xd.Model.from_text(SPRING.format(name="b") + f"[about]\ncreator = {value}\n")
