"""Every sub-command in one line, so that `lambent --help` imports none of them."""

from dataclasses import dataclass

CLIENT = "client"


@dataclass(frozen=True, slots=True)
class Entry:
    """A sub-command: where it is listed, what it does, and where its function lives.

    `module` of lambent.cli holds the function of that name; it is empty for a command of the entry-point
    group "lambent.commands", which the extra `extra` brings.
    """

    name: str
    panel: str
    summary: str
    module: str = ""
    extra: str = CLIENT


_START, _SERVER, _PICTURES, _LOCAL = (
    "Start here",
    "With a server",
    "Pictures from a bundle",
    "Without a server",
)

ENTRIES = (
    Entry(
        "demo",
        _START,
        "From the bundled sample to relit pictures, in a few minutes.",
        "demo",
        extra="client,server,worker",
    ),
    Entry("doctor", _START, "Check this machine and the server, and say what to fix.", "doctor"),
    Entry(
        "serve", _SERVER, "Run the server: API, pages, queue, and workers on this machine.", extra="server"
    ),
    Entry(
        "keys", _SERVER, "Make, list, revoke and replace keys of the server on this machine.", extra="server"
    ),
    Entry("push", _SERVER, "Upload a scene folder or archive; sends only what is missing.", "transfer"),
    Entry("submit", _SERVER, "Queue a training job on an uploaded scene.", "jobs"),
    Entry("watch", _SERVER, "Follow jobs until they end.", "jobs"),
    Entry("jobs", _SERVER, "List jobs.", "jobs"),
    Entry("cancel", _SERVER, "Stop jobs.", "jobs"),
    Entry("retry", _SERVER, "Queue failed or cancelled jobs again, as new jobs.", "jobs"),
    Entry("delete", _SERVER, "Delete scenes, jobs, bundles and environments on the server.", "jobs"),
    Entry("logs", _SERVER, "Print the log of a job.", "jobs"),
    Entry("fetch", _SERVER, "Download the bundle of a finished job; verified and resumable.", "transfer"),
    Entry(
        "relight", _PICTURES, "Render a bundle under other environments, as PNG and linear EXR.", "relight"
    ),
    Entry(
        "batch",
        _PICTURES,
        "Render assets x environments x cameras from a manifest; resumable, here or on a server.",
        "batch",
    ),
    Entry(
        "turntable",
        _PICTURES,
        "Render a turn around the object, or of the light around it, as a film.",
        "turntable",
    ),
    Entry("view", _PICTURES, "Look at a bundle from all sides and in any light.", "view"),
    Entry(
        "probe",
        _PICTURES,
        "Look at an environment map: chrome ball, grey ball, brightest lights, energy.",
        "probe",
    ),
    Entry(
        "check", _LOCAL, "Look at a scene folder before any training, and say what to fix.", extra="worker"
    ),
    Entry("train", _LOCAL, "Train a scene folder on this machine.", extra="worker"),
    Entry("evaluate", _LOCAL, "Compare a trained run with ground truth.", extra="worker"),
    Entry("export", _LOCAL, "Write the relightable bundle of a trained run.", extra="worker"),
    Entry(
        "bake-light",
        _LOCAL,
        "Adapt a bundle's fast cache to an environment, all bounces included.",
        extra="worker",
    ),
    Entry(
        "benchmark",
        _LOCAL,
        "Train and evaluate scenes x seeds x ablations, and print the paper's tables.",
        extra="worker",
    ),
)
