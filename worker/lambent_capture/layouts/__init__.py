"""The layouts in which captures arrive, a module each, and the detection of one."""
