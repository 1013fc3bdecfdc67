"""REST routes of people, keys and signing in."""
