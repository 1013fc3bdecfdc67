"""Collects all problems of a scene instead of stopping at the first one."""

from lambent_proto.v1 import scene_pb2

MAX_FINDINGS = 100


class Problems:
    """A list of findings that keeps the first hundred, errors first, and counts the rest."""

    def __init__(self) -> None:
        self._errors: list[scene_pb2.Finding] = []
        self._warnings: list[scene_pb2.Finding] = []
        self._lost: list[scene_pb2.Finding] = []

    def error(self, code: str, message: str, subject: str = "") -> None:
        """Note something that makes the scene unusable; `subject` is the file or frame it is about."""
        self._errors.append(_finding(code, scene_pb2.SEVERITY_ERROR, message, subject))

    def warning(self, code: str, message: str, subject: str = "") -> None:
        """Note something the owner should know although the scene can be used."""
        self._warnings.append(_finding(code, scene_pb2.SEVERITY_WARNING, message, subject))

    def lost(self, code: str, message: str, subject: str) -> None:
        """Note the picture `subject` that a frame needs: an error, unless `forgive_lost` is called."""
        self._lost.append(_finding(code, scene_pb2.SEVERITY_ERROR, message, subject))

    def forgive_lost(self) -> list[scene_pb2.Finding]:
        """Return what `lost` noted and forget it."""
        forgiven, self._lost = self._lost, []
        return forgiven

    def take_lost(self, code: str) -> list[str]:
        """Return the pictures that `lost` noted with `code`, and forget these."""
        taken = [finding.subject for finding in self._lost if finding.code == code]
        self._lost = [finding for finding in self._lost if finding.code != code]
        return taken

    @property
    def num_lost(self) -> int:
        """Return how many pictures `lost` has noted."""
        return len(self._lost)

    def extend(self, others: "Problems") -> None:
        """Add all that `others` has noted."""
        self._errors += others._errors
        self._warnings += others._warnings
        self._lost += others._lost

    @property
    def usable(self) -> bool:
        """Return whether no error was found."""
        return not self._errors and not self._lost

    def findings(self) -> list[scene_pb2.Finding]:
        """Return at most `MAX_FINDINGS` findings; the last one says how many were left out."""
        everything = [*self._lost, *self._errors, *self._warnings]
        if len(everything) <= MAX_FINDINGS:
            return everything
        left_out = len(everything) - (MAX_FINDINGS - 1)
        severity = scene_pb2.SEVERITY_WARNING if self.usable else scene_pb2.SEVERITY_ERROR
        rest = _finding(
            "scene.more_findings",
            severity,
            f"{left_out} more findings are not listed; fix these first and check again",
            "",
        )
        return [*everything[: MAX_FINDINGS - 1], rest]


def _finding(code: str, severity: scene_pb2.Severity, message: str, subject: str) -> scene_pb2.Finding:
    # Names from untrusted files may contain lone surrogates, which a message cannot encode.
    message, subject = (text.encode("utf-8", "replace").decode("utf-8") for text in (message, subject))
    return scene_pb2.Finding(code=code, severity=severity, message=message, subject=subject)
