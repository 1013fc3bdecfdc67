"""Restrictions of a process that decodes untrusted files; it needs nothing but the standard library."""
