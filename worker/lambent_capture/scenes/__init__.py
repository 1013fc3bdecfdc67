"""A described capture: frames, cameras, problems, world and silhouettes."""
