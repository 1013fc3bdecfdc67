"""The server's decoding process with a reader that is taken over: `python taken_over.py ACT ORDER`.

It enters the sandbox as the real one does, and runs `ACT` where that reads the first byte.
"""

import ctypes
import os
import socket
import subprocess
import sys
import time

from lambent_server.storage import archive_entries, decoding_child, environment_files

NAMES = {"ctypes": ctypes, "os": os, "socket": socket, "subprocess": subprocess, "sys": sys, "time": time}


def act(*_: object) -> None:
    """Run the order that this process received."""
    exec(ACT, NAMES)


if __name__ == "__main__":
    ACT = sys.argv.pop(1)
    archive_entries.entries_of = act  # type: ignore[assignment]
    environment_files.parse_head = act  # type: ignore[assignment]
    sys.exit(decoding_child.main())
