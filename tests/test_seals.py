"""Digests of variables and runs: what they hang on, and what not."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from xdynamics.archive.origin import digest_of
from xdynamics.archive.seals import content_digest

NUMBERS = np.arange(6.0).reshape(2, 3)
SAME = digest_of("a", xr.Variable(("n", "m"), NUMBERS))


@pytest.mark.parametrize(
    ("name", "dims", "values"),
    [
        ("b", ("n", "m"), NUMBERS),
        ("a", ("m", "n"), NUMBERS),
        ("a", ("n", "m"), NUMBERS.reshape(3, 2)),
        ("a", ("n", "m"), NUMBERS.reshape(6, 1)),
        ("a", ("n", "m"), NUMBERS.view("i8")),
        ("a", ("n", "m"), NUMBERS[:, ::-1]),
        ("a", ("n", "m"), np.where(NUMBERS == 0.0, -0.0, NUMBERS)),
    ],
)
def test_a_digest_is_of_name_dims_shape_type_and_bits(name: str, dims: tuple[str, ...], values: np.ndarray) -> None:
    """Assert that no two variables that differ in any of these have one digest, the same bytes in another shape either."""
    assert digest_of(name, xr.Variable(dims, values)) != SAME


@pytest.mark.parametrize("shape", [(0, 2), (0, 3), (2, 0), ()])
def test_a_digest_of_nothing_is_of_its_shape(shape: tuple[int, ...]) -> None:
    """Assert that variables without a value are told from one another, and from one of a row."""
    others = [(0, 2), (0, 3), (2, 0)]
    dims = ("n", "m")[: len(shape)]
    found = digest_of("a", xr.Variable(dims, np.zeros(shape)))
    assert [one for one in others if digest_of("a", xr.Variable(("n", "m"), np.zeros(one))) == found] == [
        one for one in others if one == shape
    ]


def test_a_digest_is_of_no_order_in_memory() -> None:
    """Assert that byte order, strides and chunks of the same numbers change nothing."""
    for values in (NUMBERS.astype(">f8"), np.asfortranarray(NUMBERS), np.repeat(NUMBERS, 2, axis=1)[:, ::2]):
        assert digest_of("a", xr.Variable(("n", "m"), values)) == SAME
    long = xr.Variable(("n",), np.arange(70_000.0))
    assert digest_of("a", long.chunk({"n": 999})) == digest_of("a", long)


def test_the_content_digest_is_of_every_attribute_that_is_no_circumstance() -> None:
    """Assert that attributes of the run and of its variables count, and their order and the date do not."""
    run = xr.Dataset({"a": ("n", [1.0, 2.0], {"units": "m", "role": "state"})}, attrs={"title": "x", "solver_order": 2})
    same = content_digest(run)
    assert content_digest(run.assign_attrs(date_created="now", content_digest="other")) == same
    assert content_digest(run.drop_attrs(deep=False).assign_attrs(solver_order=2, title="x")) == same
    others = [run.assign_attrs(title="y"), run.assign_attrs(more=1), run.assign(a=run.a.assign_attrs(units="s"))]
    assert same not in [content_digest(one) for one in others]


def test_a_digest_of_a_text_is_of_its_letters() -> None:
    """Assert that a text has the digest of its UTF-8, whether it is one value or letters."""
    text = digest_of("a", xr.Variable((), np.array("kräftig")))
    assert text != digest_of("a", xr.Variable((), np.array("kraftig")))
    assert text == digest_of("a", xr.Variable((), np.array("kräftig", dtype=object)))
