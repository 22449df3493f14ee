"""Diagnoses: what a run tells of itself."""
