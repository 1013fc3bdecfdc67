"""The steps of a job, one file each: `run(context: StepContext) -> None`."""
