"""Files of strangers are read right, or refused with the file, the cause and what to do."""

import sys
import warnings
from pathlib import Path

import pytest
from strangers.corpus import ROWS
from strangers.judging import fault_of

pytestmark = pytest.mark.slow

LINKS = sys.platform != "win32"


@pytest.mark.parametrize("name", ROWS)
def test_what_a_stranger_brought_is_read_right_or_refused_clearly(name: str, tmp_path: Path):
    if "linked" in name and not LINKS:
        pytest.skip("links need rights on this system")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of libraries that write the files
        assert fault_of(ROWS[name], tmp_path / "scene") == ""
