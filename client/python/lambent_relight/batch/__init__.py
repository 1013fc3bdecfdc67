"""Many pictures at once: assets x environments x cameras x qualities -> files, resumable by content."""
