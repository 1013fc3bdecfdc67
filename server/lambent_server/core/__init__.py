"""Clock, settings, logs, counters and secrets."""
