"""Every stage on models of every pair of kinds: it answers, or refuses in one line that names the model or what it lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

import xdynamics as xd
from cases.kinds import CASES, MARCHES, STAGES, model_of

OF_MODELS = ("modes", "enclose")  # which ask for no march
pytestmark = pytest.mark.filterwarnings(
    "ignore::xdynamics.faults.AccuracyWarning", "ignore::xdynamics.faults.StabilityWarning"
)


@pytest.mark.every(41)
@pytest.mark.parametrize(("pair", "march"), CASES, ids=lambda part: part if isinstance(part, str) else "-".join(part))
def test_every_stage_answers_or_refuses(pair: tuple[str, ...], march: str, tmp_path: Path) -> None:
    """Assert that nothing but the package's own errors comes out, of one line each, and that most stages answer."""
    try:
        model = model_of(pair)
    except xd.ModelError as error:
        assert "delayed values are of single numbers" in str(error)
        return
    answered = []
    for name, stage in STAGES.items():
        folder = tmp_path / name
        folder.mkdir()
        try:
            stage(model, MARCHES[march], folder)
        except xd.InputError as error:
            assert "\n" not in str(error)
            continue
        answered.append(name)
    assert len(answered) >= len(STAGES) - len(OF_MODELS) - 2 or march in ("taylor", "time_stepping")
