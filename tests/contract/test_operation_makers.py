"""Of every operation that writes it is known with whom what it makes ends; new ones fail here."""

from lambent_server.app import describe

DATA = "belongs to the organisation, and gives nobody access"
ENDS = {
    "POST /v1/login": "with the maker of its link, and with the session in which that was made",
    "POST /v1/login-links": "as the session that it opens",
    "POST /v1/me:switch": "with the sign-in that it continues from",
    "POST /v1/keys": "with the key that made it",
    "POST /v1/keys/{key_id}:rotate": "as the key that it replaces",
    "POST /v1/bundles/{bundle_id}/shares": "with its maker",
    "POST /v1/webhooks": "with its maker",
    "PATCH /v1/webhooks/{webhook_id}": "with whoever chose its address or enabled it",
    "POST /v1/webhooks/{webhook_id}:rotate": "with the subscription",
    "POST /v1/webhooks/{webhook_id}:ping": "with the subscription",
    "POST /v1/webhook-secret:rotate": "is the organisation's, for it signs and opens nothing",
    "POST /v1/deliveries/{delivery_id}:redeliver": "with the subscription, or the maker of the job",
    "POST /v1/jobs": "its webhook with its maker",
    "POST /v1/jobs/{job_id}:retry": "its webhook with the maker of the first job",
    "POST /v1/logout": "makes nothing",
    "POST /v1/estimates": "makes nothing",
    "POST /v1/jobs/{job_id}:cancel": "makes nothing",
    "POST /v1/batches/{batch_id}:cancel": "makes nothing",
    "PATCH /v1/jobs/{job_id}": DATA,
    "POST /v1/batches/{batch_id}:retry": DATA,
    "POST /v1/renders": DATA,
    "POST /v1/batches": DATA,
    "POST /v1/environments": DATA,
    "PATCH /v1/bundles/{bundle_id}": DATA,
    "POST /v1/scenes": DATA,
    "PATCH /v1/scenes/{scene_id}": DATA,
    "POST /v1/scenes/{scene_id}:commit": DATA,
    "POST /v1/scenes/{scene_id}/files:plan": DATA,
    "PUT /v1/scenes/{scene_id}/files/{sha256}": DATA,
    "PUT /v1/scenes/{scene_id}/archive": DATA,
    "POST /v1/scenes/{scene_id}/files:uploads": "addresses of the store, which end within minutes",
    "POST /v1/scenes/{scene_id}/files:complete": DATA,
}
"""Of every operation that writes: with whom what it makes ends."""


def test_of_every_operation_that_makes_something_it_is_known_with_whom_that_ends():
    writing = {
        f"{method.upper()} {path}"
        for path, operations in describe()["paths"].items()
        for method in operations
        if method in ("post", "put", "patch")
    }
    assert writing == set(ENDS)
