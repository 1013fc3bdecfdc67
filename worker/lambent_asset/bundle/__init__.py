"""The relightable bundle: its manifest, graphs and files."""
