"""Certificates: made, kept, made again from the file alone; changed ones are refused by name."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.budgeting.budget_summary import rounded_result
from xdynamics.budgeting.certificate import _decide_gates, _differences, certificate_lines

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ASKED: dict[str, Any] = {
    "event": "ground",
    "method": "dormand_prince",
    "rtol": 1e-8,
    "atol": {"y": "1 nm"},
    "draws": 400,
    "seed": 5,
}


@pytest.fixture(scope="module")
def certificate() -> xr.Dataset:
    """Of the landing of a ball with drag."""
    return xd.certify(BALL, "t", **ASKED)


def gates(found: xr.Dataset) -> dict[str, str]:
    """Name what became of each gate."""
    words = found["gate_verdict"].attrs["flag_meanings"].split()
    return {
        str(name): words[one] for name, one in zip(found["gate_name"].values, found["gate_verdict"].values, strict=True)
    }


def test_a_certificate_has_all_that_defends_a_number(certificate: xr.Dataset) -> None:
    """Assert budget, levels with orders and digests, gates, the ledger's cases and the result."""
    assert certificate.attrs["result"].startswith("3.711 ± 0.040 s")
    assert certificate.sizes["level"] == 4
    assert certificate.level_value.values[0] == float(certificate.value)
    assert len({*certificate.run_digest.values.tolist()}) == 4
    assert certificate.sizes["case"] == xd.validate(["dormand_prince"]).sizes["case"]
    found = gates(certificate)
    assert {name: value for name, value in found.items() if name != "linear_budget"} == dict.fromkeys(
        ("outcome", "levels", "convergence", "interpolation", "ledger", "record", "numerical_part"), "passed"
    )
    assert all(variable.attrs["units"] and variable.attrs["long_name"] for variable in certificate.variables.values())


def budget_by_hand(**more: Any) -> xr.Dataset:
    """What gates look at: a number that passes all of them, just so."""
    numbers = {"physical_rss": 1.0, "numerical_bound": 0.1, "run_outcome": "completed"} | more
    found = xr.Dataset(
        {
            "term_name": ("term", np.array(["truncation", "interpolation"])),
            "bound": ("term", np.array([0.125, numbers.pop("inside", 0.25)])),
            "level_value": ("level", np.array(numbers.pop("values", [3.0, 3.25, 4.0]))),
            "level_verdict": ((), numbers.pop("verdict", 0), {"flag_meanings": "asymptotic converging not_converging"}),
            "linear_verdict": ((), numbers.pop("linear", 0)),
        }
    )
    attributes = numbers.pop("attributes", {})
    return found.assign({name: ((), number) for name, number in numbers.items()}).assign_attrs(attributes)


@pytest.mark.parametrize(
    ("more", "verdicts", "failed"),
    [
        ({}, [0, 2], ""),
        ({"physical_rss": 0.0, "numerical_bound": 9.0}, [0], ""),
        ({}, [0, 1, 0], "ledger"),
        ({"run_outcome": "step_limit"}, [0], "outcome"),
        ({"values": [3.0, 3.25]}, [0], "levels"),
        ({"inside": 0.2501}, [0], "interpolation"),
        ({"values": [3.25, 3.0, 4.0]}, [0], ""),
        ({"values": [3.0, 3.0, 4.0]}, [0], "interpolation"),
        ({"values": [3.0, 3.0, 4.0], "inside": 0.125}, [0], ""),
        ({"numerical_bound": 0.1001}, [0], "numerical_part"),
    ],
)
def test_each_gate_has_its_own_border(more: dict[str, Any], verdicts: list[int], failed: str) -> None:
    """Assert which gate a number fails by hand-made figures, that the border is passed, and what is said of it."""
    ledger = xr.Dataset({"verdict": ("case", np.array(verdicts))})
    found = _decide_gates(budget_by_hand(**more), ledger, has_draws=False)
    assert [name for name, verdict, _ in found if verdict != "passed"] == [failed] * bool(failed)
    assert [verdict for *_, verdict, _ in found if verdict not in ("passed", "failed")] == []
    said = {name: why for name, _, why in found}
    assert ("numerical_part" in said) is (more.get("physical_rss") != 0.0)
    words = [verdicts.count(one) for one in range(3)]
    assert said["ledger"] == "{} cases of the method passed, {} failed, {} refused".format(*words)
    assert said["levels"] == f"{len(more.get('values', [0] * 3))} levels"


def test_gates_of_levels_and_draws_have_their_words() -> None:
    """Assert that levels which do not converge fail, and of a linear budget passed, failed, and open with what settles it."""
    from xdynamics.budgeting.montecarlo import ADEQUATE, NOT_ADEQUATE, NOT_CHECKED
    from xdynamics.evidence.refining.convergence import NOT_CONVERGING, VERDICTS

    ledger = xr.Dataset({"verdict": ("case", np.array([0]))})
    for verdict in range(len(VERDICTS)):
        budget = budget_by_hand(verdict=verdict)
        budget["level_verdict"].attrs["flag_meanings"] = " ".join(VERDICTS)
        gate = _decide_gates(budget, ledger, has_draws=False)[2]
        word = VERDICTS[verdict].replace("pre_", "pre-").replace("_", " ")
        assert gate == (
            "convergence",
            "failed" if verdict == NOT_CONVERGING else "passed",
            f"verdict on the levels: {word}",
        )
    for linear, verdict, said in (
        (ADEQUATE, "passed", "the linear budget is adequate"),
        (NOT_ADEQUATE, "failed", "the linear budget is not adequate"),
        (NOT_CHECKED, "not_checked", "the linear budget is not checked: nothing was drawn; 10000 draws tell as a rule"),
    ):
        assert _decide_gates(budget_by_hand(linear=linear), ledger, has_draws=True)[-1] == (
            "linear_budget",
            verdict,
            said,
        )
    few = budget_by_hand(linear=NOT_CHECKED, attributes={"draws_needed": 2300.0, "draws": 400})
    assert _decide_gates(few, ledger, has_draws=True)[-1][2].endswith(
        "checked: 400 draws leave it open, about 2300 settle it"
    )


def test_what_is_apart_is_named_with_both_values() -> None:
    """Assert names that are missing and added, shapes, the first place of a number or text that differs, and attributes."""
    again = xr.Dataset(
        {"a": ("x", [1.0, np.nan, 3.0]), "b": ((), 2.0), "c": ("x", ["u", "v", "w"])},
        attrs={"of": "y", "seed": 5, "extra": 1},
    )
    assert _differences(again.copy(), again) == []
    assert _differences(again.drop_vars("b"), again) == ["'b' is missing"]
    assert _differences(again.assign(d=1.0), again) == ["'d' is added"]
    assert _differences(again.assign(a=("z", [1.0, 2.0])), again) == ["'a' has the shape (2,), and comes out as (3,)"]
    assert _differences(again.assign(a=("x", [1.0, np.nan, 4.0])), again) == ["'a'[2] is 4.0, and comes out as 3.0"]
    assert _differences(again.assign(a=("x", [1.0, 5.0, 3.0])), again) == ["'a'[1] is 5.0, and comes out as nan"]
    assert _differences(again.assign(b=2.5), again) == ["'b' is 2.5, and comes out as 2.0"]
    assert _differences(again.assign(b=np.nan), again) == ["'b' is nan, and comes out as 2.0"]
    assert _differences(again.assign(c=("x", ["u", "q", "w"])), again) == ["'c'[1] is q, and comes out as v"]
    assert _differences(again.assign_attrs(seed=6, extra=2), again) == ["attribute 'seed' is 6, and comes out as 5"]
    assert _differences(again.assign_attrs(seed="5"), again) == []


def test_a_certificate_in_words() -> None:
    """Assert number, place of an extreme, gates, model and what makes it again."""
    found = xr.Dataset(
        {
            "gate_name": ("gate", np.array(["numerical_part", "linear_budget"])),
            "gate_verdict": ("gate", np.array([1, 2])),
            "gate_reason": ("gate", np.array(["too large", "few"])),
        }
    )
    found.attrs = {
        "of": "maximum of y",
        "result": "3 m",
        "model_digest": "ab",
        "solver_method": "rk4",
        "extreme_rule": "located",
        "extreme_time": 1.5,
    }
    assert certificate_lines(found) == [
        "result    maximum of y = 3 m",
        "found     located by an event, at t = 1.5 s",
        "failed    numerical part: too large",
        "not checked linear budget: few",
        "model     sha256 ab; method rk4",
        "again     xdynamics recheck makes it again from this file alone, and compares every number",
    ]


@pytest.mark.dear
def test_it_is_made_again_from_the_file_alone(certificate: xr.Dataset, tmp_path: Path) -> None:
    """Assert the same numbers from an archive, with the model's file gone, and the verbs."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    def call(*arguments: object) -> Any:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    xd.save(certificate, tmp_path / "C.nc")
    again = xd.recheck(tmp_path / "C.nc")
    assert again.attrs["result"] == certificate.attrs["result"]
    asked = [
        "certify",
        MODELS / "ball_drag.toml",
        "--quantity",
        "t",
        "--event",
        "ground",
        "--method",
        "dormand_prince",
        "--rtol",
        "1e-8",
    ]
    done = call(*asked, "--draws", "5000", "-o", tmp_path / "D.nc")
    assert "result    time of ground = 3.711 ± 0.040 s" in done.output
    assert "passed    ledger" in done.output
    (line,) = [each for each in done.output.splitlines() if "numerical part" in each and "bound" in each]
    found = re.fullmatch(
        r"passed +numerical part: numerical bound (\S+) s, physical standard uncertainty 0\.02 s", line
    )
    assert len(found[1].partition("e")[0].replace(".", "")) <= 2
    same = call("recheck", tmp_path / "D.nc")
    assert (same.exit_code, same.output.startswith("the same  ")) == (0, True)
    assert call("show", tmp_path / "D.nc").output.startswith("certificate of Ball")
    assert call("recheck", MODELS / "ball_drag.toml").exit_code != 0


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("value", "'value' is"),
        ("monte_carlo_mean", "'monte_carlo_mean' is"),
        ("residual", "'residual'"),
        ("gate_verdict", "'gate_verdict'"),
    ],
)
def test_one_digit_changed_is_named(certificate: xr.Dataset, name: str, said: str) -> None:
    """Assert that a changed number does not come out again."""
    values = np.array(certificate[name].values)
    place = (0,) * values.ndim
    values[place] = values[place] * (1 + 1e-15) + (1 if values.dtype.kind == "i" else 1e-300)
    forged = certificate.copy()
    forged[name] = (certificate[name].dims, values, certificate[name].attrs)
    with pytest.raises(xd.ArchiveError, match=said):
        xd.recheck(forged)


def test_a_small_uncertainty_of_old_is_written_otherwise(certificate: xr.Dataset) -> None:
    """Assert that a result whose uncertainty stands with all its zeros is the same, and one with another digit is not."""
    old, new = certificate.copy(), certificate.copy()
    new.attrs["result"] = "3.71119880 ± 5.3e-7 s (k = 2)"
    old.attrs["result"] = "3.71119880 ± 0.00000053 s (k = 2)"
    assert _differences(old, new) == []
    old.attrs["result"] = "3.71119880 ± 0.00000054 s (k = 2)"
    assert len(_differences(old, new)) == 1


def test_a_certificate_of_old_has_twice_what_was_drawn() -> None:
    """Assert that one made before records were audited is made again, with its number as it was written then."""
    model = xd.Model.from_toml(MODELS / "mass_calibration.toml")
    now = xd.certify(model, "dm", at="1 s", draws=1000, seed=2, event_start="waiting", atol_floor="none")
    asked = {k: v for k, v in json.loads(now.attrs["asked"]).items() if k not in ("event_start", "atol_floor")}
    old = now.isel(gate=now.gate_name.values != "record").drop_vars("run_contradiction")
    old.attrs["asked"] = json.dumps(asked, sort_keys=True)
    value, drawn = float(now.value), float(now.monte_carlo_standard_uncertainty)
    former = rounded_result(value, drawn, float(now.numerical_bound), "kg", "k = 2, drawn")
    old = old.assign(result=((), former, now.result.attrs)).assign_attrs(result=former)
    assert "± 0.15)e-6 kg (k = 2, drawn" in former
    assert xd.recheck(old).attrs["result"] == former
    old.attrs["result"] = former.replace("0.15", "0.14")
    with pytest.raises(xd.ArchiveError, match="result"):
        xd.recheck(old)


@pytest.mark.dear
def test_other_forgeries_are_named(certificate: xr.Dataset, tmp_path: Path) -> None:
    """Assert a result that was written over, a file of which a byte was changed, and what is no certificate."""
    forged = certificate.copy()
    forged.attrs["result"] = "3.712 ± 0.001 s"
    with pytest.raises(xd.ArchiveError, match=r"'result' is '3\.712"):
        xd.recheck(forged)
    xd.save(certificate, tmp_path / "C.nc")
    content = bytearray((tmp_path / "C.nc").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "C.nc").write_bytes(content)
    with pytest.raises(xd.ArchiveError, match="damaged"):
        xd.recheck(tmp_path / "C.nc")
    with pytest.raises(xd.InputError, match="is no certificate"):
        xd.recheck(xd.simulate(BALL, method="rk4", step="10 ms", until="1 s"))
    two = xd.certify(BALL, "y", at="1 s", method="rk4", step="20 ms", draws=400, digits=2)
    assert xd.recheck(two).attrs["digits"] == 2
    with pytest.raises(xd.InputError, match="discrepancy"):
        xd.certify(BALL, "t", terms=[], **ASKED)


@pytest.mark.dear
def test_a_number_that_is_not_defended_fails_its_gates() -> None:
    """Assert that numbers of coarse steps, and of a linear budget that is not adequate, do not pass."""
    coarse = xd.certify(BALL, "y", at="1 s", method="forward_euler", step="0.25 s", draws=500)
    assert gates(coarse)["numerical_part"] == "failed"
    mass = xd.certify(xd.Model.from_toml(MODELS / "mass_calibration.toml"), "dm", at="1 s", draws=20_000)
    assert gates(mass)["linear_budget"] == "failed"


@pytest.mark.dear
def test_a_bundle_is_made_again_and_every_file_is_held(certificate: xr.Dataset, tmp_path: Path) -> None:
    """Assert files, standard digests, metadata, figures drawn by the script to the byte, and faults of each kind."""
    import hashlib
    import json
    import runpy
    import shutil

    folder = xd.bundle(tmp_path / "b", certificate)
    names = {entry.name for entry in folder.iterdir()}
    assert {
        "certificate.nc",
        "run.nc",
        "ledger.nc",
        "model.toml",
        "plot.py",
        "README.md",
        "SHA256SUMS",
        "ro-crate-metadata.json",
    } <= names
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    graph = {one["@id"]: one for one in json.loads((folder / "ro-crate-metadata.json").read_text())["@graph"]}
    assert graph["./"]["description"].startswith("time of ground = 3.711 ± 0.040 s")
    assert {one["@id"] for one in graph["./"]["hasPart"]} == names - {"SHA256SUMS", "ro-crate-metadata.json"}
    assert xd.recheck(folder).attrs["result"] == certificate.attrs["result"]
    assert xd.reproduce(folder / "run.nc").attrs["identical"]
    before = (folder / "certificate.png").read_bytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        runpy.run_path("plot.py")
    assert (folder / "certificate.png").read_bytes() == before
    for k, spoil in enumerate(("damaged", "missing", "added", "no sums", "link", "pipe")):
        copy = tmp_path / str(k)
        shutil.copytree(folder, copy)
        if spoil == "damaged":
            (copy / "model.toml").write_text((copy / "model.toml").read_text().replace("0.145", "0.146"))
        elif spoil == "missing":
            (copy / "run.nc").unlink()
        elif spoil == "added":
            (copy / "more.txt").write_text("x")
        elif spoil in ("link", "pipe"):
            (copy / "run.nc").unlink()
            (copy / "run.nc").symlink_to(folder / "run.nc") if spoil == "link" else os.mkfifo(copy / "run.nc")
            with pytest.raises(xd.ArchiveError, match="run.nc is a .*, and no file of its own"):
                xd.document(copy, tmp_path / "page.html")
        else:
            (copy / "SHA256SUMS").unlink()
        said = {
            "damaged": "model.toml differs",
            "missing": "run.nc is missing",
            "added": "more.txt is none",
            "no sums": "no SHA256SUMS",
            "link": "run.nc is a link, and no file of its own",
            "pipe": r"run.nc is a pipe \(FIFO\), and no file of its own",
        }[spoil]
        with pytest.raises(xd.ArchiveError, match=said):
            xd.recheck(copy)


@pytest.mark.dear
@pytest.mark.parametrize("said", ["another model", "another run than the certificate's"])
def test_a_bundle_with_other_sums_is_found_out(said: str, certificate: xr.Dataset, tmp_path: Path) -> None:
    """Assert that who writes the digests anew still does not get another model, or a whole archive of another run, past."""
    import hashlib

    folder = xd.bundle(tmp_path / "b", certificate)
    if said == "another model":
        (folder / "model.toml").write_text((folder / "model.toml").read_text().replace("0.145", "0.146"))
    else:
        xd.simulate(BALL, path=folder / "run.nc", method="rk4", step="10 ms", until="1 s")
    rows = [line.split("  ")[1] for line in (folder / "SHA256SUMS").read_text().splitlines()]
    (folder / "SHA256SUMS").write_text(
        "".join(f"{hashlib.sha256((folder / row).read_bytes()).hexdigest()}  {row}\n" for row in rows)
    )
    with pytest.raises(xd.ArchiveError, match=said):
        xd.recheck(folder)


@pytest.mark.dear
def test_a_method_that_fails_its_ledger_is_no_witness(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a failed case of the method fails the gate."""
    from xdynamics.budgeting import certificate as room

    def failing(methods: list[str], **kept: Any) -> xr.Dataset:
        found = xd.validate(methods, **kept)
        found["verdict"] = (
            found.verdict.dims,
            np.where(np.arange(found.sizes["case"]) == 3, 1, found.verdict.values).astype(np.int8),
            found.verdict.attrs,
        )
        return found

    monkeypatch.setattr(room, "validate", failing)
    found = xd.certify(BALL, "y", at="1 s", method="rk4", step="20 ms", draws=400)
    assert gates(found)["ledger"] == "failed"


def test_what_cannot_be_bundled_is_named(certificate: xr.Dataset, tmp_path: Path) -> None:
    """Assert a folder that is not empty, a file in its place, and what is no certificate."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    (tmp_path / "file").write_text("")
    for folder, said in (("full", "holds 'x' already"), ("file", "is a file; name a folder")):
        with pytest.raises(xd.InputError, match=said):
            xd.bundle(tmp_path / folder, certificate)
    with pytest.raises(xd.InputError, match="is no certificate"):
        xd.bundle(tmp_path / "new", xd.simulate(BALL, method="rk4", step="10 ms", until="1 s"))
    assert not (tmp_path / "new").exists()


@pytest.mark.dear
def test_too_few_draws_leave_a_gate_open_and_say_how_many_settle_it(tmp_path: Path) -> None:
    """Assert not_checked, the number of draws, the verdict by so many, exit code 1 and the same again from the file."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    asked = {name: value for name, value in ASKED.items() if name != "draws"}
    few = xd.certify(BALL, "t", draws=100, **asked)
    assert gates(few)["linear_budget"] == "not_checked"
    needed = float(few.attrs["draws_needed"])
    reason = str(few.gate_reason.values[few.gate_name.values.tolist().index("linear_budget")])
    assert reason == f"the linear budget is not checked: 100 draws leave it open, about {needed:.0f} settle it"
    rounds, verdict = 0, "not_checked"
    while verdict == "not_checked" and rounds < 4:
        more = xd.error_budget(BALL, "t", draws=round(needed), **asked)
        verdict, rounds = more.linear_verdict.attrs["flag_meanings"].split()[int(more.linear_verdict)], rounds + 1
        needed = float(more.attrs.get("draws_needed", needed))
    assert verdict == "adequate"
    none = xd.certify(BALL, "t", draws=0, **asked)
    assert gates(none)["linear_budget"] == "not_checked"
    xd.save(few, tmp_path / "C.nc")
    assert gates(xd.recheck(tmp_path / "C.nc"))["linear_budget"] == "not_checked"
    verb = ["certify", str(MODELS / "ball_drag.toml"), "--quantity", "t", "--event", "ground", "--rtol", "1e-8"]
    said = CliRunner().invoke(
        main, [*verb, "--method", "dormand_prince", "--draws", "100", "-o", str(tmp_path / "D.nc")]
    )
    assert said.exit_code == 1, said.output
    assert "not checked linear budget: the linear budget is not checked: 100 draws leave it open" in said.output


@pytest.mark.cases(200)
def test_the_number_of_draws_that_is_told_settles_it(case: int) -> None:
    """Assert the right verdict of normal and of bent numbers, and that what is left open is so after four rounds at most."""
    from scipy.optimize import brentq
    from scipy.stats import norm

    from xdynamics.budgeting.montecarlo import (
        ADEQUATE,
        NOT_ADEQUATE,
        NOT_CHECKED,
        draw_statistics,
        draws_needed,
        judge_linear,
        tolerance_of,
    )

    rng = np.random.default_rng([case, 5])
    spread, bent = float(rng.uniform(0.011, 0.099)), float(rng.uniform(0.0, 0.2)) * (case % 2)

    def end(part: float) -> float:
        """A quantile of z + b z^2."""

        def below(y: float) -> float:
            root = np.sqrt(max(1.0 + 4.0 * bent * y, 0.0))
            return float(norm.cdf((root - 1.0) / (2.0 * bent)) - norm.cdf((-root - 1.0) / (2.0 * bent))) - part

        return spread * (float(brentq(below, -0.25 / bent, 9.0)) if bent else float(norm.ppf(part)))

    true = max(abs(end(part) - spread * float(norm.ppf(part))) for part in (0.025, 0.975))
    tolerance = tolerance_of(spread * np.sqrt(1.0 + 2.0 * bent**2))
    count, rounds, verdict = 100, 0, NOT_CHECKED
    while verdict == NOT_CHECKED and rounds < 5 and count < 2_000_000:
        normal = rng.standard_normal(count)
        found = draw_statistics(3.0 + spread * (normal + bent * normal**2), 0.95)
        verdict, apart = judge_linear(3.0, spread, found, 0.95)
        needed, rounds = draws_needed(apart, found, count, 0.95), rounds + 1
        assert needed > count
        count = round(needed)
    if abs(true - tolerance) > 0.2 * tolerance:
        assert verdict == (ADEQUATE if true < tolerance else NOT_ADEQUATE)
