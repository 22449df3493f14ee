"""What a record is by comparison with what it was, told on small records that nobody had to march."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from xdynamics.archive.content import content_digest
from xdynamics.archive.integrity import (
    check_unchanged,
    marched,
    record_standing,
    rows_within,
    selected_like,
    variable_digest,
)
from xdynamics.faults import InputError
from xdynamics.schema import LEFT_OUT_ATOL, SELECTION, SELECTION_OF

Change = Callable[[xr.Dataset], xr.Dataset]
LONG = 40_000  # rows, more than one slab of a dimension without a size of its own
MANY = {f"p{n:02}": ((), float(n), {}) for n in range(12)}


def record() -> xr.Dataset:
    """A record as it was marched."""
    about = {"units": "m", "atol_si": 1e-9}
    variables = {
        "x": ("step", np.arange(6.0), about),
        "pairs": (("step", "bound"), np.arange(12.0).reshape(6, 2), {"units": "s", "atol_si": 1e-3}),
        "bulk": ("rows", np.arange(float(LONG)), {"units": "1"}),
        "event": ("event", [1.5, np.nan], {"units": "s"}),
        "g": ((), 9.8, {"units": "m s-2", "nothing": np.nan}),
        "text": ((), "abc", {}),
    }
    return marched(xr.Dataset(variables | MANY, attrs={"title": "t", "solver_step": 0.1, "none": np.nan}))


def put(name: str, place: object, value: float) -> Change:
    """Return a change of one value."""

    def change(run: xr.Dataset) -> xr.Dataset:
        values = run[name].values.copy()
        values[place] = value
        return run.assign({name: run[name].copy(data=values)})

    return change


def swapped(run: xr.Dataset) -> xr.Dataset:
    """Take the same bytes for numbers of the other byte order."""
    return run.assign(x=run.x.copy(data=run.x.values.view(">f8")))


EDITS: dict[str, tuple[Change, str]] = {
    "attribute gone": (
        lambda run: run.drop_attrs(deep=False).assign_attrs(title="t", none=np.nan, origin=run.attrs["origin"]),
        "attribute 'solver_step' is gone",
    ),
    "attribute": (lambda run: run.assign_attrs(title="u"), "attribute 'title' is 'u', in the run 't'"),
    "new attribute": (
        lambda run: run.assign_attrs(more=np.float64(1)),
        "attribute 'more' is 1.0, and the run has none",
    ),
    "long attribute": (
        lambda run: run.assign_attrs(title="u" * 70),
        f"attribute 'title' is '{'u' * 56}…, in the run 't'",
    ),
    "rather long attribute": (
        lambda run: run.assign_attrs(title="u" * 58),
        f"attribute 'title' is '{'u' * 58}', in the run 't'",
    ),
    "attribute of one": (
        lambda run: run.assign(x=run.x.assign_attrs(units="km")),
        "attribute 'units' of 'x' is 'km', in the run 'm'",
    ),
    "dims": (
        lambda run: run.assign(x=("other", run.x.values, run.x.attrs)),
        "variable 'x' has the dims ('other',), in the run ('step',)",
    ),
    "new": (lambda run: run.assign(y=run.x), "variable 'y' is not in the run"),
    "number": (lambda run: run.assign(g=run.g.copy(data=2.0)), "variable 'g' is 2.0, in the run 9.8"),
    "text": (lambda run: run.assign(text=((), "abcd")), "variable 'text' is 'abcd', in the run 'abc'"),
    "kind": (lambda run: run.assign(x=run.x.astype("i8")), "variable 'x' is of the type int64, in the run float64"),
    "size": (lambda run: run.assign(x=run.x.astype("f4")), "variable 'x' is of the type float32, in the run float64"),
    "order": (swapped, "variable 'x' is of the type >f8, in the run float64"),
    "value": (put("x", 4, 7.0), "variable 'x' is 7.0 in row 4, in the run 4.0"),
    "row": (put("pairs", (3, 1), 0.0), "variable 'pairs' is 0.0 in row 3, bound 1, in the run 7.0"),
    "nan": (put("event", 1, 2.0), "variable 'event' is 2.0 in row 1, in the run nan"),
    "zero": (put("x", 0, -0.0), "variable 'x' is -0.0 in row 0, in the run 0.0"),
    "far row": (put("bulk", 35_000, 1.0), "variable 'bulk' is 1.0 in row 35000, in the run 35000.0"),
    "row of a part": (
        lambda run: put("x", 4, 7.0)(run).isel(step=slice(2, 6)),
        "row 2 of 'step', with x = 7.0, is none of the run's rows",
    ),
    "order of a part": (lambda run: run.isel(step=[3, 2]), "row 1 of 'step', with x = 2.0, is none of the run's rows"),
    "type of a part": (
        lambda run: run.assign(x=run.x.astype("f4")).isel(step=slice(3)),
        "row 0 of 'step', with x = 0.0, is none of the run's rows",
    ),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_is_named(edit: str) -> None:
    """Assert one fault, with both values, and that such a record is not gone on with."""
    change, fault = EDITS[edit]
    edited = change(record())
    assert record_standing(edited).faults == (fault,)
    with pytest.raises(InputError, match="this is not the record that was marched:\n  1. ") as caught:
        check_unchanged(edited)
    assert fault in str(caught.value)


@pytest.mark.parametrize(
    "same",
    [
        lambda run: run,
        lambda run: run.copy(deep=True),
        lambda run: run.assign_attrs(history="later", content_digest="x"),
        lambda run: run.assign(x=run.x.astype(">f8")),
        lambda run: run.chunk({"step": 4}),
    ],
)
def test_what_was_not_edited_is_the_run(same: Change) -> None:
    """Assert that copies, chunks, byte order and what may be written afterwards are no edit."""
    run = record()
    found = record_standing(same(run))
    assert (found.faults, found.selected, found.left_out_atol) == ((), "", {})
    assert found.source_digest == content_digest(run)
    check_unchanged(same(run))


def test_a_part_is_told_from_the_run() -> None:
    """Assert how many rows are kept, what is left out, ten of it by name, and the tolerances of that."""
    run = record()
    part = run.drop_vars(["pairs", *list(MANY)[:9]]).isel(step=[1, 4], rows=slice(5, 9))
    found = record_standing(part)
    named = ", ".join(["pairs", *list(MANY)[:9]])
    assert found.selected == f"2 of 6 rows of 'step'; 4 of {LONG} rows of 'rows'; without {named}"
    assert (found.faults, found.left_out_atol, found.source_digest) == ((), {"pairs": (1e-3, "s")}, content_digest(run))
    more = record_standing(part.drop_vars(list(MANY)[9:11])).selected
    assert more.endswith(f"; without {named} and 2 more")
    with pytest.raises(InputError, match="this is a part of a run, 2 of 6 rows of 'step'; .*; take the whole one"):
        check_unchanged(part)


def test_a_record_without_a_past_is_known_by_its_digest() -> None:
    """Assert that a digest that holds names the run, and one that does not, or none, is told."""
    run = record()
    digest = content_digest(run)
    plain = run.drop_attrs(deep=False).assign_attrs(
        {name: attr for name, attr in run.attrs.items() if name != "origin"}
    )
    assert record_standing(plain.assign_attrs(content_digest=digest)).source_digest == digest
    for other in (plain, plain.assign_attrs(content_digest=digest, title="u")):
        found = record_standing(other)
        assert found.source_digest == ""
        assert found.faults[0].startswith("its origin is unknown")


def test_where_the_run_is_no_longer_at_hand() -> None:
    """Assert that an edit is told by the digest alone, and that rows cannot be looked for."""
    sent = pickle.loads(pickle.dumps(record()))
    assert record_standing(sent).faults == ()
    assert record_standing(put("x", 4, 7.0)(sent)).faults == ("variable 'x' differs from its digest in the run",)
    assert (
        record_standing(sent.isel(step=slice(3)))
        .faults[0]
        .startswith("rows of 'step' are left out, and the run they were")
    )


def test_arrays_that_were_opened_to_writing_are_told() -> None:
    """Assert that the very array of the march vouches for nothing once it could be written to."""
    run = record()
    run.x.values.flags.writeable = True
    assert record_standing(run).faults == (
        "variable 'x' was opened to writing, and what was marched is no longer known",
    )


def test_rows_are_found_in_their_order() -> None:
    """Assert places of rows by all their variables at once, each place taken once, and the first that is not there."""
    whole = xr.Dataset(
        {"a": ("n", [1.0, 1.0, np.nan, 2.0, 1.0]), "b": (("n", "m"), [[0, 0], [0, 1], [0, 0], [0, 0], [0, 1]])}
    )
    for rows in ([0, 1, 2, 3, 4], [1, 2, 4], [2], []):
        assert list(rows_within(["a", "b"], whole.isel(n=rows), whole)) == rows
    assert list(rows_within(["a"], whole.isel(n=[4, 3]), whole)) == [0, 3]
    assert rows_within(["a"], whole.isel(n=[3, 4, 4]), whole) == 2
    assert rows_within(["b"], whole.isel(n=[0]).astype("i4"), whole) == 0


def test_what_a_selection_kept_is_selected_again() -> None:
    """Assert that of a run marched again the rows and variables of a selection are taken, and the run's digest with them."""
    whole = record().assign_attrs(xdynamics_version="1", math_functions="m")
    part = whole.drop_vars(["event", *MANY]).isel(step=[1, 4])
    kept = part.assign_attrs({SELECTION: "2 rows", SELECTION_OF: "0" * 64, LEFT_OUT_ATOL: "{}"})
    found = selected_like(kept, whole)
    assert {name: variable_digest(str(name), variable) for name, variable in found.variables.items()} == {
        name: variable_digest(str(name), variable) for name, variable in part.variables.items()
    }
    said = {name: found.attrs[name] for name in (SELECTION, SELECTION_OF, LEFT_OUT_ATOL)}
    assert said == {SELECTION: "2 rows", SELECTION_OF: content_digest(whole), LEFT_OUT_ATOL: "{}"}
    assert selected_like(part, whole) is whole
    for name in ("xdynamics_version", "math_functions"):
        assert selected_like(kept, whole.assign_attrs({name: "another"})).attrs[SELECTION_OF] == "0" * 64
    forged = put("x", 0, 7.0)(kept)
    assert selected_like(forged, whole).sizes["step"] == 6
