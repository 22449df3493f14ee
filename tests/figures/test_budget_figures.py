"""Pictures of error budgets of many terms."""

from __future__ import annotations

import numpy as np

import xdynamics as xd

SPRINGS = """
name = "masses, each on a spring"
[dimensions]
body = 24
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
k = { dims = ["body"], value = KS, unit = "N m-1", uncertainty = US }
[mass]
x = "1*kilogram"
[forces.springs]
potential = "sum(k*x**2/2, body)"
[initial]
x = "1 m"
[run]
method = "rk4"
step = "50 ms"
until = "1 s"
"""


def test_the_smaller_of_many_terms_are_one_bar() -> None:
    """Assert the sixteen largest terms by name, and the root of the sum of squares of all others, with how many they are."""
    doubts = [0.01 * (1.0 + number) for number in range(24)]
    text = SPRINGS.replace("KS", str([1.0] * 24)).replace("US", str(doubts))
    budget = xd.error_budget(xd.Model.from_text(text), "total_energy", at="0.5 s")
    (axes,) = xd.plot(budget).axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == [f"k[{number}]" for number in range(23, 7, -1)] + ["12 others together"]
    rest = np.sort(budget.standard_uncertainty.values)[:-16]
    assert rest.size == 12
    assert np.isclose(axes.patches[-1].get_width(), np.sqrt((rest**2).sum()), rtol=1e-12, atol=0.0)
    assert len(axes.patches) == 17


def test_terms_bear_the_names_by_which_they_are_asked_for() -> None:
    """Assert all terms of few, and their names as `only` and `without` take them."""
    text = SPRINGS.replace("24", "2").replace("KS", "[1.0, 2.0]").replace("US", "[0.01, 0.02]")
    (axes,) = xd.plot(xd.error_budget(xd.Model.from_text(text), "x[1]", at="0.5 s")).axes
    names = {label.get_text() for label in axes.get_yticklabels()}
    assert names == {"k[0]", "k[1]", "truncation", "roundoff", "interpolation", "event_location"}
    assert axes.get_title(loc="left") == "standard uncertainty from each source"


def test_no_line_of_a_total_crosses_the_number_of_a_bar() -> None:
    """Assert that the line of what is together, right of bars a little shorter, has all their numbers beside it."""
    text = SPRINGS.replace("24", "2").replace("KS", "[1.0, 1.0]").replace("US", "[0.01, 0.012]")
    figure = xd.plot(xd.error_budget(xd.Model.from_text(text), "total_energy", at="0.5 s"))
    (axes,) = figure.axes
    figure.draw_without_rendering()
    lines = [line.get_window_extent().x0 for line in axes.lines if line.get_label().endswith("together")]
    widths = [bar.get_width() for bar in axes.patches]
    assert any(
        0.5 * total < width < total for total in (line.get_xdata()[0] for line in axes.lines) for width in widths
    )
    assert not any(text.get_window_extent().x0 < x < text.get_window_extent().x1 for text in axes.texts for x in lines)
