"""A process that has entered the sandbox can do what reading takes, and nothing else."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from lambent_sandbox import calls, filters, sandbox
from lambent_server.executors import installed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only"),
]

NUMBERS = calls.NUMBERS.get(filters.machine() or "", {})
HEAD = "import ctypes, os, resource, signal, socket, subprocess, sys, threading, time, zlib\n"


def run(
    act: str,
    *,
    readable: Path | None = None,
    strictness: str = "available",
    more: str = "",
    data: bytes = b"",
):
    """Return how a process ended that entered the sandbox and then did `act`."""
    given = "None" if readable is None else f"[Path({str(readable)!r})]"
    program = (
        f"{HEAD}{more}from pathlib import Path\n"
        "from lambent_sandbox.sandbox import Limits, enter\n"
        "limits = Limits(memory_bytes=600 * 2**20, cpu_s=2)\n"
        f"layers = enter(limits, {strictness!r}, readable={given}, as_nobody={readable is None})\n"
        f"{act}\nprint('done', flush=True)\n"
    )
    return subprocess.run(
        [sys.executable, "-B", "-c", program], capture_output=True, text=False, input=data, check=False
    )


KILLED = {
    "a socket": "socket.socket()",
    "a pair of sockets": "socket.socketpair()",
    "another program": "os.execv('/bin/true', ['true'])",
    "a child": "os.fork()",
    "a child by a library": "os.posix_spawn('/bin/true', ['true'], {})",
    "a new file": "os.open('/tmp/lambent-attack', os.O_WRONLY | os.O_CREAT)",
    "the end of a file": "os.open('/etc/hostname', os.O_WRONLY | os.O_APPEND)",
    "a nameless file": "os.open('/tmp', os.O_WRONLY | os.O_TMPFILE)",
    "removing": "os.unlink('/tmp/lambent-attack')",
    "renaming": "os.rename('/tmp/a', '/tmp/b')",
    "a folder": "os.mkdir('/tmp/lambent-attack')",
    "a link": "os.symlink('/etc', '/tmp/lambent-attack')",
    "rights": "os.chmod('/tmp', 0o777)",
    "a signal": "os.kill(os.getppid(), 0)",
    "another user": "os.setuid(1234)",
    "another process's memory": "ctypes.CDLL(None).ptrace(16, os.getppid(), 0, 0)",
    "a namespace": "ctypes.CDLL(None).unshare(0x10000000)",
    "the other table of calls": "ctypes.CDLL(None).syscall(0x40000000 | 39)",
}


@pytest.mark.parametrize("name", KILLED)
@pytest.mark.parametrize("reads", [False, True])
def test_what_only_foreign_code_tries_ends_the_process(tmp_path: Path, name: str, reads: bool):
    if "other table" in name and filters.machine() != calls.X86_64:
        pytest.skip("one machine has two tables")
    done = run(KILLED[name], readable=tmp_path if reads else None)
    assert done.returncode == -signal.SIGSYS, done
    assert b"done" not in done.stdout
    assert not Path("/tmp/lambent-attack").exists()


def test_a_process_that_only_streams_opens_nothing():
    done = run(
        "try:\n    os.open('/proc/self/status', os.O_RDONLY)\n    print('opened')\n"
        "except OSError as e:\n    print(e.errno)"
    )
    assert done.stdout.split()[-1] == b"done"
    assert b"opened" not in done.stdout


LOOKS = (
    "def looks(*calls):\n    for call in calls:\n        try:\n            print('seen', call())\n"
    "        except PermissionError:\n            pass\n"
)


def test_a_process_that_only_streams_looks_at_no_path():
    act = (
        "looks(lambda: os.stat('/etc/hostname'), lambda: os.lstat('/etc'), lambda: os.listdir('/'),\n"
        "    lambda: os.readlink('/proc/self/exe'), lambda: os.statvfs('/'), lambda: os.getcwd(),\n"
        "    lambda: os.stat('hostname', dir_fd=0), lambda: os.open('/etc', 0o10000000))\n"
        "print(os.access('/etc/hostname', os.F_OK), os.path.exists('/etc'))"
    )
    done = run(act, more=LOOKS)
    assert b"seen" not in done.stdout, done
    assert done.stdout.splitlines()[-2:] == [b"False False", b"done"], done


def test_a_reader_learns_of_other_paths_what_security_md_says_and_no_more(tmp_path: Path):
    for path, text in ((tmp_path / "scene" / "a.txt", "mine"), (tmp_path / "other" / "api.key", "secret")):
        path.parent.mkdir()
        path.write_text(text)
    for path in (tmp_path, *tmp_path.iterdir()):
        path.chmod(0o755)
    other = str(tmp_path / "other")
    act = (
        f"print(os.stat({other!r} + '/api.key').st_size)\n"
        f"looks(lambda: os.listdir({other!r}), lambda: open({other!r} + '/api.key').read(),\n"
        f"    lambda: os.listxattr({other!r}), lambda: os.utime({other!r}))"
    )
    done = run(act, readable=tmp_path / "scene", more=LOOKS)
    assert done.stdout.split() == [b"6", b"done"], done


def test_a_reader_opens_what_it_may_and_nothing_else(tmp_path: Path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "a.txt").write_text("mine")
    (tmp_path / "api.key").write_text("secret")
    (tmp_path / "scene" / "link").symlink_to(tmp_path / "api.key")
    for path in (tmp_path, tmp_path / "scene"):
        path.chmod(0o755)
    act = (
        f"scene = {str(tmp_path / 'scene')!r}\nprint(open(scene + '/a.txt').read(), os.listdir(scene))\n"
        "for path in (scene + '/../api.key', scene + '/link', '/proc/1/environ', '/root'):\n"
        "    try:\n        os.open(path, os.O_RDONLY)\n        print('opened', path)\n"
        "    except OSError:\n        pass"
    )
    done = run(act, readable=tmp_path / "scene")
    assert b"mine" in done.stdout, done
    assert b"opened" not in done.stdout
    assert b"done" in done.stdout


SIGNALS = (
    "import fcntl\nfor command, value in ((fcntl.F_SETOWN, os.getppid()), (10, signal.SIGTERM), (15, 0),\n"
    "        (fcntl.F_SETFL, os.O_ASYNC), (fcntl.F_SETLEASE, 0), (1031, 4096)):\n"
    "    try:\n        fcntl.fcntl(0, command, value)\n        print('accepted', command)\n"
    "    except PermissionError:\n        pass\n"
)


@pytest.mark.parametrize("reads", [False, True])
def test_a_file_cannot_be_made_to_signal_another_process(tmp_path: Path, reads: bool):
    done = run(SIGNALS, readable=tmp_path if reads else None, more="import fcntl\n")
    assert b"accepted" not in done.stdout
    assert b"done" in done.stdout, done
    # Copies and flags of files are what Python needs.
    used = "copy = fcntl.fcntl(0, fcntl.F_DUPFD_CLOEXEC, 9)\n"
    used += "fcntl.fcntl(copy, fcntl.F_SETFD, fcntl.fcntl(0, fcntl.F_GETFD))\n"
    used += "fcntl.fcntl(0, fcntl.F_GETFL)"
    done = run(used, readable=tmp_path if reads else None, more="import fcntl\n")
    assert b"done" in done.stdout, done


def test_limits_are_read_and_never_set_not_even_through_an_address_above_four_gigabytes(tmp_path: Path):
    act = (
        "resource.getrlimit(resource.RLIMIT_NOFILE)\n"
        "library = ctypes.CDLL(None, use_errno=True)\n"
        "new, old = (ctypes.c_uint64 * 2)(16, 16), (ctypes.c_uint64 * 2)()\n"
        # The lower half of this address is zero.
        "library.mmap.restype = ctypes.c_uint64\n"
        "at = library.mmap(ctypes.c_void_p(1 << 33), 4096, 3, 0x22 | 0x100000, -1, 0)\n"
        "if at != 1 << 33:\n    print('elsewhere', hex(at))\n"
        "ctypes.memmove(1 << 33, new, 16)\n"
        "high = ctypes.c_void_p(1 << 33)\n"
        "for pid, given in ((0, new), (0, high), (os.getppid(), None), (os.getpid(), None)):\n"
        "    ctypes.set_errno(0)\n"
        f"    done = library.syscall({NUMBERS['prlimit64']}, pid, 7, given, old)\n"
        "    if done == 0 or ctypes.get_errno() != 1:\n        print('accepted', pid, given)\n"
        f"if library.syscall({NUMBERS['prlimit64']}, 0, 7, None, old) == 0 and old[0] == 64:\n"
        "    print('kept')"
    )
    done = run(act, readable=tmp_path)
    assert done.stdout.split() == [b"kept", b"done"], done


WITHOUT_LANDLOCK = "import lambent_sandbox.landlock as l\nl.install = lambda paths: ''\n"


@pytest.mark.parametrize("more", ["", WITHOUT_LANDLOCK], ids=["all layers", "filters alone"])
@pytest.mark.parametrize("reads", [False, True])
def test_files_cannot_be_changed_through_calls_that_do_not_create(tmp_path: Path, reads: bool, more: str):
    kept = tmp_path / "kept.txt"
    kept.write_text("kept")
    act = (
        f"try:\n    os.open({str(kept)!r}, os.O_RDWR)\n    print('opened')\nexcept PermissionError:\n    pass"
    )
    done = run(act, readable=tmp_path if reads else None, more=more)
    assert b"opened" not in done.stdout
    assert b"done" in done.stdout, done
    assert kept.read_text() == "kept"


def test_memory_ends_before_the_machine_does():
    done = run("try:\n    bytearray(8 * 2**30)\n    print('allocated')\nexcept MemoryError:\n    pass")
    assert (b"allocated" in done.stdout, b"done" in done.stdout) == (False, True)


@pytest.mark.timeout(60)
def test_spinning_for_ever_ends_with_the_processor_time():
    assert run("while True: pass").returncode in (-signal.SIGXCPU, -signal.SIGKILL)


def test_there_is_no_memory_that_can_be_written_and_then_run(tmp_path: Path):
    act = (
        "import mmap\n"
        "for prot in (mmap.PROT_EXEC | mmap.PROT_READ, mmap.PROT_EXEC | mmap.PROT_READ | mmap.PROT_WRITE):\n"
        "    try:\n        mmap.mmap(-1, 4096, prot=prot)\n        print('mapped')\n"
        "    except OSError:\n        pass"
    )
    for readable in (None, tmp_path):
        done = run(act, readable=readable, more="import mmap\n")
        assert (b"mapped" in done.stdout, b"done" in done.stdout) == (False, True), done


def test_the_working_directory_and_pythonpath_are_no_part_of_the_program(tmp_path: Path, monkeypatch):
    (tmp_path / "scene").mkdir()
    secret = tmp_path / "api.key"
    secret.write_text("secret")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.chdir(tmp_path)
    assert not any(secret.is_relative_to(each) for each in sandbox.program_paths())
    paths = [path for path in sys.path if path]
    monkeypatch.setenv("PYTHONPATH", ":".join(paths))
    act = f"try:\n    os.open({str(secret)!r}, os.O_RDONLY)\n    print('opened')\nexcept OSError:\n    pass"
    done = run(act, readable=tmp_path / "scene")
    assert (b"opened" in done.stdout, b"done" in done.stdout) == (False, True), done


@pytest.mark.parametrize("below", ["", "site/scene"])
def test_a_folder_among_the_program_is_not_read(tmp_path: Path, below: str):
    (tmp_path / "site" / "scene").mkdir(parents=True)
    among = f"import lambent_sandbox.sandbox as s\ns._package_parents = lambda: [Path({str(tmp_path)!r})]\n"
    given = {"readable": tmp_path / below, "more": "from pathlib import Path\n" + among}
    done = run("", **given)
    assert b"is inside" in done.stderr, done
    assert b"done" not in done.stdout
    assert b"done" in run("", strictness="limits", **given).stdout


def test_packages_are_found_where_they_are_imported_from():
    parents = sandbox._package_parents()
    assert Path(sandbox.__file__).parents[1] in parents
    assert set(sandbox.PACKAGES) < set(installed.PACKAGES)


def test_reading_streams_and_threads_of_a_reader_work(tmp_path: Path):
    act = (
        "seen = []\n"
        "each = threading.Thread(target=lambda: seen.append(zlib.crc32(sys.stdin.buffer.read())))\n"
        "each.start(); each.join(); print(seen)"
    )
    done = run(act, readable=tmp_path, data=b"abc")
    assert done.stdout.split() == [b"[891568578]", b"done"], done


def test_every_layer_is_told_and_one_that_is_missing_is_an_error_where_all_are_required():
    assert run("print(layers.in_force, layers.missing)").stdout.splitlines()[0] == (
        b"('limits', 'privileges', 'files', 'calls') {}"
    )
    without = "import lambent_sandbox.landlock as l\nl.install = lambda paths: 'no such thing'\n"
    told = run("print(layers.missing)", more=without)
    assert told.stdout.splitlines()[0] == b"{'files': 'no such thing'}"
    refused = run("", more=without, strictness="required")
    assert b"this system has no files (no such thing)" in refused.stderr
    assert b"done" not in refused.stdout


def test_limits_alone_are_told_as_such():
    done = run("print(layers.in_force, sorted(layers.missing))", strictness="limits")
    assert done.stdout.splitlines()[0] == b"('limits',) ['calls', 'files', 'privileges']"


def test_both_machines_have_the_calls_that_open_connect_and_start():
    for table in calls.NUMBERS.values():
        needed = {"openat", "socket", "connect", "execve", "execveat", "clone", "clone3", "mmap", "mprotect"}
        assert needed | {"unlinkat", "renameat2", "ptrace", "io_uring_setup", "seccomp"} <= set(table)
        assert len(set(table.values())) == len(table)


def test_a_program_is_one_that_the_kernel_takes():
    for table in calls.NUMBERS:
        for rules in (filters.stream_rules(), filters.picture_rules()):
            assert 8 < len(filters.program(rules, table)) // 8 < 4096
