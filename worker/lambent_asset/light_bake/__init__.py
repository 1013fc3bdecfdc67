"""Adapting a bundle's fast cache to an environment: `lambent bake-light` and jobs of the kind `bake`."""
