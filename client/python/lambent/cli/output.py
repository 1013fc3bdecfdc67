"""Options that many commands share. Results go to standard output, talk to standard error."""

import json
import sys
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

UrlOption = Annotated[
    str, typer.Option("--url", help="Server address (else LAMBENT_URL, else the local one).")
]
BundleArgument = Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle folder or zip.")]
FilesOption = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where files go.")]
PicturesOption = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where pictures go.")]
MapOption = Annotated[Path, typer.Option("--env", metavar="MAP", help="Environment map, .exr or .hdr.")]
MapsOption = typer.Option("--env", metavar="MAP", help="Environment map, .exr or .hdr; repeatable.")
RotateOption = Annotated[float, typer.Option(help="Turn the light by this angle about +z, degrees.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, one object per line, for machines.")]


class Output:
    """Prints results and notes; with `as_json` only JSON objects, one per line."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json

    def result(self, text: str, data: Any) -> None:
        """Print what the command was asked for: `text` for people, `data` for machines."""
        if self.as_json:
            print(json.dumps(asdict(data) if is_dataclass(data) else data), flush=True)  # type: ignore[arg-type]
        else:
            print(text, flush=True)

    def note(self, text: str) -> None:
        """Print a remark for people."""
        if not self.as_json:
            print(text, file=sys.stderr, flush=True)


def format_duration(seconds: float) -> str:
    """Return seconds as "h:mm:ss" or "m:ss"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def format_size(size_bytes: float) -> str:
    """Return a size in the largest unit that keeps it at or above one (1 MiB = 1048576 bytes)."""
    for unit in ("B", "KiB", "MiB"):
        if size_bytes < 1024:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1024
    return f"{size_bytes:.1f} GiB"
