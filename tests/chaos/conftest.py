"""Fixtures of the tests of faults."""

from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def end(tmp_path: Path) -> Iterator[Path]:
    """Yield the file that lets endless jobs end; it is written at the end in any case."""
    path = tmp_path / "end"
    yield path
    path.touch()
