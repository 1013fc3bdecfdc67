"""Fields: the functions of position that describe a scene."""
