"""Validation: runs held against what is known exactly."""
