"""The tasks of a run, one file each: `run(context: TaskContext) -> None`."""
