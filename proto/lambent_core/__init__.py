"""What server, worker and client share: errors, files, colour, scenes, and the settings of pictures."""
