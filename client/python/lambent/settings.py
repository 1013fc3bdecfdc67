"""The server to talk to, and its key."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from lambent.errors import UnreachableError, UsageProblemError


@dataclass(frozen=True, kw_only=True, slots=True)
class ServerAddress:
    """Base URL without a trailing slash, and the key to send (empty: none)."""

    url: str
    api_key: str = ""

    @property
    def is_loopback(self) -> bool:
        """Whether the server is on this machine, where no proxy must get in between."""
        return urlsplit(self.url).hostname in {"127.0.0.1", "localhost", "::1"}

    def __repr__(self) -> str:
        """Return the address without the key."""
        return f"ServerAddress(url={self.url!r}, api_key={'***' if self.api_key else ''!r})"


def data_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the data folder of the server on this machine (LAMBENT_DATA, else the user's data folder)."""
    if environ.get("LAMBENT_DATA"):
        return Path(environ["LAMBENT_DATA"])
    from platformdirs import user_data_dir

    return Path(user_data_dir("lambent"))


def find_server(
    url: str = "",
    api_key: str = "",
    *,
    data: Path | None = None,
    environ: Mapping[str, str] = os.environ,
) -> ServerAddress:
    """Return the server to use: arguments, else LAMBENT_URL and LAMBENT_API_KEY, else the local server.

    The local key file is only ever sent to the local server that wrote it. Raises
    `server.not_running` when neither an address is given nor a local server has left one.
    """
    folder = data or data_folder(environ)
    url = url or environ.get("LAMBENT_URL", "")
    api_key = api_key or environ.get("LAMBENT_API_KEY", "")
    local = local_url(folder)
    if not url and not local:
        raise UnreachableError(
            "server.not_running",
            f"no server has left its address in {folder}",
            "start one with `lambent serve`, or set LAMBENT_URL (and LAMBENT_API_KEY) to another machine's",
        )
    url = (url or local).rstrip("/")
    if urlsplit(url).scheme not in {"http", "https"} or not urlsplit(url).hostname:
        raise UsageProblemError(
            "server.bad_url", f"{url!r} is not an http(s) address", "write it like http://127.0.0.1:8420"
        )
    if not api_key and url == local.rstrip("/"):
        api_key = _local_key(folder)
    return ServerAddress(url=url, api_key=api_key)


def local_url(folder: Path) -> str:
    """Return the address that the server of a data folder left there; empty where there is none."""
    try:
        return str(json.loads((folder / "server.json").read_text())["url"])
    except FileNotFoundError:
        return ""
    except (ValueError, KeyError, TypeError) as error:
        raise UsageProblemError(
            "server.bad_address_file",
            f"{folder / 'server.json'} is not what `lambent serve` writes: {error}",
            "remove it and start the server again",
        ) from error


def _local_key(folder: Path) -> str:
    path = folder / "api.key"
    try:
        return path.read_text().strip()
    except FileNotFoundError:
        return ""
    except PermissionError as error:
        raise UsageProblemError(
            "server.key_unreadable",
            f"{path} cannot be read by this user",
            "run as the user that runs the server, or set LAMBENT_API_KEY",
        ) from error
