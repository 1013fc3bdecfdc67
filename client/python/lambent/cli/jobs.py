"""submit, watch, jobs, cancel, retry, delete, logs."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from lambent.cli.output import JsonOption, Output, UrlOption
from lambent.cli.progress import open_view
from lambent.client import Client
from lambent.errors import LambentError, UsageProblemError
from lambent.models import Event, Job

Answer = TypeVar("Answer")
JobArguments = Annotated[list[str], typer.Argument(metavar="JOB...", help="Job ids.")]


def submit(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="Scene id, as `lambent push` prints it.")],
    preset: Annotated[str, typer.Option("--preset", "-p", help="quick, fast, long, standard, ...")] = "fast",
    settings: Annotated[
        list[str], typer.Option("--set", metavar="KEY=VALUE", help="A setting over the preset; repeatable.")
    ] = [],  # noqa: B006 - typer reads it once
    seed: Annotated[int, typer.Option(help="Seed of every random number.", min=0)] = 0,
    labels: Annotated[
        list[str],
        typer.Option("--label", metavar="KEY=VALUE", help="A label to find the job by; repeatable."),
    ] = [],  # noqa: B006
    priority: Annotated[int, typer.Option(help="Larger first.")] = 0,
    gpus: Annotated[int | None, typer.Option(help="GPUs the job needs; else the preset says.", min=0)] = None,
    prepare: Annotated[
        bool, typer.Option("--prepare", help="Only find cameras and masks, to look at before training.")
    ] = False,
    corrections: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Corrections of masks, as `lambent masks --edit` saves them."),
    ] = None,
    grey_card: Annotated[
        str,
        typer.Option(
            metavar="PHOTOGRAPH:X,Y,W,H[:R]",
            help="Where a photograph shows a grey card, pixels, and its reflectance (0.18).",
        ),
    ] = "",
    webhook: Annotated[str, typer.Option(metavar="URL", help="Where to tell that the job has ended.")] = "",
    follow: Annotated[bool, typer.Option("--watch", help="Follow the job until it ends.")] = False,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Queue a training job on an uploaded scene and print its id."""
    output = Output(as_json)
    params = parse_pairs(settings, "--set")
    if corrections is not None:
        params["corrections"] = read_corrections(corrections)
    if grey_card:
        params["grey_card"] = grey_card
    with Client(url) as client:
        job = client.submit(
            scene,
            preset=preset,
            params=params,
            kind="prepare" if prepare else "train",
            seed=seed,
            labels=parse_pairs(labels, "--label"),
            priority=priority,
            gpus=gpus,
            webhook=webhook,
        )
        output.result(job.id, job)
        if follow:
            raise typer.Exit(follow_jobs(client, [job.id], as_json=as_json))


def watch(jobs: JobArguments, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Follow jobs until they end; exit code 1 when one of them did not succeed."""
    with Client(url) as client:
        raise typer.Exit(follow_jobs(client, jobs, as_json=as_json))


def jobs(
    state: Annotated[str, typer.Option(help="Only this state (queued, running, succeeded, ...).")] = "",
    label: Annotated[str, typer.Option(metavar="KEY=VALUE", help="Only jobs with this label.")] = "",
    limit: Annotated[int, typer.Option(help="How many at most; 0 for all.", min=0)] = 20,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """List jobs, newest first."""
    with Client(url) as client:
        listed = list(client.jobs(state=state, label=label, limit=limit))
    output = Output(as_json)
    if as_json:
        for job in listed:
            output.result("", job)
        return
    rows = [("JOB", "STATE", "WORK", "SCENE", "DONE", "CREATED")]
    rows += [
        (
            job.id,
            job.state,
            job.preset if job.kind == "train" else job.kind,
            job.scene_id,
            f"{100 * _share(job):.0f} %",
            job.created_at[:19],
        )
        for job in listed
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def cancel(jobs: JobArguments, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Ask for jobs to be stopped; exit code 4 when the server declined one of them."""
    with Client(url) as client:
        _each(jobs, client.cancel, Output(as_json), _id_and_state)


def delete(
    ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Scenes, jobs, bundles, links, ...")],
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Delete things on the server for good; exit code 4 when it declined one of them."""
    with Client(url) as client:

        def call(identifier: str) -> dict[str, str]:
            client.delete(identifier)
            return {"deleted": identifier}

        _each(ids, call, Output(as_json), lambda answer: f"{answer['deleted']} deleted")


def retry(
    jobs: JobArguments,
    follow: Annotated[bool, typer.Option("--watch", help="Follow the jobs until they end.")] = False,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Queue failed or cancelled jobs again, as new jobs with the same order; print their ids."""
    with Client(url) as client:
        fresh = _each(jobs, client.retry, Output(as_json), _id_and_state)
        if follow:
            raise typer.Exit(follow_jobs(client, [job.id for job in fresh], as_json=as_json))


def change(
    ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Jobs, scenes or bundles.")],
    labels: Annotated[
        list[str],
        typer.Option("--label", metavar="KEY=VALUE", help="A label to set, KEY= removes it; repeatable."),
    ] = [],  # noqa: B006
    priority: Annotated[int | None, typer.Option(help="Priority of waiting jobs; larger first.")] = None,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Change labels, or the priority of waiting jobs; exit code 4 when the server declined one of them."""
    pairs = {key: value or None for key, value in parse_pairs(labels, "--label").items()}
    with Client(url) as client:

        def call(identifier: str) -> Mapping[str, Any]:
            return client.change(identifier, labels=pairs or None, priority=priority)

        _each(ids, call, Output(as_json), lambda shown: f"{shown['id']} changed")


def logs(
    job: Annotated[str, typer.Argument(metavar="JOB", help="Job id.")],
    url: UrlOption = "",
) -> None:
    """Print the log of a job."""
    with Client(url) as client:
        sys.stdout.write(client.logs(job))


def follow_jobs(client: Client, job_ids: Sequence[str], *, as_json: bool, findings: bool = True) -> int:
    """Show jobs until they end and return the exit code: 1 when one did not succeed, 130 on Ctrl-C.

    Without `findings` those are left to the caller.
    """
    ended: dict[str, Job] = {}
    try:
        with open_view(as_json) as view:
            for update in client.watch(list(job_ids)):
                if findings or not (isinstance(update, Event) and update.type == "finding"):
                    view.show(update)
                if isinstance(update, Job) and update.is_final:
                    ended[update.id] = update
    except KeyboardInterrupt:
        ids = " ".join(job_ids)
        Output(as_json).note(f"stopped watching; the work continues. Again: lambent watch {ids}")
        return 130
    return 0 if all(job.state == "succeeded" for job in ended.values()) else 1


def read_corrections(file: Path) -> str:
    """Return the JSON of a file of corrections without white space; raises `cli.bad_corrections`."""
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageProblemError(
            "cli.bad_corrections",
            f"--corrections {file} is not a JSON file that can be read: {error}",
            "give the corrections.json of the mask editor",
        ) from error
    return json.dumps(record, separators=(",", ":"))


def parse_pairs(pairs: Sequence[str], option: str) -> dict[str, str]:
    """Return {"key": "value"} from "key=value" words; raises `cli.bad_pair`."""
    parsed = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not key or not equals:
            raise UsageProblemError("cli.bad_pair", f"{option} {pair!r} is not KEY=VALUE", "write key=value")
        parsed[key] = value
    return parsed


def _share(job: Job) -> float:
    return 1.0 if job.state == "succeeded" else job.progress.fraction


def _id_and_state(job: Job) -> str:
    return f"{job.id} {job.state}"


def _each(
    ids: Sequence[str], call: Callable[[str], Answer], output: Output, text: Callable[[Answer], str]
) -> list[Answer]:
    """Do one call for every id even when some are declined; raise the first refusal at the end."""
    refusal: LambentError | None = None
    answers = []
    for identifier in ids:
        try:
            answer = call(identifier)
        except LambentError as error:
            if len(ids) == 1 or error.exit_code == 3:
                raise
            refusal = refusal or error
            output.note(f"{identifier}: {error}")
            continue
        answers.append(answer)
        output.result(text(answer), answer)
    if refusal is not None:
        raise refusal
    return answers
