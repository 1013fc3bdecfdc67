"""Options of code that numba compiles here: no interpreter lock, kept on disk where that is possible."""

from numba import njit


def can_keep_compiled_code() -> bool:
    """Return whether numba finds a folder for compiled code; a read-only installation may have none."""
    try:
        njit(cache=True)(can_keep_compiled_code)
    except RuntimeError:
        return False
    return True


COMPILE_OPTIONS = {
    "nogil": True,
    "cache": can_keep_compiled_code(),
    "fastmath": {"contract", "reassoc", "nsz"},
    "boundscheck": False,
}
