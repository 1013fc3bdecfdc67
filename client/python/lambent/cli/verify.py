"""verify: whether a bundle is whole, and where it is from."""

from pathlib import Path
from typing import Annotated

import typer

from lambent import provenance
from lambent.cli.output import JsonOption, Output


def verify(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Folder or .zip.")],
    key: Annotated[
        Path | None,
        typer.Option(help="Public key of the server: PEM, or what GET /v1/provenance-key answers."),
    ] = None,
    statement: Annotated[
        Path | None, typer.Option(help="The signed statement; BUNDLE.provenance.json by default.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare every file with the signed statement; exits with 1 if anything is not as it was signed.

    Needs no server. Without --key, damage is noticed, but not who has signed.
    """
    verified = provenance.verify(bundle, statement=statement, key=key)
    output = Output(as_json)
    signed = f"signed by {'' if verified.trusted else 'the unknown key '}{verified.key_id[:16]}"
    lines = [
        f"{bundle}: {verified.num_files} files are as stated, {signed}",
        f"made by {verified.made_by} from {len(verified.inputs)} files, "
        f"{verified.started_on} to {verified.finished_on}",
        f"in {verified.invocation}, preset {verified.parameters.get('preset') or '-'}",
    ]
    output.result("\n".join(lines), verified)
    if not verified.trusted:
        output.note("add --key FILE with the key of the server that you trust: GET /v1/provenance-key")
