"""One run of a model: marched, reproduced, extended, completed, or asked for as SciPy asks."""
