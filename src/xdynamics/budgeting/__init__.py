"""How far one number of a run may be off, and why: terms, totals, Monte Carlo."""
