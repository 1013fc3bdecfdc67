"""The asset: mesh, textures, light transport, and the bundle that holds them."""
