"""What a bundle is made of: checked graphs, a mesh, figures, and the manifest that lists all files."""
