"""Signed statements of where bundles are from, and the key that verifies them."""

import json

from fastapi import APIRouter

from lambent_server import provenance
from lambent_server.api.problems import Problem, not_found
from lambent_server.api.resources import ResourceRoute
from lambent_server.bundles.messages import Provenance, ProvenanceKey
from lambent_server.bundles.rows import require_bundle
from lambent_server.http.common import Id, ServicesOf, TenantOf, problems

router = APIRouter(tags=["bundles"], route_class=ResourceRoute)


@router.get("/v1/bundles/{bundle_id:id}/provenance", responses=problems(404))
def get_provenance(services: ServicesOf, tenant: TenantOf, bundle_id: Id) -> Provenance:
    """Return the signed statement of what a bundle was made from, with which code, when and where."""
    with services.database.read() as connection:
        require_bundle(connection, tenant, bundle_id)
        envelope = provenance.find(connection, tenant, bundle_id)
    if envelope is None:
        # It was made by a release that signed nothing.
        raise not_found("provenance", bundle_id)
    return Provenance(**json.loads(envelope))


@router.get("/v1/provenance-key", responses=problems(404))
def get_provenance_key(services: ServicesOf) -> ProvenanceKey:
    """Return the public key of this server, for `lambent verify --key`."""
    signer = services.signer
    if signer is None:
        raise Problem(404, "provenance_key_not_found", "this server signs nothing")
    return ProvenanceKey(keyid=signer.key_id, public_key_pem=signer.public_pem)
