"""Settings of a server, from the environment (`LAMBENT_…`) or the command line.

Times are in seconds, sizes in bytes.
"""

import os
import re
import sys
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from lambent_sandbox.sandbox import AVAILABLE
from platformdirs import user_data_dir
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict
from sqlalchemy import make_url

Seconds = Annotated[float, Field(gt=0)]
Size = Annotated[int, Field(ge=0)]
LocalPath = Annotated[Path, AfterValidator(Path.absolute)]
"""The same file in every process, whatever folder that process works in."""

KIB = 1024
MIB = 1024 * KIB
GIB = 1024 * MIB

# Neither the folder of the caller nor that of the user is searched for modules, and nothing is written there.
_PYTHON = (sys.executable, "-P", "-s", "-B")


def _split(value: Any) -> Any:
    """Return the parts of "a, b"."""
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


def _networks(values: tuple[str, ...]) -> tuple[str, ...]:
    """Return networks such as "10.0.0.0/8" or "10.0.0.7"; ValueError if one is something else."""
    return tuple(str(ip_network(value, strict=False)) for value in values)


def _with_driver(url: str) -> str:
    return url.replace("postgresql://", "postgresql+psycopg://", 1)


def _readable(file: Path | None) -> Path | None:
    """Return the path of a file; ValueError if this user cannot read it."""
    if file is not None and not (file.is_file() and os.access(file, os.R_OK)):
        raise ValueError(f"{file} is not a file that this user can read")
    return file


def _with_password(url: str, file: Path | None) -> str:
    """Return `url` with the password in `file`."""
    if file is None:
        return url
    password = file.read_text(encoding="utf-8").strip()
    return make_url(url).set(password=password).render_as_string(hide_password=False)


def _host_or_network(entry: str) -> str:
    """Return an entry of a list of hosts and networks; raises ValueError for any other text."""
    if "/" in entry or ":" in entry:
        return str(ip_network(entry))
    if not re.fullmatch(r"(\*\.)?[A-Za-z0-9._-]+", entry):
        raise ValueError(f"{entry!r} is neither a host name, nor *. and one, nor a network")
    return entry


def _host_and_port(text: str | None) -> str | None:
    """Return an address such as "10.0.0.7:8421" or "[::]:8421"; ValueError if it is something else."""
    if text is not None and not re.fullmatch(r"(\[[0-9a-fA-F:]+\]|[A-Za-z0-9._-]+):[1-9][0-9]{0,4}", text):
        raise ValueError(f"{text!r} is not a host with a port, such as 10.0.0.7:8421")
    return text


class ServeError(Exception):
    """The server cannot start with what it was given; the message says why and what to do."""


class Settings(BaseSettings):
    """The complete configuration of one server, including every timeout, so that tests can shorten them.

    Relative paths are relative to the folder in which the command was given, and absolute from here on.
    """

    model_config = SettingsConfigDict(env_prefix="LAMBENT_", frozen=True, extra="ignore")

    data: LocalPath = Field(default_factory=lambda: Path(user_data_dir("lambent")))
    """Folder for the database, the blobs, the key and the run folders."""
    host: str = "127.0.0.1"
    port: int = Field(default=8420, ge=0, le=65535)
    """0 selects any free port."""
    insecure: bool = False
    """Allow an address that other machines can reach, without TLS."""
    allowed_hosts: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Host names that the server accepts besides the loopback ones, separated by commas."""
    database: str | None = None
    """SQLAlchemy URL; default: a SQLite file in the data folder."""
    database_direct: str | None = None
    """The same database without a connection pooler in between, for LISTEN; default: `database`. If it is
    set, statements are not prepared on `database`, where a pooler may change connections any time."""
    secrets: LocalPath | None = None
    """Folder with the secrets that all servers on a database share, such as a mounted one; default: in the
    database (PostgreSQL) or the data folder (SQLite)."""
    database_password_file: Annotated[LocalPath | None, AfterValidator(_readable)] = None
    """File with the password of the database's user, for addresses that should not contain it."""
    store: str | None = None
    """URL of the blob store, such as "s3://bucket/prefix"; default: a folder in the data folder."""
    store_endpoint: str | None = None
    """Address of an S3 server other than AWS."""
    store_public_endpoint: str | None = None
    """Its address for clients and run processes, if it differs."""
    store_region: str | None = None
    store_direct: bool = True
    """Let clients and run processes exchange bytes with a store in S3 themselves, by presigned addresses."""
    store_redirect: Literal["asked", "always"] = "asked"
    """Who is redirected to such an address when reading: programs that ask for it, or everybody."""
    store_url_s: Seconds = 900.0
    """Time for which a presigned address is valid."""
    store_reserved_s: Seconds = 3600.0
    """Time after the last address for which bytes that were sent and not taken over are kept, and count."""
    store_whole_bytes: Size = 64 * MIB
    """Larger files are sent in parts."""
    store_part_bytes: int = Field(default=16 * MIB, ge=5 * MIB)
    """Size of a part."""
    executor: Literal["local", "ray"] = "local"
    """Where run processes are: on this machine, or on the nodes of a Ray cluster."""
    run_command: tuple[str, ...] = (sys.executable, "-P", "-m", "lambent_run", "run")
    """Command with which the local executor starts a run process."""
    run_environment: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Variables that run processes get besides the usual ones; `HF_*` stands for all with this prefix."""
    run_memory_bytes: Size | None = None
    """Memory that one run process may allocate (Linux), 0 for no limit; default: nine tenths of the memory
    divided by `local_slots`."""
    run_file_bytes: Size = 64 * GIB
    """Size of the largest file that a run process may write (not on Windows), 0 for no limit."""
    run_processes: Size = 4096
    """Processes and threads that a run may have (Linux), 0 for no limit."""
    run_give_up_after_s: Seconds = 24 * 3600.0
    """Time without a server after which a run process exits."""

    sandbox: Literal["required", "available", "limits"] = AVAILABLE
    """Around processes that decode uploads: all layers or no decoding, those that this system has, or limits
    of memory, time and files only."""
    decode_command: tuple[str, ...] = (*_PYTHON, "-m", "lambent_server.storage.decoding_child")
    """Command with which the server starts a process that reads one archive or environment."""
    decode_memory_bytes: int = Field(default=512 * MIB, ge=128 * MIB)
    """Address space of such a process."""
    decode_cpu_s: Seconds = 300.0
    """Its processor time; it is also ended after three times as long on the clock."""
    decode_bytes_per_s: float = Field(default=256.0 * KIB, gt=0)
    """How fast a file must be read, in bytes of it, after the first minute."""
    max_decoders: int = Field(default=4, ge=1)
    """How many there are at once; further uploads wait, and tenants take turns. One tenant has its share
    (`tenant_share`) of them, and one key or session (`client_share`)."""

    local_slots: int = Field(default=1, ge=0)
    """Jobs that run on this machine at the same time; 0 for a server that only answers requests."""
    local_gpus: int | None = Field(default=None, ge=0)
    """GPUs that the local executor assigns; default: the number of device files."""

    ray_address: str | None = None
    """Ray cluster: "10.0.0.5:6379" if this machine is one of its nodes, else "ray://10.0.0.5:10001"."""
    ray_token_file: LocalPath | None = None
    """File with the token of the cluster; default: as Ray itself (RAY_AUTH_TOKEN, ~/.ray/auth_token)."""
    ray_without_token: bool = False
    """Use a cluster that runs the programs of anyone who reaches it."""
    ray_namespace: str | None = None
    """Namespace of our actors; default: one for all servers on a database."""
    ray_run_cpus: float = Field(default=1.0, gt=0)
    """Processors that Ray reserves for a run."""
    ray_node_gpus: int | None = Field(default=None, ge=0)
    """GPUs of the largest node there can be; default: of those there are."""
    ray_ahead: int = Field(default=0, ge=0)
    """Runs that may wait for a node, so that Ray's autoscaler starts one."""
    ray_place_s: Seconds = 120.0
    """Time after which a run that has no node goes back to the queue."""
    ray_folder: Path | None = None
    """Folder on the nodes for files of runs; default: `lambent-<user id>` in their temporary folder."""
    ray_poll_s: Seconds = 1.0
    """How often the cluster is looked at."""
    ray_away_s: Seconds = 30.0
    """Age at which the last look at the cluster says nothing any more."""
    place_retry_s: Seconds = 30.0
    """Wait before a run that could not be placed is tried again."""

    worker_address: Annotated[str | None, AfterValidator(_host_and_port)] = None
    """Address ("10.0.0.7:8421") at which run processes of other machines reach this server, with TLS;
    default: only the socket in the data folder."""
    worker_public_address: Annotated[str | None, AfterValidator(_host_and_port)] = None
    """The same as run processes know it, if it differs."""
    worker_certificate: LocalPath | None = None
    """Certificate chain (PEM) of `worker_address`, read again when the file has changed; default: one that
    the servers make themselves, with an authority that they share."""
    worker_key: LocalPath | None = None
    """Its private key (PEM)."""
    worker_authority: LocalPath | None = None
    """Certificates (PEM) by which run processes check it; default: those that gRPC brings."""
    worker_plain: bool = False
    """Allow run processes of other machines to connect without TLS."""
    worker_calls: int = Field(default=16, ge=1)
    """Simultaneous calls of one run."""
    worker_calls_per_s: float = Field(default=50.0, gt=0)
    """Calls of one run per second, averaged over four seconds."""

    server_beat_s: Seconds = 2.0
    """How often a server tells the others on its database that it lives."""
    server_lost_after_s: Seconds = 15.0
    """Time after which a silent server counts as dead, and another may lead."""
    log_copy_s: Seconds = 5.0
    """How often new output of runs is copied to where other servers can read it (PostgreSQL)."""

    tick_s: Seconds = 0.5
    """How often the controller compares rows with processes."""
    heartbeat_s: Seconds = 10.0
    lost_after_s: Seconds = 60.0
    """Time without a heartbeat after which a run that cannot be found is lost."""
    stall_after_s: Seconds = 900.0
    """Time without a step after which a run is stopped and retried."""
    stage_stall_after_s: dict[str, float] = {}
    """The same for individual tasks."""
    stop_grace_s: Seconds = 30.0
    """Time between SIGTERM and SIGKILL."""
    shutdown_grace_s: Seconds = 8.0
    """Time for open streams to end when the server stops."""
    stop_runs_s: Seconds = 8.0
    """Time for run processes of this machine to write a checkpoint and end when the server stops on SIGINT
    (Ctrl-C); they are killed afterwards."""
    retry_delay_s: float = Field(default=5.0, ge=0)
    """Wait before the first retry after a failure; doubles with every further one."""
    max_failures: int = Field(default=3, ge=1)
    max_losses: int = Field(default=20, ge=0)
    max_losses_without_checkpoint: int = Field(default=3, ge=1)
    progress_interval_s: Seconds = 1.0
    preview_interval_s: Seconds = 10.0

    stream_ping_s: Seconds = 15.0
    stream_poll_s: Seconds = 1.0
    max_wait_s: Seconds = 60.0
    header_timeout_s: Seconds = 5.0
    """Time for the header of a request, from the moment the connection is open or the last response sent."""
    body_window_s: Seconds = 30.0
    """Window over which a body must average `body_bytes_per_s`; up to a fifth longer, by chance."""
    body_bytes_per_s: float = Field(default=1.0 * KIB, ge=0)
    send_timeout_s: Seconds = 60.0
    """Time within which a client must accept the next part of a response."""
    max_connections: int = Field(default=8192, ge=16)
    """Simultaneous connections; this and the next three are lower if the system allows fewer open files."""
    max_streams: int = Field(default=4000, ge=1)
    """Simultaneous event streams."""
    max_bodies: int = Field(default=1000, ge=1)
    """Simultaneous requests whose body is still being sent."""
    max_requests: int = Field(default=1000, ge=1)
    """Simultaneous other requests."""
    tenant_share: float = Field(default=0.5, gt=0, le=1)
    """Part of each of these that one tenant can use."""
    client_share: float = Field(default=0.25, gt=0, le=1)
    """Part of each of these that one address, and one key or browser session, can use."""
    trusted_proxies: Annotated[
        tuple[str, ...], NoDecode, BeforeValidator(_split), AfterValidator(_networks)
    ] = ()
    """Proxies that name client and scheme (`X-Forwarded-For`, `-Proto`): addresses, networks, by commas."""
    provenance_key: LocalPath | None = None
    """PEM file of the Ed25519 key that signs where bundles are from. Default: made in the data folder."""
    oidc_issuer: str | None = None
    """Issuer of the OpenID Connect provider at which people sign in, such as "https://id.example"."""
    oidc_client_id: str | None = None
    oidc_client_secret_file: LocalPath | None = None
    """File with the client's secret; none for a public client."""
    oidc_scopes: str = "openid email profile"
    """Scopes to ask for."""
    oidc_ca_file: LocalPath | None = None
    """Certificates of further authorities that the provider may use."""
    oidc_organisation_claim: str | None = None
    """Claim that names the organisations of a person by their ids: "studio", or "studio:viewer"."""
    oidc_role_claim: str | None = None
    """Claim that gives the role in organisations that are named without one."""
    oidc_roles: dict[str, Literal["viewer", "editor", "admin"]] = {}
    """Roles for values of that claim: {"lambent-admins": "admin"}."""
    login_header: str | None = None
    """Header in which a trusted proxy names who has signed in there."""
    login_organisations_header: str | None = None
    """Header in which it names the organisations, as the claim above does, separated by commas."""
    login_secret_file: LocalPath | None = None
    """File with the secret that this proxy sends in `X-Lambent-Login-Secret`; needed on the loopback."""
    login_create: Literal["nobody", "claimed", "everybody"] = "nobody"
    """Who becomes a user at the first sign-in: only whom operators have added, whoever is claimed, or all."""
    login_organisation: str = "default"
    """The organisation of everybody about whose organisations nothing is claimed."""
    login_role: Literal["viewer", "editor", "admin"] = "viewer"
    """The role of those about whose role nothing is claimed."""
    login_code_s: Seconds = 3600.0
    session_s: Seconds = 30 * 24 * 3600.0
    idempotency_s: Seconds = 7 * 24 * 3600.0
    garbage_after_s: Seconds = 60.0
    """Time for which an unreferenced blob is kept."""
    orphan_after_s: Seconds = 24 * 3600.0
    """Age at which bytes without a row, and folders of interrupted uploads, are removed."""
    reconcile_s: Seconds = 3600.0
    """Interval at which rows and files are compared."""
    scrub_bytes_per_s: Size = 16 * MIB
    """Rate at which the store is read to find damaged bytes; 0: only what is needed is compared."""
    scrub_every_s: Seconds = 7 * 24 * 3600.0
    """Time after which the same bytes are compared again."""
    open_scene_s: Seconds = 7 * 24 * 3600.0
    """Time for which an uncommitted upload is kept."""

    max_json_bytes: Size = MIB
    max_plan_bytes: Size = 8 * MIB
    max_scene_bytes: Size = 4 * GIB
    max_scene_files: int = Field(default=20_000, ge=1)
    max_archive_ratio: float = Field(default=200.0, gt=1)
    max_environment_bytes: Size = 512 * MIB
    max_environment_pixels: int = Field(default=16384 * 8192, ge=1)
    max_queued_jobs: int = Field(default=1000, ge=1)
    """Unfinished jobs of one tenant."""
    max_priority: int = Field(default=1000, ge=0, le=1000)
    """Highest priority that a job may be given."""
    max_batch_pictures: int = Field(default=1000, ge=1)
    """Pictures of one order."""
    max_organisation_bytes: Size = 0
    """Bytes that one organisation may store, unless `lambent admin quota` has set others; 0: no limit."""
    max_gpu_minutes: float = Field(default=0.0, ge=0)
    """Minutes on a GPU that the jobs of one organisation may use in a month; 0: no limit."""
    client_writes_per_s: float = Field(default=100.0, ge=0)
    """How often one key or browser session may change something, on average; 0: no limit."""
    organisation_writes_per_s: float = Field(default=300.0, ge=0)
    """The same of one organisation."""
    sign_ins_per_s: float = Field(default=20.0, ge=0)
    """How often one address may sign in or open a link, on average; 0: no limit."""
    writes_burst_s: Seconds = 10.0
    """Seconds of that rate that may be used at once."""
    disk_floor_bytes: Size = GIB
    """Free space below which uploads and new jobs are refused."""

    webhook_allowed: Annotated[
        tuple[Annotated[str, AfterValidator(_host_or_network)], ...], NoDecode, BeforeValidator(_split)
    ] = ()
    """Host names (`*.example.com`) and networks (`10.1.0.0/16`) that webhooks may reach although their
    addresses are not public, separated by commas."""
    webhook_only_allowed: bool = False
    """Send webhooks nowhere else."""
    webhook_allow_http: bool = False
    """Allow webhooks without TLS."""
    webhook_ports: Annotated[tuple[int, ...], NoDecode, BeforeValidator(_split)] = (443, 8443)
    webhook_ca_file: LocalPath | None = None
    """Certificates of further authorities that receivers may use."""
    webhook_timeout_s: Seconds = 10.0
    """For a whole attempt, from the look-up of the name to the first line of the answer."""
    webhook_concurrency: int = Field(default=16, ge=1)
    webhook_per_host: int = Field(default=4, ge=1)
    """Attempts of one tenant at one host; all tenants together may make twice as many there."""
    webhook_poll_s: Seconds = 1.0
    webhook_retry_s: Seconds = 10.0
    """Wait after the first failed attempt; three times as long after each further one."""
    webhook_longest_retry_s: Seconds = 4 * 3600.0
    webhook_give_up_s: Seconds = 24 * 3600.0
    webhook_rotation_s: float = Field(default=24 * 3600.0, ge=0)
    """Time for which a secret that was replaced still signs."""
    webhook_keep_s: Seconds = 30 * 24 * 3600.0
    """Time for which ended deliveries are listed."""
    max_webhooks: int = Field(default=50, ge=0)
    """Subscriptions of one tenant."""

    log_json: bool | None = None
    """Log JSON lines; default: unless standard error is a terminal."""

    @model_validator(mode="after")
    def _sign_in_is_possible(self) -> Self:
        """Refuse settings with which no one, or everyone, could sign in."""
        if self.oidc_issuer is not None and self.oidc_client_id is None:
            raise ValueError("oidc_issuer needs oidc_client_id, the name of this server at the provider")
        if self.login_header is not None and not self.trusted_proxies:
            raise ValueError("login_header needs trusted_proxies: it is ignored from any other address")
        return self

    @property
    def database_url(self) -> str:
        """Return the SQLAlchemy URL in effect."""
        if self.database is None:
            return f"sqlite:///{self.data / 'lambent.sqlite'}"
        return _with_password(_with_driver(self.database), self.database_password_file)

    @property
    def listening_url(self) -> str:
        """Return the SQLAlchemy URL on which changes are announced."""
        if self.database_direct is None:
            return self.database_url
        return _with_password(_with_driver(self.database_direct), self.database_password_file)

    @property
    def runs(self) -> Path:
        """Return the folder that contains a folder per job."""
        return self.data / "runs"

    @property
    def scratch(self) -> Path:
        """Return the folder of uploads in progress."""
        return self.data / "scratch"

    def stall_limit(self, stage: str) -> float:
        """Return the time in seconds that a step of the task `stage` may take."""
        return self.stage_stall_after_s.get(stage, self.stall_after_s)
