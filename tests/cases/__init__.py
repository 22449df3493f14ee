"""Models, runs and records that many tests share."""
