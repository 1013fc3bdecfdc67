"""The end of a batch's output: its failures, and the outcome for machines."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lambent_relight.batch.plan import Failure
from lambent_relight.batch.run import Result

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


def report(
    results: Sequence[Result], folder: Path, sheets: Sequence[Path], document: Document, output: Output
) -> dict[str, Any]:
    """Print the failures among the results of a batch, and return its outcome for machines."""
    failures = [result.failure for result in results if result.failure is not None]
    list_failures(failures, document, output)
    return {
        "path": str(folder),
        "states": Counter(result.state for result in results),
        "failures": [asdict(failure) for failure in failures],
        "contact_sheets": [path.name for path in sheets],
    }
