"""Steps that solve equations."""
