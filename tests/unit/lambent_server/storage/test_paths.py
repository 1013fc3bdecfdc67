"""Names of files from outside: which are one file on some system, and what an archive's names mean."""

import pytest
from lambent_server.storage.paths import Names, clash_with, in_archive, is_archive, is_picture, path_problem

INVISIBLE = "\u200c\u200d\u200e\u202e\u206a\ufeff\u00ad\ufe0f"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        *(("a.json", "A.JSON"), ("caf\u00e9.png", "cafe\u0301.png"), ("stra\u00dfe.png", "STRASSE.png")),
        *(("a.json", f"a{letter}.json") for letter in INVISIBLE),
        ("a.png", "a.png/b.png"),
        ("a\u200c.png/b.png", "A.png"),
        ("\u1e9e.png", "ss.png"),
    ],
)
def test_two_names_of_one_file_clash(first: str, second: str):
    for names in ((first, second), (second, first)):
        kept = Names()
        assert kept.add(names[0]) is None
        assert kept.add(names[1]) == names[0]


def test_other_names_do_not():
    kept = Names()
    paths = ("a.png", "b.png", "a-.png", "\u00e9.png", "e.png", "\u2764.png", "x/a.png", "\U0001f600.png")
    assert [kept.add(path) for path in paths] == [None] * len(paths)


def test_a_clash_says_what_to_do():
    assert "rename one" in clash_with("a.png")


@pytest.mark.parametrize(
    "path", ["com\u00b9.png", "con .png", "CONIN$", "lpt\u00b3", "a/nul.txt", "a.", "a /b", "a\u00a0/b"]
)
def test_names_that_windows_reads_otherwise_are_refused(path: str):
    assert path_problem(path) is not None


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("./a.png", "a.png"),
        ("././a//b/./c.png", "a/b/c.png"),
        ("a.png", "a.png"),
        ("/a.png", "/a.png"),
        ("//a", "//a"),
        ("./../a", "../a"),
        ("a/..", "a/.."),
        (".", "."),
        ("./", ""),
        (".hidden/a.png", ".hidden/a.png"),
    ],
)
def test_a_dot_and_a_doubled_separator_say_nothing_in_an_archive(name: str, path: str):
    assert in_archive(name) == path


def test_pictures_and_archives_are_known_by_their_names():
    assert all(map(is_picture, ("a.JPG", "a/b.dng", "a.exr")))
    assert not any(map(is_picture, ("a.txt", "a.json", "0-camera.pkl", "a.zip", ".a.png", "__MACOSX/a.png")))
    assert all(map(is_archive, ("a.ZIP", "a.tar.gz", "b/a.7z")))
    assert not is_archive("zip.png")
