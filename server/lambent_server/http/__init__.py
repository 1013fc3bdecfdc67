"""What surrounds every request: who asks, how much they may send, and how errors are told."""
