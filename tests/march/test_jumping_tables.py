"""Two rows of one argument are a jump: each side is interpolated by itself, and the motion is exact on both."""

import math
from pathlib import Path

import pytest

import xdynamics as xd

PULSE = "t [s],F [N]\n0,0\n1,0\n1,3\n2,1\n2,-2\n3,-2\n3,0\n4,0\n"
# twice integrated, over 2 kg: v = 3/2 u - u^2/2 in the second second, 1 - u in the third
LAST = 3 / 4 - 1 / 6 + 1 / 2
WELL = "x [m],F [N]\n-1,1\n1,1\n1,-2\n3,-2\n3,1\n9,1\n"


def pulled(csv: str, speed: str = "0 m s-1", **drive: str) -> xd.Model:
    return xd.Model(
        name="Mass pulled by a table",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "2 kg"},
        mass={"x": "m"},
        drives={"F": {"csv": csv, "duplicates": "jump", **drive}},
        forces={"pull": {"x": "F"}},
        initial={"x": "0 m", "v_x": speed},
    )


@pytest.mark.parametrize("interpolation", ["linear", "pchip", "cubic"])
@pytest.mark.parametrize("method", ["rk4", "dop853", "radau_iia", "taylor", "dormand_prince"])
def test_each_side_is_interpolated_by_itself(method: str, interpolation: str) -> None:
    settings = {"rtol": 1e-10} if method in ("dop853", "radau_iia", "taylor", "dormand_prince") else {"step": "0.3 s"}
    run = xd.simulate(pulled(PULSE, interpolation=interpolation), method=method, until="4 s", **settings)
    assert float(run.x[-1]) == pytest.approx(LAST, rel=1e-12)
    assert float(run.v_x[-1]) == pytest.approx(0.0, abs=1e-12)
    assert {1.0, 2.0, 3.0} <= {*run.time.values.tolist()}


def test_of_values_that_hold_the_second_of_two_rows_does() -> None:
    run = xd.simulate(pulled(PULSE, interpolation="previous"), method="rk4", step="0.25 s", until="4 s")
    force = dict(zip(run.time.values.tolist(), run.force_pull_x.values.tolist(), strict=True))
    assert (force[1.0], force[1.25], force[2.25], force[3.25]) == (0.0, 3.0, -2.0, 0.0)  # a step ends before the jump
    assert float(run.x[-1]) == pytest.approx(9 / 4, rel=1e-12)


def test_jumps_at_both_ends_hold_their_outer_value() -> None:
    model = pulled("t [s],F [N]\n1,4\n1,0\n2,0\n2,-4\n", outside="hold")
    run = xd.simulate(model, method="rk4", step="0.5 s", until="3 s")
    assert float(run.v_x[-1]) == pytest.approx(0.0, abs=1e-14)
    assert float(run.x[-1]) == pytest.approx(1.0 + 2.0 + 1.0, rel=1e-14)


def test_a_jump_over_a_position_is_located() -> None:
    run = xd.simulate(pulled(WELL, "2 m s-1", argument="x"), method="dop853", rtol=1e-11, until="3 s")
    speed = math.sqrt(5.0)  # 4 J and 1 N over 1 m, of 2 kg; then 1 m s-2 against it
    first = (speed - 2.0) / 0.5
    assert run.event_time.values == pytest.approx([first, first + speed - 1.0], rel=1e-11)


def test_the_text_keeps_what_two_rows_mean(tmp_path: Path) -> None:
    model = pulled(PULSE)
    assert xd.Model.from_text(model.to_toml()).digest == model.digest
    assert model.digest != pulled(PULSE.replace("1,3", "1,2")).digest
    run = xd.simulate(model, method="dop853", rtol=1e-9, until="4 s")
    xd.save(run, tmp_path / "pulse.nc")
    assert xd.reproduce(tmp_path / "pulse.nc").attrs["identical"] == 1


def test_a_table_of_pandas_jumps_too() -> None:
    import pandas as pd

    table = pd.DataFrame({"t [s]": [0.0, 1.0, 1.0, 2.0], "F [N]": [0.0, 0.0, 2.0, 2.0]})
    expected = {"jump": 1 / 2, "mean": 2 / 3, "first": 1 / 6, "last": 7 / 6}
    for duplicates, last in expected.items():
        model = xd.Model(
            name="From pandas",
            coordinates={"x": {"unit": "m"}},
            parameters={"m": "2 kg"},
            mass={"x": "m"},
            drives={"F": {"table": table, "duplicates": duplicates}},
            forces={"pull": {"x": "F"}},
            initial={"x": "0 m", "v_x": "0 m s-1"},
        )
        assert float(xd.simulate(model, method="rk4", step="0.1 s", until="2 s").x[-1]) == pytest.approx(last), (
            duplicates
        )


def test_uncertain_rows_on_both_sides_count() -> None:
    """v(2 s) of 2 kg by a constant 4 ± 0.2 N, then 2 ± 0.1 N: what is common to all rows adds."""
    csv = "t [s],F [N],u_common(F) [N]\n0,4,0.2\n1,4,0.2\n1,2,0.1\n2,2,0.1\n"
    settings = {"method": "rk4", "step": "0.25 s", "until": "2 s"}
    budget = xd.error_budget(pulled(csv), "v_x", at="2 s", **settings)
    assert float(budget.sensitivity[-1]) == pytest.approx(0.15, rel=1e-9)
    assert budget.result.item().startswith("3.00 ± 0.30 m s-1")


def test_members_of_a_sweep_take_both_rows() -> None:
    sweep = xd.sweep(pulled(PULSE), {"m": [1.0, 2.0, 4.0]}, method="rk4", step="0.1 s", until="4 s", keep=["end_x"])
    assert sweep.end_x.values == pytest.approx([2 * LAST, LAST, LAST / 2], rel=1e-12)


def test_what_cannot_jump_says_so(tmp_path: Path) -> None:
    with pytest.raises(xd.ModelError, match="delays the drive 'F', whose table has jumps"):
        pulled(PULSE).replace(forces={"pull": {"x": "delayed(F, 0.5*second)"}})
    run = xd.simulate(pulled(PULSE), method="rk4", step="0.5 s", until="4 s")
    (tmp_path / "x.csv").write_text("time [s],x [m]\n0,0\n1,0\n1,1\n2,0\n")
    with pytest.raises(xd.InputError, match="duplicates is 'jump', which drives have"):
        xd.compare(run, tmp_path / "x.csv", reading={"duplicates": "jump"})
