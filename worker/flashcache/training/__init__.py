"""The two training stages and what they share."""
