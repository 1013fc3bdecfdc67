"""The worker's commands, one module each; torch is imported only when they run."""
