"""Exit codes of a run process that the server needs no word about."""

EXIT_FENCED = 3
"""Another run has taken over."""
EXIT_UNREACHABLE = 4
"""It was asked to end, or has waited long enough, and the server did not answer any more."""
