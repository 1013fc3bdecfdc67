"""`lambent` and `python -m lambent`."""

import os
import sys
from typing import NoReturn

# Before anything can load an OpenMP runtime: spinning threads stall every neighbour.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def main() -> NoReturn:
    """Run the command line and exit: 0 ok, 1 some work failed, 2 usage, 3 unreachable, 4 refused."""
    from lambent.cli.app import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
