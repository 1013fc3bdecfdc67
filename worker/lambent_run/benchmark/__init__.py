"""Runs scenes x seeds x ablations and builds the tables."""
