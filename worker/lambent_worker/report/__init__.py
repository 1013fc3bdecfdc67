"""Evaluation of a trained run: predictions on disk, figures, and a page to look at."""
