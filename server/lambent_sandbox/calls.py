"""Numbers of the Linux system calls that the filters name, and the flags that they look at.

Source: the tables of the kernel for x86-64 (`syscall_64.tbl`) and for 64-bit ARM (`asm-generic/unistd.h`).
"""

from typing import Final

X86_64: Final = "x86_64"
AARCH64: Final = "aarch64"

AUDIT_ARCH: Final = {X86_64: 0xC000003E, AARCH64: 0xC00000B7}

_X86_64_NUMBERS = """
    read=0 write=1 open=2 close=3 stat=4 fstat=5 lstat=6 poll=7 lseek=8 mmap=9 mprotect=10 munmap=11 brk=12
    rt_sigaction=13 rt_sigprocmask=14 rt_sigreturn=15 ioctl=16 pread64=17 readv=19 writev=20 access=21
    sched_yield=24 mremap=25 madvise=28 dup=32 nanosleep=35 getpid=39 socket=41 connect=42 accept=43
    sendto=44 sendmsg=46 bind=49 listen=50 socketpair=53 clone=56 fork=57 vfork=58 execve=59 exit=60 kill=62
    uname=63 fcntl=72 truncate=76 getcwd=79 rename=82 mkdir=83 rmdir=84 creat=85 link=86 unlink=87
    symlink=88 readlink=89 chmod=90 chown=92 lchown=94 gettimeofday=96 getrlimit=97 getrusage=98 sysinfo=99
    times=100 ptrace=101 getuid=102 getgid=104 setuid=105 setgid=106 geteuid=107 getegid=108 getppid=110
    sigaltstack=131 mknod=133 statfs=137 fstatfs=138 prctl=157 chroot=161 mount=165 gettid=186 setxattr=188
    time=201 futex=202 sched_getaffinity=204 getdents64=217 restart_syscall=219 fadvise64=221
    clock_gettime=228 clock_getres=229 clock_nanosleep=230 exit_group=231 tgkill=234 get_mempolicy=239
    openat=257 mkdirat=258 mknodat=259 fchownat=260 newfstatat=262 unlinkat=263 renameat=264 linkat=265
    symlinkat=266 readlinkat=267 fchmodat=268 faccessat=269 ppoll=271 unshare=272 set_robust_list=273
    accept4=288 preadv=295 prlimit64=302 sendmmsg=307 setns=308 getcpu=309 process_vm_readv=310
    process_vm_writev=311 renameat2=316 seccomp=317 getrandom=318 bpf=321 execveat=322 membarrier=324
    statx=332 rseq=334 io_uring_setup=425 clone3=435 openat2=437 faccessat2=439 fchmodat2=452
"""
_AARCH64_NUMBERS = """
    getcwd=17 dup=23 fcntl=25 ioctl=29 mknodat=33 mkdirat=34 unlinkat=35 symlinkat=36 linkat=37 renameat=38
    mount=40 statfs=43 fstatfs=44 truncate=45 faccessat=48 chroot=51 fchmodat=53 fchownat=54 openat=56
    close=57 getdents64=61 lseek=62 read=63 write=64 readv=65 writev=66 pread64=67 preadv=69 ppoll=73
    readlinkat=78 newfstatat=79 fstat=80 exit=93 exit_group=94 unshare=97 futex=98 set_robust_list=99
    nanosleep=101 clock_gettime=113 clock_getres=114 clock_nanosleep=115 ptrace=117 sched_getaffinity=123
    sched_yield=124 restart_syscall=128 kill=129 tgkill=131 sigaltstack=132 rt_sigaction=134
    rt_sigprocmask=135 rt_sigreturn=139 setgid=144 setuid=146 times=153 uname=160 getrlimit=163
    getrusage=165 prctl=167 getcpu=168 gettimeofday=169 getpid=172 getppid=173 getuid=174 geteuid=175
    getgid=176 getegid=177 gettid=178 sysinfo=179 setxattr=5 socket=198 socketpair=199 bind=200 listen=201
    accept=202 connect=203 sendto=206 sendmsg=211 brk=214 munmap=215 mremap=216 clone=220 execve=221
    mmap=222 fadvise64=223 mprotect=226 madvise=233 get_mempolicy=236 accept4=242 prlimit64=261 setns=268
    sendmmsg=269 process_vm_readv=270 process_vm_writev=271 renameat2=276 seccomp=277 getrandom=278 bpf=280
    execveat=281 membarrier=283 statx=291 rseq=293 io_uring_setup=425 clone3=435 openat2=437 faccessat2=439
    fchmodat2=452
"""


def _table(text: str) -> dict[str, int]:
    return {name: int(number) for name, number in (each.split("=") for each in text.split())}


NUMBERS: Final = {X86_64: _table(_X86_64_NUMBERS), AARCH64: _table(_AARCH64_NUMBERS)}
"""By machine; a call that a machine does not have is not in its table."""

LANDLOCK_CREATE_RULESET: Final = 444
LANDLOCK_ADD_RULE: Final = 445
LANDLOCK_RESTRICT_SELF: Final = 446

CLONE_THREAD: Final = 0x00010000
PROT_EXEC: Final = 0x4
MAP_ANONYMOUS: Final = 0x20
WRITING: Final = 0o3
"""O_WRONLY and O_RDWR."""
CREATING: Final = 0o100 | 0o1000 | 0o2000 | 0o20000000
"""O_CREAT, O_TRUNC, O_APPEND and the bit of O_TMPFILE that no other flag has."""
F_DUPFD: Final = 0
F_GETFD: Final = 1
F_SETFD: Final = 2
F_GETFL: Final = 3
F_DUPFD_CLOEXEC: Final = 1030
PR_SET_NAME: Final = 15
PR_GET_NAME: Final = 16
EPERM: Final = 1
ENOSYS: Final = 38
