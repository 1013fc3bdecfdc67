"""A run process: the part that talks to the server, and what each kind of job does."""
