"""OpenStack Swift with its S3 interface as one process: a real S3 server that comes as a package.

`python swift_s3.py FOLDER PORT` serves until it is killed; what it has stored is there again at the next
start. It checks signatures, their expiry, checksums and lengths as S3 does.
"""

import socket
import sys
from pathlib import Path
from typing import Any

import eventlet

eventlet.monkey_patch()

from eventlet import wsgi  # noqa: E402
from paste.deploy import loadapp  # noqa: E402
from swift.common.ring import RingBuilder  # noqa: E402
from swift.common.utils import NullLogger, set_swift_dir, validate_hash_conf  # noqa: E402

ACCESS_KEY = "test:tester"
SECRET_KEY = "testing"

_SWIFT = """
[swift-hash]
swift_hash_path_suffix = of_the_tests

[storage-policy:0]
name = one
default = yes
"""
_BACKEND = """
[DEFAULT]
devices = {folder}/devices
mount_check = false
swift_dir = {folder}
disable_fallocate = true
log_level = ERROR

[pipeline:main]
pipeline = {kind}-server

[app:{kind}-server]
use = egg:swift#{kind}
allow_versions = true
"""
_PROXY = """
[DEFAULT]
swift_dir = {folder}
log_level = ERROR

[pipeline:main]
pipeline = catch_errors gatekeeper cache listing_formats s3api tempauth copy bulk slo dlo proxy-server

[app:proxy-server]
use = egg:swift#proxy
account_autocreate = true
node_timeout = 10

[filter:catch_errors]
use = egg:swift#catch_errors
[filter:gatekeeper]
use = egg:swift#gatekeeper
[filter:cache]
use = egg:swift#memcache
memcache_servers = 127.0.0.1:1
[filter:listing_formats]
use = egg:swift#listing_formats
[filter:s3api]
use = egg:swift#s3api
location = us-east-1
cors_preflight_allow_origin = *
[filter:tempauth]
use = egg:swift#tempauth
user_test_tester = testing .admin
user_test_reader = reading
[filter:copy]
use = egg:swift#copy
[filter:bulk]
use = egg:swift#bulk
[filter:slo]
use = egg:swift#slo
[filter:dlo]
use = egg:swift#dlo
"""
_KINDS = ("account", "container", "object")


def _listen(port: int = 0) -> Any:
    listener = eventlet.listen(("127.0.0.1", port), backlog=256)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


def _write_ring(folder: Path, kind: str, port: int) -> None:
    builder = RingBuilder(part_power=1, replicas=1, min_part_hours=0)
    device = {"region": 0, "zone": 0, "ip": "127.0.0.1", "port": port, "device": "disk", "weight": 1.0}
    builder.add_dev({"id": 0, **device})
    builder.rebalance()
    builder.get_ring().save(str(folder / f"{kind}.ring.gz"))


def main(folder: Path, port: int) -> None:
    """Serve."""
    (folder / "devices" / "disk").mkdir(parents=True, exist_ok=True)
    (folder / "swift.conf").write_text(_SWIFT)
    set_swift_dir(str(folder))
    validate_hash_conf()
    backends = {kind: _listen() for kind in _KINDS}
    for kind, listener in backends.items():
        _write_ring(folder, kind, listener.getsockname()[1])
        (folder / f"{kind}.conf").write_text(_BACKEND.format(folder=folder, kind=kind))
    (folder / "proxy.conf").write_text(_PROXY.format(folder=folder))
    for kind, listener in backends.items():
        app = loadapp(f"config:{folder / f'{kind}.conf'}")
        eventlet.spawn(wsgi.server, listener, app, NullLogger())
    proxy = loadapp(f"config:{folder / 'proxy.conf'}")
    listener = _listen(port)
    print(listener.getsockname()[1], flush=True)
    wsgi.server(listener, proxy, NullLogger(), keepalive=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
