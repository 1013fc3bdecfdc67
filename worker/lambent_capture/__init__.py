"""Captures: layouts, pictures, missing cameras and masks, and checks; needs neither torch nor a renderer."""
