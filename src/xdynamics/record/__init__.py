"""The run record: a march's log as one Dataset that says what every number is and how it came about."""

from xdynamics.record.column import Column
from xdynamics.record.columns import columns, constants, element_columns, factors, followed_tolerances
from xdynamics.record.conformity import faults_of
from xdynamics.record.dataset import check, check_kind, dataset, described, foreseen
from xdynamics.record.identity import apart, comes_of, identity, input_digest, is_of, same_settings
from xdynamics.record.unfolding import of_elements, shapes_of, unfold, whole_of
from xdynamics.record.variable_attributes import own_attributes, plain

__all__ = [
    "Column",
    "apart",
    "check",
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
    "of_elements",
    "own_attributes",
    "plain",
    "same_settings",
    "shapes_of",
    "unfold",
    "whole_of",
]
