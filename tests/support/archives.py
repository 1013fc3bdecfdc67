"""Archives of any content, hostile ones too."""

import io
import tarfile
import zipfile
from contextlib import AbstractContextManager, nullcontext


class AnyRoom:
    """Room for everything that is unpacked."""

    def entry(self, size: int) -> None:
        pass

    def writing(self, size: int) -> AbstractContextManager[None]:
        return nullcontext()

    def kept(self, sha256: str, size: int) -> None:
        pass


def make_zip(entries: dict[str, bytes], **modes: int) -> bytes:
    """Return a zip; `modes` gives the file modes of some entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = modes.get(name, 0) << 16
            archive.writestr(info, data)
    return buffer.getvalue()


def make_tar(*members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    """Return a tar of what `tar_member` returns."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for info, data in members:
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


def tar_member(name: str, data: bytes = b"x", kind: bytes = tarfile.REGTYPE, target: str = "") -> tuple:
    """Return a member of any kind."""
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info, data
