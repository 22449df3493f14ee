"""Bounds of motions that are proven, as datasets."""
