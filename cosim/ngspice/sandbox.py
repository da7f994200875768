"""What the kernel lets a child process do: the last line of defence behind all checks of a netlist.

Linux only, without privileges, a program or user namespaces: limits of resources, a filter of system calls
(seccomp: no program is started, no process made, no socket opened, no other process touched) and rules of
files (Landlock: what it reads and writes is listed). Where a kernel offers less, the rest still holds;
`applied` states what is in force. Elsewhere a child is a process with limits of its own, no more.

Numbers are those of Linux's ``asm/unistd``, ``linux/seccomp.h`` and ``linux/landlock.h``.
"""

import ctypes
import errno
import os
import platform
import struct
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Status", "applied", "confine", "limit_cpu", "processor_s"]

_MOST_FILE_BYTES = 64 << 30
"""Largest file a child may write: a run of some hundred million rows."""
_MEMORY_SHARE = 0.9
"""Of the machine's memory, for the data of one child."""

_NO_NEW_PRIVS, _SET_SECCOMP, _FILTER = 38, 22, 2
_ALLOW, _KILL, _REFUSE = 0x7FFF0000, 0x80000000, 0x00050000
_THREAD = 0x00010000  # CLONE_THREAD
_X32 = 0x40000000
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER_AT, _ARCH_AT, _FIRST_ARGUMENT_AT = 0, 4, 16

_ARCHITECTURES = {"x86_64": (0xC000003E, 0), "aarch64": (0xC00000B7, 1)}
"""Machine -> seccomp's number for it, and the column of `_DENIED`."""
_DENIED: dict[str, tuple[int | None, int | None]] = {
    # programs and processes
    "execve": (59, 221), "execveat": (322, 281), "fork": (57, None), "vfork": (58, None),
    # sockets, and io_uring, which opens some past this filter
    "socket": (41, 198), "socketpair": (53, 199), "connect": (42, 203), "bind": (49, 200),
    "listen": (50, 201), "accept": (43, 202), "accept4": (288, 242),
    "io_uring_setup": (425, 425), "io_uring_enter": (426, 426), "io_uring_register": (427, 427),
    # other processes
    "ptrace": (101, 117), "process_vm_readv": (310, 270), "process_vm_writev": (311, 271),
    "tkill": (200, 130), "rt_sigqueueinfo": (129, 138), "rt_tgsigqueueinfo": (297, 240),
    "pidfd_open": (434, 434), "pidfd_send_signal": (424, 424), "pidfd_getfd": (438, 438),
    "process_madvise": (440, 440),
    # the kernel and the machine
    "bpf": (321, 280), "perf_event_open": (298, 241), "userfaultfd": (323, 282), "keyctl": (250, 219),
    "add_key": (248, 217), "request_key": (249, 218), "init_module": (175, 105), "finit_module": (313, 273),
    "delete_module": (176, 106), "kexec_load": (246, 104), "kexec_file_load": (320, 294),
    "reboot": (169, 142),
    "swapon": (167, 224), "swapoff": (168, 225), "acct": (163, 89), "quotactl": (179, 60),
    "settimeofday": (164, 170), "clock_settime": (227, 112), "adjtimex": (159, 171),
    "clock_adjtime": (305, 266), "sethostname": (170, 161), "setdomainname": (171, 162),
    "syslog": (103, 116), "personality": (135, 92), "ioperm": (173, None), "iopl": (172, None),
    "modify_ldt": (154, None),
    # other views of the file system, and what Landlock has no rule for
    "mount": (165, 40), "umount2": (166, 39), "pivot_root": (155, 41), "chroot": (161, 51),
    "setns": (308, 268), "unshare": (272, 97), "open_tree": (428, 428), "move_mount": (429, 429),
    "fsopen": (430, 430), "fsconfig": (431, 431), "fsmount": (432, 432), "fspick": (433, 433),
    "mount_setattr": (442, 442), "name_to_handle_at": (303, 264), "open_by_handle_at": (304, 265),
    "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "fchmodat2": (452, 452),
    "chown": (92, None), "fchown": (93, 55), "lchown": (94, None), "fchownat": (260, 54),
    "setxattr": (188, 5), "lsetxattr": (189, 6), "fsetxattr": (190, 7), "setxattrat": (463, 463),
    "removexattr": (197, 14), "lremovexattr": (198, 15), "fremovexattr": (199, 16),
}  # fmt: skip
_CLONE, _CLONE3, _KILL_OWN, _PRLIMIT = (56, 220), (435, 435), ((62, 129), (234, 131)), (302, 261)

_LANDLOCK_CREATE, _LANDLOCK_ADD, _LANDLOCK_RESTRICT = 444, 445, 446
_FIRST_RIGHTS = 13  # of files, in the first version
_MORE_RIGHTS = ((2, 1 << 13), (3, 1 << 14), (5, 1 << 15))  # refer, truncate, ioctl of devices
_READ = (1 << 2) | (1 << 3)  # files, folders
_OF_FILES = (1 << 0) | (1 << 1) | (1 << 2) | (1 << 14) | (1 << 15)
_UNNEEDED = (1 << 0) | (1 << 6) | (1 << 9) | (1 << 10) | (1 << 11) | (1 << 15)  # execute, devices, sockets
_NETWORK, _SCOPED = 0b11, 0b11

_SYSTEM = (
    "/usr", "/lib", "/lib64", "/opt/homebrew", "/nix/store", "/gnu/store", "/etc/ld.so.cache",
    "/etc/ld.so.preload", "/etc/localtime", "/etc/timezone", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat",
    "/proc/filesystems",
    "/proc/sys/vm", "/proc/self", "/sys/devices/system", "/sys/fs/cgroup", "/dev/urandom", "/dev/random",
)  # fmt: skip
"""What libraries read by themselves."""


@dataclass(frozen=True)
class Status:
    """Which parts of the sandbox this system offers.

    Attributes
    ----------
    seccomp
        Whether system calls are filtered.
    landlock
        Version of Landlock, 0 where files are not limited.
    """

    seccomp: bool
    landlock: int

    def __str__(self) -> str:
        calls = "no programs, processes or sockets (seccomp)" if self.seccomp else "system calls NOT filtered"
        files = (
            f"only listed files (Landlock {self.landlock})"
            if self.landlock
            else "files NOT limited: no Landlock"
        )
        return f"{calls}; {files}; limits of CPU, memory and file size"


_applied = Status(False, 0)


def confine(reads: Iterable[str], writes: Iterable[str]) -> Status:
    """Give up, for good, all that a simulation does not need. To be called before any thread starts.

    Parameters
    ----------
    reads, writes
        Files and folders; what is not there is left out. Python's own and the system's libraries are read
        anyway. What may be written may be read.

    Returns
    -------
    Status
        What was done.
    """
    global _applied
    _limit_resources()
    if sys.platform.startswith("linux"):
        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(_NO_NEW_PRIVS, 1, 0, 0, 0)
        version = _limit_files(libc, [*_SYSTEM, *_python(), *reads], ["/dev/null", *writes])
        _applied = Status(_filter_calls(libc), version)
    return _applied


def applied() -> Status:
    """Return what this process has given up."""
    return _applied


def limit_cpu(seconds: float | None) -> None:
    """Let this process compute for this much longer, all threads together; without limit at ``None``."""
    try:
        import resource
    except ImportError:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    last = resource.getrlimit(resource.RLIMIT_CPU)[1]
    soft = last if seconds is None else int(used.ru_utime + used.ru_stime + seconds) + 1
    resource.setrlimit(
        resource.RLIMIT_CPU, (soft if last == resource.RLIM_INFINITY else min(soft, last), last)
    )


def processor_s() -> float:
    """Return the processor time [s] of this process, all threads together.

    Under `limit_cpu` Linux reads ``time.process_time`` from a count that only ticks (4 ms); usage does not.
    """
    try:
        import resource
    except ImportError:  # Windows
        return time.process_time()
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _limit_resources() -> None:
    """Set limits of memory and of files, and no core dumps."""
    try:
        import resource
    except ImportError:  # Windows
        return
    memory = int(_MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    wanted = (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, _MOST_FILE_BYTES),
        (resource.RLIMIT_DATA, memory),
    )
    for which, most in wanted:
        last = resource.getrlimit(which)[1]
        least = most if last == resource.RLIM_INFINITY else min(most, last)
        resource.setrlimit(which, (least, least))


def _python() -> list[str]:
    """Return where this Python and its modules are."""
    here = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    named = os.environ.get("NGSPICE_LIBRARY_PATH")
    prefix = [os.path.dirname(os.path.dirname(os.path.realpath(named)))] if named else []
    return [
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        here,
        *prefix,
        *(entry for entry in sys.path if entry),
    ]


# ---- files


def _landlock_version(libc: ctypes.CDLL) -> int:
    return int(libc.syscall(_LANDLOCK_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint32(1)))


def _limit_files(libc: ctypes.CDLL, reads: list[str], writes: list[str]) -> int:
    """Allow these files only; return Landlock's version, 0 where there is none."""
    version = _landlock_version(libc)
    if version < 1:
        return 0
    rights = (1 << _FIRST_RIGHTS) - 1
    for since, right in _MORE_RIGHTS:
        rights |= right if version >= since else 0
    fields = [rights, _NETWORK if version >= 4 else 0, _SCOPED if version >= 6 else 0]
    known = fields[: 1 + (version >= 4) + (version >= 6)]
    attributes = struct.pack(f"={len(known)}Q", *known)
    rules = libc.syscall(_LANDLOCK_CREATE, attributes, ctypes.c_size_t(len(attributes)), ctypes.c_uint32(0))
    if rules < 0:
        return 0
    try:
        for path in dict.fromkeys(reads):
            _allow(libc, rules, path, rights & _READ)
        for path in dict.fromkeys(writes):
            _allow(libc, rules, path, rights & ~_UNNEEDED)
        return version if libc.syscall(_LANDLOCK_RESTRICT, rules, ctypes.c_uint32(0)) == 0 else 0
    finally:
        os.close(rules)


def _allow(libc: ctypes.CDLL, rules: int, path: str, rights: int) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:  # what is not there cannot be read either
        return
    try:
        if not os.path.isdir(path):
            rights &= _OF_FILES
        rule = struct.pack("=Qi", rights, place)
        if libc.syscall(_LANDLOCK_ADD, rules, 1, rule, ctypes.c_uint32(0)) != 0:
            code = ctypes.get_errno()
            raise OSError(code, f"Landlock refuses a rule for {path}: {os.strerror(code)}")
    finally:
        os.close(place)


# ---- system calls


def _step(code: int, value: int, then: int = 0, otherwise: int = 0) -> bytes:
    return struct.pack("=HBBI", code, then, otherwise, value)


def _program(machine: str, pid: int) -> bytes:
    """Return the filter for this process (its own signals, as `abort` sends, pass)."""
    arch, column = _ARCHITECTURES[machine]
    refuse = _step(_RETURN, _REFUSE | errno.EPERM)
    allow = _step(_RETURN, _ALLOW)

    def only_with(call: int, code: int, value: int) -> bytes:
        """Allow a call whose first argument is such."""
        return (
            _step(_EQUAL, call, 0, 4)
            + _step(_LOAD, _FIRST_ARGUMENT_AT)
            + _step(code, value, 0, 1)
            + allow
            + refuse
        )

    out = _step(_LOAD, _ARCH_AT) + _step(_EQUAL, arch, 1, 0) + _step(_RETURN, _KILL)
    out += _step(_LOAD, _NUMBER_AT)
    if machine == "x86_64":
        out += _step(_AT_LEAST, _X32, 0, 1) + refuse
    out += only_with(_CLONE[column], _ANY_BIT, _THREAD)
    # its flags are in memory, where a filter cannot look: the C library takes the older call then
    out += _step(_EQUAL, _CLONE3[column], 0, 1) + _step(_RETURN, _REFUSE | errno.ENOSYS)
    out += b"".join(only_with(call[column], _EQUAL, pid) for call in _KILL_OWN)
    out += only_with(_PRLIMIT[column], _EQUAL, 0)
    for numbers in _DENIED.values():
        number = numbers[column]
        if number is not None:
            out += _step(_EQUAL, number, 0, 1) + refuse
    return out + allow


def _filter_calls(libc: ctypes.CDLL) -> bool:
    """Install the filter; return whether the kernel took it."""
    machine = platform.machine()
    if machine not in _ARCHITECTURES:
        return False
    program = _program(machine, os.getpid())
    kept = ctypes.create_string_buffer(program, len(program))
    head = struct.pack("=H6xQ", len(program) // 8, ctypes.addressof(kept))
    return bool(libc.prctl(_SET_SECCOMP, _FILTER, head, 0, 0) == 0)
