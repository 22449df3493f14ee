"""What a lecturer, a student and an engineer typed first, and what was computed in silence: each against a closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main
from xdynamics.documenting.summary import summary
from xdynamics.model.uncertainty import split_uncertainty


def spring(stiffness: str, **sections: Any) -> xd.Model:
    """Return a mass of 1 kg on a spring, from 1 m at rest."""
    return xd.Model(
        name="Spring",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": stiffness},
        mass={"x": "m"},
        forces={"s": {"potential": "k*x**2/2"}},
        initial={"x": "1 m"},
        **sections,
    )


@pytest.mark.parametrize("text", ["100 ± 5% N/m", "100 ± 5 % N/m", "100 N/m ± 5%", "100 N/m +/- 5 percent"])
def test_percent_is_a_part_of_the_value(text: str) -> None:
    """Assert the motion of 100 N/m, and a sensitivity of 5 N/m; it was 1 N/m."""
    model = spring(text)
    run = xd.simulate(model, method="dop853", rtol=1e-11, until="1 s")
    assert float(run.x[-1]) == pytest.approx(np.cos(10.0), rel=1e-8)
    assert model.parameters["k"].uncertainty == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0.75 ± 5%", "has no unit, and may mean percent of it, or in percent; write '0.75 ± 0.0375'"),
        ("100 N/m ± 5 % N/m", "has two units; write '100 N/m ± 5 %'"),
        ("20 °C ± 5 %", "unit '°C' is for values alone"),
        ("much ± 5 %", "has no number that percent could be of"),
    ],
)
def test_percent_that_may_mean_two_things_is_refused(text: str, said: str) -> None:
    """Assert one line with what to write; two numbers in percent are as they were."""
    with pytest.raises(xd.ModelError, match=said.replace("°", ".")):
        spring(text)
    assert split_uncertainty("50 % ± 2 %") == ("50 %", "2 %")


def test_the_kinetic_energy_of_a_driven_hoop_is_the_one_that_was_written(tmp_path: Path) -> None:
    """Assert all of it at each row; what is free of velocities was left out. The Jacobi integral stays constant."""
    model = xd.Model(
        name="Bead on a turning hoop",
        coordinates={"theta": "rad"},
        parameters={"m": "50 g", "R": "20 cm", "w": "9 rad/s", "g": "9.81 m s-2"},
        lagrangian={"kinetic": "m*R**2*(v_theta**2 + w**2*sin(theta)**2)/2", "potential": "-m*g*R*cos(theta)"},
        initial={"theta": "30 degree"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s")
    theta = run.theta.values if run.theta.attrs["units"] == "rad" else np.deg2rad(run.theta.values)
    turning = 0.05 * 0.04 * 81.0 * np.sin(theta) ** 2 / 2.0
    kinetic = 0.05 * 0.04 * run.v_theta.values**2 / 2.0 + turning
    assert run.kinetic_energy.values == pytest.approx(kinetic, rel=1e-12)
    jacobi = run.total_energy.values - 2.0 * turning
    assert jacobi == pytest.approx(np.full(jacobi.size, jacobi[0]), rel=1e-8)
    xd.save(run, tmp_path / "hoop.nc")
    assert xd.reproduce(tmp_path / "hoop.nc").attrs["identical"] == 1


def test_the_kinetic_energy_of_a_shaken_pivot_has_the_term_linear_in_velocities() -> None:
    """Assert T of a pivot that moves as A sin(w t), at rest in its frame at the start: m (A w)^2 / 2."""
    model = xd.Model(
        name="Pendulum on a shaken pivot",
        coordinates={"th": "rad"},
        parameters={"m": "1 kg", "l": "1 m", "A": "0.1 m", "w": "5 rad/s", "g": "9.81 m s-2"},
        lagrangian={
            "kinetic": "m/2*((l*cos(th)*v_th + A*w*cos(w*t))**2 + (l*sin(th)*v_th)**2)",
            "potential": "-m*g*l*cos(th)",
        },
        initial={"th": "0.1 rad"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="1 s")
    t, th, v = run.time.values, run.th.values, run.v_th.values
    kinetic = ((np.cos(th) * v + 0.5 * np.cos(5.0 * t)) ** 2 + (np.sin(th) * v) ** 2) / 2.0
    assert float(run.kinetic_energy[0]) == pytest.approx(0.125, rel=1e-12)
    assert run.kinetic_energy.values == pytest.approx(kinetic, rel=1e-12)


@pytest.mark.parametrize("method", ["dop853", "taylor", "rk4"])
def test_a_stop_where_a_table_ends_is_a_crossing(method: str) -> None:
    """Assert the kind of an event that is passed at 17 m/s; it was called a touch."""
    model = xd.Model(
        name="Ball in a wind by height",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "0.1 kg", "g": "9.81 m s-2", "c": "0.01 kg s-1"},
        mass={"x": "m", "y": "m"},
        drives={"wind": {"csv": "y [m],wind [m/s]\n0,1\n10,3\n50,8\n", "argument": "y"}},
        forces={"g": {"potential": "m*g*y"}, "d": {"x": "-c*(v_x - wind)", "y": "-c*v_y"}},
        initial={"x": "0 m", "y": "15 m", "v_x": "10 m/s", "v_y": "1 m/s"},
        events={"ground": {"function": "y", "direction": "falling", "action": "stop"}},
    )
    settings = {"step": "10 ms"} if method == "rk4" else {"rtol": 1e-10}
    run = xd.simulate(model, method=method, until="9 s", **settings)
    assert run.dynamics.events("ground").event_kind.values.tolist() == [0]
    found = float(run.event_time[-1])  # y = 15 + (1 + 98.1)*10*(1 - exp(-t/10)) - 98.1 t
    assert 15.0 + 991.0 * (1.0 - np.exp(-found / 10.0)) - 98.1 * found == pytest.approx(0.0, abs=1e-7)


def test_a_comparison_at_the_end_of_a_table_has_a_number() -> None:
    """Assert an observable that reads a road over v*t at its last point; it was nan there."""

    def car(damping: str) -> Any:
        model = xd.Model(
            name="Car",
            coordinates={"u": "m"},
            parameters={"m": "40 kg", "k": "2e4 N/m", "c": damping, "v": "20 m/s"},
            mass={"u": "m"},
            drives={"road": {"csv": "s [m],z [mm]\n0,0\n10,5\n50,8\n100,1\n", "argument": "v*t"}},
            forces={"tyre": {"u": "-k*(u - road) - c*v_u"}},
            observables={"tyre_load": "k*(u - road)"},
            initial={"u": "0 m"},
        )
        return xd.simulate(model, method="dop853", rtol=1e-8, until="5 s")

    first, second = car("100 N s/m"), car("200 N s/m")
    compared = xd.compare(first, second)
    assert np.isfinite(compared.difference_tyre_load.values).all()
    expected = float(first.tyre_load[-1] - second.tyre_load[-1])
    assert abs(float(compared.difference_tyre_load[-1])) == pytest.approx(abs(expected), rel=1e-9)


def cradle(law: str, restitution: str = "1") -> xd.Model:
    """Return three pendulums that touch, of which the first falls from 30 degrees."""
    return xd.Model(
        name="Cradle",
        coordinates={f"q{i}": "rad" for i in range(3)},
        parameters={"m": "1 kg", "L": "1 m", "g": "9.81 m s-2"},
        mass={f"q{i}": "m*L**2" for i in range(3)},
        forces={f"g{i}": {"potential": f"-m*g*L*cos(q{i})"} for i in range(3)},
        contacts={
            f"c{i}": {"gap": f"L*(q{i + 1} - q{i})/radian", "restitution": restitution, "law": law} for i in range(2)
        },
        initial={"q0": "-30 degree", "q1": "0 rad", "q2": "0 rad"},
    )


@pytest.mark.parametrize(
    ("law", "restitution", "said"),
    [("newton", "1", True), ("poisson", "0.5", True), ("sequential", "1", False), ("newton", "0", False)],
)
def test_where_the_law_of_impacts_decides_the_summary_says_so(law: str, restitution: str, *, said: bool) -> None:
    """Assert the line where contacts that push each other close at once, and none where laws agree or one is chosen."""
    run = xd.simulate(cradle(law, restitution), method="dop853", rtol=1e-9, until="0.6 s")
    lines = " ".join(" ".join(summary(run)).split())
    assert (
        f"c0, c1 closed at once at t = 0.510247 s, and push each other: what follows is chosen by the law '{law}'"
        in lines
    ) is said


def test_two_balls_that_land_at_once_apart_are_no_choice_of_a_law() -> None:
    """Assert no line where the contacts share no coordinate."""
    model = xd.Model(
        name="Two balls",
        coordinates={"a": "m", "b": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"a": "m", "b": "m"},
        forces={"g": {"potential": "m*g*(a + b)"}},
        contacts={f"floor_{name}": {"gap": name, "restitution": "0.5"} for name in ("a", "b")},
        initial={"a": "1 m", "b": "1 m"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-9, until="0.5 s")
    assert run.sizes["event"] == 2
    assert not any(line.startswith("impacts") for line in summary(run))


def test_a_mean_over_time_says_how() -> None:
    """Assert the note below xarray's error, and the mean that it names against its closed form."""
    model = xd.Model(
        name="Decay",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "c": "1 kg/s"},
        mass={"x": "m"},
        forces={"d": {"x": "-c*v_x"}},
        initial={"x": "0 m", "v_x": "1 m/s"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-9, until="20 s")
    for data, options in ((run, {"dim": "time"}), (run.v_x, {"dim": "time"})):
        with pytest.raises(ValueError, match="time") as caught:
            data.mean(**options)
        assert "run.dynamics.at(np.linspace(0, 5, 1001)).x.mean('at')" in caught.value.__notes__[0]
    even = run.dynamics.at(np.linspace(0.0, 20.0, 20001)).v_x
    assert float(even.integrate("at_time")) / 20.0 == pytest.approx((1.0 - np.exp(-20.0)) / 20.0, rel=1e-5)


def test_a_root_at_zero_in_a_potential_says_what_to_write() -> None:
    """Assert the divisor and the remedy where a spring to an anchor begins at it."""
    model = xd.Model(
        name="Spring to the origin",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "k": "1 N/m"},
        mass={"x": "m", "y": "m"},
        forces={"s": {"potential": "k*hypot(x, y)**2/2"}},
        initial={"x": "0 m", "y": "0 m", "v_x": "1 m/s"},
    )
    with pytest.warns(UserWarning, match="did not reach"):
        run = xd.simulate(model, method="dop853", rtol=1e-8, until="1 s")
    words = str(run.attrs["run_outcome_text"])
    assert (
        "hypot(x, y) is 0 there; it is divided by in the slope of a root: write the square of a distance by sums"
        in words
    )


def test_refine_takes_the_coarsest_step_or_tolerance_alone() -> None:
    """Assert five levels as of the command line, each a half or a tenth of the one before; both at once are refused."""
    by_steps = xd.refine(spring("1 N/m"), method="rk4", step="40 ms", until="1 s")
    assert by_steps.step_size.values == pytest.approx([0.04, 0.02, 0.01, 0.005, 0.0025])
    assert by_steps.order_x.values.ravel()[1:4] == pytest.approx([4.0, 4.0, 4.0], abs=0.1)
    by_tolerances = xd.refine(spring("1 N/m"), method="dop853", rtol=1e-5, until="1 s")
    assert by_tolerances.rtol.values == pytest.approx([1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
    declared = xd.refine(spring("1 N/m", run={"method": "rk4", "step": "20 ms", "until": "1 s"}))
    assert declared.step_size.values[0] == 0.02
    with pytest.raises(xd.InputError, match="step and rtol are both given; one of them is varied"):
        xd.refine(spring("1 N/m"), method="dop853", rtol=1e-8, step="1 s", until="1 s")
    with pytest.raises(xd.InputError, match="has no step in its .run.; give step or rtol, the coarsest one"):
        xd.refine(spring("1 N/m"), method="dop853", until="1 s")


def test_the_text_of_a_model_is_no_path() -> None:
    """Assert that it is said which reads it."""
    with pytest.raises(
        xd.ModelError, match=r"this is the text of a model, no name of a file; Model.from_text reads it"
    ):
        xd.Model.from_toml(spring("1 N/m").to_toml())


def test_texts_of_a_model_are_no_tags_in_markdown(tmp_path: Path) -> None:
    """Assert that a name and descriptions stay text in the report of a bundle."""
    live = "<script>alert(1)</script> ![x](javascript:alert(2))"
    model = spring("100 ± 5 % N/m").replace(parameters={"k": {"value": "100 N/m", "description": live}})
    (tmp_path / "m.toml").write_text(model.to_toml().replace('name = "Spring"', f"name = '{live}'"))
    certify = [
        "certify",
        "m.toml",
        "--until",
        "1 s",
        "--method",
        "rk4",
        "--step",
        "5 ms",
        "--quantity",
        "x",
        "--at",
        "1 s",
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        for command in ([*certify, "-o", "c.nc"], ["bundle", "c.nc", "-o", "b"], ["report", "b", "-o", "r.md"]):
            done = CliRunner().invoke(main, command)
            assert done.exit_code == 0, done.output
    for file in ("b/README.md", "r.md"):
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert "alert(1)" in text
        shown = "\n".join(line for line in text.splitlines() if not line.startswith("    "))
        assert "<script" not in shown
        assert "](javascript" not in shown


def test_declared_observables_are_drawn(tmp_path: Path) -> None:
    """Assert panels of them by their units, and no plane of two heights."""
    from xdynamics.figures.run import panels_and_omissions

    model = xd.Model(
        name="Quarter car",
        coordinates={"zs": "m", "zu": "m"},
        parameters={"ms": "300 kg", "mu": "40 kg", "k": "2e4 N/m"},
        mass={"zs": "ms", "zu": "mu"},
        forces={"spring": {"zs": "-k*(zs - zu)", "zu": "k*(zs - zu)"}},
        observables={"comfort": "a_zs", "stretch": "zs - zu"},
        initial={"zs": "0 m", "zu": "0.01 m"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-8, until="1 s")
    panels, _ = panels_and_omissions(run, ["observable"])
    assert len(panels) == 2
    few, left_out = panels_and_omissions(run, amount="few")
    assert len(few) == 4
    assert "plane" not in left_out
    xd.plot(run, tmp_path / "car.png", only=["comfort"])
    assert (tmp_path / "car.png").stat().st_size > 5_000
