"""Archives that attack whoever unpacks them, with the codes of their refusal (none: they can be unpacked)."""

import gzip
import io
import stat
import struct
import tarfile
import zipfile
from collections.abc import Callable

from support.archives import make_tar, make_zip, tar_member

UNSAFE, BROKEN, PATHS = {"archive_unsafe"}, {"archive_broken"}, {"archive_unsafe", "path_unsafe"}
EITHER = UNSAFE | BROKEN
PNG = b"\x89PNG\r\n\x1a\n"

ARCHIVES: dict[str, tuple[Callable[[], bytes], set[str]]] = {}


def kind(name: str, codes: set[str]) -> Callable[[Callable[[], bytes]], Callable[[], bytes]]:
    """Register an archive."""

    def keep(make: Callable[[], bytes]) -> Callable[[], bytes]:
        ARCHIVES[name] = (make, codes)
        return make

    return keep


# ---- names ----------------------------------------------------------------------

NAMES = {
    "parent folders": "../../evil.png",
    "a parent folder in the middle": "a/../../evil.png",
    "the root": "/etc/evil.png",
    "backslashes": "..\\..\\evil.png",
    "a drive": "c:/evil.png",
    "a share": "\\\\host\\share\\evil.png",
    "a device of Windows": "con.png",
    "a device with a space": "con .png",
    "a device with a power": "com\u00b9.png",
    "an alternate stream": "a.png:evil",
    "a trailing dot": "a.png./b.png",
    "a trailing space": "a /b.png",
    "a parent folder behind a dot": "./../b.png",
    "a control character": "a\x07.png",
    "a line break": "a\nb.png",
    "300 characters": "a" * 300 + ".png",
    "a part of 600 bytes": "\u00e9" * 200 + ".png",
    "a wildcard": "*.png",
}
for _name, _path in NAMES.items():
    ARCHIVES[f"zip with {_name}"] = (lambda path=_path: make_zip({path: b"x"}), UNSAFE)
    ARCHIVES[f"tar with {_name}"] = (lambda path=_path: make_tar(tar_member(path)), EITHER)

CLASHES = {
    "case": ("a.png", "A.png"),
    "composition": ("caf\u00e9.png", "cafe\u0301.png"),
    "folding": ("stra\u00dfe.png", "STRASSE.png"),
    "an invisible character": ("a.png", "a\u200c.png"),
    "the order of bytes": ("a.png", "\ufeffa.png"),
    "a form of a sign": ("\u2764.png", "\u2764\ufe0f.png"),
    "a sharp s": ("\u1e9e.png", "SS.png"),
    "a doubled separator": ("a//b.png", "a/b.png"),
    "a file that is a folder": ("a.png", "a.png/b.png"),
    "a folder that is a file, in another case": ("A.PNG/b.png", "a.png"),
    "the same name twice": ("./a.png", "a.png"),
}
for _name, _paths in CLASHES.items():
    ARCHIVES[f"zip with a clash of {_name}"] = (lambda p=_paths: make_zip(dict.fromkeys(p, b"x")), UNSAFE)
    ARCHIVES[f"tar with a clash of {_name}"] = (lambda p=_paths: make_tar(*map(tar_member, p)), UNSAFE)


# ---- kinds of entries ----------------------------------------------------------------------

for _name, _mode in {
    "link": stat.S_IFLNK,
    "device": stat.S_IFBLK,
    "pipe": stat.S_IFIFO,
    "socket": stat.S_IFSOCK,
}.items():
    ARCHIVES[f"zip with a {_name}"] = (
        lambda mode=_mode: make_zip({"a.png": b"/etc/passwd"}, **{"a.png": mode | 0o777}),
        UNSAFE,
    )
for _name, _type in {
    "link": tarfile.SYMTYPE,
    "hard link": tarfile.LNKTYPE,
    "character device": tarfile.CHRTYPE,
    "block device": tarfile.BLKTYPE,
    "pipe": tarfile.FIFOTYPE,
}.items():
    ARCHIVES[f"tar with a {_name}"] = (
        lambda kind=_type: make_tar(tar_member("a.png", b"", kind, "/etc/passwd")),
        UNSAFE,
    )


@kind("tar with a link, then a file behind it", UNSAFE)
def _() -> bytes:
    return make_tar(tar_member("a", b"", tarfile.SYMTYPE, "/tmp"), tar_member("a/evil.png"))


@kind("tar with a sparse file of a terabyte", EITHER)
def _() -> bytes:
    info = tarfile.TarInfo("a.png")
    info.pax_headers = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": str(2**40)}
    info.size = 512
    return info.tobuf(tarfile.PAX_FORMAT) + b"1\n0\n512\n".ljust(512, b"\0") + bytes(1024)


@kind("zip with an encrypted entry", UNSAFE)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x"}))
    data[6] |= 1
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    return bytes(data)


@kind("zip with a folder that has contents", UNSAFE)
def _() -> bytes:
    return make_zip({"a/": b"contents"})


@kind("zip with another method", UNSAFE)
def _() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.png", b"x" * 100)
    return buffer.getvalue()


# ---- bombs ----------------------------------------------------------------------


@kind("zip bomb", UNSAFE)
def _() -> bytes:
    return make_zip({"a.png": bytes(1_900_000)})


@kind("zip bomb that denies it", EITHER)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": bytes(1_900_000)}))
    place = data.rindex(b"PK\x01\x02") + 24
    data[place : place + 4] = struct.pack("<I", 10)
    return bytes(data)


@kind("zip whose entries share their bytes", UNSAFE)
def _() -> bytes:
    # After D. Fifield, A better zip bomb, WOOT 2019: many entries of the list, one kernel.
    first = make_zip({"0.png": bytes(range(256)) * 40})
    start = first.rindex(b"PK\x01\x02")
    end = first.rindex(b"PK\x05\x06")
    entry = bytearray(first[start:end])
    entries = b"".join(bytes(entry[:46] + b"%d.png" % n) for n in range(10))
    tail = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 10, 10, len(entries), start, 0)
    return first[:start] + entries + tail


@kind("tar.gz bomb", UNSAFE)
def _() -> bytes:
    return gzip.compress(make_tar(tar_member("a.png", bytes(1_900_000))))


@kind("tar.gz bomb of many gzip members", UNSAFE)
def _() -> bytes:
    whole = make_tar(*(tar_member(f"{n}.png", bytes(90_000)) for n in range(30)))
    return b"".join(gzip.compress(whole[at : at + 1000]) for at in range(0, len(whole), 1000))


@kind("gzip in gzip", BROKEN)
def _() -> bytes:
    return gzip.compress(gzip.compress(make_tar(tar_member("a.png"))))


@kind("zip in zip", {"archive_nested"})
def _() -> bytes:
    return make_zip({"inner.zip": make_zip({"a.png": bytes(1000)}), "notes.txt": b"x"})


@kind("zip and the end of an empty one", UNSAFE)
def _() -> bytes:
    return make_zip({"a.png": b"x"}) + make_zip({})


@kind("zip and another zip", UNSAFE)
def _() -> bytes:
    return make_zip({"a.png": b"x"}) + make_zip({"b.png": b"y"})


@kind("zip behind a program", UNSAFE)
def _() -> bytes:
    return b"PK MZ a program" + make_zip({"a.png": b"x"})


@kind("zip whose comment is another one's end", EITHER)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x"}))
    end = bytes(data[-22:])
    data[-2:] = struct.pack("<H", len(end))
    return bytes(data) + end


@kind("zip of nothing", {"archive_empty"})
def _() -> bytes:
    return make_zip({})


@kind("zip of a film", {"archive_empty"})
def _() -> bytes:
    return make_zip({"film.mp4": b"x", ".DS_Store": b"x"})


@kind("tar of nothing", BROKEN)
def _() -> bytes:
    return make_tar()


@kind("zip with a marker of parts", set())
def _() -> bytes:
    buffer = io.BytesIO(b"PK00")
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr("a.png", b"x")
    return buffer.getvalue()


@kind("zip with a comment", set())
def _() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.png", b"x")
        archive.comment = b"made by a camera" * 100
    return buffer.getvalue()


@kind("zip of 61 files", UNSAFE)
def _() -> bytes:
    return make_zip({f"{n}.png": b"" for n in range(61)})


@kind("tar of 61 files", UNSAFE)
def _() -> bytes:
    return make_tar(*(tar_member(f"{n}.png", b"") for n in range(61)))


@kind("tar with a name of 17 MiB", UNSAFE)
def _() -> bytes:
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, 3 * 2**30
    return gzip.compress(info.tobuf(tarfile.GNU_FORMAT) + b"a" * (17 * 2**20))


@kind("tar with headers that announce headers", BROKEN)
def _() -> bytes:
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, 10
    return gzip.compress((info.tobuf(tarfile.GNU_FORMAT) + b"a" * 10 + bytes(502)) * 3000)


@kind("tar with an extended header of 100 000 entries", EITHER | {"scene.layout_unknown"})
def _() -> bytes:
    records = b"".join(b"31 k%06d=%s\n" % (n, b"v" * 19) for n in range(100_000))
    info = tarfile.TarInfo("pax")
    info.type, info.size = tarfile.XHDTYPE, len(records)
    data = info.tobuf(tarfile.USTAR_FORMAT) + records + bytes(-len(records) % 512)
    return gzip.compress(data + make_tar(tar_member("a.txt")))


@kind("tar with a negative size", BROKEN | {"archive_unsafe"})
def _() -> bytes:
    data = bytearray(make_tar(tar_member("a.png", b"x")))
    data[124:136] = b"\xff" * 11 + b"\xfe"
    head = bytes(data[:148]) + b" " * 8 + bytes(data[156:512])
    data[148:156] = b"%06o\0 " % sum(head)
    return bytes(data)


# ---- lies ----------------------------------------------------------------------


@kind("zip with a wrong checksum", BROKEN)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x" * 50}))
    data[data.rindex(b"PK\x01\x02") + 16] ^= 1
    return bytes(data)


@kind("zip whose two names differ", BROKEN)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x"}))
    data[data.rindex(b"PK\x01\x02") + 46] = ord("b")
    return bytes(data)


@kind("zip that says it has 65535 entries", set())
def _() -> bytes:
    # Readers go by the size of the list, which is true.
    data = bytearray(make_zip({"a.txt": b"x"}))
    end = data.rindex(b"PK\x05\x06")
    data[end + 8 : end + 12] = b"\xff\xff" * 2
    return bytes(data)


@kind("zip64 with a list beyond the end", BROKEN)
def _() -> bytes:
    data = make_zip({"a.png": b"x"})
    end = data.rindex(b"PK\x05\x06")
    record = struct.pack("<IQHHIIQQQQ", 0x06064B50, 44, 45, 45, 0, 0, 2**40, 2**40, 2**50, 2**60)
    locator = struct.pack("<IIQI", 0x07064B50, 0, end, 1)
    tail = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return data[:end] + record + locator + tail


@kind("zip64 with sizes of an exabyte", EITHER)
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x"}))
    start, end = data.rindex(b"PK\x01\x02"), data.rindex(b"PK\x05\x06")
    extra = struct.pack("<HHQQ", 1, 16, 2**60, 2**60)
    entry = bytearray(data[start:end])
    entry[20:28] = b"\xff" * 8
    entry[30:32] = struct.pack("<H", len(extra))
    listing = bytes(entry[:51]) + extra
    tail = bytearray(data[end:])
    tail[12:16] = struct.pack("<I", len(listing))
    return bytes(data[:start]) + listing + bytes(tail)


@kind("zip with an extra field cut short", BROKEN | {"archive_unsafe"})
def _() -> bytes:
    data = bytearray(make_zip({"a.png": b"x"}))
    start, end = data.rindex(b"PK\x01\x02"), data.rindex(b"PK\x05\x06")
    data[start + 30 : start + 32] = struct.pack("<H", 4)
    data[end:end] = struct.pack("<HH", 1, 400)
    where = data.rindex(b"PK\x05\x06")
    data[where + 12 : where + 16] = struct.pack("<I", where - start)
    return bytes(data)


@kind("zip with a name in no encoding", BROKEN)
def _() -> bytes:
    return make_zip({"caf\u00e9.txt": b"x"}).replace("caf\u00e9.txt".encode(), b"caf\xff\xfe.txt")


@kind("zip with a null byte in a name", UNSAFE)
def _() -> bytes:
    return make_zip({"a.png_.txt": b"x"}).replace(b"a.png_.txt", b"a.png\0.txt")


@kind("zip cut off", BROKEN)
def _() -> bytes:
    return make_zip({"a.png": bytes(range(256)) * 20})[:-30]


@kind("tar cut off", BROKEN)
def _() -> bytes:
    return make_tar(tar_member("a.png", b"x" * 5000))[:2000]


@kind("tar.gz cut off", BROKEN)
def _() -> bytes:
    return gzip.compress(make_tar(tar_member("a.png", bytes(range(256)) * 20)))[:-20]


@kind("tar.gz with a wrong checksum", BROKEN)
def _() -> bytes:
    data = bytearray(gzip.compress(make_tar(tar_member("a.txt", bytes(range(256)) * 20))))
    data[-6] ^= 0xFF
    return bytes(data)


@kind("7z", BROKEN)
def _() -> bytes:
    return b"7z\xbc\xaf\x27\x1c\0\4" + bytes(200)


@kind("rar", BROKEN)
def _() -> bytes:
    return b"Rar!\x1a\7\1\0" + bytes(200)


@kind("nothing", BROKEN)
def _() -> bytes:
    return b""


@kind("a picture with a zip behind it", BROKEN)
def _() -> bytes:
    return PNG + bytes(50) + make_zip({"a.png": b"x"})


@kind("zip of a program, a pickle and a graph", set())
def _() -> bytes:
    return make_zip({"run.exe": b"MZ", "data.pkl": b"\x80\x04.", "model.onnx": b"\x08", "notes.txt": b"x"})
