"""Switches of many elements that are declared smooth."""

from __future__ import annotations

import pytest

import xdynamics as xd
from xdynamics.model.switches import are_too_many, smooth_switches


@pytest.mark.parametrize(("sites", "counted"), [(20, 19), (150, 0)])
def test_smooth_switches_of_many_elements_are_not_written_out(sites: int, counted: int) -> None:
    """Assert that those of the largest of 20 squares are counted, and that of 150 the force stays one in loops."""
    model = xd.Model(
        name="largest",
        dimensions={"site": sites},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N m-3", "m": "1 kg"},
        mass={"u": "m"},
        forces={"pull": {"u": "-k*u*max(u*u, site)", "smooth": True}},
        initial={"u": "metre*(1 + index(site))/size(site)", "v_u": "0*metre/second*index(site)"},
    )
    assert len(smooth_switches(model)) == counted
    run = xd.simulate(model, method="rk4", step="1 ms", until="2 ms")
    assert float(run.force_pull_u[0, 0]) == pytest.approx(-1.0 / sites, rel=1e-14)
    assert len(str(run.force_source.values)) < 60_000


def test_switches_are_counted_in_the_first_elements_that_have_them() -> None:
    """Assert that of a force with the largest of 60 squares one element is written out, and its 59 switches are too many."""
    model = xd.Model(
        name="largest",
        dimensions={"site": 60},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N m-3", "m": "1 kg"},
        mass={"u": "m"},
        forces={"pull": {"u": "-k*u*max(u*u, site)"}},
        initial={"u": "metre*(1 + index(site))/size(site)"},
    )
    assert are_too_many(model)
    assert dict.keys(model.force_components["pull"]) == {"u·0"}  # in a `dict` what was made so far
