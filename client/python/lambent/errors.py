"""Exceptions of the client: a stable code, what to do, and the exit code of the command line.

Exit codes: 0 ok, 1 some work failed, 2 usage, 3 server unreachable, 4 refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lambent_core.errors import LambentError


class UsageProblemError(LambentError):
    """The call itself is wrong: a missing file, a setting out of range, an extra that is not installed."""

    exit_code = 2


class UnreachableError(LambentError):
    """No server answered."""

    exit_code = 3


class DigestMismatchError(LambentError):
    """Bytes that arrived are not the bytes that were announced."""


class JobNotSucceededError(LambentError):
    """A job ended in another state than "succeeded", or has not ended yet."""


class WaitTimeoutError(LambentError, TimeoutError):
    """A job or batch has not ended within the time given; it has not been stopped."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PointerError:
    """One fault inside a request body: a JSON pointer and what is wrong there."""

    pointer: str
    message: str


class ProblemError(LambentError):
    """The server answered with an RFC 9457 problem; `errors` point into the request body."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        code = str(problem.get("code") or f"http_{status}")
        message = str(problem.get("detail") or problem.get("title") or f"the server answered {status}")
        super().__init__(code, message, advice=_advice(status, code, problem))
        self.status = status
        self.retryable = bool(problem.get("retryable", False))
        self.request_id = str(problem.get("request_id") or "")
        self.problem = dict(problem)
        self.errors = tuple(
            PointerError(pointer=str(entry.get("pointer", "")), message=str(entry.get("message", "")))
            for entry in problem.get("errors") or ()
        )

    def __str__(self) -> str:
        """Return code, what was found, every pointer, the findings about a scene, and the advice."""
        pointers = "".join(f"\n  {error.pointer or '#'}: {error.message}" for error in self.errors)
        for finding in self.problem.get("findings") or ():
            about = f" ({finding['subject']})" if finding.get("subject") else ""
            pointers += f"\n  {finding.get('code')}: {finding.get('message')}{about}"
        advice = f"\n  what to do: {self.advice}" if self.advice else ""
        return f"{self.code}: {self.message}{pointers}{advice}"


class RefusedError(ProblemError):
    """The server understood and declined (4xx, or no room left): asking again changes nothing by itself."""

    exit_code = 4


class ServerFaultError(ProblemError):
    """The server failed on a request that may be fine (5xx)."""


_ADVICE_BY_CODE = {
    "digest_mismatch": "a file changed while it was uploaded; run the same command again",
    "archive_unsafe": "pack the scene folder again with plain files only (no links, no paths with '..')",
    "archive_nested": "unpack the archive, and push the folder that comes out of it",
    "archive_empty": "pack the folder that holds the photographs",
    "decoder_stopped": "the file is damaged, or made to attack its readers; make it again",
    "unsatisfiable_resources": "ask for fewer GPUs, or start a worker that has them",
}

_ADVICE_BY_STATUS = {
    401: "set LAMBENT_API_KEY, or LAMBENT_DATA to the server's data folder so that its api.key can be read",
    403: "use a key with the scope that this call needs",
    404: "check the id (`lambent jobs` lists yours) and the server address (LAMBENT_URL)",
    409: "look at its state first (`lambent jobs`), then decide",
    413: "send smaller pieces; GET /v1/limits tells the limits of this server",
    422: "fix the fields named above and send the request again",
    429: "wait, or free some of the quota named above",
    507: "free disk space on the server, then run the same command again",
}


def _advice(status: int, code: str, problem: Mapping[str, Any]) -> str:
    given = problem.get("advice")
    return str(given) if given else _ADVICE_BY_CODE.get(code) or _ADVICE_BY_STATUS.get(status, "")


def problem_error(status: int, problem: Mapping[str, Any]) -> ProblemError:
    """Return the exception for a problem document: refused for 4xx and 507, a server fault for other 5xx."""
    refused = status < 500 or status == 507
    return RefusedError(status, problem) if refused else ServerFaultError(status, problem)
