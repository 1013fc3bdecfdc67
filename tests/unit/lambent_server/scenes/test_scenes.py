"""Uploads over REST: planned files, archives, and everything that can be wrong with them."""

import gzip
import stat
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.api import Api, expect, expect_problem, opened, sha256
from support.archives import make_tar, make_zip, tar_member


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data", max_scene_bytes=200_000, max_scene_files=50) as api:
        yield api


def new_scene(api: Api) -> str:
    return expect(api.post("/v1/scenes", json={"name": "new"}), 201)["id"]


def plan_of(files: dict[str, bytes]) -> list[dict]:
    return [{"path": path, "size": len(data), "sha256": sha256(data)} for path, data in files.items()]


def test_an_upload_sends_only_what_is_missing_and_ends_with_a_commit(api: Api):
    files = {"transforms_train.json": b"one", "train/r_0.png": b"two", "again.png": b"two"}
    scene_id = new_scene(api)
    plan = expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of(files)), 200)
    assert plan == {"missing": sorted({sha256(b"one"), sha256(b"two")}), "unsupported": [], "uploads": []}
    expect(api.put(f"/v1/scenes/{scene_id}/files/{sha256(b'one')}", content=b"one"), 204)
    problem = expect_problem(api.post(f"/v1/scenes/{scene_id}:commit"), 409, "files_missing")
    assert [each["pointer"] for each in problem["errors"]] == ["#/files/again.png", "#/files/train/r_0.png"]
    plan = expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of(files)), 200)
    assert plan["missing"] == [sha256(b"two")]
    expect(api.put(f"/v1/scenes/{scene_id}/files/{sha256(b'two')}", content=b"two"), 204)
    scene = expect(api.post(f"/v1/scenes/{scene_id}:commit"), 200)
    assert (scene["state"], scene["num_files"], scene["size_bytes"]) == ("uploaded", 3, 9)
    assert expect(api.post(f"/v1/scenes/{scene_id}:commit"), 200) == scene
    assert expect(api.get(f"/v1/scenes/{scene_id}"), 200) == scene


def test_a_committed_scene_does_not_change_any_more(api: Api):
    scene_id = api.scene()
    expect_problem(api.post(f"/v1/scenes/{scene_id}/files:plan", json=[]), 409, "scene_committed")
    expect_problem(api.put(f"/v1/scenes/{scene_id}/files/{'0' * 64}", content=b"x"), 409, "scene_committed")
    expect_problem(api.put(f"/v1/scenes/{scene_id}/archive", content=b"x"), 409, "scene_committed")


def test_a_body_with_another_hash_is_refused_and_not_kept(api: Api):
    scene_id = new_scene(api)
    api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of({"a.png": b"abc"}))
    answer = api.put(f"/v1/scenes/{scene_id}/files/{sha256(b'abc')}", content=b"abd")
    expect_problem(answer, 422, "digest_mismatch")
    expect_problem(api.post(f"/v1/scenes/{scene_id}:commit"), 409, "files_missing")
    assert list(api.services.settings.scratch.iterdir()) == []


def test_a_file_that_is_not_in_the_plan_is_refused(api: Api):
    scene_id = new_scene(api)
    answer = api.put(f"/v1/scenes/{scene_id}/files/{sha256(b'abc')}", content=b"abc")
    expect_problem(answer, 422, "file_not_planned")


def test_a_body_larger_than_planned_is_cut_off(api: Api):
    scene_id = new_scene(api)
    api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of({"a.png": b"abc"}))
    answer = api.put(f"/v1/scenes/{scene_id}/files/{sha256(b'abc')}", content=b"abcd")
    expect_problem(answer, 413, "body_too_large")


@pytest.mark.parametrize(
    "path",
    [
        "../a.png",
        "/a.png",
        "a//b.png",
        "a/../b.png",
        "a\\b.png",
        "c:/a.png",
        "con.png",
        "a.png ",
        "a/./b.png",
        "\x01.png",
    ],
)
def test_paths_that_could_leave_the_folder_are_refused(api: Api, path: str):
    answer = api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=plan_of({path: b"a"}))
    problem = expect_problem(answer, 422, "path_unsafe")
    assert problem["errors"][0]["pointer"] == "#/0/path"


def test_paths_that_clash_on_other_systems_are_refused(api: Api):
    for names in (["a.png", "A.PNG"], ["caf\u00e9.png", "cafe\u0301.png"]):
        answer = api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=plan_of(dict.fromkeys(names, b"a")))
        problem = expect_problem(answer, 422, "path_unsafe")
        assert problem["errors"][0]["pointer"] == "#/1/path"


def test_files_of_every_layout_have_a_place_in_a_scene(api: Api):
    names = (
        *("transforms.json", "images/IMG_1.heic", "masks/IMG_1.png", "Lights/013/raw_undistorted/CA1.JPG"),
        *("sparse/0/cameras.bin", "sparse/0/images.txt", "train_000/rgba_sunset_120.png", "0-depth.png"),
        *("0-camera.pkl", "angel/127-camera.pkl", "synthetic_split_128.pkl", "a.exr", "b.hdr"),
    )
    plan = api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=plan_of(dict.fromkeys(names, b"a")))
    assert expect(plan, 200)["unsupported"] == []


def test_a_pickle_that_is_no_camera_has_no_place_in_a_scene(api: Api):
    names = ("camera.pkl", "x-camera.pkl", "0-camera.pkl.pkl", "model-1.pkl", "1-camera.pickle", "a/.pkl")
    plan = api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=plan_of(dict.fromkeys(names, b"a")))
    assert expect(plan, 200)["unsupported"] == sorted(names)


def test_a_path_with_two_contents_is_refused(api: Api):
    files = [{"path": "a.png", "size": 1, "sha256": digest * 64} for digest in ("0", "1")]
    answer = api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=files)
    assert expect_problem(answer, 422, "path_unsafe")["errors"][0]["pointer"] == "#/1/path"


def test_files_without_a_place_in_a_scene_are_left_out_and_named(api: Api):
    files = {"a.png": b"a", "model.onnx": b"b", "data.pkl": b"c", "run.exe": b"d", ".git/config.json": b"e"}
    scene_id = new_scene(api)
    plan = expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of(files)), 200)
    assert plan["missing"] == [sha256(b"a")]
    assert plan["unsupported"] == [".git/config.json", "data.pkl", "model.onnx", "run.exe"]
    report = expect(api.get(f"/v1/scenes/{scene_id}/report"), 200)
    assert {each["code"] for each in report["findings"]} == {"unsupported_file"}
    assert not report["checked"]


def test_a_scene_over_its_limits_is_refused_at_the_plan(api: Api):
    big = [{"path": "a.png", "size": 200_001, "sha256": "0" * 64}]
    expect_problem(api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=big), 413, "scene_too_large")
    many = [{"path": f"{n}.png", "size": 1, "sha256": "0" * 64} for n in range(51)]
    expect_problem(
        api.post(f"/v1/scenes/{new_scene(api)}/files:plan", json=many), 413, "scene_too_many_files"
    )


def test_an_empty_scene_cannot_be_committed(api: Api):
    expect_problem(api.post(f"/v1/scenes/{new_scene(api)}:commit"), 409, "scene_empty")


def test_a_deleted_scene_is_gone_unless_a_job_works_on_it(api: Api):
    scene_id = api.scene()
    job = api.job(scene_id)
    expect_problem(api.delete(f"/v1/scenes/{scene_id}"), 409, "scene_in_use")
    expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
    expect(api.delete(f"/v1/scenes/{scene_id}"), 204)
    expect_problem(api.get(f"/v1/scenes/{scene_id}"), 404, "scene_not_found")


SAFE = {"scene/transforms_train.json": b"{}", "scene/train/r_0.png": b"png", "scene/notes.pdf": b"?"}


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
def test_an_archive_is_unpacked_and_committed(api: Api, kind: str):
    data = make_zip(SAFE) if kind == "zip" else make_tar(*(tar_member(*each) for each in SAFE.items()))
    data = gzip.compress(data) if kind == "tar.gz" else data
    scene_id = new_scene(api)
    scene = expect(api.put(f"/v1/scenes/{scene_id}/archive", content=data), 200)
    assert (scene["state"], scene["num_files"], scene["size_bytes"]) == ("uploaded", 2, 5)
    report = expect(api.get(f"/v1/scenes/{scene_id}/report"), 200)
    assert [each["subject"] for each in report["findings"]] == ["scene/notes.pdf"]
    same = api.scene({"transforms_train.json": b"{}", "train/r_0.png": b"png"})
    assert api.get(f"/v1/scenes/{same}").json()["content_sha256"] == scene["content_sha256"]


def _bad_size_zip() -> bytes:
    data = bytearray(make_zip({"a.png": b"x" * 1000}))
    place = data.rindex(b"PK\x01\x02") + 24
    data[place : place + 4] = (10).to_bytes(4, "little")
    return bytes(data)


def _huge_name_tar() -> bytes:
    # A long name of 17 MiB in a small file: a reader that believes the header holds it in memory.
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, 3 * 2**30
    return gzip.compress(info.tobuf(tarfile.GNU_FORMAT) + b"a" * (17 * 2**20))


def _long_names_tar(count: int, size: int) -> bytes:
    # Headers that announce headers: none is large, together they are.
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, size
    padded = b"a" * (size + -size % 512)
    return gzip.compress((info.tobuf(tarfile.GNU_FORMAT) + padded) * count)


LINK = stat.S_IFLNK | 0o777
HOSTILE = {
    "zip traversal": make_zip({"../../evil.png": b"x"}),
    "zip absolute": make_zip({"/etc/evil.png": b"x"}),
    "zip backslash": make_zip({"a\\..\\b.png": b"x"}),
    "zip link": make_zip({"a.png": b"/etc/passwd"}, **{"a.png": LINK}),
    "zip device": make_zip({"a.png": b""}, **{"a.png": stat.S_IFCHR}),
    "zip clash": make_zip({"a.png": b"x", "A.png": b"y"}),
    "zip bomb": make_zip({"a.png": b"\0" * 190_000}),
    "zip too large": make_zip({f"{n}.png": bytes(range(256)) * 400 for n in range(3)}),
    "zip many": make_zip({f"{n}.png": b"" for n in range(51)}),
    "tar traversal": make_tar(tar_member("../evil.png")),
    "tar absolute": make_tar(tar_member("/evil.png")),
    "tar symlink": make_tar(tar_member("a.png", b"", tarfile.SYMTYPE, "/etc/passwd")),
    "tar hard link": make_tar(tar_member("a.png", b"", tarfile.LNKTYPE, "/etc/passwd")),
    "tar device": make_tar(tar_member("a.png", b"", tarfile.CHRTYPE)),
    "tar fifo": make_tar(tar_member("a.png", b"", tarfile.FIFOTYPE)),
    "tar clash": make_tar(tar_member("a.png"), tar_member("a.PNG")),
    "tar many": make_tar(*(tar_member(f"{n}.png", b"") for n in range(51))),
    "tar bomb": gzip.compress(make_tar(*(tar_member(f"{n}.png", b"\0" * 90_000) for n in range(40)))),
    "tar long name": _huge_name_tar(),
    "tar long names": _long_names_tar(25, 2**20),
}
BROKEN = {
    "nothing": b"",
    "text": b"hello",
    "cut zip": make_zip(SAFE)[:-30],
    "zip that lies": _bad_size_zip(),
    "cut tar": make_tar(*(tar_member(*each) for each in SAFE.items()))[:700],
    "cut gzip": gzip.compress(make_tar(*(tar_member(*each) for each in SAFE.items())))[:-20],
    "tar without end": _long_names_tar(3000, 10),
    "noise in gzip": gzip.compress(bytes(range(256)) * 8),
}


def count_blobs(api: Api) -> int:
    return sum(path.is_file() for path in (api.services.settings.data / "store").rglob("*"))


@pytest.mark.parametrize("name", [*HOSTILE, *BROKEN])
def test_a_hostile_archive_rejects_the_scene_and_leaves_nothing(api: Api, name: str):
    scene_id = new_scene(api)
    before = count_blobs(api)
    answer = api.put(f"/v1/scenes/{scene_id}/archive", content=HOSTILE.get(name, BROKEN.get(name)))
    code = "archive_unsafe" if name in HOSTILE else "archive_broken"
    expect_problem(answer, 422, code)
    assert api.get(f"/v1/scenes/{scene_id}").json()["state"] == "rejected"
    report = api.get(f"/v1/scenes/{scene_id}/report").json()
    assert [each["code"] for each in report["findings"]] == [code]
    assert count_blobs(api) == before
    data = api.services.settings.data
    assert sorted(path.name for path in data.iterdir() if path.is_dir()) == ["runs", "scratch", "store"]
    assert list((data / "scratch").iterdir()) == []
    assert not (Path("/etc") / "evil.png").exists()


def test_a_job_on_a_rejected_scene_is_refused_with_the_findings(api: Api):
    scene_id = new_scene(api)
    api.put(f"/v1/scenes/{scene_id}/archive", content=HOSTILE["zip traversal"])
    answer = api.post("/v1/jobs", json={"scene_id": scene_id, "preset": "tiny"})
    problem = expect_problem(answer, 409, "scene_rejected")
    assert problem["findings"][0]["code"] == "archive_unsafe"


def test_uploads_are_refused_when_the_disk_is_nearly_full(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        scene_id = api.scene(commit=False)
        job = api.job()
    with opened(tmp_path / "data", disk_floor_bytes=2**60) as api:
        digest = sha256(b"{}")
        for answer in (
            api.post("/v1/scenes", json={"name": "x"}),
            api.put(f"/v1/scenes/{scene_id}/files/{digest}", content=b"{}"),
            api.put(f"/v1/scenes/{scene_id}/archive", content=b"{}"),
            api.post("/v1/jobs", json={"scene_id": scene_id, "preset": "tiny"}),
            api.post("/v1/environments?name=x", content=b"{}"),
        ):
            assert expect_problem(answer, 507, "disk_floor")["retryable"]
        # Reading continues.
        expect(api.get(f"/v1/jobs/{job['id']}"), 200)


def test_a_form_is_no_archive_and_its_scene_stays_open(api: Api):
    scene_id = new_scene(api)
    for url in (f"/v1/scenes/{scene_id}/archive", f"/v1/scenes/{scene_id}/files/{sha256(b'a')}"):
        if url.endswith(sha256(b"a")):
            expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan_of({"a.png": b"a"})), 200)
        problem = expect_problem(api.put(url, files={"file": b"PK"}), 415, "unsupported_media_type")
        assert "curl -T" in problem["detail"]
    assert expect(api.get(f"/v1/scenes/{scene_id}"), 200)["state"] == "open"
    sky = api.post("/v1/environments", params={"name": "sky"}, files={"file": b"x"})
    expect_problem(sky, 415, "unsupported_media_type")
