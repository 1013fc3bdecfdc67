"""Bits that flip in the store of a running server, and what must come of it."""

import contextlib
import hashlib
import os
import random
import time
from pathlib import Path
from typing import Any

import httpx2
import obstore
from lambent_server.storage.store import BlobStore
from sqlalchemy import create_engine, text
from support.live_server import LiveServer, wait_until
from support.s3_server import S3Server


class FlippedBits:
    """Damages files of a server in ways that cost nothing but time, and checks that none is served."""

    server: LiveServer
    database: str
    store: BlobStore
    s3: S3Server | None
    folder: Path
    spare: bytes
    choice: random.Random

    def _named(self, query: str) -> list[str]:
        engine = create_engine(self.database)
        with engine.connect() as connection:
            found = sorted(connection.execute(text(query)).scalars())
        engine.dispose()
        return found

    def flip(self, sha256: str, *, quietly: bool = False) -> bytes | None:
        """Change one bit of a blob and return the bytes before; None if it is gone by now."""
        key = BlobStore.key(sha256)
        try:
            whole = bytes(obstore.get(self.store._store, key).bytes())
        except FileNotFoundError:
            return None
        if not whole:
            return None
        data = bytearray(whole)
        data[self.choice.randrange(len(data))] ^= 1 << self.choice.randrange(8)
        if self.s3 is not None:
            obstore.put(self.store._store, key, bytes(data))
            return whole
        path = self.folder / key
        with contextlib.suppress(FileNotFoundError):
            before = path.stat()
            with path.open("r+b") as file:
                file.write(data)
            if quietly:
                os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        return whole

    def never_served(self, sha256: str, whole: bytes) -> None:
        """Read a blob that was damaged: it is refused, gone or whole again, but never wrong."""
        for _ in range(50):
            with contextlib.suppress(httpx2.HTTPError):
                answer = self.server.client.get(f"/v1/blobs/{sha256}")
                assert answer.status_code in (200, 404, 410, 500, 503), answer.text
                assert answer.status_code != 200 or answer.content == whole, f"{sha256} has wrong bytes"
                if answer.status_code in (200, 404, 410):
                    return
            time.sleep(0.2)
        raise AssertionError(f"{sha256} is not answered")

    def flip_checkpoint(self) -> None:
        """Damage a checkpoint of an unfinished job, whose next run has to do without it."""
        found = self._named("SELECT sha256 FROM checkpoint_files")
        if found:
            sha256 = self.choice.choice(found)
            whole = self.flip(sha256)
            if whole is not None:
                self.never_served(sha256, whole)

    def flip_capture(self) -> None:
        """Damage a capture, which the same upload repairs."""
        sha256 = hashlib.sha256(self.spare).hexdigest()
        if self.flip(sha256) is not None:
            self.never_served(sha256, self.spare)
        self.push_spare()

    def push_spare(self) -> None:
        """Upload a capture that no job uses, as often as it takes."""
        sha256 = hashlib.sha256(self.spare).hexdigest()
        plan = [{"path": "spare.png", "size": len(self.spare), "sha256": sha256}]
        wait_until(lambda: self._pushed(plan, sha256), timeout_s=60.0)
        self.never_served(sha256, self.spare)

    def _pushed(self, plan: list[dict[str, Any]], sha256: str) -> bool:
        client = self.server.client
        try:
            scene = client.post("/v1/scenes", json={"name": "spare"}).raise_for_status().json()["id"]
            missing = client.post(f"/v1/scenes/{scene}/files:plan", json=plan).raise_for_status().json()
            for each in missing["missing"]:
                client.put(f"/v1/scenes/{scene}/files/{each}", content=self.spare).raise_for_status()
            client.post(f"/v1/scenes/{scene}:commit").raise_for_status()
            answer = client.get(f"/v1/blobs/{sha256}").raise_for_status()
        except httpx2.HTTPError:
            return False
        return answer.content == self.spare

    def flip_between(self) -> None:
        """Damage a file of a bundle as a disk does, which tells nobody, and bring it back from a back-up."""
        found = self._named("SELECT DISTINCT sha256 FROM bundle_files")
        self.server.kill()
        sha256 = self.choice.choice(found) if found else ""
        whole = self.flip(sha256, quietly=True) if found else None
        self.server.start()
        if whole is not None:
            self.never_served(sha256, whole)
            obstore.put(self.store._store, BlobStore.key(sha256), whole)
            self.never_served(sha256, whole)
