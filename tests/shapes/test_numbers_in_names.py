"""Elements that are named by their number, from the front or from the end, wherever a quantity's name is taken."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main

TEXT = """
name = "Three on springs"
[dimensions]
site = LABELS
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
m = { dims = ["site"], value = [1.0, 2.0, 4.0], unit = "kg", uncertainty = "0.1 kg" }
k = "4 N m-1"
[mass]
u = "m"
[forces.spring]
u = "-k*u"
[initial]
u = "0.5 m"
[events.middle]
function = "u"
direction = "falling"
[events.turn]
function = "v_u[2]"
action = "reset"
set = { "v_u[LAST]" = "0*metre/second" }
[validation.closed]
quantity = "u[LAST]"
expression = "0.5*metre*cos(sqrt(k/m[LAST])*t)"
times = ["0.5 s"]
bound = "1e-2 m"
[run]
step = "0.05 s"
until = "2 s"
[discrepancy]
u = "1 mm"
"""
MARCH: dict[str, Any] = {"method": "velocity_verlet", "step": "0.05 s", "until": "2 s"}
DATA = {"time [s]": [0.2, 0.4, 0.6, 0.8], "u[LAST] [m]": [0.49, 0.46, 0.41, 0.34]}


def model(last: str = "-1", labels: str = "3") -> xd.Model:
    """Return three oscillators, the last of which is named in its file in some way."""
    return xd.Model.from_text(TEXT.replace("LAST", last).replace("LABELS", labels))


def swept(name: Callable[[str], str]) -> xr.Dataset:
    """Sweep the last mass, and keep numbers of the last coordinate."""
    keep = [name("u"), name("maximum_u"), name("event_time_middle")]
    return xd.sweep(model(), axes={name("m"): ["4 kg", "8 kg"]}, keep=keep, times=["1 s"], **MARCH)


def drawn(name: Callable[[str], str]) -> xr.Dataset:
    """Draw the last mass from a range, and as it is declared."""
    draws = xd.Draws(2, {name("m"): ("4 kg", "5 kg")}), xd.Draws(2, [name("m")], "declared")
    return xr.merge(
        [xd.sweep(model(), axes={f"d{i}": draw}, keep=["end"], **MARCH) for i, draw in enumerate(draws)],
        compat="override",
    )


def refined(name: Callable[[str], str]) -> xr.Dataset:
    """Refine the last coordinate until it changes by little."""
    asked = {"at": ["1 s"], "observables": [name("u")], "until_change": {name("u"): "1 mm"}}
    return xd.refine(model(), method="velocity_verlet", steps=["0.1 s", "0.05 s", "0.025 s"], until="2 s", **asked)


def budgeted(name: Callable[[str], str]) -> xr.Dataset:
    """Budget the time at which the last one passes its middle, by its own mass alone."""
    return xd.error_budget(model(), "t", event=name("middle"), only=[name("m")], **MARCH)


def fitted(name: Callable[[str], str]) -> xr.Dataset:
    """Fit the last mass to what was measured of the last coordinate."""
    data = {name("u") + " [m]" if "u" in title else title: column for title, column in DATA.items()}
    return xd.fit(model(), data, [name("m")], bounds={name("m"): ("1 kg", "9 kg")}, **MARCH)


def diagnosed(name: Callable[[str], str]) -> xr.Dataset:
    """Diagnose the last coordinate beside a closed form."""
    run = xd.simulate(model(), **MARCH | {"until": "8 s"})
    return xd.diagnose(run, of=name("u"), exact={name("u"): "0.5*metre*cos(t/second)"}, reference="6 s")


@pytest.mark.parametrize("verb", [swept, drawn, refined, budgeted, fitted, diagnosed])
def test_every_verb_takes_the_last_element_by_either_number(verb: Callable[..., xr.Dataset]) -> None:
    """Assert that -1 is 2 wherever a name is given, and that -4 and 3 are refused with what there is."""
    xr.testing.assert_equal(verb("{}[-1]".format), verb("{}[2]".format))
    for number in ("-4", "3", "x", "0, 1", ""):
        with pytest.raises(
            xd.InputError, match=r"dimension 'site' has no element \S+; it has the elements 0 to 2|an entry"
        ):
            verb(f"{{}}[{number}]".format)


def test_files_take_numbers_from_the_end() -> None:
    """Assert that a reset and a closed form of -1 are those of 2, and of a label; a file keeps what it says."""
    runs = [
        xd.simulate(entry, **MARCH | {"until": "4 s"}) for entry in (model(), model("2"), model("c", '["a", "b", "c"]'))
    ]
    assert runs[0].sizes["event"] == 5
    for run in runs[1:]:
        assert run.u.values.tobytes() == runs[0].u.values.tobytes()
    ledgers = [xd.validate(["velocity_verlet"], entry) for entry in (model(), model("2"))]
    assert [ledger.case_observable.item() for ledger in ledgers] == ["u[2]", "u[2]"]
    assert ledgers[0].residual.item() == ledgers[1].residual.item() < 1e-4
    assert '"v_u[-1]" = ' in model().to_toml()
    assert 'quantity = "u[-1]"' in model().to_toml()
    with pytest.raises(xd.ModelError, match=r"'v_u\[-4\]': dimension 'site' has no element -4"):
        model("-4")


def test_the_command_line_sets_the_last_element(tmp_path: Path) -> None:
    """Assert that --set and --only take -1, and say what there is for -4."""
    path, archive = tmp_path / "three.toml", tmp_path / "run.nc"
    path.write_text(model().to_toml())
    call = ["run", str(path), "--method", "rk4", "--step", "0.1 s", "--until", "1 s", "-o", str(archive)]
    assert CliRunner().invoke(main, [*call, "--set", "m[-1]=8 kg"]).exit_code == 0
    assert xd.open_run(archive).m.values.tolist() == [1.0, 2.0, 8.0]
    refused = CliRunner().invoke(main, [*call, "--set", "m[-4]=8 kg"])
    assert "--set 'm[-4]': dimension 'site' has no element -4; it has the elements 0 to 2" in refused.output
    drawn = CliRunner().invoke(main, ["plot", str(archive), "--only", "u[-1]", "-o", str(tmp_path / "u.png")])
    assert drawn.exit_code == 0


@pytest.mark.parametrize("target", ["u[", "u[0", "u[0]x", "u]"])
def test_targets_without_both_brackets(target: str) -> None:
    """Assert that a reset of what is only nearly an element is refused by its name."""
    text = model().to_toml().replace('"v_u[-1]" =', f'"{target}" =')
    with pytest.raises(xd.ModelError, match=f"event 'turn' sets '{re.escape(target)}', which is no coordinate"):
        xd.Model.from_text(text)


def test_one_element_by_two_numbers() -> None:
    """Assert that two values for one element are refused, where one of them would be lost."""
    with pytest.raises(xd.ModelError, match=r"\[initial\] names 'u\[2\]' twice"):
        model().replace(initial={"u[-1]": "2 m", "u[2]": "3 m"})
    with pytest.raises(xd.ModelError, match=r"\[parameters\] names 'm\[c\]' twice"):
        model("c", '["a", "b", "c"]').replace(parameters={"m[c]": "2 kg", "m[2]": "3 kg"})
    with pytest.raises(xd.InputError, match=r"draws have 'm\[2\]' twice"):
        xd.sweep(model(), {"d": xd.Draws(2, {"m[2]": ("4 kg", "5 kg"), "m[-1]": ("1 kg", "2 kg")})}, **MARCH)
    with pytest.raises(xd.InputError, match=r"ranges have 'm\[2\]' twice"):
        xd.sobol_indices(model(), ["m[2]", "m[-1]"], quantity="end_u[2]", draws=4, **MARCH)
    with pytest.raises(xd.InputError, match=r"until_change names 'u\[2\]' twice"):
        xd.refine(
            model(), method="rk4", steps=["0.1 s", "0.05 s"], until="1 s", until_change={"u[2]": "1 m", "u[-1]": "1 mm"}
        )


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ('"m[-1]" = { "m[2]" = 0.3 }', r"m\[-1\] and m\[2\]: a number with itself has 1"),
        ('"m[0]" = { "m[2]" = 0.3 }\n"m[-1]" = { "m[0]" = 0.4 }', r"m\[-1\] and m\[0\]: are there twice"),
        ('"m[0]" = { "m[3]" = 0.3 }', r"'m\[3\]': dimension 'site' has no element 3"),
    ],
)
def test_correlations_of_elements(pairs: str, message: str) -> None:
    """Assert that pairs are judged by the elements that are meant, and that the section is named."""
    with pytest.raises(xd.ModelError, match=f"model 'Three on springs': correlations: {message}"):
        xd.Model.from_text(f"{model().to_toml()}\n[correlations]\n{pairs}\n")


def test_discrepancies_of_elements() -> None:
    """Assert that the discrepancy of an element that is not there, or there twice, is refused with its section."""
    text = model().to_toml()
    for names, message in ((("u[3]",), "has no element 3"), (("u[2]", "u[-1]"), "twice")):
        entries = "\n".join(f'"{name}" = {{ standard = "1 mm" }}' for name in names)
        with pytest.raises(xd.ModelError, match=rf"'Three on springs': discrepancy: names 'u\[\d\]'.* {message}"):
            xd.Model.from_text(text.replace('u = { "standard" = "1.0 mm" }', entries))


def test_names_that_are_no_text() -> None:
    """Assert that numbers in the place of names are refused with what is needed."""
    run = xd.simulate(model(), **MARCH)
    with pytest.raises(xd.InputError, match="of is 5, needs the name of a coordinate"):
        xd.diagnose(run, of=5)  # type: ignore[arg-type]
    for only in ([5], 5):
        with pytest.raises(
            xd.InputError, match=re.escape(f"only is {only!r}, needs kinds of panels and names in a list")
        ):
            xd.plot(run, only=only)  # type: ignore[arg-type]
