"""Bodies of the REST interface for bundles and the links that share them."""

from typing import Annotated

from lambent_core.pictures import WHOLE
from pydantic import Field

from lambent_server.api.messages import Given, Sha256, Shown, SizeBytes
from lambent_server.api.origins import MAX_COUNT, Origin

MAX_SHARE_S = 366 * 24 * 3600


class Bundle(Shown):
    """A relightable asset that a job has produced."""

    id: str
    job_id: str
    scene_id: str
    scene_name: str
    """Empty if the scene was deleted."""
    created_at: str
    num_files: int
    size_bytes: SizeBytes
    thumbnail_url: str | None
    """A small picture of the object; null if the bundle has none."""
    labels: dict[str, str]
    """At first those of its job."""


class BundleList(Shown):
    """One page of bundles, newest first."""

    items: list[Bundle]
    next_cursor: str | None


class BundleFile(Shown):
    """A file of a bundle."""

    path: str
    sha256: Sha256
    size_bytes: SizeBytes
    media_type: str
    url: str


class BundleDetail(Bundle):
    """A bundle with its files."""

    files: list[BundleFile]


class NewShare(Given):
    """How long a link will work, and whose pages may show the bundle."""

    expires_in_s: Annotated[int, Field(ge=60, le=MAX_SHARE_S), WHOLE] = 7 * 24 * 3600
    frame_ancestors: Annotated[list[Origin], Field(default_factory=list, max_length=MAX_COUNT)]
    """Origins such as https://shop.example; no page may show it if there are none."""


class Share(Shown):
    """A link that gives everyone who has it read access to one bundle."""

    id: str
    bundle_id: str
    url: str
    """Its fragment is the secret; browsers do not send that part to a server."""
    created_at: str
    expires_at: str
    frame_ancestors: list[str]
    """Origins whose pages may show the bundle, in a frame or through the viewer's element."""


class ShareList(Shown):
    """The active links of a bundle, newest first."""

    items: list[Share]
    next_cursor: str | None


class Signature(Shown):
    """A signature of a statement."""

    keyid: str
    """SHA-256 of the 32 bytes of the public key."""
    sig: str
    """Ed25519 signature, base64."""
    public_key: str
    """The 32 bytes of the key, base64: proves no more than that nothing was damaged."""


class Provenance(Shown):
    """A DSSE envelope with an in-toto statement."""

    payloadType: str  # noqa: N815 (as DSSE calls it)
    payload: str
    """The statement, JSON in base64."""
    signatures: list[Signature]


class ProvenanceKey(Shown):
    """The key that verifies what this server signs."""

    keyid: str
    public_key_pem: str
