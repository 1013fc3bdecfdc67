"""Every sub-command in one line, so that `lambent --help` imports none of them."""

from dataclasses import dataclass

CLIENT = "client"


@dataclass(frozen=True, kw_only=True, slots=True)
class Entry:
    """A sub-command: where it is listed, what it does, and where its function lives.

    `target` is "module:function" for the client's own, and empty for a command of the entry-point group
    "lambent.commands", which the extra `extra` brings.
    """

    name: str
    panel: str
    summary: str
    target: str = ""
    extra: str = CLIENT


_START, _SERVER, _PICTURES, _LOCAL = (
    "Start here",
    "With a server",
    "Pictures from a bundle",
    "Without a server",
)

ENTRIES = (
    Entry(
        name="demo",
        panel=_START,
        summary="From the bundled sample to relit pictures, in a few minutes.",
        target="lambent.cli.demo:demo",
        extra="client,server,worker",
    ),
    Entry(
        name="doctor",
        panel=_START,
        summary="Check this machine and the server, and say what to mend.",
        target="lambent.cli.doctor:doctor",
    ),
    Entry(
        name="serve",
        panel=_SERVER,
        summary="Run the server: API, pages, queue, and workers on this machine.",
        extra="server",
    ),
    Entry(
        name="keys",
        panel=_SERVER,
        summary="Make, list, revoke and replace the keys of the server on this machine.",
        extra="server",
    ),
    Entry(
        name="push",
        panel=_SERVER,
        summary="Upload a scene folder or archive; sends only what is missing.",
        target="lambent.cli.transfer:push",
    ),
    Entry(
        name="submit",
        panel=_SERVER,
        summary="Queue a training job on an uploaded scene.",
        target="lambent.cli.jobs:submit",
    ),
    Entry(
        name="watch", panel=_SERVER, summary="Follow jobs until they end.", target="lambent.cli.jobs:watch"
    ),
    Entry(name="jobs", panel=_SERVER, summary="List jobs.", target="lambent.cli.jobs:jobs"),
    Entry(name="cancel", panel=_SERVER, summary="Stop jobs.", target="lambent.cli.jobs:cancel"),
    Entry(
        name="retry",
        panel=_SERVER,
        summary="Queue failed or cancelled jobs again, as new jobs.",
        target="lambent.cli.jobs:retry",
    ),
    Entry(
        name="delete",
        panel=_SERVER,
        summary="Delete scenes, jobs, bundles and environments on the server.",
        target="lambent.cli.jobs:delete",
    ),
    Entry(name="logs", panel=_SERVER, summary="Print the log of a job.", target="lambent.cli.jobs:logs"),
    Entry(
        name="fetch",
        panel=_SERVER,
        summary="Download the bundle of a finished job; verified and resumable.",
        target="lambent.cli.transfer:fetch",
    ),
    Entry(
        name="relight",
        panel=_PICTURES,
        summary="Render a bundle under other environments, as PNG and linear EXR.",
        target="lambent.cli.relight:relight",
    ),
    Entry(
        name="batch",
        panel=_PICTURES,
        summary="Render assets x environments x cameras from a manifest; resumable, here or on a server.",
        target="lambent.cli.batch:batch",
    ),
    Entry(
        name="turntable",
        panel=_PICTURES,
        summary="Render a turn around the object, or of the light around it, as a film.",
        target="lambent.cli.turntable:turntable",
    ),
    Entry(
        name="view",
        panel=_PICTURES,
        summary="Look at a bundle from all sides and in any light.",
        target="lambent.cli.view:view",
    ),
    Entry(
        name="probe",
        panel=_PICTURES,
        summary="Look at an environment map: chrome ball, grey ball, brightest lights, energy.",
        target="lambent.cli.probe:probe",
    ),
    Entry(
        name="check",
        panel=_LOCAL,
        summary="Look at a scene folder before any training, and say what to mend.",
        extra="worker",
    ),
    Entry(name="train", panel=_LOCAL, summary="Train a scene folder on this machine.", extra="worker"),
    Entry(name="evaluate", panel=_LOCAL, summary="Compare a trained run with ground truth.", extra="worker"),
    Entry(
        name="export", panel=_LOCAL, summary="Write the relightable bundle of a trained run.", extra="worker"
    ),
    Entry(
        name="bake-light",
        panel=_LOCAL,
        summary="Adapt a bundle's fast cache to an environment, all bounces included.",
        extra="worker",
    ),
    Entry(
        name="benchmark",
        panel=_LOCAL,
        summary="Train and evaluate scenes x seeds x ablations, and print the paper's tables.",
        extra="worker",
    ),
)
