"""Light transport of the surface, baked for interactive relighting."""
