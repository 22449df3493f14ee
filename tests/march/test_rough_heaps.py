"""Discs that fall into a box whose floor and walls rub, as they do on each other: laws that hold in every row."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.documenting.summary import summary
from xdynamics.schema import REST, STICK

HEAP = (MODELS / "rough_pile.toml").read_text()


@lru_cache
def heap() -> xr.Dataset:
    """Return the run of twenty-four discs until several layers slide, roll and stick."""
    return xd.simulate(xd.Model.from_text(HEAP), until="0.26 s", log="full", force_samples="none")


@pytest.mark.dear
def test_discs_do_not_sink_into_each_other() -> None:
    """Assert, in every row, no overlap beyond rounding: one that lies on another and lets go is found when it comes back."""
    run = heap()
    x, y, radius = run.x.values, run.y.values, run.radius.values
    first, second = run.pair_first.values, run.pair_second.values
    gaps = np.hypot(x[:, second] - x[:, first], y[:, second] - y[:, first]) - radius[first] - radius[second]
    assert run.attrs["run_outcome"] == "completed"
    assert gaps.min() > -1e-11
    assert min(run.contact_gap_floor.values.min(), run.contact_gap_left.values.min()) > -1e-11


def test_friction_stays_within_its_cone() -> None:
    """Assert at steps' ends that no link pulls, friction is at most mu times the force, and that many stick and many slide."""
    run = heap()
    of_steps = run.row_kind.values[run.closed_step.values] == 1  # at an event, bounds are what it is about
    force, rubs = run.closed_force.values[of_steps], np.abs(run.closed_friction_force.values[of_steps])
    size = force.max()
    assert force.min() > -1e-9 * size
    assert (rubs - 0.4 * force).max() < 1e-8 * size
    slides = rubs > 0.4 * force - 1e-8 * size
    assert min(np.count_nonzero(slides), np.count_nonzero(~slides)) > 100


def test_discs_are_moved_by_what_is_recorded() -> None:
    """Assert for every disc and row that weight, normal and friction forces make the acceleration across and upward."""
    run = heap()
    mass = 25 * np.pi * run.radius.values**2
    total = np.stack([0 * run.x.values, 0 * run.x.values - mass * 9.80665], axis=2)
    total[:, :, 0] += run.contact_force_left.values - run.contact_force_right.values + run.friction_force_floor.values
    total[:, :, 1] += run.contact_force_floor.values + run.friction_force_left.values + run.friction_force_right.values
    words = run.closed_contact.attrs["flag_meanings"].split()
    of_pairs = run.closed_contact.values == words.index("discs")
    row, one, other = (run[f"closed_{name}"].values[of_pairs] for name in ("step", "first", "second"))
    along = np.stack([run[name].values[row, other] - run[name].values[row, one] for name in "xy"], axis=1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    beside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    push = run.closed_force.values[of_pairs][:, None] * along
    push += run.closed_friction_force.values[of_pairs][:, None] * beside
    np.add.at(total, (row, one), -push)
    np.add.at(total, (row, other), push)
    found = np.stack([run.a_x.values, run.a_y.values], axis=2) * mass[:, None]
    steps = run.row_kind.values == 1  # a row before an event has the forces of what was closed until then
    assert np.abs(total - found)[steps].max() < 1e-8 * np.abs(total).max()


DIGEST = """
import sys
import xdynamics as xd
print(xd.content_digest(xd.simulate(xd.Model.from_text(sys.stdin.read()), until="0.13 s", step="5 ms")))
"""


@pytest.mark.dear
def test_compiled_heaps_have_the_bits_of_plain_python() -> None:
    """Assert equal digests of six discs that strike a rough floor, and each other, with and without a compiler."""
    digests = []
    for switch in ("0", "1"):
        known = os.environ | {"NUMBA_DISABLE_JIT": switch}
        done = subprocess.run(
            [sys.executable, "-c", DIGEST],
            input=HEAP.replace("disc = 24", "disc = 6"),
            capture_output=True,
            text=True,
            env=known,
            check=True,
        )
        digests.append(done.stdout.strip())
    assert digests[0] == digests[1]


def nearly_at_rest() -> xd.Model:
    """The heap of 38 links, in which one disc still rolls on others."""
    path = Path(__file__).parent.parent / "cases" / "rough_heap.csv"
    names = [name.split()[0] for name in path.read_text().splitlines()[0].split(",")]
    columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    units = {"x": "m", "v_x": "m s-1", "y": "m", "v_y": "m s-1", "theta": "rad", "v_theta": "rad s-1"}
    start = "".join(
        f'{name} = {{ value = {values.tolist()}, unit = "{units[name]}" }}\n' for name, values in columns.items()
    )
    text = HEAP[: HEAP.index("[initial]")] + "[initial]\n" + start + HEAP[HEAP.index("[run]") :]
    return xd.Model.from_text(text)


@pytest.mark.dear
def test_a_heap_that_nearly_rests() -> None:
    """Assert that forces of 38 links go on within their cones, where shares that jumped from one to another took minutes."""
    run = xd.simulate(nearly_at_rest(), until="60 ms", log="full", force_samples="none")
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] < 100  # 30 steps of 2 ms, and a few events
    last = run.closed_step.values == run.sizes["step"] - 1
    pressing, rubbing = run.closed_force.values[last], run.closed_friction_force.values[last]
    assert last.sum() > 30
    assert pressing.min() >= 0.0
    assert (np.abs(rubbing) - 0.4 * pressing).max() < 1e-10 * pressing.max()


@lru_cache
def small_heap() -> xr.Dataset:
    """Return the run of nine discs in a narrow box, whose bounces below 10 nm may be skipped, until 1 s."""
    text = (
        HEAP.replace("disc = 24", "disc = 9")
        .replace('"0.7 m"', '"0.36 m"')
        .replace("index(disc), 6)", "index(disc), 3)")
    )
    text = text.replace("index(disc)/6)", "index(disc)/3)")
    low = text.replace("restitution = 0\n", 'restitution = 0\nrest_height = "10 nm"\n')
    return xd.simulate(xd.Model.from_text(low), until="1 s", log="full", force_samples="none")


def test_a_heap_comes_to_rest() -> None:
    """Assert that motions lower than bounces of 10 nm end: no velocity, no event from 0.9 s on, each disc in balance."""
    run = small_heap()
    rests = run.time.values > 0.9
    assert run.attrs["run_outcome"] == "completed"
    assert run.event_time.values.max() < 0.9
    for name in ("v_x", "v_y", "v_theta"):
        assert np.abs(run[name].values[rests]).max() < 1e-18
    of_steps = rests[run.closed_step.values]
    force, rubs = run.closed_force.values[of_steps], np.abs(run.closed_friction_force.values[of_steps])
    assert force.min() >= 0.0
    assert (rubs - 0.4 * force).max() < 1e-9 * force.max()
    mass = 25 * np.pi * run.radius.values**2  # accelerations are what forces of all links leave of weights
    for name in ("a_x", "a_y"):
        assert (np.abs(run[name].values[rests]) * mass).max() < 1e-9 * 9.80665 * mass.min()
    assert np.abs(run.a_theta.values[rests] * run.radius.values / 2.0).max() < 1e-9 * 9.80665


def test_what_stops_slow_motions_takes_less_than_a_bounce() -> None:
    """Assert of rows of rest and stick that each took at most what a bounce of 10 nm has, and that the summary sums them up."""
    run = small_heap()
    stops = np.isin(run.event_kind.values, (REST, STICK))
    lost = run.event_energy_lost.values[stops]
    bounce = 25 * np.pi * run.radius.values.max() ** 2 * 9.80665 * 10e-9
    assert np.abs(lost).max() < bounce
    assert np.count_nonzero(lost > 1e-3 * bounce) > 10
    (line,) = [line for line in summary(run) if line.startswith("stopped")]
    assert line.startswith(f"stopped   {np.count_nonzero(lost)} motions lower than a bounce of rest_height")
    assert f"which took {lost.sum():.3g} J" in line


def test_links_that_part_are_located_with_few_forces() -> None:
    """Assert that no event of a heap takes more than 100 parts of a step: links that part at both ends of one need none."""
    assert small_heap()["event_substeps"].max() <= 100
