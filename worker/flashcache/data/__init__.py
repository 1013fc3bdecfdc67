"""What the method is trained on: scenes in memory and batches of rays."""
