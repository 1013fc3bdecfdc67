"""`lambent admin`: what the operator of a server does, on the server's machine and in its database."""
