"""The pictures that a folder holds: one JSON line each, written once the picture is complete.

A batch runs for hours, and is stopped, edited and started again. Its journal says what need not be made
twice. Lines are only ever added to it while a batch runs: a crash can cut off the last line and no other.
A half line is ignored, and its picture is made again.
"""

import contextlib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TextIO

from lambent_core.errors import SettingError
from lambent_core.files import file_sha256, whole_file

NAME = "pictures.jsonl"
_LOCK = ".lambent-batch.lock"


@dataclass(frozen=True, kw_only=True, slots=True)
class MadeFile:
    """A file of a picture: `key` stands for everything it was made from."""

    path: str
    key: str
    sha256: str
    size_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A picture that was made: its files by suffix, and what was measured."""

    path: str
    asset: str
    environment: str
    quality: str
    camera: str
    files: Mapping[str, MadeFile]
    width: int
    height: int
    seconds: float
    num_samples: int
    mean_standard_error: float
    """Mean over the pixels, linear radiance."""
    relative_standard_error: float
    """That over the mean radiance; 0 where there is no noise."""
    rotate_deg: float = 0.0
    bounces: str = ""
    """Where bounced light came from, as the picture says."""
    notes: tuple[str, ...] = ()
    """Notes for the user about the map."""


@dataclass(slots=True)
class Journal:
    """The records of one folder, the newest of every picture."""

    folder: Path
    records: dict[str, Record] = field(default_factory=dict)
    by_key: dict[str, MadeFile] = field(default_factory=dict)
    _file: TextIO | None = None

    def known(self, suffix: str, path: str, key: str) -> MadeFile | None:
        """Return the file with this key that lies under this name, else one under another name, else None."""
        # A file elsewhere serves as well: a picture that was renamed in the batch is copied, not rendered.
        record = self.records.get(path)
        own = record.files.get(suffix) if record is not None else None
        for made in (own, self.by_key.get(key)):
            if made is not None and made.key == key and self.is_whole(made):
                return made
        return None

    def is_whole(self, made: MadeFile) -> bool:
        """Return whether the file is there with the bytes it was written with."""
        # People edit, crop and delete pictures where they lie. The size comes first: it costs no read.
        path = self.folder / made.path
        whole = path.is_file() and path.stat().st_size == made.size_bytes
        return whole and file_sha256(path) == made.sha256

    def lines(self, paths: Collection[str]) -> str:
        """Return the lines of these pictures, as the file holds them."""
        return "".join(json.dumps(asdict(self.records[path])) + "\n" for path in sorted(paths))

    def add(self, record: Record) -> None:
        """Keep a record of a picture whose files are complete."""
        assert self._file is not None
        self._file.write(json.dumps(asdict(record)) + "\n")
        # Handed to the system at once, which keeps it when this program is killed. Not forced to the disk: a
        # power cut may cost the last lines, and all they stand for is pictures that are then made again.
        self._file.flush()
        self._remember(record)

    def _remember(self, record: Record) -> None:
        self.records[record.path] = record
        # Keys of older records stay: `is_whole` tells whether their bytes are still there.
        for made in record.files.values():
            self.by_key[made.key] = made


def peek_journal(folder: Path) -> Journal:
    """Return what the journal of a folder says, for a look only: nothing is written, nothing is locked.

    Raises SettingError (`batch.bad_journal`) as `open_journal` does. A folder that is not there has none.
    """
    journal = Journal(folder)
    for record in read_records(folder / NAME):
        journal._remember(record)
    return journal


@contextlib.contextmanager
def open_journal(folder: Path) -> Iterator[Journal]:
    """Open the journal of a folder for one program at a time.

    Raises SettingError: `batch.folder_in_use` while another batch writes there, `batch.bad_journal` for a
    journal that this program did not write.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        journal, path = peek_journal(folder), folder / NAME
        # Every run adds lines, so the file would grow with each. One line for each picture is left, and no
        # half line at the end, which the first new line would be glued to.
        with whole_file(path) as partial:
            lines = [json.dumps(asdict(record)) + "\n" for record in journal.records.values()]
            partial.write_text("".join(lines), encoding="utf-8")
        with path.open("a", encoding="utf-8") as file:
            journal._file = file
            yield journal


def record_from_json(value: Mapping[str, Any]) -> Record:
    """Return the record of a decoded line; raises TypeError or KeyError for anything else."""
    files = {suffix: MadeFile(**made) for suffix, made in value["files"].items()}
    return Record(**{**value, "files": files, "notes": tuple(value["notes"])})


def read_records(path: Path) -> Iterator[Record]:
    """Yield the records of a journal as they were written; a half line at its end is left out.

    Raises SettingError (`batch.bad_journal`) for a line that this program did not write.
    """
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            # A crash wrote this much of it. Only the last line can be without its end.
            if not line.endswith("\n"):
                return
            try:
                yield record_from_json(json.loads(line))
            except (ValueError, TypeError, KeyError, AttributeError) as error:
                # Refused, not skipped: `open_journal` writes the file anew, without what it cannot read.
                raise SettingError(
                    "batch.bad_journal",
                    f"line {number} of {path} was not written by this program ({type(error).__name__})",
                    "choose another folder, or remove the file to make every picture again",
                ) from error


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder against other programs, where the system can."""
    # A lock of the system's, which ends with the process: a file that only stands for one would outlive a
    # crash, and shut the folder until a user removed it.
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    with (folder / _LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SettingError(
                "batch.folder_in_use",
                f"another batch writes to {folder}",
                "wait for it, or take another folder",
            ) from error
        yield
