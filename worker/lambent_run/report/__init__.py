"""Evaluation of a trained run: predictions on disk, metrics, and a report page."""
