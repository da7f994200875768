"""What containers forbid, put on this process: filters of system calls as their engines install them.

Facts of Docker's published default profile (``profiles/seccomp/default.json`` of Moby) for a process without
capabilities, and for the root of a container, who has fourteen: an allow list, here the other way round, by
the numbers of Linux's ``asm/unistd``.
"""

import ctypes
import errno
import os
import platform
import struct
import sys
from pathlib import Path

from cosim.ngspice.sandbox import _step

KINDS = ("docker", "docker, root", "older docker", "no user namespaces")
ROOTS_CAPABILITIES = 0xA80425FB
"""What Docker leaves to a container's root; of the calls below they allow chroot."""
ARCHITECTURES = {"x86_64": (0xC000003E, 0), "aarch64": (0xC00000B7, 1)}
SUPPORTED = (
    sys.platform.startswith("linux")
    and platform.machine() in ARCHITECTURES
    and "Seccomp:" in Path("/proc/self/status").read_text()
)

_LOAD, _EQUAL, _ABOVE, _ANY_BIT, _RETURN = 0x20, 0x15, 0x25, 0x45, 0x06
_ALLOW, _ERROR = 0x7FFF0000, 0x00050000
_NAMESPACES, _NEW_USER = 0x7E020000, 0x10000000
_PERSONALITIES = (0, 8, 0x20000, 0x20008, 0xFFFFFFFF)
_VSOCK = 40
_NEWEST = 450
"""Last call that the profile knows; the engine answers newer ones as a kernel without them would."""

_DENIED = {
    "syslog": (103, 116), "vhangup": (153, 58), "pivot_root": (155, 41), "chroot": (161, 51),
    "acct": (163, 89), "settimeofday": (164, 170), "mount": (165, 40), "umount2": (166, 39),
    "swapon": (167, 224), "swapoff": (168, 225), "reboot": (169, 142), "sethostname": (170, 161),
    "setdomainname": (171, 162), "iopl": (172, None), "ioperm": (173, None), "init_module": (175, 105),
    "delete_module": (176, 106), "quotactl": (179, 60), "nfsservctl": (180, 42), "lookup_dcookie": (212, 18),
    "clock_settime": (227, 112), "mbind": (237, 235), "set_mempolicy": (238, 237),
    "get_mempolicy": (239, 236), "kexec_load": (246, 104), "add_key": (248, 217), "request_key": (249, 218),
    "keyctl": (250, 219), "migrate_pages": (256, 238), "unshare": (272, 97), "move_pages": (279, 239),
    "perf_event_open": (298, 241), "fanotify_init": (300, 262), "open_by_handle_at": (304, 265),
    "setns": (308, 268), "kcmp": (312, 272), "finit_module": (313, 273), "kexec_file_load": (320, 294),
    "bpf": (321, 280), "userfaultfd": (323, 282), "uselib": (134, None), "ustat": (136, None),
    "sysfs": (139, None), "open_tree": (428, 428), "move_mount": (429, 429), "fsopen": (430, 430),
    "fsconfig": (431, 431), "fsmount": (432, 432), "fspick": (433, 433), "pidfd_getfd": (438, 438),
    "process_madvise": (440, 440), "mount_setattr": (442, 442), "quotactl_fd": (443, 443),
    "set_mempolicy_home_node": (450, 450),
    # since Docker 25
    "io_uring_setup": (425, 425), "io_uring_enter": (426, 426), "io_uring_register": (427, 427),
}  # fmt: skip
_LANDLOCK = (444, 445, 446)
_UNSHARE, _CLONE, _CLONE3, _PERSONALITY, _SOCKET = (272, 97), (56, 220), (435, 435), (135, 92), (41, 198)


def _error(number: int) -> bytes:
    return _step(_RETURN, _ERROR | number)


def program(kind: str, machine: str) -> bytes:
    """Return the filter of one of `KINDS`."""
    arch, column = ARCHITECTURES[machine]
    allow, refuse = _step(_RETURN, _ALLOW), _error(errno.EPERM)

    def denied(number: int, answer: bytes = refuse) -> bytes:
        return _step(_EQUAL, number, 0, 1) + answer

    def with_argument(number: int, rows: bytes) -> bytes:
        body = _step(_LOAD, 16) + rows  # the lower half of the first argument
        return _step(_EQUAL, number, 0, len(body) // 8) + body

    def without_bits(bits: int) -> bytes:
        return _step(_ANY_BIT, bits, 0, 1) + refuse + allow

    out = _step(_LOAD, 4) + _step(_EQUAL, arch, 1, 0) + refuse + _step(_LOAD, 0)
    if kind == "no user namespaces":  # as where a setting of the kernel forbids them
        out += with_argument(_UNSHARE[column], without_bits(_NEW_USER))
        out += with_argument(_CLONE[column], without_bits(_NEW_USER))
        return out + denied(_CLONE3[column], _error(errno.ENOSYS)) + allow
    if kind == "older docker":  # than Landlock
        out += b"".join(denied(number) for number in _LANDLOCK)
    out += _step(_ABOVE, _NEWEST, 0, 1) + _error(errno.ENOSYS)
    out += with_argument(_CLONE[column], without_bits(_NAMESPACES))
    out += denied(_CLONE3[column], _error(errno.ENOSYS))
    each = b"".join(_step(_EQUAL, value, 0, 1) + allow for value in _PERSONALITIES)
    out += with_argument(_PERSONALITY[column], each + refuse)
    out += with_argument(_SOCKET[column], _step(_EQUAL, _VSOCK, 0, 1) + refuse + allow)
    numbers = [row[column] for name, row in _DENIED.items() if (name, kind) != ("chroot", "docker, root")]
    return out + b"".join(denied(number) for number in numbers if number is not None) + allow


def _keep(libc: ctypes.CDLL, capabilities: int) -> None:
    """Give up all other capabilities of this process, and of the programs it starts."""
    number = 0
    while (known := libc.prctl(23, number, 0, 0, 0)) >= 0:  # PR_CAPBSET_READ, an error behind the last one
        if known and not capabilities >> number & 1:
            libc.prctl(24, number, 0, 0, 0)  # PR_CAPBSET_DROP
        number += 1
    rows = Path("/proc/self/status").read_text().splitlines()
    capabilities &= next(int(row.split()[1], 16) for row in rows if row.startswith("CapPrm:"))
    low, high = capabilities & 0xFFFFFFFF, capabilities >> 32
    sets = struct.pack("=6I", low, low, 0, high, high, 0)  # effective, permitted, inheritable
    if libc.capset(struct.pack("=Ii", 0x20080522, 0), sets) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def enter(kind: str) -> dict[str, int]:
    """Put the filter on this process, for good; return what the kernel then says to some calls (errno)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if kind == "docker, root":
        _keep(libc, ROOTS_CAPABILITIES)
    rows = program(kind, platform.machine())
    kept = ctypes.create_string_buffer(rows, len(rows))

    class Head(ctypes.Structure):
        _fields_ = [("count", ctypes.c_ushort), ("rows", ctypes.c_void_p)]

    head = Head(len(rows) // 8, ctypes.addressof(kept))
    for call in ((38, 1, 0, 0, 0), (22, 2, ctypes.byref(head), 0, 0)):  # no new privileges; the filter
        if libc.prctl(*call) != 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))
    column = ARCHITECTURES[platform.machine()][1]

    def answer(number: int, *arguments: int) -> int:
        ctypes.set_errno(0)
        return ctypes.get_errno() if libc.syscall(number, *arguments) < 0 else 0

    return {
        "a user namespace": answer(_UNSHARE[column], _NEW_USER),
        "a process in one": answer(_CLONE[column], _NEW_USER | 17, 0, 0, 0, 0),
        "clone3": answer(_CLONE3[column], 0, 0),
        "a key": answer(_DENIED["keyctl"][column] or 0, 0, 0, 0),
        "another personality": answer(_PERSONALITY[column], 0x0040000),
        "the same personality": answer(_PERSONALITY[column], 0xFFFFFFFF),
        "version of Landlock": answer(_LANDLOCK[0], 0, 0, 1),
    }
