"""Archives as people make them: what is read, and what is refused with what to do."""

import gzip
import tarfile
from pathlib import Path

import pytest
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.storage.archives import unpack
from support.archives import AnyRoom, make_tar, make_zip, tar_member

SETTINGS = Settings(max_scene_bytes=100_000, max_scene_files=20)
FOLDER = tarfile.DIRTYPE


def unpacked(tmp_path: Path, data: bytes) -> tuple[list[str], list[str]]:
    """Return the paths of an archive's files, and those that are left out."""
    archive, folder = tmp_path / "archive", tmp_path / "out"
    archive.write_bytes(data)
    folder.mkdir()
    members, left_out = unpack(archive, folder, SETTINGS, AnyRoom())
    return [member.path for member in members], left_out


def refused(tmp_path: Path, data: bytes) -> Problem:
    """Return why an archive is refused."""
    with pytest.raises(Problem) as caught:
        unpacked(tmp_path, data)
    return caught.value


def test_an_archive_of_a_folder_as_tar_writes_it_is_read(tmp_path: Path):
    # tar czf x.tgz -C scene .
    folders = [tar_member(name, b"", FOLDER) for name in ("./", "./images/", "./images//raw/")]
    files = [tar_member(name) for name in ("./images/a.png", "./images//raw/b.png", "././c.json")]
    paths, left_out = unpacked(tmp_path, gzip.compress(make_tar(*folders, *files)))
    assert (paths, left_out) == (["images/a.png", "images/raw/b.png", "c.json"], [])


def test_so_is_a_zip_with_the_same_names(tmp_path: Path):
    entries = dict.fromkeys(("./", "./a/", "./a/./b.png", "a//c.png", "./._c.png"), b"")
    assert unpacked(tmp_path, make_zip(entries)) == (["b.png", "c.png"], ["._c.png"])


@pytest.mark.parametrize("name", ["./../a.png", "/a.png", "//a.png", "a/..", "./a/../b.png", ".."])
def test_what_leads_out_of_the_folder_is_refused_all_the_same(tmp_path: Path, name: str):
    assert refused(tmp_path, make_tar(tar_member(name))).code == "archive_unsafe"


ZIP = make_zip({"a.png": b"x"})
NESTED = make_zip({"scene.zip": ZIP, "readme.txt": b"hello"})
MANY = make_zip({f"{number}.tar.gz": b"x" for number in range(5)})
SYMBOLIC, HARD = (
    make_tar(tar_member("a.png"), tar_member("b.png", b"", kind, "a.png"))
    for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE)
)


@pytest.mark.parametrize(
    ("data", "code", "pointer", "words"),
    [
        (NESTED, "nested", "scene.zip", "holds scene.zip and no pictures; unpack it, and send what is in it"),
        (MANY, "nested", "0.tar.gz", "holds 0.tar.gz, 1.tar.gz, 2.tar.gz and 2 more and no pictures"),
        (make_zip({"film.mp4": b"x"}), "empty", "", "holds film.mp4, and nothing else"),
        (ZIP + make_zip({}), "unsafe", "", "two archives joined"),
        (SYMBOLIC, "unsafe", "b.png", "tar -h"),
        (HARD, "unsafe", "b.png", "tar -h"),
    ],
)
def test_a_refusal_says_what_is_wrong_and_what_to_do(
    tmp_path: Path, data: bytes, code: str, pointer: str, words: str
):
    problem = refused(tmp_path, data)
    assert (problem.code, problem.errors[0].pointer) == (f"archive_{code}", f"#/{pointer}".removesuffix("/"))
    assert words in problem.detail


def test_an_archive_beside_pictures_is_left_out(tmp_path: Path):
    assert unpacked(tmp_path, make_zip({"a.png": b"x", "b.zip": b"y"})) == (["a.png"], ["b.zip"])
