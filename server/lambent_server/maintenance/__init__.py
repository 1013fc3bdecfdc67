"""Background work: retention, deletion, compression, checks of contents."""
