"""Evidence from runs: states, comparisons, diagnoses, refinements, validation, modes and stable steps."""
