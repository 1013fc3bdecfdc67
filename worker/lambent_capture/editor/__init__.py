"""The page on which a person corrects masks, served to this machine only."""
