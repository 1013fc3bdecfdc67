"""Deletion of jobs, bundles and environments, unless an unfinished job needs them."""

from collections.abc import Iterator

from sqlalchemy import Connection, Table

from lambent_server import provenance
from lambent_server.api import labels as label_rows
from lambent_server.api.idempotency import forget as forget_keys
from lambent_server.api.problems import conflict
from lambent_server.api.resources import require
from lambent_server.database.model import BundleRow, EnvironmentRow
from lambent_server.database.schema import (
    artifacts,
    bundle_files,
    bundles,
    environments,
    events,
    idempotency_keys,
    job_labels,
    jobs,
    render_orders,
    shares,
)
from lambent_server.database.tenancy import Tenant, change, remove, rows
from lambent_server.jobs.checkpoints import drop_checkpoints
from lambent_server.jobs.logs import forget as forget_logs
from lambent_server.jobs.queries import require_job
from lambent_server.jobs.rows import FINAL, is_unfinished
from lambent_server.storage.store import discard
from lambent_server.webhooks.rows import forget_job


def delete_job(connection: Connection, tenant: Tenant, job_id: str) -> None:
    """Delete a job that has ended, with its history, artifacts and log; its bundle stays."""
    job = require_job(connection, tenant, job_id, lock=True)
    if job.state not in FINAL or job.handle is not None:
        raise conflict("job_in_use", f"job {job_id} is {job.state}; cancel it and wait until it has ended")
    drop_checkpoints(connection, tenant, job_id)
    for table in (events, artifacts):
        _forget(connection, tenant, table, job_id=job_id)
    forget_logs(connection, tenant, job_id)
    for table in (job_labels, idempotency_keys):
        connection.execute(remove(tenant, table).filter_by(job_id=job_id))
    forget_job(connection, tenant, job_id)
    connection.execute(remove(tenant, jobs).filter_by(id=job_id))
    order_id = job.order_id
    if order_id and connection.execute(rows(tenant, jobs).filter_by(order_id=order_id)).first() is None:
        connection.execute(remove(tenant, idempotency_keys).filter_by(job_id=order_id))
        connection.execute(remove(tenant, render_orders).filter_by(id=order_id))


def delete_bundle(connection: Connection, tenant: Tenant, bundle_id: str) -> None:
    """Delete a bundle with its files and the links to it; the job that made it stays."""
    bundle = require(connection, tenant, BundleRow, "bundle", bundle_id, lock=True)
    _require_unused(connection, tenant, "bundle", bundle_id)
    _forget(connection, tenant, bundle_files, bundle_id=bundle_id)
    connection.execute(remove(tenant, shares).filter_by(bundle_id=bundle_id))
    made_by = change(tenant, jobs).filter_by(id=bundle.job_id, bundle_id=bundle_id)
    connection.execute(made_by.values(bundle_id=None))
    label_rows.forget(connection, tenant, bundle_id)
    provenance.forget(connection, tenant, bundle_id)
    connection.execute(remove(tenant, bundles).filter_by(id=bundle_id))


def delete_environment(connection: Connection, tenant: Tenant, environment_id: str) -> None:
    """Delete an environment; pictures that were rendered with it stay."""
    require(connection, tenant, EnvironmentRow, "environment", environment_id, lock=True)
    _require_unused(connection, tenant, "environment", environment_id)
    _forget(connection, tenant, environments, id=environment_id)
    forget_keys(connection, tenant, environment_id)


def _forget(connection: Connection, tenant: Tenant, table: Table, **having: str) -> None:
    """Delete rows, and release the blobs that they refer to."""
    named = rows(tenant, table, table.c.sha256).filter_by(**having)
    for sha256 in set(connection.execute(named).scalars()) - {""}:
        discard(connection, tenant, sha256)
    connection.execute(remove(tenant, table).filter_by(**having))


def _require_unused(connection: Connection, tenant: Tenant, kind: str, identifier: str) -> None:
    """Refuse to delete what an unfinished job needs."""
    for job_id, needed in _needs(connection, tenant):
        if identifier in needed:
            raise conflict(f"{kind}_in_use", f"job {job_id} needs this {kind}; cancel it first")


def _needs(connection: Connection, tenant: Tenant) -> Iterator[tuple[str, set[str]]]:
    """Yield each unfinished job with what its request refers to."""
    going_on = rows(tenant, jobs, jobs.c.id, jobs.c.params, jobs.c.order_id).where(is_unfinished())
    unfinished = connection.execute(going_on).all()
    ordered = rows(tenant, render_orders, render_orders.c.id, render_orders.c.spec)
    order_ids = {order_id for _, _, order_id in unfinished if order_id is not None}
    named = connection.execute(ordered.where(render_orders.c.id.in_(order_ids)))
    specs = {order.id: order.spec for order in named}
    for job_id, params, order_id in unfinished:
        order = specs.get(order_id, {"assets": (), "environments": ()})
        needed = {asset["bundle_id"] for asset in order["assets"]}
        needed |= {light["environment_id"] for light in order["environments"]}
        yield job_id, needed | {params.get("bundle", ""), params.get("environment", "")}
