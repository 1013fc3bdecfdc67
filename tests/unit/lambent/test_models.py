"""The server's JSON as dataclasses."""

import pytest
from lambent.models import Artifact, Environment, Scene


@pytest.mark.parametrize("kind", [Artifact, Environment, Scene], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("written", [3084, 3084.0])
def test_sizes_are_integers_whatever_the_server_writes(kind, written):
    found = kind.from_json({"id": "x", "name": "x", "sha256": "0", "size_bytes": written})
    assert type(found.size_bytes) is int
    assert found.size_bytes == 3084
