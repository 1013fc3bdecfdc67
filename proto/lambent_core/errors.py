"""Errors that a user can act on: a stable code, what was found, and what to do about it."""

from collections.abc import Iterable
from typing import Any

from lambent_proto.v1 import scene_pb2


class LambentError(Exception):
    """An error a user can fix.

    `code` is part of the public interface and never changes its meaning; `advice` says what to do next, where
    `message` does not. `str(error)` is `code: message; advice`, one line for a terminal. `exit_code` ends the
    command line.
    """

    exit_code = 1

    def __init__(self, code: str, message: str, advice: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.advice = advice

    def __str__(self) -> str:
        return f"{self.code}: {self.message}" + (f"; {self.advice}" if self.advice else "")

    def __reduce__(self) -> tuple[Any, ...]:
        """Let the error travel between processes."""
        return type(self), (self.code, self.message, self.advice)


class RelightError(LambentError):
    """A bundle, a light, a camera or a setting cannot be used for relighting."""


class BundleError(RelightError):
    """A bundle is damaged, unsafe, or of an unsupported version. Codes start with `bundle.`."""


class EnvironmentFileError(RelightError):
    """An environment map cannot be used. Codes start with `environment.`."""


class CameraError(RelightError):
    """A camera description cannot be used. Codes start with `camera.`."""


class ExportError(RelightError):
    """An asset cannot be written in a format. Codes start with `export.`."""


class SettingError(RelightError, ValueError):
    """A setting of a render is out of range. Codes start with `relight.`."""


class UnsupportedQuality(RelightError):  # noqa: N818 - the quality is at fault, not the program
    """The requested quality is not supported by this version or by this bundle.

    Codes `relight.quality_unsupported` and `relight.networks_missing`.
    """


class WorkerError(LambentError):
    """A run, or a command that does its work, cannot continue with what it was given."""


class UsageError(WorkerError):
    """The command was called with arguments that make no sense together."""

    exit_code = 2


class IncompleteError(UsageError):
    """A part of the result could not be made; the artifacts sent so far are published."""


class SceneRefusedError(WorkerError):
    """The scene cannot be used; `report` lists every problem that was found."""

    exit_code = 4

    def __init__(self, report: scene_pb2.SceneReport) -> None:
        errors = [f for f in report.findings if f.severity == scene_pb2.SEVERITY_ERROR]
        shown = "\n".join(f"  {finding.code}: {finding.message}" for finding in errors)
        super().__init__(
            "scene.refused", f"the scene cannot be used; {len(errors)} problem(s) to fix first:\n{shown}"
        )
        self.report = report

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.report,)

    @classmethod
    def of(cls, findings: Iterable[scene_pb2.Finding], layout: str = "") -> "SceneRefusedError":
        """Return the refusal of a capture with these findings, at least one of them an error."""
        return cls(scene_pb2.SceneReport(usable=False, layout=layout, findings=findings))


class InputDamagedError(WorkerError):
    """The server does not have the bytes of an input any more, or other ones."""

    @classmethod
    def of(cls, path: str, reason: str, *, is_scene: bool) -> "InputDamagedError":
        """Return the error of an input file, of a capture or of another kind; `reason` is the server's."""
        if is_scene:
            code, remedy = "scene.file_damaged", "push the same capture again, which sends what is missing"
        else:
            code, remedy = "input.file_damaged", "upload it again, or run the job that made it again"
        return cls(code, f"{path}: the server's copy is missing or damaged ({reason}); {remedy}, then submit")


class Stopped(WorkerError):  # noqa: N818 - not a mistake of anyone
    """The run was asked to end; a checkpoint holds everything that was reached."""

    exit_code = 130

    def __init__(self) -> None:
        super().__init__(
            "run.stopped",
            "stopped on request after writing a checkpoint; the same command continues from there",
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), ()


def pip_install(*extras: str) -> str:
    """Return the command that installs the packages of some extras; without any, those of Lambent itself.

    The command works wherever such a message is seen, and only there: Lambent is installed, so that pip looks
    for nothing but the packages that are missing. Lambent itself is in no package index; how to install it in
    the first place: docs/howto/install.md.
    """
    return f"pip install 'lambent[{','.join(extras)}]'" if extras else "pip install lambent"
