"""The scope that each route needs; the application does not start with a route that is not in this table."""

from collections.abc import Iterable
from typing import Any

from fastapi import APIRouter, Request

from lambent_server.accounts.scopes import ADMIN, READ, RENDER, SUBMIT, ScopeName
from lambent_server.accounts.who import Who
from lambent_server.api.problems import Problem

# By the name of the route's function, which is its operation in the description. None: no key or session is
# needed (`request.PUBLIC` has their paths).
SCOPES: dict[str, ScopeName | None] = {
    # What the server says about itself
    "get_version": None,
    "get_provenance_key": None,
    "get_health": None,
    "get_readiness": None,
    "describe": None,
    "get_limits": READ,
    "list_presets": READ,
    "get_notices": READ,
    "get_metrics": READ,
    # Pages
    "get_start": None,
    "get_page": None,
    "get_embed_page": None,
    "get_embed_picture": None,
    # Signing in and out
    "log_in": None,
    "begin_sign_in": None,
    "end_sign_in": None,
    "log_out": READ,
    "create_login_link": ADMIN,
    "get_me": READ,
    "switch_organisation": READ,
    # Scenes
    "list_scenes": READ,
    "get_scene": READ,
    "get_scene_report": READ,
    "create_scene": SUBMIT,
    "plan_files": SUBMIT,
    "put_file": SUBMIT,
    "offer_uploads": SUBMIT,
    "complete_uploads": SUBMIT,
    "put_archive": SUBMIT,
    "commit_scene": SUBMIT,
    "change_scene": SUBMIT,
    "delete_scene": SUBMIT,
    # Jobs
    "list_jobs": READ,
    "get_job": READ,
    "list_events": READ,
    "stream_events": READ,
    "get_log": READ,
    "list_artifacts": READ,
    "estimate_job": READ,
    "submit_job": SUBMIT,
    "change_job": SUBMIT,
    "cancel_job": SUBMIT,
    "retry_job": SUBMIT,
    "delete_job": SUBMIT,
    # Bundles and files
    "list_bundles": READ,
    "get_bundle": READ,
    "get_provenance": READ,
    "get_manifest": READ,
    "get_bundle_file": READ,
    "get_bundle_archive": READ,
    "get_blob": READ,
    "list_shares": READ,
    "change_bundle": SUBMIT,
    "delete_bundle": SUBMIT,
    "create_share": SUBMIT,
    "revoke_share": SUBMIT,
    # Pictures
    "list_environments": READ,
    "get_environment": READ,
    "list_batches": READ,
    "get_batch": READ,
    "list_batch_artifacts": READ,
    "create_environment": RENDER,
    "delete_environment": RENDER,
    "submit_render": RENDER,
    "submit_batch": RENDER,
    "cancel_batch": RENDER,
    "retry_batch": RENDER,
    # Administration: addresses of webhooks may be secrets, too
    "create_key": ADMIN,
    "list_keys": ADMIN,
    "revoke_key": ADMIN,
    "rotate_key": ADMIN,
    "create_webhook": ADMIN,
    "list_webhooks": ADMIN,
    "get_webhook": ADMIN,
    "change_webhook": ADMIN,
    "delete_webhook": ADMIN,
    "rotate_webhook": ADMIN,
    "ping_webhook": ADMIN,
    "get_webhook_secret": ADMIN,
    "rotate_webhook_secret": ADMIN,
    "list_deliveries": ADMIN,
    "get_delivery": ADMIN,
    "redeliver": ADMIN,
    "list_audit_entries": ADMIN,
}


async def check_scope(request: Request) -> None:
    """Refuse a request whose key or session lacks the scope of its route."""
    needed = SCOPES[request.scope["route"].name]
    if needed is None:
        return
    who: Who = request.state.who
    if needed not in who.scopes:
        raise missing(needed, who)


def missing(needed: ScopeName, who: Who) -> Problem:
    """Return the problem of a client without a scope."""
    given = ", ".join(sorted(who.scopes)) or "none"
    return Problem(
        403,
        "scope_missing",
        f"this needs the scope {needed!r}, and this {who.kind} has {given}; "
        f"{'ask an admin for the role' if who.kind == 'user' else 'ask an admin for a key'} with it",
        members={"scope": needed},
    )


def require_complete(routers: Iterable[APIRouter]) -> None:
    """Raise LookupError for a route that declares no scope."""
    names = {str(getattr(route, "name", route)) for router in routers for route in router.routes}
    if names - set(SCOPES):
        raise LookupError(f"SCOPES in {__name__} has no scope for {', '.join(sorted(names - set(SCOPES)))}")


def describe_scope(operation: dict[str, Any]) -> None:
    """Add to the description of an operation which scope it needs."""
    scope = SCOPES[operation["operationId"]]
    if scope is None:
        return
    # OpenAPI 3.1 lets every scheme name what is required here, not only OAuth.
    operation["security"] = [{"key": [scope]}, {"session": [scope]}]
    text = operation.get("description", "").rstrip()
    operation["description"] = f"{text}\n\nNeeds the scope `{scope}`.".strip()
