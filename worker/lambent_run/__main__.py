"""`python -m lambent_run run`: what the server starts for a job; `work` is the part that trains."""

import sys

from lambent_run.job.supervisor import supervise

USAGE = "usage: python -m lambent_run run (started by the server, with LAMBENT_RUN in the environment)"


def main(arguments: list[str]) -> int:
    """Return the exit code."""
    if arguments == ["run"]:
        return supervise([sys.executable, "-P", "-m", "lambent_run", "work"])
    if arguments == ["work"]:
        from lambent_core.startup import prepare

        prepare()
        from lambent_run.job.process import work

        return work()
    print(USAGE, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
