"""Orders of pictures: rows, tasks, and their REST routes."""
