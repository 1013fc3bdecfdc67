"""Several servers on one database: members, claims, notices, certificates."""
