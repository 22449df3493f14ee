"""A report of a defended number, to be handed out: one file, with formulas, tables and figures in it."""
