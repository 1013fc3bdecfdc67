"""How messages name the command that installs the packages of an extra."""


def pip_install(*extras: str) -> str:
    """Return the command that installs the packages of some extras; without any, those of Lambent itself.

    The command works wherever such a message is seen, and only there: Lambent is installed, so that pip looks
    for nothing but the packages that are missing. Lambent itself is in no package index; how to install it in
    the first place: docs/howto/install.md.
    """
    return f"pip install 'lambent[{','.join(extras)}]'" if extras else "pip install lambent"
