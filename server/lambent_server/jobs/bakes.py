"""Jobs of kind `bake`: the bundle and the environment that they refer to."""

from sqlalchemy import Connection

from lambent_server.api.messages import NewJob
from lambent_server.api.problems import invalid
from lambent_server.database.model import BundleRow, EnvironmentRow
from lambent_server.database.tenancy import Tenant, find

KIND = "bake"
NEEDED = ("bundle", "environment")
OPTIONAL = ("name", "rotate_deg", "albedo_ratio", "steps")


def check_order(connection: Connection, tenant: Tenant, order: NewJob) -> None:
    """Refuse a request whose `params` do not name a bundle of its scene and an environment, or name more."""
    unknown = sorted(set(order.params) - {*NEEDED, *OPTIONAL})
    if unknown:
        known = ", ".join((*NEEDED, *OPTIONAL))
        raise invalid("bake_setting_unknown", f"#/params/{unknown[0]}", f"a bake knows {known}")
    for name in NEEDED:
        if not order.params.get(name):
            raise invalid("bake_input_missing", f"#/params/{name}", f"a bake needs the id of its {name}")
    bundle = find(connection, tenant, BundleRow, order.params["bundle"])
    if bundle is None or bundle.scene_id != order.scene_id:
        message = f"scene {order.scene_id} has no bundle {order.params['bundle']!r}"
        raise invalid("bundle_not_found", "#/params/bundle", message)
    if find(connection, tenant, EnvironmentRow, order.params["environment"]) is None:
        message = f"there is no environment {order.params['environment']!r}"
        raise invalid("environment_not_found", "#/params/environment", message)
