"""push and fetch: nothing twice, nothing half, nothing outside its folder."""

import json

import httpx2
import pytest
from lambent import Client
from lambent.errors import DigestMismatchError, JobNotSucceededError, UnreachableError, UsageProblemError
from lambent.fetch import download_all
from lambent.models import Artifact
from lambent.provenance import beside, verify
from lambent.scenes import content_sha256, list_files
from support.fake_server import FakeServer, sha256


@pytest.fixture
def server():
    """Return a server without faults."""
    return FakeServer()


@pytest.fixture
def client(server):
    """Return a client of `server` that does not wait between tries."""
    with Client("http://127.0.0.1:1", transport=server.transport, sleep=lambda seconds: None) as client:
        yield client


@pytest.fixture
def scene_folder(tmp_path):
    """Return a folder with three files, two of them equal, and one hidden."""
    folder = tmp_path / "cup"
    (folder / "train_000").mkdir(parents=True)
    (folder / "train_000" / "rgba.png").write_bytes(b"picture")
    (folder / "train_000" / "copy.png").write_bytes(b"picture")
    (folder / "scene.json").write_bytes(b"{}")
    (folder / ".DS_Store").write_bytes(b"junk")
    return folder


def puts(server):
    return [line for line in server.requests if line.startswith("PUT")]


def test_push_sends_every_distinct_file_once_and_commits(server, client, scene_folder):
    scene = client.push(scene_folder)
    assert scene.state == "uploaded"
    assert scene.name == "cup"
    assert len(puts(server)) == 2
    assert {entry["path"] for entry in server.scenes[scene.id]["files"]} == {
        "scene.json",
        "train_000/copy.png",
        "train_000/rgba.png",
    }


def test_pushing_again_sends_nothing(server, client, scene_folder):
    client.push(scene_folder)
    sent = len(puts(server))
    assert client.push(scene_folder).state == "uploaded"
    assert len(puts(server)) == sent


def test_an_interrupted_push_goes_on_where_it_stopped(server, client, scene_folder):
    def break_second(request):
        if request.method == "PUT" and len(puts(server)) > 1:
            raise httpx2.WriteError("cable out")

    server.faults.append(break_second)
    with pytest.raises(UnreachableError):
        client.push(scene_folder)
    server.faults.clear()
    server.requests.clear()
    client.push(scene_folder)
    assert len(puts(server)) == 1


def test_a_change_of_any_path_or_byte_changes_the_content_hash(scene_folder):
    before = content_sha256(list_files(scene_folder))
    (scene_folder / "scene.json").write_bytes(b"{ }")
    changed = content_sha256(list_files(scene_folder))
    (scene_folder / "scene.json").rename(scene_folder / "other.json")
    moved = content_sha256(list_files(scene_folder))
    assert len({before, changed, moved}) == 3


def test_a_symbolic_link_in_a_scene_is_refused(client, scene_folder, tmp_path):
    (scene_folder / "link.png").symlink_to(tmp_path)
    with pytest.raises(UsageProblemError, match=r"scene\.link.*link\.png"):
        client.push(scene_folder)


def test_links_that_stay_in_a_scene_are_sent_as_what_they_lead_to(scene_folder):
    before = {entry.path: entry.sha256 for entry in list_files(scene_folder)}
    (scene_folder / "again").symlink_to(scene_folder)
    (scene_folder / "copy.json").symlink_to("scene.json")
    (scene_folder / "nested").mkdir()
    (scene_folder / "nested" / "folder").symlink_to("../deep", target_is_directory=True)
    (scene_folder / "deep").mkdir()
    (scene_folder / "deep" / "a.png").write_bytes(b"a")
    after = {entry.path: entry.sha256 for entry in list_files(scene_folder)}
    assert set(after) - set(before) == {"copy.json", "deep/a.png", "nested/folder/a.png"}
    assert after["copy.json"] == before["scene.json"]


@pytest.mark.parametrize("target", ["nowhere", "..", "loop"])
def test_links_that_lead_out_or_nowhere_are_refused(scene_folder, target):
    (scene_folder / "loop").symlink_to(target)
    with pytest.raises(UsageProblemError, match=r"scene\.link.*loop"):
        list_files(scene_folder)


def test_an_empty_folder_a_missing_one_and_an_odd_file_are_usage_errors(client, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "scene.rar").write_bytes(b"x")
    for source, code in (
        ("empty", "scene.empty"),
        ("nowhere", "scene.not_a_folder"),
        ("scene.rar", "scene.unk"),
    ):
        with pytest.raises(UsageProblemError, match=code):
            client.push(tmp_path / source)


def test_an_archive_is_sent_whole_with_its_length(server, client, tmp_path):
    (tmp_path / "cup.zip").write_bytes(b"PK-something")
    assert client.push(tmp_path / "cup.zip").name == "cup"
    assert server.blobs["archive"] == b"PK-something"


def test_an_archive_whose_first_answer_was_lost_is_still_pushed(server, client, tmp_path):
    (tmp_path / "cup.zip").write_bytes(b"PK-something")
    lost = []

    def lose_answer(request):
        if request.url.path.endswith("/archive") and not lost:
            lost.append(server._scenes(request, request.url.path.removeprefix("/v1/scenes/").split("/")))
            raise httpx2.ReadError("lost")

    server.faults.append(lose_answer)
    assert client.push(tmp_path / "cup.zip").state == "uploaded"


def test_upload_progress_ends_at_all_bytes(client, scene_folder):
    calls = []
    client.push(scene_folder, progress=lambda *call: calls.append(call))
    uploads = [call for call in calls if call[0] == "upload"]
    assert uploads[-1][1] == uploads[-1][2] == len(b"picture") + len(b"{}")


FILES = {"models/weights.bin": bytes(range(256)) * 40, "cameras.json": b"{}"}


def write_half(folder, data):
    """Leave what a fetch leaves that was cut off."""
    half = folder / "out.partial" / "models" / "weights.bin"
    half.parent.mkdir(parents=True)
    half.write_bytes(data)


def test_a_fetched_bundle_is_complete_and_nothing_partial_stays(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    fetched = client.fetch("bundle_1", tmp_path / "out")
    assert (fetched.path / "models/weights.bin").read_bytes() == FILES["models/weights.bin"]
    assert json.loads((fetched.path / "manifest.json").read_bytes())["files"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_job_is_fetched_through_its_bundle(server, client, tmp_path):
    server.add_bundle("bundle_9", FILES)
    server.jobs["job_1"] = {"id": "job_1", "state": "succeeded", "bundle_id": "bundle_9"}
    assert client.fetch("job_1", tmp_path / "out").bundle_id == "bundle_9"


def test_a_job_without_a_bundle_says_what_to_do(server, client, tmp_path):
    server.jobs["job_1"] = {"id": "job_1", "state": "failed", "bundle_id": None}
    with pytest.raises(JobNotSucceededError, match=r"job_1 is failed.*lambent logs job_1"):
        client.fetch("job_1", tmp_path / "out")


def test_a_broken_download_resumes_with_a_range(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    write_half(tmp_path, FILES["models/weights.bin"][:1000])
    client.fetch("bundle_1", tmp_path / "out")
    ranges = [headers["Range"] for headers in server.headers if "Range" in headers]
    assert ranges == ["bytes=1000-"]
    assert (tmp_path / "out/models/weights.bin").read_bytes() == FILES["models/weights.bin"]


def test_a_server_that_ignores_ranges_is_asked_once_more_at_most(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    whole = FILES["models/weights.bin"]
    server.faults.append(
        lambda request: httpx2.Response(200, content=whole) if "Range" in request.headers else None
    )
    write_half(tmp_path, whole[:1000])
    client.fetch("bundle_1", tmp_path / "out")
    assert sum("weights.bin" in line for line in server.requests) == 1


def test_a_wrong_half_file_is_noticed_and_loaded_anew(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    write_half(tmp_path, b"x" * 1000)
    client.fetch("bundle_1", tmp_path / "out")
    assert (tmp_path / "out/models/weights.bin").read_bytes() == FILES["models/weights.bin"]


def test_bytes_that_never_match_are_refused_and_no_bundle_appears(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    server.bundles["bundle_1"]["cameras.json"] = b"no"
    with pytest.raises(DigestMismatchError, match=r"cameras\.json"):
        client.fetch("bundle_1", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_fetching_again_downloads_nothing(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    client.fetch("bundle_1", tmp_path / "out")
    server.requests.clear()
    client.fetch("bundle_1", tmp_path / "out")
    # No file; the statement is small, and may have been lost.
    assert server.requests == ["GET /v1/bundles/bundle_1/manifest", "GET /v1/bundles/bundle_1/provenance"]


def test_a_statement_about_an_earlier_bundle_does_not_stay_beside_another(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    old = beside(tmp_path / "cup.relight")
    old.write_text("about the bundle that was here")
    client.fetch("bundle_1", tmp_path / "cup.relight")
    assert not old.exists()
    with pytest.raises(UsageProblemError, match=r"verify\.no_statement"):
        verify(tmp_path / "cup.relight")


def test_a_folder_with_other_things_is_left_alone(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("keep")
    with pytest.raises(UsageProblemError, match=r"fetch\.target_in_use"):
        client.fetch("bundle_1", tmp_path / "out")
    assert (tmp_path / "out" / "mine.txt").read_text() == "keep"


@pytest.mark.parametrize("path", ["../evil", "/etc/evil", "a/../../evil", "a\\..\\evil", ""])
def test_a_manifest_cannot_name_a_place_outside_the_folder(server, client, tmp_path, path):
    entry = {"path": path, "size_bytes": 1, "sha256": sha256(b"x")}
    server.bundles["bundle_1"] = {"manifest.json": json.dumps({"files": [entry]}).encode()}
    with pytest.raises(UsageProblemError, match=r"fetch\.unsafe_path"):
        client.fetch("bundle_1", tmp_path / "out")


def test_leftovers_of_another_bundle_do_not_get_in(server, client, tmp_path):
    server.add_bundle("bundle_1", FILES)
    (tmp_path / "out.partial" / "old").mkdir(parents=True)
    (tmp_path / "out.partial" / "old" / "stranger.bin").write_bytes(b"x")
    client.fetch("bundle_1", tmp_path / "out")
    assert not (tmp_path / "out" / "old").exists()


@pytest.mark.parametrize("name", ["../a.png", "/a.png", "a/../../b.png", "a\\b.png", ""])
def test_a_file_of_a_batch_whose_name_leaves_the_folder_is_not_written(tmp_path, name):
    """All names are looked at before the first file is fetched, so no connection is needed here."""
    artifacts = [Artifact(name=each, sha256="0" * 64) for each in ("fine/c.png", name)]
    with pytest.raises(UsageProblemError, match=r"fetch\.unsafe_path"):
        download_all(None, artifacts, tmp_path / "out")
    assert not (tmp_path / "out").exists()
