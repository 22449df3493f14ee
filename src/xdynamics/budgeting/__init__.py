"""Error budgets of one number of a run: terms, totals, Monte Carlo."""
