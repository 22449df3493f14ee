"""What a run's states are between its steps, and how small changes of them grow along it: floors below evidence."""
