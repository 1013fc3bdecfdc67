"""The failures at the end of a batch's output."""

from collections.abc import Sequence

from lambent_relight.batch.plan import Failure

from lambent.cli.output import Output
from lambent.manifest_file import Document

SHOWN_FAILURES = 50


def list_failures(failures: Sequence[Failure], document: Document, output: Output) -> None:
    """Print failures, each with its reason and, where it is known, its line of the manifest."""
    for failure in failures[:SHOWN_FAILURES]:
        place = f" ({document.where(failure.pointer)})" if failure.pointer else ""
        output.note(f"failed {failure.path}: {failure.code}: {failure.message}{place}")
    if len(failures) > SHOWN_FAILURES:
        output.note(f"and {len(failures) - SHOWN_FAILURES} more; pictures.csv has all")
