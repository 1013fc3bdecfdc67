"""Shared by server, worker and client: errors, files, colour, scenes, and the settings of pictures."""
