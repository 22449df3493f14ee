"""The run record: a march's log as one Dataset that says what every number is and how it came about."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.runtime.lazy_imports import entrance

if TYPE_CHECKING:
    from xdynamics.record.column import Column
    from xdynamics.record.conformity import faults_of
    from xdynamics.record.flag_words import own_attributes, plain
    from xdynamics.record.folded_columns import sizes_of
    from xdynamics.record.folding import check_elements
    from xdynamics.record.provenance import (
        comes_of,
        identity,
        input_digest,
        is_of,
        is_of_model,
        model_words,
        same_settings,
        word_differences,
    )
    from xdynamics.record.run_columns import columns, constants, factors, followed_tolerances
    from xdynamics.record.run_dataset import check, check_kind, dataset, described, foreseen
    from xdynamics.record.unfolding import of_elements, shapes_of, unfold, whole_of

# name -> its room, entered when the name is first used: who reads attributes alone, like the examining process, loads no engine
_ROOMS = {
    "Column": "column",
    "word_differences": "provenance",
    "check": "run_dataset",
    "check_elements": "folding",
    "check_kind": "run_dataset",
    "columns": "run_columns",
    "comes_of": "provenance",
    "constants": "run_columns",
    "dataset": "run_dataset",
    "described": "run_dataset",
    "factors": "run_columns",
    "faults_of": "conformity",
    "followed_tolerances": "run_columns",
    "foreseen": "run_dataset",
    "identity": "provenance",
    "input_digest": "provenance",
    "is_of": "provenance",
    "is_of_model": "provenance",
    "model_words": "provenance",
    "of_elements": "unfolding",
    "own_attributes": "flag_words",
    "plain": "flag_words",
    "same_settings": "provenance",
    "shapes_of": "unfolding",
    "sizes_of": "folded_columns",
    "unfold": "unfolding",
    "whole_of": "unfolding",
}

__all__ = [
    "Column",
    "check",
    "check_elements",
    "check_kind",
    "columns",
    "comes_of",
    "constants",
    "dataset",
    "described",
    "factors",
    "faults_of",
    "followed_tolerances",
    "foreseen",
    "identity",
    "input_digest",
    "is_of",
    "is_of_model",
    "model_words",
    "of_elements",
    "own_attributes",
    "plain",
    "same_settings",
    "shapes_of",
    "sizes_of",
    "unfold",
    "whole_of",
    "word_differences",
]

__getattr__ = entrance(__name__, _ROOMS)
