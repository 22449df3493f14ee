"""Messages for texts that cannot be read name the whole text to write, which is then read."""

import re

import pytest

from xdynamics.expressions import parse, text_of
from xdynamics.faults import InputError

MEANT = {
    "1 m - y": "1*metre - y",
    "sin(30 degree)": "sin(30*degree)",
    "sin(30 degrees)": "sin(30*degree)",
    "9.81 m s-2*b": "9.81*metre*second**-2*b",
    "1 m/s - v_x": "1*metre/second - v_x",
    "0.5 m2 + b": "0.5*metre**2 + b",
    "5 cm - x": "0.05*metre - x",
    "1e3kg": "1e3*kilogram",
    "12 year - t": "12*year - t",
    "2 k*x": "2*k*x",
    "2x": "2*x",
    "2(x + 1)": "2*(x + 1)",
    "(a)(b)": "(a)*(b)",
    "y^2": "y**2",
    "k·x": "k*x",
    "30°": "30*degree",
    "np.sin(x)": "sin(x)",
    "y' - 2 x": "v_y - 2*x",
}


@pytest.mark.parametrize("text", MEANT)
def test_the_message_names_a_text_that_is_read(text: str) -> None:
    """Assert that the first text it names is the one that was meant, and that the next try succeeds."""
    with pytest.raises(InputError, match="; write '") as refused:
        parse(text)
    named = re.findall(r"write '([^']+)'", str(refused.value))[0]
    assert (named, text_of(parse(named))) == (MEANT[text], text_of(parse(MEANT[text])))


def test_a_symbol_may_be_a_name() -> None:
    """Assert that of a unit's symbol that the model may have as a name both readings are named."""
    with pytest.raises(InputError, match=r"write '2\*metre\*g', or '2\*m\*g' if m is a name of the model"):
        parse("2 m*g")


@pytest.mark.parametrize("text", ["a b c", "3 -", "x''", "5 % x"])
def test_nothing_is_guessed(text: str) -> None:
    """Assert that no text is named where it is not known what was meant."""
    with pytest.raises(InputError) as refused:
        parse(text)
    assert "write '" not in str(refused.value)


def test_derivatives_have_names() -> None:
    """Assert that a mark after a velocity leads to how rates are named."""
    with pytest.raises(InputError, match="no sign stands for a derivative: the velocity of x is v_x"):
        parse("v_x'")
