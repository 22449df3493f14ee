"""Every stage on models of every pair of kinds: it answers, or refuses in one line that names the model or what it lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

import xdynamics as xd
from cases.kinds import CASES, MARCHES, STAGES, model_of

OF_MODELS = ("modes", "enclose")  # stages that refuse some kinds
TAKE_ALL = ("fixed", "chosen")  # marches that refuse none
pytestmark = pytest.mark.filterwarnings(
    "ignore::xdynamics.faults.AccuracyWarning", "ignore::xdynamics.faults.StabilityWarning"
)


@pytest.mark.every(83)
@pytest.mark.parametrize(("pair", "march"), CASES, ids=lambda part: part if isinstance(part, str) else "-".join(part))
def test_every_stage_answers_or_refuses(pair: tuple[str, ...], march: str, tmp_path: Path) -> None:
    """Assert that nothing but the package's own errors comes out, of one line each, and that most stages answer."""
    model, answered, refusals = model_of(pair), [], dict[str, str]()
    for name, stage in STAGES.items():
        folder = tmp_path / name
        folder.mkdir()
        try:
            stage(model, MARCHES[march], folder)
        except xd.InputError as refusal:
            refusals[name] = str(refusal)
        else:
            answered.append(name)
    assert all("\n" not in words for words in refusals.values())
    if march in TAKE_ALL:
        assert len(answered) >= len(STAGES) - len(OF_MODELS), refusals
