"""The mesh of a trained field: extraction, decimation and its atlas."""
