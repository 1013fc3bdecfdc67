"""Material polish: albedo, GGX width, metalness and light fitted to all photographs after stage two."""
