"""Organisations, users and keys: their scopes, quotas and audit log."""
