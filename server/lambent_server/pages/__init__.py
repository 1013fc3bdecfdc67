"""The web pages, and what a server says about itself."""
