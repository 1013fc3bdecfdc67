"""`lambent admin` on the data folder of an interface in memory."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lambent_server.admin.commands import app
from lambent_server.core.secrets import read_or_create
from support.api import Api, opened
from typer.testing import CliRunner, Result


@contextlib.contextmanager
def administered(data: Path) -> Iterator[Api]:
    """Yield an interface on a folder that a server has used, which the commands ask for."""
    with opened(data) as api:
        read_or_create(data / "worker.secret")
        yield api


def admin(api: Api, *arguments: str, code: int = 0) -> Result:
    """Run a command and return its result; AssertionError unless it ends with `code`."""
    result = CliRunner().invoke(app, [*arguments, "--data", str(api.services.settings.data)])
    assert result.exit_code == code, result.output
    return result


def listed(api: Api, *arguments: str) -> list[dict[str, Any]]:
    """Return the objects that a command prints, a line each."""
    return [json.loads(line) for line in admin(api, *arguments, "--json").stdout.splitlines()]
