"""A described capture brought into memory, and inspected."""
