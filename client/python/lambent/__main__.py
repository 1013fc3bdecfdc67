"""`lambent` and `python -m lambent`."""

import os
import sys
from typing import NoReturn

from lambent_core.errors import pip_install

# Before anything can load an OpenMP runtime: spinning threads stall every neighbour.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def main() -> NoReturn:
    """Run the command line and exit: 0 ok, 1 some work failed, 2 usage, 3 unreachable, 4 refused."""
    try:
        from lambent.cli.app import run
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("lambent"):
            raise
        # Installed without its dependencies, or one was removed.
        sys.exit(_lacks(error.name))
    sys.exit(run(sys.argv[1:]))


def _lacks(package: str | None) -> int:
    """Say on standard error that the command itself lacks a package, and return its exit code."""
    print(
        f"error: cli.missing_package: `lambent` cannot start: the package {package!r} is not installed; "
        + pip_install(),
        file=sys.stderr,
    )
    return 2


if __name__ == "__main__":
    main()
