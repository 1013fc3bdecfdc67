"""Archives damaged at random are refused or unpacked, never anything else."""

import io
import random
import stat
import tempfile
import zipfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.storage.archives import unpack
from lambent_server.storage.paths import path_problem
from support.archives import AnyRoom, make_tar, make_zip, tar_member

SETTINGS = Settings(max_scene_bytes=100_000, max_scene_files=20)
FILES = {
    "scene/transforms_train.json": b"{}",
    "scene/train/r_0.png": bytes(range(256)),
    "scene/a.txt": b"a" * 600,
}
ORIGINALS = [
    make_zip(FILES),
    make_tar(*(tar_member(name, data) for name, data in FILES.items())),
    make_zip({"a.png": b"x"}, **{"a.png": stat.S_IFREG}),
]


def damage(data: bytes, seed: int) -> bytes:
    """Return the archive with some bytes changed, cut out or doubled."""
    choice = random.Random(seed)  # noqa: S311
    changed = bytearray(data)
    for _ in range(choice.randint(1, 6)):
        place = choice.randrange(len(changed))
        what = choice.random()
        if what < 0.6:
            changed[place] = choice.choice((0, 1, 0x7F, 0x80, 0xFF, choice.randrange(256)))
        elif what < 0.8:
            del changed[place : place + choice.randint(1, 40)]
        else:
            changed[place:place] = changed[max(place - 30, 0) : place]
    return bytes(changed) or b"x"


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(ORIGINALS), st.integers(0, 2**32))
def test_a_damaged_archive_is_refused_or_gives_safe_files(original: bytes, seed: int):
    with tempfile.TemporaryDirectory() as name:
        archive, folder = Path(name) / "archive", Path(name) / "out"
        archive.write_bytes(damage(original, seed))
        folder.mkdir()
        try:
            members, left_out = unpack(archive, folder, SETTINGS, AnyRoom())
        except Problem:
            return
        for member in members:
            assert path_problem(member.path) is None
            assert member.file.parent == folder
            assert member.file.stat().st_size == member.size_bytes
        assert len(members) + len(left_out) <= SETTINGS.max_scene_files
        assert sum(member.size_bytes for member in members) <= SETTINGS.max_scene_bytes


def test_the_undamaged_ones_are_read():
    for original, count in zip(ORIGINALS, (3, 3, 1), strict=True):
        with tempfile.TemporaryDirectory() as name:
            archive = Path(name) / "archive"
            archive.write_bytes(original)
            members, _ = unpack(archive, Path(name), SETTINGS, AnyRoom())
        assert len(members) == count
    assert zipfile.is_zipfile(io.BytesIO(ORIGINALS[0]))
