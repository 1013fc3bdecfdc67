"""Every sub-command in one line, so that `lambent --help` imports none of them."""

from dataclasses import dataclass

CLIENT, CAPTURE, SERVER, WORKER = "client", "capture", "server", "worker"


@dataclass(frozen=True, slots=True)
class Entry:
    """A sub-command: where it is listed, what it does, and where its function lives.

    `module` of lambent.cli holds the function of that name; it is empty for a command of the entry-point
    group "lambent.commands". `extra` brings the packages that the command needs; an empty one stands for
    those of the bare installation.
    """

    panel: str
    name: str
    summary: str
    module: str = ""
    extra: str = ""


_PANELS = {
    "Start here": (
        (
            "demo",
            "From the bundled sample to relit pictures, in a few minutes.",
            "demo",
            f"{SERVER},{WORKER}",
        ),
        ("doctor", "Check this machine and the server, and say what to fix.", "doctor"),
    ),
    "With a server": (
        ("serve", "Run the server: API, pages, queue, and workers on this machine.", "", SERVER),
        ("keys", "Make, list, revoke and replace keys of the server on this machine.", "", SERVER),
        (
            "admin",
            "Operate the server of this machine: drain, maintenance, jobs, webhooks.",
            "",
            SERVER,
        ),
        (
            "store",
            "Compare rows and files of the server on this machine, and remove what is left over.",
            "",
            SERVER,
        ),
        ("push", "Upload a scene folder or archive; sends only what is missing.", "transfer"),
        ("submit", "Queue a training job on an uploaded scene.", "jobs"),
        ("watch", "Follow jobs until they end.", "jobs"),
        ("jobs", "List jobs.", "jobs"),
        ("cancel", "Stop jobs.", "jobs"),
        ("retry", "Queue failed or cancelled jobs again, as new jobs.", "jobs"),
        ("delete", "Delete scenes, jobs, bundles, environments and links on the server.", "jobs"),
        ("change", "Change labels of jobs, scenes and bundles, or the priority of waiting jobs.", "jobs"),
        ("webhooks", "Have changes of jobs told to an address of yours.", "webhooks"),
        ("logs", "Print the log of a job.", "jobs"),
        ("fetch", "Download the bundle of a finished job; verified and resumable.", "transfer"),
        (
            "verify",
            "Say whether a bundle is whole, and where it is from: checks the server's signature.",
            "verify",
            CLIENT,
        ),
        ("share", "Make a link to a bundle, which other pages may show if it says so.", "transfer"),
    ),
    "Pictures from a bundle": (
        ("relight", "Render a bundle under other environments, as PNG and linear EXR.", "relight", CLIENT),
        (
            "batch",
            "Render assets x environments x cameras from a manifest; resumable, here or on a server.",
            "batch",
            CLIENT,
        ),
        (
            "turntable",
            "Render a turn around the object, or of the light around it, as a film.",
            "turntable",
            CLIENT,
        ),
        ("view", "Look at a bundle from all sides and in any light.", "view", CLIENT),
        (
            "probe",
            "Look at an environment map: chrome ball, grey ball, brightest lights, energy.",
            "probe",
            CLIENT,
        ),
        (
            "blender",
            "Write the script that opens a bundle in Blender, with its light and cameras.",
            "blender",
            CLIENT,
        ),
    ),
    "Without a server": (
        ("check", "Look at a scene folder before any training, and say what to fix.", "", CAPTURE),
        ("poses", "Find the cameras of photographs, to look at them before training.", "", CAPTURE),
        ("masks", "Cut the object out of each photograph, to look at and correct it.", "", CAPTURE),
        ("train", "Train on photographs or a scene folder on this machine.", "", WORKER),
        ("evaluate", "Compare a trained run with ground truth.", "", WORKER),
        (
            "export",
            "Write the relightable bundle of a trained run, or its asset as glTF, USD, OBJ or Mitsuba scene.",
            "export",
            CLIENT,
        ),
        ("bake-light", "Adapt a bundle's fast cache to an environment, all bounces included.", "", WORKER),
        (
            "benchmark",
            "Train and evaluate scenes x seeds x ablations, and print the paper's tables.",
            "",
            WORKER,
        ),
    ),
}
"""Commands by panel: name, summary, module, extra."""

ENTRIES = tuple(Entry(panel, *row) for panel, rows in _PANELS.items() for row in rows)
