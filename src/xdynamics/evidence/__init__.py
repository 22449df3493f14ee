"""Evidence from runs: states between steps, comparisons, diagnoses, refinements, validation, modes and stable steps."""
