"""push, fetch and share."""

from pathlib import Path
from typing import Annotated

import typer

from lambent.cli.output import JsonOption, Output, UrlOption, format_size
from lambent.cli.progress import TransferView
from lambent.client import Client


def push(
    source: Annotated[Path, typer.Argument(metavar="DIR|ZIP", help="Scene folder, or archive of one.")],
    name: Annotated[str, typer.Option(help="Name of the scene (else the folder's).")] = "",
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Upload a scene and print its id; run again, it sends only what is missing."""
    with Client(url) as client, TransferView(as_json) as view:
        scene = client.push(source, name=name, progress=view.show)
    output = Output(as_json)
    if scene.left_out:
        shown = ", ".join(scene.left_out[:5]) + (" ..." if len(scene.left_out) > 5 else "")
        output.note(f"left out, no place in a scene: {shown}")
    output.result(scene.id, scene)


def fetch(
    job: Annotated[str, typer.Argument(metavar="JOB", help="Job id (or bundle id).")],
    target: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where the bundle goes.")],
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Download the bundle of a finished job; every file is verified, and a broken download resumes."""
    with Client(url) as client, TransferView(as_json) as view:
        bundle = client.fetch(job, target, progress=lambda _, done, total: view.show("fetch", done, total))
    size_bytes = sum(entry.size_bytes for entry in bundle.files)
    text = f"{bundle.path}  ({len(bundle.files)} files, {format_size(size_bytes)}, verified)"
    Output(as_json).result(text, {"bundle_id": bundle.bundle_id, "path": str(bundle.path)})


def share(
    job: Annotated[str, typer.Argument(metavar="JOB", help="Job id (or bundle id).")],
    days: Annotated[float, typer.Option(help="How long the link works.", min=0.001, max=366)] = 7.0,
    embed_in: Annotated[
        list[str],
        typer.Option(
            "--embed-in",
            metavar="ORIGIN",
            help="Pages of this origin may show the object, such as https://shop.example; repeatable.",
        ),
    ] = [],  # noqa: B006 - typer reads it once
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Print a link that lets everyone who has it see one bundle, and with --embed-in the HTML for a page."""
    with Client(url) as client:
        made = client.share(job, expires_in_s=round(days * 24 * 3600), frame_ancestors=embed_in)
    output = Output(as_json)
    output.note(f"{made.id} expires {made.expires_at}; `lambent delete {made.id}` revokes it")
    output.result(f"{made.url}\n{made.snippet}" if made.frame_ancestors else made.url, made)
