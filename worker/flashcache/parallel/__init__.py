"""Processes that compute beside this one on tensors in shared memory."""
