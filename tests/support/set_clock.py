"""A clock that a test sets, for programs in processes of their own: a library that is loaded before others.

It changes what `clock_gettime(CLOCK_REALTIME)`, `gettimeofday` and `time` answer by the number of seconds in
a file. Monotonic clocks, which no one can set, are left alone, and so are the times of files.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

_SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long offset_s(void) {
    const char *path = getenv("LAMBENT_TEST_CLOCK");
    char text[32] = {0};
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return 0;
    ssize_t count = read(file, text, sizeof text - 1);
    close(file);
    return count > 0 ? atol(text) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *at) {
    static int (*original)(clockid_t, struct timespec *);
    if (!original) original = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = original(clock, at);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) at->tv_sec += offset_s();
    return failed;
}

int gettimeofday(struct timeval *restrict at, void *restrict zone) {
    struct timespec now;
    (void)zone;
    int failed = clock_gettime(CLOCK_REALTIME, &now);
    if (!failed) { at->tv_sec = now.tv_sec; at->tv_usec = now.tv_nsec / 1000; }
    return failed;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}
"""


class SetClock:
    """The clock of the processes that are started with `environment`; it shows the real time at first."""

    def __init__(self, folder: Path) -> None:
        compiler = shutil.which("gcc") or shutil.which("cc")
        if compiler is None:
            pytest.skip("no C compiler for the library that changes a clock")
        folder.mkdir(parents=True, exist_ok=True)
        source, library = folder / "clock.c", folder / "clock.so"
        source.write_text(_SOURCE, encoding="utf-8")
        command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
        subprocess.run(command, check=True, capture_output=True)
        self._file = folder / "offset"
        self.offset_s = 0
        self.set(0)
        self.environment = {"LD_PRELOAD": str(library), "LAMBENT_TEST_CLOCK": str(self._file)}

    def set(self, offset_s: int) -> None:
        """Let the clock be ahead of the real time by `offset_s` seconds, behind it if that is negative."""
        partial = self._file.with_suffix(".tmp")
        partial.write_text(str(offset_s), encoding="ascii")
        partial.replace(self._file)
        self.offset_s = offset_s

    def jump(self, seconds: int) -> None:
        """Set the clock forward or back."""
        self.set(self.offset_s + seconds)
