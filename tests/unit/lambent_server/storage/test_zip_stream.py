"""Archives as streams: what other readers make of them, and what they hold in memory."""

import io
import shutil
import subprocess
import tracemalloc
import zipfile
import zlib
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lambent_server.storage.zip_stream import MAX_BYTES, MAX_ENTRIES, Entry, fits, length_of, zip_pieces

AT = 1_760_000_000.0
NAMES = st.lists(
    st.text(
        st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="/\\"), min_size=1, max_size=30
    ),
    max_size=6,
    unique=True,
)


def entry(path: str, data: bytes, piece: int = 7) -> Entry:
    return Entry(path, len(data), lambda: (data[at : at + piece] for at in range(0, len(data), piece)))


@settings(max_examples=60, deadline=None)
@given(names=NAMES, data=st.data())
def test_a_reader_finds_what_was_written_in_the_length_that_was_announced(names, data):
    contents = {f"a/{name}": data.draw(st.binary(max_size=200)) for name in names}
    entries = [entry(path, content) for path, content in contents.items()]
    archive = b"".join(zip_pieces(entries, AT))
    assert len(archive) == length_of(entries)
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        assert opened.testzip() is None
        assert {name: opened.read(name) for name in opened.namelist()} == contents
        for info in opened.infolist():
            assert info.compress_type == zipfile.ZIP_STORED
            assert info.date_time == (2025, 10, 9, 8, 53, 20)
            assert not info.flag_bits & 0x8


@pytest.mark.skipif(shutil.which("unzip") is None, reason="unzip is not installed")
def test_unzip_finds_no_fault(tmp_path):
    path = tmp_path / "a.zip"
    path.write_bytes(b"".join(zip_pieces([entry("ä/b.bin", b"x" * 1000), entry("c", b"")], 0.0)))
    subprocess.run(["unzip", "-tqq", path], check=True)


def test_no_more_than_a_piece_is_held():
    reads = []

    def pieces() -> Iterator[bytes]:
        reads.append("begun")
        for _ in range(1000):
            yield bytes(1000)

    made = zip_pieces([Entry("a", 10**6, pieces), Entry("b", 10**6, pieces)], AT)
    assert max(len(piece) for piece, _ in zip(made, range(1500), strict=False)) == 1000
    # Once for the checksum of the first entry and once for its bytes; the second was not touched.
    assert len(reads) == 2


def test_a_large_entry_is_read_piece_by_piece_also_for_its_checksum():
    num_pieces, piece = 200, bytes(1 << 20)
    read = []

    def pieces() -> Iterator[bytes]:
        for number in range(num_pieces):
            read.append(number)
            yield bytes(1 << 20)

    digest, size, most_at_once = 0, 0, 0
    tracemalloc.start()
    before = 0
    for part in zip_pieces([Entry("large", num_pieces << 20, pieces)], AT):
        most_at_once = max(most_at_once, len(read) - before)
        before, size = len(read), size + len(part)
        if len(part) == len(piece):
            digest = zlib.crc32(part, digest)
        elif part.startswith(b"PK\x03\x04"):
            told = int.from_bytes(part[14:18], "little")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most_at_once == 1
    assert size == length_of([Entry("large", num_pieces << 20, pieces)])
    assert told == digest
    assert peak < 5 << 20


def test_an_archive_that_nobody_waits_for_any_more_is_not_read_on():
    read = []

    def pieces() -> Iterator[bytes]:
        for number in range(1000):
            read.append(number)
            yield bytes(1000)

    made = zip_pieces([Entry("a", 10**6, pieces)], AT)
    assert [next(made) for _ in range(3)] == [b""] * 3
    made.close()
    assert len(read) == 3


def test_an_entry_that_has_lost_bytes_ends_the_stream():
    with pytest.raises(OSError, match="a has 3 bytes instead of 4"):
        list(zip_pieces([Entry("a", 4, lambda: iter([b"abc"]))], AT))


def test_what_needs_zip64_does_not_fit():
    assert fits([entry("a", b"b")])
    assert not fits([Entry("a", MAX_BYTES, lambda: iter(()))])
    assert not fits([Entry(str(number), 0, lambda: iter(())) for number in range(MAX_ENTRIES + 1)])
