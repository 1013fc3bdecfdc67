"""The limits of each run, and the network address of the worker service."""

import contextlib
import ssl
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import pytest
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc
from lambent_server.cluster.certificates import Certificate, Renewals, certificate_for, issue, make_authority
from lambent_server.core.settings import ServeError, Settings
from lambent_server.database.engine import Database
from lambent_server.serving import free_port
from lambent_server.workers import gate as worker_gate
from lambent_server.workers.gate import Shares
from lambent_server.workers.link import network_address
from lambent_server.workers.service import Listening, listen, serve_workers
from pydantic import ValidationError
from support.live_server import wait_until
from support.runs import SECRET, metadata, refused, staged


def test_a_run_has_its_share_of_calls_and_leaves_that_of_others(monkeypatch: pytest.MonkeyPatch):
    at = [100.0]
    monkeypatch.setattr(worker_gate.time, "monotonic", lambda: at[0])
    shares = Shares(calls=2, calls_per_s=1.0, streams=3)
    assert [shares.enter("a", stream=False) for _ in range(3)] == ["", "", "calls"]
    assert shares.enter("b", stream=False) == ""
    shares.leave("a", stream=False)
    assert shares.enter("a", stream=False) == ""
    shares.leave("a", stream=False)
    assert shares.enter("a", stream=False) == ""
    shares.leave("a", stream=False)
    # Four at once, then one per second.
    assert shares.enter("a", stream=False) == "rate"
    at[0] += 1.0
    assert [shares.enter("a", stream=False), shares.enter("a", stream=False)] == ["", "rate"]


def test_transfers_never_take_all_threads():
    shares = Shares(calls=100, calls_per_s=100.0, streams=3)
    assert [shares.enter(run, stream=True) for run in "abcd"] == ["", "", "", "streams"]
    assert shares.enter("d", stream=False) == ""
    shares.leave("a", stream=True)
    assert shares.enter("d", stream=True) == ""


def test_runs_that_ended_are_forgotten(monkeypatch: pytest.MonkeyPatch):
    at = [0.0]
    monkeypatch.setattr(worker_gate.time, "monotonic", lambda: at[0])
    shares = Shares(calls=1, calls_per_s=1.0)
    assert shares.enter("stays", stream=False) == ""
    for number in range(1001):
        at[0] += 1.0
        shares.enter(f"run {number}", stream=False)
        shares.leave(f"run {number}", stream=False)
    shares.enter("the last", stream=False)
    assert len(shares._uses) < 100
    assert "stays" in shares._uses


def test_calls_beyond_the_share_are_refused_and_count_for_nobody_else(tmp_path: Path):
    with staged(tmp_path, worker_calls_per_s=1.0, local_slots=2) as stage:
        scene = stage.api.scene()
        first, second = stage.start(scene_id=scene), stage.start(scene_id=scene)
        with refused(grpc.StatusCode.RESOURCE_EXHAUSTED):
            for _ in range(10):
                stage.call("Heartbeat", first)
        assert not stage.call("Heartbeat", second).stop


def test_a_transfer_that_was_broken_off_gives_its_place_back(tmp_path: Path):
    with staged(tmp_path, worker_calls=1) as stage:
        job = stage.start()
        digest = stage.put(job, bytes(5_000_000))

        def beats() -> bool:
            with contextlib.suppress(grpc.RpcError):
                return stage.call("Heartbeat", job) is not None
            return False

        for _ in range(5):
            request = worker_pb2.GetBlobRequest(fence={"job_id": job, "run": 1}, sha256=digest)
            pieces = stage.stub.GetBlob(request, metadata=metadata(job, 1, None), timeout=5)
            next(pieces)
            assert not beats()
            pieces.cancel()
            wait_until(beats, timeout_s=10)


def test_the_service_answers_on_the_network_by_tls_and_asks_for_the_token_there_too(tmp_path: Path):
    with staged(tmp_path) as stage:
        job = stage.start()
        settings = stage.api.services.settings
        certificate = certificate_for(stage.api.services.database, settings)
        address = f"127.0.0.1:{free_port('127.0.0.1')}"
        server = serve_workers(
            stage.api.services,
            SECRET,
            f"unix:{tmp_path}/second.sock",
            network=Listening(address=address, certificate=certificate),
            servers=lambda host: (f"tls:{host}:1",),
        )
        credentials = grpc.ssl_channel_credentials(certificate.authority.encode())
        options = [("grpc.ssl_target_name_override", certificate.name)]
        with grpc.secure_channel(address, credentials, options=options) as channel:
            stub = worker_pb2_grpc.WorkerServiceStub(channel)
            request = worker_pb2.HeartbeatRequest(fence={"job_id": job, "run": 1})
            answer = stub.Heartbeat(request, metadata=metadata(job, 1, None), timeout=5)
            assert list(answer.servers) == ["tls:here:1"]
            with refused(grpc.StatusCode.UNAUTHENTICATED):
                stub.Heartbeat(request, metadata=metadata(job, 1, "x"), timeout=5)
        with grpc.insecure_channel(address) as channel, refused(grpc.StatusCode.UNAVAILABLE):
            request = worker_pb2.HeartbeatRequest(fence={"job_id": job, "run": 1})
            worker_pb2_grpc.WorkerServiceStub(channel).Heartbeat(request, timeout=5)
        server.stop(0).wait()
        kept = settings.data / "worker.authority"
        assert kept.stat().st_mode & 0o777 == 0o600
        assert certificate_for(stage.api.services.database, settings).authority == certificate.authority


@pytest.mark.parametrize("broken", ["worker_certificate", "worker_key", "worker_authority"])
@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_a_certificate_that_cannot_be_used_is_named(tmp_path: Path, broken: str, how: str):
    given = issue(make_authority())
    authority = given.authority.encode()
    files = {"worker_certificate": given.chain, "worker_key": given.key, "worker_authority": authority}
    paths = {name: tmp_path / f"{name}.pem" for name in files}
    for name, path in paths.items():
        path.write_bytes(files[name])
    settings, database = Settings(data=tmp_path, **paths), Database("sqlite://")
    assert certificate_for(database, settings).chain == given.chain
    paths[broken].unlink() if how == "missing" else paths[broken].write_bytes(b"\xffnot PEM")
    with pytest.raises(ServeError, match=rf"worker_certificate_invalid: .*{broken}\.pem cannot be used"):
        certificate_for(database, settings)


def test_a_key_of_another_certificate_is_named(tmp_path: Path):
    authority = make_authority()
    (tmp_path / "chain.pem").write_bytes(issue(authority).chain)
    (tmp_path / "key.pem").write_bytes(issue(authority).key)
    given = {"worker_certificate": tmp_path / "chain.pem", "worker_key": tmp_path / "key.pem"}
    with pytest.raises(ServeError, match=r"worker_certificate_invalid: .*key\.pem is not the key of"):
        certificate_for(Database("sqlite://"), Settings(data=tmp_path, **given))


def shown(address: str) -> str:
    """Return the certificate (PEM) that a server shows to a new connection."""
    host, _, port = address.rpartition(":")
    return ssl.get_server_certificate((host, int(port)), timeout=10)


def test_a_renewed_certificate_is_shown_without_a_restart(tmp_path: Path):
    chain, key = tmp_path / "chain.pem", tmp_path / "key.pem"
    first, second = issue(make_authority()), issue(make_authority())
    chain.write_bytes(first.chain)
    key.write_bytes(first.key)
    address = f"127.0.0.1:{free_port('127.0.0.1')}"
    settings = Settings(data=tmp_path, worker_certificate=chain, worker_key=key)
    renewed, certificate = Renewals(settings), certificate_for(Database("sqlite://"), settings)
    server = grpc.server(ThreadPoolExecutor(2))
    listen(server, Listening(address=address, certificate=certificate, renewed=renewed))
    server.start()
    try:
        assert shown(address) == first.chain.decode()
        with channel_to(address, first) as before:
            grpc.channel_ready_future(before).result(timeout=10)
            chain.write_bytes(second.chain)
            assert shown(address) == first.chain.decode(), "its key is not there yet"
            key.write_bytes(second.key)
            assert shown(address) == second.chain.decode()
            with channel_to(address, second) as after:
                grpc.channel_ready_future(after).result(timeout=10)
            with pytest.raises(grpc.RpcError) as answer:
                before.unary_unary("/nothing")(b"", timeout=10)
            assert answer.value.code() is grpc.StatusCode.UNIMPLEMENTED, "its connection is still open"
        for path in (chain, key):
            path.unlink()
        assert shown(address) == second.chain.decode(), "nothing better is there"
    finally:
        server.stop(0).wait()


def channel_to(address: str, certificate: Certificate) -> grpc.Channel:
    credentials = grpc.ssl_channel_credentials(certificate.authority.encode())
    options = [("grpc.ssl_target_name_override", certificate.name)]
    return grpc.secure_channel(address, credentials, options=options)


def test_an_address_that_others_cannot_use_is_refused(tmp_path: Path):
    with pytest.raises(ServeError, match="worker_address_unspecific"):
        network_address(Settings(data=tmp_path, worker_address="0.0.0.0:8421"))
    given = {"worker_address": "0.0.0.0:8421", "worker_public_address": "render-1:8421"}
    assert network_address(Settings(data=tmp_path, **given)) == "tls:render-1:8421"
    assert network_address(Settings(data=tmp_path, worker_address="[fd00::7]:84")) == "tls:[fd00::7]:84"
    plain = Settings(data=tmp_path, worker_address="10.0.0.7:84", worker_plain=True)
    assert network_address(plain) == "tcp:10.0.0.7:84"
    for wrong in ("10.0.0.7", "http://x:1", "10.0.0.7:0", "a b:1"):
        with pytest.raises(ValidationError, match="not a host with a port"):
            Settings(data=tmp_path, worker_address=wrong)
