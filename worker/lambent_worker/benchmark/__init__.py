"""Runs of scenes x seeds x ablations, and the tables made of them."""
