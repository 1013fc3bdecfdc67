"""One of several processes that put, forget, sweep and read the same few blobs of one database.

`python blob_stress.py DATA DATABASE SEED SECONDS [STORE]` prints how often each happened, and ends with an
error where a row had no bytes.
"""

import hashlib
import json
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.schema import blobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.maintenance.housekeeping import sweep
from lambent_server.running.reconciler import remove_orphan
from lambent_server.services import Services, open_services
from lambent_server.storage.store import discard

CONTENTS = [f"blob {number}".encode() * 50 for number in range(3)]
ENOUGH = 6
"""Removals and finds of one process."""
TENANTS = [Tenant("one"), Tenant("two")]


def sha256(data: bytes) -> str:
    """Return the lower-case hexadecimal SHA-256."""
    return hashlib.sha256(data).hexdigest()


def services_of(data: Path, database: str, store: str | None) -> Services:
    """Return the parts of a server that shares database and store with others."""
    given: dict[str, Any] = {"garbage_after_s": 0.01, "orphan_after_s": 0.01, "disk_floor_bytes": 0}
    (data.parent / "store").mkdir(parents=True, exist_ok=True)
    shared = store or (data.parent / "store").as_uri()
    return open_services(Settings(data=data, database=database, store=shared, local_gpus=0, **given))


def put(services: Services, tenant: Tenant, content: bytes, folder: Path) -> None:
    """Send a blob, as a route does."""
    source = folder / "source"
    source.write_bytes(content)
    services.store.put_file(services.database.write, tenant, source, sha256(content), "text/plain")


def forget(services: Services, tenant: Tenant, content: bytes) -> None:
    """Tell the sweeper that the last reference may be gone."""
    with services.database.write() as connection:
        discard(connection, tenant, sha256(content))


def check(services: Services, tenant: Tenant, content: bytes) -> bool:
    """Return whether the tenant has the blob; AssertionError where its row has no bytes."""
    digest = sha256(content)
    with services.database.write() as connection:
        # While the row is locked no sweep can remove it.
        statement = rows(tenant, blobs).where(blobs.c.sha256 == digest).with_for_update()
        if connection.execute(statement).first() is None:
            return False
        size = services.store.size(digest)
        assert size == len(content), f"a row of {digest} has {size} bytes"
    return True


def main(data: str, database: str, seed: str, seconds: str, store: str | None = None) -> None:
    """Do so for some seconds."""
    services, done = services_of(Path(data), database, store), Counter[str]()
    chance = random.Random(int(seed))  # noqa: S311 (it selects what a test does)
    ends = now() + float(seconds)
    with tempfile.TemporaryDirectory() as name:
        # On a busy machine it takes longer until enough has happened.
        while now() < ends or min(done["removed"], done["found"]) < ENOUGH:
            tenant, content = chance.choice(TENANTS), chance.choice(CONTENTS)
            what = chance.choices(["put", "forget", "sweep", "check", "orphans"], [6, 6, 4, 6, 2])[0]
            done[what] += 1
            if what == "put":
                put(services, tenant, content, Path(name))
            elif what == "forget":
                forget(services, tenant, content)
            elif what == "sweep":
                done["removed"] += sweep(services)
            elif what == "orphans":
                done["removed"] += remove_orphan(services, sha256(content), now() - 0.01)
            else:
                done["found"] += check(services, tenant, content)
            time.sleep(chance.choice([0, 0, 0.002]))
    services.database.close()
    print(json.dumps(done))


if __name__ == "__main__":
    main(*sys.argv[1:])
