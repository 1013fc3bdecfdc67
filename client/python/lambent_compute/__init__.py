"""Compiled code for processors, and work on several cores, that the client and the method share."""
