"""Files that arrive, through the server and directly to the object store."""
