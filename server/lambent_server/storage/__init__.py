"""Blobs: the store, its checks, archives, space and garbage."""
