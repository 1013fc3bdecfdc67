"""Jobs: rows, queue, history, logs, and their REST routes."""
