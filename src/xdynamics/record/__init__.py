"""The run record: a march's log as one Dataset that says what every number is and how it came about."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.runtime.lazy_imports import entrance

if TYPE_CHECKING:
    from xdynamics.record.column import Column
    from xdynamics.record.conformity import faults_of
    from xdynamics.record.folding import check_elements
    from xdynamics.record.logged_elements import sizes_of
    from xdynamics.record.run_columns import columns, constants, element_columns, factors, followed_tolerances
    from xdynamics.record.run_dataset import check, check_kind, dataset, described, foreseen
    from xdynamics.record.run_identity import (
        comes_of,
        identity,
        input_digest,
        is_of,
        is_of_model,
        model_words,
        same_settings,
        word_differences,
    )
    from xdynamics.record.unfolding import of_elements, shapes_of, unfold, whole_of
    from xdynamics.record.variable_attributes import own_attributes, plain

# name -> its room, entered when the name is first used: who reads attributes alone, like the examining process, loads no engine
_ROOMS = {
    "Column": "column",
    "word_differences": "run_identity",
    "check": "run_dataset",
    "check_elements": "folding",
    "check_kind": "run_dataset",
    "columns": "run_columns",
    "comes_of": "run_identity",
    "constants": "run_columns",
    "dataset": "run_dataset",
    "described": "run_dataset",
    "element_columns": "run_columns",
    "factors": "run_columns",
    "faults_of": "conformity",
    "followed_tolerances": "run_columns",
    "foreseen": "run_dataset",
    "identity": "run_identity",
    "input_digest": "run_identity",
    "is_of": "run_identity",
    "is_of_model": "run_identity",
    "model_words": "run_identity",
    "of_elements": "unfolding",
    "own_attributes": "variable_attributes",
    "plain": "variable_attributes",
    "same_settings": "run_identity",
    "shapes_of": "unfolding",
    "sizes_of": "logged_elements",
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
    "element_columns",
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
