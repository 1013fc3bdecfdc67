"""The child process of `check`: reads a task on standard input, writes lines to standard output.

Lines are `reading "path"` before each file is decoded, and at the end `report {SceneReport as ProtoJSON}`.
"""

import json
import resource
import sys
from pathlib import Path
from typing import Any


def limit_resources(memory_bytes: int, cpu_s: int) -> None:
    """Take away from this process what reading pictures does not need, for good."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))


def main() -> None:
    """Check the folder that the task on standard input names."""
    task: dict[str, Any] = json.load(sys.stdin)
    limit_resources(task["memory_bytes"], task["cpu_s"])
    from google.protobuf import json_format

    from lambent_worker.scenes.inspect import inspect_scene

    def announce(path: str) -> None:
        print("reading", json.dumps(path), flush=True)

    report = inspect_scene(Path(task["folder"]), task["layout"], frozenset(task["killers"]), announce)
    print("report", json.dumps(json_format.MessageToDict(report)), flush=True)


if __name__ == "__main__":
    main()
