"""Implicit methods: steps that solve equations."""
