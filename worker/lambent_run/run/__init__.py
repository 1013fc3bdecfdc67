"""One training run in a folder: its specification, its tasks, and what they share."""
