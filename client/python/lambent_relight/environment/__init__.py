"""Environment maps: files, axes, cleaning, and what is computed from a map once."""
