"""The client against the real server over HTTP; a trainer that only sleeps stands in for the method."""

import hashlib
import json
import threading
import zipfile

import pytest
from lambent import Client, Event, Job, RefusedError
from lambent.scenes import content_sha256, list_files
from support.live_server import LiveServer, wait_until
from support.tcp_proxy import TcpProxy

pytestmark = pytest.mark.slow

LONG = {"num_steps": "10000", "step_s": "0.05"}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Return a server whose jobs sleep; one test kills and restarts it."""
    with LiveServer(tmp_path_factory.mktemp("server") / "data") as server:
        yield server


@pytest.fixture
def proxy(server):
    """Return a forwarder to the server that can be cut."""
    proxy = TcpProxy(server.url)
    yield proxy
    proxy.close()


@pytest.fixture
def client(server):
    """Return a client of the server."""
    with Client(server.url, server.key) as client:
        yield client


@pytest.fixture
def scene_folder(tmp_path):
    """Return a folder with pictures, a file of poses, and one file that has no place in a scene."""
    folder = tmp_path / "cup"
    (folder / "train").mkdir(parents=True)
    (folder / "transforms_train.json").write_text("{}")
    (folder / "train" / "r_000.png").write_bytes(b"first")
    (folder / "train" / "r_001.png").write_bytes(b"second")
    (folder / "run.exe").write_bytes(b"MZ")
    return folder


@pytest.fixture
def scene(client, scene_folder):
    """Return a committed scene."""
    return client.push(scene_folder)


def test_a_pushed_scene_is_committed_and_names_what_was_left_out(client, scene_folder):
    scene = client.push(scene_folder, name="a cup")
    assert scene.state == "uploaded"
    assert scene.name == "a cup"
    assert scene.num_files == 3
    assert scene.left_out == ("run.exe",)


def test_equal_content_has_an_equal_hash_and_is_sent_once(client, scene_folder):
    first = client.push(scene_folder)
    uploads = []
    second = client.push(scene_folder, progress=lambda what, done, total: uploads.append((what, total)))
    assert second.id != first.id
    assert second.content_sha256 == first.content_sha256
    assert [total for what, total in uploads if what == "upload"] == [0]


def test_an_archive_becomes_a_scene(client, scene_folder, tmp_path):
    archive = tmp_path / "cup.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for path in scene_folder.rglob("*.*"):
            file.write(path, path.relative_to(scene_folder))
    assert client.push(archive).num_files == 3


def test_an_archive_that_climbs_out_is_refused_with_its_code(client, tmp_path):
    archive = tmp_path / "bad.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("../evil.png", b"x")
    with pytest.raises(RefusedError) as caught:
        client.push(archive)
    assert caught.value.code == "archive_unsafe"


def test_a_wrong_field_is_pointed_at(client, scene):
    with pytest.raises(RefusedError) as caught:
        client.submit(scene.id, labels={"a": "b" * 10_000})
    assert caught.value.status == 422
    assert any("labels" in error.pointer for error in caught.value.errors)
    assert caught.value.request_id


@pytest.mark.parametrize("call", ["job", "scene", "cancel", "retry", "logs", "artifacts", "fetch"])
def test_what_is_not_there_is_refused(client, call, tmp_path):
    more = (tmp_path / "out",) if call == "fetch" else ()
    with pytest.raises(RefusedError) as caught:
        getattr(client, call)("job_nothing", *more)
    assert caught.value.status == 404


def test_a_wrong_key_is_refused_with_advice(server):
    with Client(server.url, "lk_wrong") as client:
        with pytest.raises(RefusedError) as caught:
            list(client.jobs())
        assert caught.value.status == 401
        assert "LAMBENT_API_KEY" in caught.value.advice


def test_the_same_idempotency_key_is_the_same_job(client, scene):
    first = client.submit(scene.id, params=LONG, preset="tiny", idempotency_key="once")
    assert client.submit(scene.id, params=LONG, preset="tiny", idempotency_key="once").id == first.id
    client.cancel(first.id)


def test_jobs_are_found_by_label_over_pages(client, scene):
    ids = [client.submit(scene.id, preset="tiny", params=LONG, labels={"set": "pages"}).id for _ in range(3)]
    assert [job.id for job in client.jobs(label="set=pages")] == ids[::-1]
    assert [job.id for job in client.jobs(label="set=pages", limit=1)] == ids[-1:]
    for job_id in ids:
        client.cancel(job_id)


def test_a_job_is_watched_from_queue_to_bundle(client, scene):
    job = client.submit(scene.id, preset="tiny", params={"num_steps": "10"})
    updates = list(client.watch([job.id]))
    events = [update for update in updates if isinstance(update, Event)]
    assert [event.seq for event in events] == sorted({event.seq for event in events})
    assert any(event.type == "progress" and event.progress.psnr > 0 for event in events)
    final = updates[-1]
    assert isinstance(final, Job)
    assert final.state == "succeeded"
    assert final.bundle_id


def test_a_cancelled_job_is_watched_to_its_end_and_can_be_retried(client, scene):
    job = client.submit(scene.id, preset="tiny", params=LONG, seed=7, labels={"a": "b"})
    updates = []
    for update in client.watch([job.id]):
        updates.append(update)
        if isinstance(update, Event) and update.type == "progress" and update.progress.step > 2:
            client.cancel(job.id)
    states = [update.state for update in updates if isinstance(update, Event) and update.type == "state"]
    assert states[-2:] == ["cancelling", "cancelled"]
    assert updates[-1].state == "cancelled"
    again = client.retry(job.id)
    assert again.id != job.id
    assert (again.seed, again.labels) == (7, {"a": "b"})
    client.cancel(again.id)


@pytest.fixture(scope="module")
def finished(server, tmp_path_factory):
    """Return a job as `wait` returned it."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "transforms_train.json").write_text("{}")
    with Client(server.url, server.key) as client:
        yield client.wait(client.submit(client.push(folder).id, preset="tiny", params={"num_steps": "3"}).id)


def test_waiting_returns_the_ended_job(finished):
    assert finished.state == "succeeded"


def test_a_log_is_text_with_a_part_for_every_run(client, finished):
    assert "== run 1 ==" in client.logs(finished.id)


def test_the_history_can_be_read_from_any_place(client, finished):
    whole = [event.seq for event in client.events(finished.id)]
    assert len(whole) > 1
    assert [event.seq for event in client.events(finished.id, after=whole[0])] == whole[1:]


def test_a_cut_connection_loses_and_doubles_no_event(server, proxy, client, scene, tmp_path):
    end = tmp_path / "end"
    job = client.submit(scene.id, preset="tiny", params={**LONG, "until": str(end)})
    seen, cuts = [], 0
    with Client(proxy.url, server.key) as watching:
        for update in watching.watch([job.id], after={job.id: 0}):
            if isinstance(update, Event):
                seen.append(update.seq)
                if len(seen) % 3 == 0 and cuts < 3:
                    cuts += proxy.cut()
                elif cuts >= 3:
                    end.touch()
    assert update.state == "succeeded"
    # Progress events are thinned with age, so only what is still there must have been seen.
    kept = {event.seq for event in client.events(job.id)}
    assert kept <= set(seen)
    assert seen == sorted(set(seen))


def test_watching_survives_kill_9_of_the_server(server, proxy, client, scene, tmp_path):
    end = tmp_path / "end"
    job = client.submit(scene.id, preset="tiny", params={**LONG, "until": str(end)})

    def restart():
        server.kill()
        proxy.cut()
        server.start()
        proxy.point_at(server.url)
        end.touch()

    seen, worker = [], None
    with Client(proxy.url, server.key) as watching:
        for update in watching.watch([job.id], after={job.id: 0}):
            if isinstance(update, Event):
                seen.append(update.seq)
                if update.progress.step > 3 and worker is None:
                    worker = threading.Thread(target=restart)
                    worker.start()
        worker.join()
        assert update.state == "succeeded"
        assert update.run == 1, "the run was adopted, not repeated"
        assert {event.seq for event in watching.events(job.id)} <= set(seen)
    assert seen == sorted(set(seen))


def test_a_bundle_is_fetched_whole_and_resumed_after_a_cut(client, finished, tmp_path):
    job = finished
    fetched = client.fetch(job.id, tmp_path / "whole")
    assert fetched.bundle_id == job.bundle_id
    for entry in fetched.files:
        assert hashlib.sha256((fetched.path / entry.path).read_bytes()).hexdigest() == entry.sha256
    largest = max(fetched.files, key=lambda entry: entry.size_bytes)
    half = tmp_path / "resumed.partial" / largest.path
    half.parent.mkdir(parents=True)
    half.write_bytes((fetched.path / largest.path).read_bytes()[: largest.size_bytes // 2])
    client.fetch(job.bundle_id, tmp_path / "resumed")
    whole = {p.relative_to(fetched.path): p.read_bytes() for p in fetched.path.rglob("*") if p.is_file()}
    again = tmp_path / "resumed"
    assert {p.relative_to(again): p.read_bytes() for p in again.rglob("*") if p.is_file()} == whole
    assert json.loads((again / "manifest.json").read_bytes())["files"]


def test_a_compressed_bundle_is_fetched_whole_and_resumed_with_its_own_bytes(
    server, client, finished, tmp_path
):
    url = f"/v1/bundles/{finished.bundle_id}/files/models/weights.bin"
    answer = wait_until(
        lambda: (answer := server.client.get(url)).headers.get("content-encoding") == "gzip" and answer
    )
    assert int(answer.headers["content-length"]) < len(answer.content) / 2
    head = server.client.head(url)
    for name in ("content-length", "content-encoding", "etag"):
        assert head.headers[name] == answer.headers[name]
    fetched = client.fetch(finished.id, tmp_path / "whole")
    weights = (fetched.path / "models" / "weights.bin").read_bytes()
    assert weights == answer.content
    half = tmp_path / "resumed.partial" / "models" / "weights.bin"
    half.parent.mkdir(parents=True)
    half.write_bytes(weights[:5000])
    assert client.fetch(finished.id, tmp_path / "resumed").files == fetched.files


def test_a_login_link_leads_to_the_server_with_a_code(client):
    assert client.login_link().startswith(f"{client.address.url}/#code=")


def test_the_content_hash_of_a_folder_names_what_is_in_it(scene_folder):
    entries = list_files(scene_folder)
    assert len(entries) == 4
    assert content_sha256(entries) == content_sha256(tuple(reversed(entries)))
