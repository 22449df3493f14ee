"""States of a run between its steps, and the growth of small changes along it: the floor below evidence."""
