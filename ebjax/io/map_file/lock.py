"""One writer at a time: an advisory lock on FILE.lock that ends with its process, however that ends."""

import contextlib
import json
import os
import socket
from datetime import UTC, datetime
from pathlib import Path

from ebjax.io.one_line import printable

NETWORK = frozenset(
    "nfs nfs4 cifs smb3 smbfs 9p afs ceph glusterfs lustre beegfs gpfs ncpfs davfs fuse.sshfs fuse.ceph fuse.glusterfs "
    "fuse.rclone fuse.s3fs fuse.gcsfuse fuse.davfs2 fuse.curlftpfs".split()
)


class Locked(OSError):  # noqa: N818 - the state of a file
    """Another process, or another part of this one, writes to the map."""


class WriterLock:
    """The lock of a map's file; taken when made."""

    def __init__(self, path: Path):
        """Takes the lock.

        Args:
          path: of the map, links resolved.

        Raises:
          Locked: it is taken; names process and host, and what to do.
          OSError: the folder cannot be written, or lies on a network file system, where locks and SQLite fail.
        """
        self.path = path.with_name(f"{path.name}.lock")
        kind = file_system(path)
        if kind in NETWORK:
            raise OSError(f"{path}: is on a network file system ({kind}); keep the map on a disk of this machine")
        self._file, self._kept = _locked(path, self.path), False
        holder = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat("T", "seconds"),
        }
        with contextlib.suppress(OSError):  # a full disk: nobody learns who holds it
            os.ftruncate(self._file, 0)
            os.write(self._file, json.dumps(holder).encode())

    def __enter__(self) -> "WriterLock":
        return self

    def __exit__(self, *stop: object) -> None:
        """Frees the lock, unless the block passed it on with `kept`."""
        if not self._kept:
            self.release()

    def kept(self) -> "WriterLock":
        """The lock, for whoever frees it."""
        self._kept = True
        return self

    def release(self) -> None:
        """Removes the file, then frees the lock: nobody can lock a file that no longer has the name."""
        if self._file >= 0:
            with contextlib.suppress(OSError):
                self.path.unlink()
            os.close(self._file)
            self._file = -1


def _locked(path: Path, lock: Path) -> int:
    try:
        import fcntl
    except ImportError:
        raise OSError(f"{path}: a map is written on Linux and macOS only; on Windows use WSL") from None
    while True:
        file = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _same(file, lock):
                return file
        except BlockingIOError:
            holder = _holder(file)
            os.close(file)
            raise Locked(f"{path}: {holder} writes to it; wait until it has ended, or end it") from None
        except OSError as fault:
            os.close(file)
            raise OSError(fault.errno, f"cannot be locked ({fault.strerror})", str(lock)) from None
        os.close(file)  # its holder removed it in between


def _same(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _holder(file: int) -> str:
    try:
        said = json.loads(os.pread(file, 4096, 0))
        pid, host, since = int(said["pid"]), str(said["host"]), str(said["since"])
    except (ValueError, KeyError, TypeError):
        return "another process"  # it has locked, and not yet written
    if (pid, host) == (os.getpid(), socket.gethostname()):
        return f"this process itself (since {printable(since)[:40]})"
    return f"process {pid} on {printable(host)[:80]} (since {printable(since)[:40]})"


def file_system(path: Path, mounts: Path = Path("/proc/self/mounts")) -> str:
    """The type of the file system that holds a path, as Linux names it; "" where that is not known."""
    try:
        lines = mounts.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return ""
    found, kind = -1, ""
    for line in lines:
        fields = line.split(" ")
        if len(fields) < 3:
            continue
        # Blanks in names are written as octal escapes.
        folder = Path(fields[1].replace("\\040", " ").replace("\\011", "\t").replace("\\134", "\\"))
        if path.is_relative_to(folder) and len(folder.parts) >= found:
            found, kind = len(folder.parts), fields[2]
    return kind
