"""Bundles: rows, messages, and their REST routes."""
