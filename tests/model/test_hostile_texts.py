"""Texts made to take time and memory: models, tables, archives; each is read or refused within bounds.

Years and months in expressions are Julian, and a model's own names come before them.
"""

from __future__ import annotations

import gc
import os
import random
import resource
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.model.drives import Table
from xdynamics.sweeping.axes import csv_text

HEAD = 'name = "m"\n[coordinates]\nx = "m"\n[mass]\nx = "1*kilogram"\n[initial]\nx = "0 m"\nv_x = "0 m s-1"\n'
TABLE = "[drives.pull]\ntable = 'a.csv'\ncsv = '''\nt [s],pull [N]\n0,0\n{}\n'''\n"

LARGE: dict[str, tuple[Callable[[], str], str]] = {
    "dotted keys": (
        lambda: HEAD + "[parameters]\n" + ".".join(["a"] * 20_000) + " = 1\n",
        "line 10: a key has over 8 names that dots join, the limit",
    ),
    "a dotted header": (lambda: HEAD + "[" + " . ".join(["a"] * 20_000) + "]\n", "line 9: a key has over 8 names"),
    "quoted dotted keys": (lambda: HEAD + ".".join(['"a"'] * 20_000) + " = 1\n", "line 9: a key has over 8 names"),
    "parameters": (
        lambda: HEAD + "[parameters]\n" + "".join(f'p{k} = "1 m"\n' for k in range(200_000)),
        "it has 200009 entries, over the limit of 10000",
    ),
    "sections": (
        lambda: HEAD + "".join(f"[events.e{k}]\n" for k in range(200_000)),
        "entries, over the limit of 10000",
    ),
    "a chain": (
        lambda: HEAD + '[definitions]\nd0 = "x"\n' + "".join(f'd{k} = "d{k - 1} + x"\n' for k in range(1, 2_000)),
        "definitions d151, .* and 1839 more are nested too deeply, over 150 levels; shorten the chain",
    ),
    "a fan": (
        lambda: (
            HEAD + '[definitions]\nd0 = "x"\n' + "".join(f'd{k} = "d{k - 1} + d{k - 1}"\n' for k in range(1, 2_000))
        ),
        "to over 1000000 nodes; shorten them",
    ),
    "a list": (
        lambda: HEAD + "[parameters]\na = [" + "1," * 5_000_000 + "]\n",
        "5000000 values, over the limit of 500000",
    ),
    "a word": (lambda: HEAD + "-" * 1_000_000 + "\n" + "a " * 500_000 + "\n", "is no TOML"),
    "lists in lists": (lambda: HEAD + "[parameters]\na = " + "[" * 20_000 + "\n", "is no TOML"),
    "names unknown": (
        lambda: HEAD + "[observables]\n" + "".join(f'o{k} = "unknown{k}"\n' for k in range(4_000)),
        "has 200 faults",
    ),
    "an expression": (
        lambda: HEAD + '[observables]\na = "' + "x+" * 1_000_000 + 'x"\n',
        "2000001 characters, 1000000 at most",
    ),
    "a section": (lambda: HEAD + "[" + "e308" * 250_000 + "]\nx = 1\n", r"model 'm': \[e308.{95}… is no section"),
    "a cell": (
        lambda: HEAD + TABLE.format("1," + "9" * 200_000),
        "line 3: a cell has over 131072 characters, the limit",
    ),
}


@pytest.mark.every(3)
@pytest.mark.parametrize("what", LARGE)
def test_what_is_too_large_is_refused_at_once(what: str) -> None:
    """Assert one error that names the limit, within a second and 200 MB of what an empty model takes."""
    make, said = LARGE[what]
    text = make()
    xd.Model.from_text(HEAD)
    with pytest.raises(xd.ModelError, match="unknown"):  # what finds similar names is imported
        xd.Model.from_text(HEAD + '[observables]\na = "unknown"\n')
    gc.freeze()  # what earlier tests of this process left is not searched for garbage in this one's second
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(text)
    taken = time.process_time() - began
    gc.unfreeze()
    assert taken < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_entries_given_in_python_are_bounded_too() -> None:
    """Assert that a section of a model made in Python has the limit of one in a file."""
    parameters = {f"p{k}": "1 m" for k in range(200_000)}
    with pytest.raises(xd.ModelError, match=r"\[parameters\] has 200000 entries, over the limit of 10000"):
        xd.Model(
            name="m", coordinates={"x": "m"}, mass={"x": "1*kilogram"}, initial={"x": "0 m"}, parameters=parameters
        )


def test_what_stands_in_texts_is_not_counted() -> None:
    """Assert that dots, signs and brackets of descriptions, comments and tables are no keys of the file."""
    rows = "".join(f"{k},{k}.5\n" for k in range(1, 20_000))
    words = "a.b.c.d.e.f.g.h.i.j.k = [" + "=," * 20_000
    text = f"# {words}\n{HEAD.replace('[coord', f'description = {words!r}' + chr(10) + '[coord')}{TABLE.format(rows)}"
    text += '[parameters]\na = { value = "1 m", description = """\n' + words + ' "" \\""" """ }\n'
    model = xd.Model.from_text(text)
    assert len(model.drives["pull"].table.value) == 20_000
    assert model.parameters["a"].description.startswith(words)


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_marks_and_line_ends_of_other_systems_are_read(tmp_path: Path, ends: str, mark: str) -> None:
    """Assert one model, whatever begins its texts and ends their lines, in the file, beside it or given as text."""
    table = "t [s],pull [N]\n0,0\n2,240\n"
    text = HEAD + "[drives.pull]\ntable = 'pull.csv'\n"
    (tmp_path / "pull.csv").write_bytes((mark + table.replace("\n", ends)).encode())
    (tmp_path / "model.toml").write_bytes((mark + text.replace("\n", ends)).encode())
    model = xd.Model.from_toml(tmp_path / "model.toml")
    assert model.drives["pull"].table.value.tolist() == [0.0, 240.0]
    assert xd.Model.from_text(mark + model.to_toml().replace("\n", ends)).digest == model.digest


SEEDS = [*sorted(MODELS.rglob("*.toml")), *sorted(MODELS.rglob("*.csv"))]


def grown(content: bytes, dice: random.Random) -> bytes:
    """Return a text with some places changed, repeated or nested at random."""
    pieces = [
        b"[",
        b"]",
        b"{",
        b"=",
        b".",
        b'"',
        b"'''",
        b"\\",
        b"\0",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\r",
        b"e308",
        b"(",
        b"-",
        b"**",
        b"\n[",
        b",",
        b"a.",
        b"sin(",
    ]
    for _ in range(dice.randint(1, 4)):
        at = dice.randrange(len(content) + 1)
        end = min(len(content), at + dice.choice([1, 10, 100, 1_000]))
        times = int(10.0 ** dice.uniform(0.0, 5.5))
        times = min(times, 8_000_000 // max(1, end - at))
        match dice.randrange(5):
            case 0:
                content = content[:at] + dice.choice(pieces) * times + content[at:]
            case 1:
                content = content[:at] + content[at:end] * times + content[end:]
            case 2:
                content = content[:at] + content[end:]
            case 3:
                content = content[:at] + bytes(dice.randrange(256) for _ in range(dice.randint(1, 50))) + content[end:]
            case _:
                lines = content.split(b"\n")
                k = dice.randrange(len(lines))
                copies = [lines[k].replace(b"=", b"%d =" % n, 1) for n in range(min(times, 100_000))]
                content = b"\n".join([*lines[:k], *copies, *lines[k:]])
    return content


def read(path: Path) -> str:
    """Read a model, a table or an archive; say whether it was read or refused."""
    try:
        if path.suffix == ".toml":
            xd.Model.from_toml(path, tables="anywhere")
        elif path.suffix == ".csv":
            Table.parse(path.name, csv_text(path))
        else:
            xd.open_run(path)
    except xd.InputError as error:
        return "refused" if str(error) else "no words"
    return "read"


def apart(path: Path) -> tuple[str, float, float]:
    """Read a file in a process of its own; return what came of it, its seconds of processor time, its megabytes."""
    receiving, sending = os.pipe()
    number = os.fork()
    if not number:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            said = read(path)
            about = resource.getrusage(resource.RUSAGE_SELF)
            grown_by = (about.ru_maxrss - before) / 1000
            os.write(sending, f"{said}|{about.ru_utime + about.ru_stime}|{grown_by}".encode())
        except BaseException:  # noqa: BLE001 - whatever it is, it is told to the process that asks
            os.write(sending, traceback.format_exc()[-2_000:].encode())
        finally:
            os._exit(0)
    os.close(sending)
    with os.fdopen(receiving) as answer:
        told = answer.read()
    os.waitpid(number, 0)
    said, seconds, megabytes = told.split("|") if told.count("|") == 2 else (told, "inf", "inf")
    return said, float(seconds), float(megabytes)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.cases(500)
def test_hostile_files_end_within_bounds(case: int, tmp_path: Path) -> None:
    """Assert that a model, a table or an archive that was changed and grown at random is read or refused in 10 s and 500 MB."""
    dice = random.Random(case)
    golden = sorted((MODELS.parent / "golden" / "0.2").glob("*.nc"))[:4]
    seed = dice.choice(golden if dice.random() < 0.15 else SEEDS)
    path = tmp_path / f"hostile{seed.suffix}"
    path.write_bytes(grown(seed.read_bytes(), dice))
    said, seconds, megabytes = apart(path)
    assert said in ("read", "refused"), seed.name
    assert seconds < 10.0
    assert megabytes < 500.0


YEAR = 365.25 * 86400.0


def _decay(**more: object) -> xd.Model:
    sections = {
        "parameters": {"tau": "3 year"},
        "states": {"n": {"unit": "1", "rate": "-n/tau"}},
        "initial": {"n": "1"},
        "events": {"mark": {"function": "t - year - 6*month"}},
    }
    return xd.Model(name="Decay", **(sections | more))


def test_years_and_months_are_julian() -> None:
    """Assert that a zero of `t - year - 6*month` is a year and a half of 365.25 days after the start."""
    run = xd.simulate(_decay(), method="dop853", until="2 year")
    assert np.isclose(float(run["event_time"][0]), 1.5 * YEAR, rtol=1e-12)


def test_a_parameter_of_that_name_comes_first() -> None:
    """Assert that a model with a parameter `year` marches by its value, bit for bit as under another name."""
    states = {"n": {"unit": "1", "rate": "-n/year"}}
    model = _decay(parameters={"year": "3 s"}, states=states, events={"mark": {"function": "t - year/2"}})
    other = _decay(
        parameters={"q": "3 s"}, states={"n": {"unit": "1", "rate": "-n/q"}}, events={"mark": {"function": "t - q/2"}}
    )
    run, twin = (xd.simulate(each, method="dop853", until="2 s") for each in (model, other))
    assert run["n"].values.tobytes() == twin["n"].values.tobytes()
    assert np.isclose(float(run["event_time"][0]), 1.5, rtol=1e-12)


def test_a_coordinate_of_that_name_comes_first() -> None:
    """Assert that a coordinate `month`, with its velocity, is the one that forces and events read."""
    model = xd.Model(
        name="Spring",
        coordinates={"month": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"month": "m"},
        forces={"spring": {"month": "-k*month"}},
        events={"through": {"function": "month", "action": "stop"}},
        initial={"month": "1 m"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s")
    assert np.isclose(float(run["time"][-1]), np.pi / 4.0, rtol=1e-8)
    assert np.isclose(float(run["v_month"][-1]), -2.0, rtol=1e-8)


def test_a_unit_that_is_no_name_is_told() -> None:
    """Assert that a symbol of a unit in an expression leads to the constant that is the unit."""
    faults = []
    for symbol in ("h", "cm"):
        try:
            _decay(events={"mark": {"function": f"t - 2*{symbol}"}})
        except xd.InputError as error:
            faults.append(str(error).split("; ")[-1])
    assert faults == ["as a unit it is written hour", "as a unit it is written 0.01*metre"]
