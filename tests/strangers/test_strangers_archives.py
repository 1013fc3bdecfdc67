"""Archives that strangers pack hold their files under the names that the capture has."""

import io
import tarfile
import zipfile
from pathlib import Path

import pytest
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.storage.archives import unpack
from strangers.ball import write_transforms
from support.archives import AnyRoom

pytestmark = pytest.mark.slow

NAMES = {"transforms.json", *(f"images/{index:03d}.png" for index in range(8))}


def _names_in(archive: Path) -> set[str]:
    kept = archive.parent / "kept"
    kept.mkdir()
    members, _ = unpack(archive, kept, Settings(), AnyRoom())
    return {member.path for member in members}


@pytest.mark.parametrize("top", [".", "./", "./scene", "scene"])
@pytest.mark.parametrize("form", [tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_a_tar_of_a_folder_holds_the_capture_wherever_it_was_packed(top: str, form: int, tmp_path: Path):
    write_transforms(tmp_path / "scene")
    with tarfile.open(tmp_path / "scene.tar.gz", "w:gz", format=form) as file:
        for path in sorted(path for path in (tmp_path / "scene").rglob("*")):
            inner = path.relative_to(tmp_path / "scene").as_posix()
            info = file.gettarinfo(str(path))
            info.name = f"{top.rstrip('/')}/{inner}"
            file.addfile(info, io.BytesIO(path.read_bytes()) if path.is_file() else None)
    assert _names_in(tmp_path / "scene.tar.gz") == NAMES


def test_a_zip_in_a_zip_is_refused_by_its_name(tmp_path: Path):
    write_transforms(tmp_path / "scene")
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as file:
        for path in (tmp_path / "scene").rglob("*.*"):
            file.write(path, path.relative_to(tmp_path / "scene").as_posix())
    with zipfile.ZipFile(tmp_path / "nested.zip", "w") as file:
        file.writestr("scene.zip", inner.getvalue())
    with pytest.raises(Problem) as refusal:
        _names_in(tmp_path / "nested.zip")
    assert "scene.zip" in str(refusal.value.detail)
    assert "unpack" in str(refusal.value.detail)
