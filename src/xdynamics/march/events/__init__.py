"""Events: whether a trial holds one, where it is, and how the march goes on after it."""
