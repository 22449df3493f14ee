"""Validation: runs compared with exact solutions."""
