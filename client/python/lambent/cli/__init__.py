"""The `lambent` command: one module per family of sub-commands, imported only when one is called."""
