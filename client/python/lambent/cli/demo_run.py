"""The whole chain on the bundled sample: serve, push, train, fetch, relight, compare with the truth."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

from lambent.cli.output import Output, format_duration
from lambent.cli.progress import TransferView, open_view
from lambent.cli.rendering import relight_errors
from lambent.client import Client
from lambent.demo_pictures import Figure, Sample, format_table, make_pictures, read_figures
from lambent.errors import JobNotSucceededError, UsageProblemError
from lambent.local_server import local_server
from lambent.models import Job
from lambent.scenes import content_sha256, list_files

SAMPLE = Path(__file__).parents[1] / "sample"
LABEL = "lambent.demo"
"""Label of the demo's jobs, by which the next demo finds them, also one of another release."""


def run_demo(
    folder: Path,
    *,
    data: Path,
    preset: str = "fast",
    seed: int = 0,
    keep: bool = False,
    sample: Path = SAMPLE,
    output: Output,
) -> list[Figure]:
    """Run the demo into `folder` and return its figures.

    Run again, it takes up the job where it is: the same scene, preset and seed are the same job. Nothing is
    left running afterwards; with `keep` the server stays until Ctrl-C, so that its page can be looked at.
    """
    if not (sample / "scene.json").is_file():
        raise UsageProblemError(
            "demo.no_sample", f"the sample scene is not in {sample}", "install lambent again"
        )
    began = time.monotonic()
    bundle_folder = folder / "bundle"
    with local_server(data) as server, Client(server.url, data=data) as client:
        output.note(f"server    {server.url}  (data in {data}, log in {server.log})")
        output.note(f"page      {client.login_link()}  (opens once)")
        job = _follow(client, _find_or_submit(client, sample, preset, seed, output), output)
        with TransferView(output.as_json) as view:
            _fetch(client, job, bundle_folder, view.show)
        figures = read_figures(bundle_folder, folder / "out")
        if figures is None:
            with relight_errors():
                figures = make_pictures(bundle_folder, Sample.open(sample), folder / "out", output.note)
        _report(folder, bundle_folder, job, figures, time.monotonic() - began, output)
        if keep and server.is_ours:
            _stay(client.login_link(), output)
    return figures


def _find_or_submit(client: Client, sample: Path, preset: str, seed: int, output: Output) -> Job:
    """Return the job of this very scene, preset and seed; queue or retry it where needed."""
    content = content_sha256(list_files(sample))[:16]
    value = f"{content}-{preset}-{seed}"
    known = next(iter(client.jobs(label=f"{LABEL}={value}", limit=1)), None)
    if known is not None and known.state in {"failed", "cancelled"}:
        output.note(f"job       {known.id} had {known.state}: trying again")
        return client.retry(known.id)
    if known is not None:
        output.note(f"job       {known.id} from before ({known.state})")
        return known
    with TransferView(output.as_json) as view:
        scene = client.push(sample, name="sample", progress=view.show)
    job = client.submit(
        scene.id,
        preset=preset,
        seed=seed,
        labels={LABEL: value},
        idempotency_key=f"demo-{scene.id}-{value}",
    )
    output.note(f"job       {job.id}  (preset {preset}, seed {seed})")
    return job


def _follow(client: Client, job: Job, output: Output) -> Job:
    final = job
    with open_view(output.as_json) as view:
        for update in client.watch([job.id]):
            view.show(update)
            if isinstance(update, Job):
                final = update
    if final.state != "succeeded":
        reason = f"{final.error.code}: {final.error.message}" if final.error else final.state
        raise JobNotSucceededError("demo.job_failed", f"job {job.id} ended: {reason}", "run the demo again")
    return final


def _fetch(client: Client, job: Job, target: Path, show: Callable[[str, int, int], None]) -> None:
    """Fetch the bundle; one of an earlier job (another preset or version) is put aside, never mixed in."""

    def progress(_: str, done: int, total: int) -> None:
        show("fetch", done, total)

    try:
        client.fetch(job.id, target, progress=progress)
    except UsageProblemError as error:
        if error.code != "fetch.target_in_use":
            raise
        number = next(n for n in range(1, sys.maxsize) if not target.with_name(f"bundle.{n}").exists())
        target.rename(target.with_name(f"bundle.{number}"))
        client.fetch(job.id, target, progress=progress)


def _report(
    folder: Path, bundle: Path, job: Job, figures: list[Figure], seconds: float, output: Output
) -> None:
    text = "\n".join(
        [
            "",
            format_table(figures),
            "",
            f"contact sheet   {folder / 'out' / 'contact_sheet.png'}",
            f"pictures        {folder / 'out'}/<view>/*.png and *.exr",
            f"figures         {folder / 'out' / 'metrics.json'}",
            f"bundle          {bundle}",
            f"time            {format_duration(seconds)}",
            "",
            f"next: lambent relight {bundle} --env YOUR.exr --turntable 8 -o pictures",
        ]
    )
    data = {
        "job": job.id,
        "bundle": str(bundle),
        "output": str(folder / "out"),
        "seconds": seconds,
        "figures": {figure.name: {"value": figure.value, "floor": figure.floor} for figure in figures},
    }
    output.result(text, data)


def _stay(page_link: str, output: Output) -> None:
    output.note("\nThe server is still there; Ctrl-C ends it.")
    output.note(f"page      {page_link}  (opens once)")
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        output.note("stopping the server")
