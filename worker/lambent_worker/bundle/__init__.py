"""The parts of a bundle: checked graphs, a mesh, metrics, and the manifest that lists all files."""
