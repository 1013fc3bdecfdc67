"""Training data: scenes in memory and batches of rays."""
