"""Uncertain measured tables in budgets: rows that are independent, rows that move together, what is drawn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.summary import summary
from xdynamics.units.digits import with_uncertainty

MARCH: dict[str, Any] = {"method": "rk4", "step": "20 ms", "until": "1 s"}


def pushed(force: str, csv: str, **more: Any) -> xd.Model:
    """A mass of 2 kg under a force that reads a measured table."""
    statement = {
        "name": "pushed",
        "coordinates": {"x": "m"},
        "parameters": {"m": "2 kg"},
        "mass": {"x": "m"},
        "forces": {"push": {"x": force}},
        "drives": {"f": {"table": "f.csv", "csv": csv, "interpolation": "linear"}},
        "initial": {"x": "0 m", "v_x": "0 m s-1"},
    }
    return xd.Model(**statement | more)


def written(header: str, *columns: np.ndarray) -> str:
    """CSV text of columns."""
    return (
        "\n".join(
            [header, *(",".join(map(repr, row)) for row in zip(*(column.tolist() for column in columns), strict=True))]
        )
        + "\n"
    )


def row_of(budget: xr.Dataset, name: str) -> int:
    """Where a term stands."""
    return budget["term_name"].values.tolist().index(name)


def term(budget: xr.Dataset, variable: str, name: str) -> float:
    """A number of a term."""
    return float(budget[variable][row_of(budget, name)])


@pytest.mark.dear
@pytest.mark.cases(200)
def test_rows_have_the_weights_of_the_trapezoidal_rule(case: int) -> None:
    """Assert what independent and common errors of random forces do to a speed, and to a sum with a start's own."""
    rng = np.random.default_rng([case, 2])
    count = int(rng.integers(3, 12))
    times = np.concatenate([[0.0], np.sort(rng.uniform(0.02, 0.98, count - 2)), [1.0]])
    value, own = rng.normal(0.0, 3.0, count), rng.uniform(0.01, 0.2, count) * (rng.random(count) < 0.8)
    together = np.full(count, rng.uniform(0.01, 0.1)) if rng.random() < 0.5 else rng.uniform(0.0, 0.1, count)
    csv = written("t [s],f [N],u(f) [N],u_common(f) [mN]", times, value, own, 1e3 * together)
    budget = xd.error_budget(pushed("f", csv, initial={"x": "0 m", "v_x": "1 ± 0.02 m s-1"}), "v_x", at="1 s", **MARCH)
    weights = np.zeros(count)
    weights[:-1] += np.diff(times) / 2.0
    weights[1:] += np.diff(times) / 2.0
    sizes = [math.sqrt(float(np.sum((weights * own) ** 2))) / 2.0, abs(float(weights @ together)) / 2.0, 0.02]
    for name, size in zip(("f", "f_common", "v_x"), sizes, strict=True):
        if size:
            assert term(budget, "standard_uncertainty", name) == pytest.approx(size, rel=1e-8)
    assert float(budget.physical_rss) == pytest.approx(math.hypot(*sizes), rel=1e-8)
    assert term(budget, "standard_uncertainty_doubt", "f_common") == 0.0


@pytest.mark.dear
def test_a_table_that_moves_as_a_whole_is_an_input_in_its_own_unit() -> None:
    """Assert slope, sign, uncertainty and units of what all rows have together, and that rows that part are a pure number."""
    times = np.linspace(0.0, 1.0, 5)
    same = written("t [s],f [mN],u_common(f) [mN]", times, 2e3 + 0.0 * times, 50.0 + 0.0 * times)
    budget = xd.error_budget(pushed("-3*f", same), "v_x", at="1 s", **MARCH)
    i = row_of(budget, "f_common")
    assert term(budget, "sensitivity", "f_common") == pytest.approx(-1.5, rel=1e-9)
    assert (budget.sensitivity_units.values[i], budget.input_units.values[i]) == ("m s-1 N-1", "N")
    assert term(budget, "input_uncertainty", "f_common") == pytest.approx(0.05)
    assert "common to all rows" in str(budget.term_rule.values[i])
    grown = written("t [s],f [mN],u_common(f) [mN]", times, 2e3 + 0.0 * times, 50.0 + 10.0 * times)
    budget = xd.error_budget(pushed("-3*f", grown), "v_x", at="1 s", **MARCH)
    assert budget.input_units.values[row_of(budget, "f_common")] == "1"
    assert term(budget, "sensitivity", "f_common") == pytest.approx(-1.5 * 0.055, rel=1e-9)


@pytest.mark.dear
def test_a_number_that_is_not_linear_in_its_rows_is_drawn_and_says_so(tmp_path: Any) -> None:
    """Assert the standard deviation of a square, the uncertainty of so few draws, and both in lines, figure and document."""
    times, zero = np.linspace(0.0, 1.0, 3), np.zeros(3)
    csv = written("t [s],f [N],u(f) [N]", times, zero, 0.3 + zero)
    model = pushed("0*newton", csv, observables={"square": "f**2/(1*newton)"})
    budget = xd.error_budget(model, "square", at="0.5 s", **MARCH)
    size, doubt = (term(budget, name, "f") for name in ("standard_uncertainty", "standard_uncertainty_doubt"))
    assert size == pytest.approx(math.sqrt(3.0) * 0.09, rel=0.5)  # of a squared normal number about 0
    assert doubt == pytest.approx(size / 8.0)
    assert "every row drawn" in str(budget.term_rule.values[row_of(budget, "f")])
    assert float(budget.physical_rss_doubt) == pytest.approx(doubt)
    line = next(one for one in summary(budget) if one.split()[:2] == ["f", "physical"])
    assert f" {with_uncertainty(size, doubt, 1)} N " in line
    xd.plot(budget, tmp_path / "B.svg")
    assert f"± {doubt:.1g}" in (tmp_path / "B.svg").read_text()


@pytest.mark.dear
def test_more_rows_than_have_slopes_are_drawn() -> None:
    """Assert a standard uncertainty within three of its own of a table of 300 rows."""
    times = np.linspace(0.0, 1.0, 300)
    csv = written("t [s],f [N],u(f) [N]", times, 2.0 + 0.0 * times, 0.1 + 0.0 * times)
    budget = xd.error_budget(pushed("f", csv), "v_x", at="1 s", method="rk4", step="0.25 s", until="1 s")
    right = 0.1 / 2.0 * math.sqrt(298 + 0.5) / 299.0
    size, doubt = (term(budget, name, "f") for name in ("standard_uncertainty", "standard_uncertainty_doubt"))
    assert abs(size - right) <= 3.0 * doubt
    assert doubt == pytest.approx(size / 8.0)


@pytest.mark.dear
def test_draws_have_the_tables_too() -> None:
    """Assert that the standard deviation of draws is that of rows, of what is common to them and of a start together."""
    times = np.linspace(0.0, 1.0, 5)
    csv = written(
        "t [s],f [N],u(f) [N],u_common(f) [N]", times, 2.0 + 0.0 * times, 0.1 + 0.0 * times, 0.06 + 0.0 * times
    )
    model = pushed("f", csv, initial={"x": "0 m", "v_x": "1 ± 0.02 m s-1"})
    budget = xd.error_budget(model, "v_x", at="1 s", draws=20_000, **MARCH)
    right = math.hypot(0.1 / 2.0 * math.sqrt(3 / 16 + 2 / 64), 0.03, 0.02)
    assert float(budget.physical_rss) == pytest.approx(right, rel=1e-8)
    assert float(budget.monte_carlo_standard_uncertainty) == pytest.approx(right, rel=0.02)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("t [s],f [N],u_common(f) [m]", "uncertainties are in 'm', the values in 'N'"),
        ("t [s],f [N],u_common(g) [N]", "2 columns of values"),
        ("t [s],u(f) [N],u_common(f) [N]", "columns of values"),
    ],
)
def test_columns_of_uncertainties_that_belong_to_nothing_are_named(header: str, said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.ModelError, match=said):
        pushed("f", f"{header}\n0,1,1\n1,1,1\n")


def test_a_common_uncertainty_is_kept_in_model_files_and_read_from_any_header() -> None:
    """Assert both columns after a round trip, from headers in parentheses, with a negative one refused."""
    for header in ("t [s],f [N],u(f) [N],u_common(f) [mN]", "t (s),f (N),u(f) (N),u_common(f) (mN)"):
        model = xd.Model.from_text(pushed("f", f"{header}\n0,1,0.1,50\n1,1,0.2,60\n").to_toml())
        table = model.drives["f"].table
        assert table.uncertainty is not None
        assert table.common is not None
        assert (table.uncertainty.tolist(), table.common.tolist()) == ([0.1, 0.2], [0.05, 0.06])
    with pytest.raises(xd.ModelError, match=r"line 3: the uncertainty -0\.06 is negative"):
        pushed("f", "t [s],f [N],u_common(f) [N]\n0,1,0.05\n1,1,-0.06\n")
