"""Blocks: what stands where in an array."""

from __future__ import annotations

import pickle

import numpy as np

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.kernels import layout_of
from xdynamics.shapes import Extent
from xdynamics.shapes.blocks import Block, Blocks


def test_blocks_stand_one_after_another() -> None:
    """Assert that places follow from the shapes of the blocks before, also in arrays joined from others."""
    random = np.random.default_rng(1)
    shapes = [tuple(random.integers(0, 4, size=random.integers(0, 3)).tolist()) for _ in range(20)]
    blocks = [Block(f"b{k}", "state", tuple("ij"[: len(shape)]), shape) for k, shape in enumerate(shapes)]
    joined = Blocks(blocks[:7]) + Blocks(blocks[7:])
    places = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    assert [joined.offset_of(block.name) for block in joined.blocks] == places[:-1].tolist()
    assert joined.size == len(joined) == places[-1]


def test_numbers_are_found_by_their_names() -> None:
    """Assert that every number of blocks has a name, by which it is found, and that no other name is."""
    body, axis = Extent("body", 2, ("Sun", "Moon")), Extent("axis", 3)
    blocks = Blocks([Block("t", "time"), Block("r", "coordinate", ("body", "axis"), (2, 3), (body, axis))])
    assert tuple(blocks) == ("t", *(f"r·{label}·{k}" for label in ("Sun", "Moon") for k in range(3)))
    assert [blocks.index(name) for name in blocks] == [*range(7)] == [blocks.find_offset(blocks[k]) for k in range(7)]
    assert blocks[-1] == "r·Moon·2"
    assert blocks.renamed("velocity", "v_{}".format).offset_of("v_r·Moon·0") == 4
    for name in ("r", "r·Sun", "r·Sun·3", "r·Sun·03", "r·Sun·²", "r·Mars·0", "s·Sun·0", 0):
        assert name not in blocks


def test_copies_have_the_same_blocks() -> None:
    """Assert that blocks are the same after a trip to another process."""
    blocks = Blocks([Block("r", "coordinate", ("body",), (3,)), Block("s", "state")])
    copy = pickle.loads(pickle.dumps(blocks))
    assert (copy, copy.blocks, copy.size, copy.offset_of("s")) == (blocks, blocks.blocks, 4, 3)


def test_a_state_has_its_variables_first() -> None:
    """Assert the order of roles in a state of the march, and that a single number has the shape of none."""
    record = layout_of(xd.Model.from_toml(MODELS / "double_pendulum.toml")).record
    roles = list(dict.fromkeys(block.role for block in record.blocks))
    assert roles == ["coordinate", "velocity", "acceleration", "force"]
    assert {block.shape for block in record.blocks} == {()}
    assert record.size == len(record)
