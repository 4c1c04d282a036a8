"""Kills, full disks, locks and rights: one line, nothing lost that was acknowledged, and the map goes on."""

import hashlib
import importlib
import multiprocessing
import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ebjax.io.map_file import checkpoints
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.lock import Locked, WriterLock, file_system
from ebjax.io.map_file.repair import repair

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
made = importlib.import_module("small_maps")
FACTS, append, arrays_of, assert_arrays, assert_filled, filled, keyframe_of = (
    getattr(made, name) for name in "FACTS append arrays_of assert_arrays assert_filled filled keyframe_of".split()
)
NOBODY = 65534


def begun(path, count=0):
    with MapFile.create(path, FACTS) as kept:
        kept.begin_session("monday.bag", {})
        for number in range(count):
            append(kept, number)
    return path


def writer(path, size=300):
    """A process that appends until it is killed, and the first keyframe that it has acknowledged."""
    code = f"import sys; sys.path[:0] = {[str(HERE), str(HERE.parents[2])]}; import small_maps"
    code += f"; small_maps.append_until_killed({str(path)!r}, {size})"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    return process, int(process.stdout.readline())


def killed(path, size=300, after_s=0.0):
    """Kills a writer; returns the last keyframe that it acknowledged."""
    process, first = writer(path, size)
    time.sleep(after_s)
    process.kill()
    said = process.communicate()[0].split("\n")[:-1]
    assert process.returncode == -signal.SIGKILL
    return int(said[-1]) if said else first


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_appended(kept, last):
    """Everything up to the last acknowledged keyframe, at most one more, and nothing half."""
    keyframes, edges, frames = kept.keyframes(), kept.edges(), kept.frames()
    count = len(keyframes)
    assert last is None or count in (last + 1, last + 2)
    assert keyframes.id.tolist() == frames.keyframe.tolist() == list(range(count))
    assert len(edges) == max(2 * count - 3, 0)
    for number in (0, count // 2, count - 1):
        assert_arrays(kept.arrays(number), arrays_of(number, kept.arrays(number)["view"].size - number % 7))
    return count


def test_killed_at_any_moment(tmp_path):
    path, rng, count = begun(tmp_path / "a.ebmap"), np.random.default_rng(os.getpid()), 0
    for _ in range(5):
        last = killed(path, after_s=rng.uniform(0, 0.2))
        before = digest(path)
        with MapFile.open(path, write=False) as kept:
            found = check_appended(kept, last)
        assert digest(path) == before and found > count
        count = found
    with MapFile.open(path, write=True) as kept:
        assert check_appended(kept, last) == count
    assert os.listdir(tmp_path) == [path.name]


def test_killed_while_pages_move_into_the_file(tmp_path):
    path = begun(tmp_path / "a.ebmap")
    last = killed(path, size=400_000, after_s=0.5)
    report = repair(path, tmp_path / "saved.ebmap")
    assert not report.lost
    for file in (path, report.out):
        with MapFile.open(file, write=False) as kept:
            check_appended(kept, last)


@pytest.mark.parametrize("seed", range(3))
def test_a_power_cut_leaves_whole_keyframes(tmp_path, seed):
    path = begun(tmp_path / "a.ebmap")
    last = killed(path, after_s=0.1)
    log, rng = tmp_path / "a.ebmap-wal", np.random.default_rng(seed)
    (tmp_path / "a.ebmap-shm").unlink()
    # What the disk has of the log: some of it, and of its end some pages that never came.
    content = bytearray(log.read_bytes()[: int(rng.integers(log.stat().st_size // 2, log.stat().st_size))])
    content[-int(rng.integers(1, 3000)) :] = b""
    log.write_bytes(content + bytes(5000))
    with MapFile.open(path, write=True) as kept:
        count = len(kept.keyframes())
        assert 0 <= count <= last + 2
        append(kept, count)
        check_appended(kept, count)


def test_the_log_stays_short_while_a_writer_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "LOG_BYTES", 200_000)
    with MapFile.create(tmp_path / "a.ebmap", FACTS) as kept:
        kept.begin_session("monday.bag", {})
        longest = 0
        for number in range(150):
            append(kept, number, size=20_000)
            longest = max(longest, (tmp_path / "a.ebmap-wal").stat().st_size)
            time.sleep(0.002)
        assert longest < 2_000_000 < (tmp_path / "a.ebmap").stat().st_size
        check_appended(kept, 149)


def test_a_reader_looks_while_a_writer_writes(tmp_path):
    path = begun(tmp_path / "a.ebmap")
    process, _ = writer(path, 20_000)
    seen = []
    with MapFile.open(path, write=False) as kept:
        for _ in range(6):
            with kept.snapshot():
                seen.append(check_appended(kept, None))
                time.sleep(0.01)
                assert check_appended(kept, None) == seen[-1]
    assert seen == sorted(seen) and seen[-1] > seen[0]
    with pytest.raises(Locked) as fault:
        MapFile.open(path, write=True)
    words = f"process {process.pid} on {socket.gethostname()} (since "
    assert words in str(fault.value) and "wait until it has ended, or end it" in str(fault.value)
    with pytest.raises(Locked, match="writes to it"):
        repair(path, tmp_path / "saved.ebmap")
    process.kill()
    process.communicate()
    with MapFile.open(path, write=True) as kept:
        assert check_appended(kept, None) >= seen[-1]


def test_one_writer_in_a_process_too(tmp_path):
    path = begun(tmp_path / "a.ebmap")
    with MapFile.open(path, write=True), pytest.raises(Locked, match=r"a\.ebmap: this process itself \(since "):
        MapFile.open(path, write=True)
    (tmp_path / "link.ebmap").symlink_to(path)
    with MapFile.open(tmp_path / "link.ebmap", write=True), pytest.raises(Locked, match="this process itself"):
        MapFile.open(path, write=True)
    MapFile.open(path, write=True).close()


def test_the_lock_of_a_dead_process_is_free(tmp_path):
    lock = tmp_path / "a.ebmap.lock"
    lock.write_text("not what a process of ours wrote")
    with WriterLock(tmp_path / "a.ebmap"):
        assert f'"pid": {os.getpid()}' in lock.read_text()
    assert not lock.exists()


def test_closed_while_a_reader_stays(tmp_path):
    path = begun(tmp_path / "a.ebmap", 3)
    kept = MapFile.open(path, write=True)
    with MapFile.open(path, write=False) as reader:
        append(kept, 3)
        assert len(reader.keyframes()) == 4
        begin = time.monotonic()
        kept.close()
        assert time.monotonic() - begin < 2
        assert len(reader.keyframes()) == 4
        with MapFile.open(path, write=True) as kept:
            append(kept, 4)
            assert len(reader.keyframes()) == 5
    with MapFile.open(path, write=True) as kept:
        append(kept, 5)
    assert os.listdir(tmp_path) == [path.name]


def test_another_program_holds_a_transaction(tmp_path, monkeypatch):
    path = begun(tmp_path / "a.ebmap", 2)
    monkeypatch.setattr("ebjax.io.map_file.connection.WAIT_S", 0.05)
    with MapFile.open(path, write=True) as kept:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(Locked, match=r"another program has it open .*; close it and try again"):
            append(kept, 2)
        other.execute("ROLLBACK")
        other.close()
        append(kept, 2)
        check_appended(kept, 2)


def test_a_full_disk_loses_nothing_and_the_map_goes_on(tmp_path):
    path = begun(tmp_path / "a.ebmap", 3)
    with MapFile.open(path, write=True) as kept:
        most = kept._database.execute("PRAGMA max_page_count").fetchone()[0]
        kept._database.execute("PRAGMA max_page_count = 40")
        with pytest.raises(
            OSError, match="the disk is full; make room and go on: what was acknowledged is kept"
        ) as fault:
            for number in range(3, 100):
                append(kept, number, size=20_000)
        assert fault.value.filename == str(path)
        check_appended(kept, number - 1)
        kept._database.execute(f"PRAGMA max_page_count = {most}")
        append(kept, number, size=20_000)
        check_appended(kept, number)
    with MapFile.open(path, write=False) as kept:
        check_appended(kept, number)


FULL = """
import sys; sys.path[:0] = {paths}
import resource, signal, small_maps
from ebjax.io.map_file.file import MapFile
kept = MapFile.open({path!r}, write=True)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, resource.RLIM_INFINITY))
try:
    for number in range(1, 1000):
        small_maps.append(kept, number, size=20_000)
except OSError as fault:
    print(number, fault.strerror)
print(len(kept.keyframes()))
try:
    kept.close()
except OSError as fault:
    print(fault.strerror)
"""


def test_a_file_that_may_not_grow(tmp_path):
    path = begun(tmp_path / "a.ebmap", 1)
    code = FULL.format(paths=[str(HERE), str(HERE.parents[2])], path=str(path))
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    number, words = said.stdout.splitlines()[0].split(" ", 1)
    assert re.fullmatch(r"the disk .*; make room( or check it)?.*: what was acknowledged is kept", words)
    assert not said.stderr and said.stdout.splitlines()[1] == number
    for words in said.stdout.splitlines()[2:]:
        assert re.fullmatch(r"is not tidied up \(.*\); keep a.ebmap-wal beside it", words)
    with MapFile.open(path, write=True) as kept:
        check_appended(kept, int(number) - 1)
        append(kept, int(number))


SHRINK = """
import sys; sys.path[:0] = {paths}
import resource, signal, small_maps
from ebjax.io.map_file.file import MapFile
kept = MapFile.open({path!r}, write=True)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))
kept.forget(1)
print(*kept.notes)
kept.close()
"""


def test_no_room_to_shrink_is_said_and_the_session_is_forgotten(tmp_path):
    path = filled(tmp_path / "a.ebmap", 3, 5_000)
    with MapFile.open(path, write=True) as kept:
        second = kept.begin_session("tuesday", {})
        for number in range(3, 20):
            kept.append(keyframe_of(number, second), arrays_of(number, 50_000))
    before = path.stat().st_size
    code = SHRINK.format(paths=[str(HERE), str(HERE.parents[2])], path=str(path))
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert re.fullmatch(r".*a\.ebmap: done, but it keeps its size until it is written again \(the disk .*\)\n", said)
    assert path.stat().st_size == before
    with MapFile.open(path, write=False) as kept:
        assert [row.id for row in kept.sessions()] == [second] and len(kept.keyframes()) == 17
        assert_arrays(kept.arrays(19), arrays_of(19, 50_000))


def as_nobody(call, *arguments):
    """Calls in a process without root's rights; returns what it returned, or what it raised."""

    def run(pipe):
        if os.getuid() == 0:
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        try:
            pipe.send(call(*arguments))
        except (OSError, ValueError) as fault:
            pipe.send(f"{type(fault).__name__}: {fault}")

    context = multiprocessing.get_context("fork")
    mine, theirs = context.Pipe()
    process = context.Process(target=run, args=(theirs,))
    process.start()
    said = mine.recv()
    process.join()
    return said


def look(path):
    with MapFile.open(path, write=False) as kept:
        return len(kept.keyframes()), kept.notes


@pytest.fixture
def locked_folder(tmp_path):
    """A folder in which nobody but root can write, below folders that all can enter."""
    for folder in (tmp_path, *tmp_path.parents):
        if not folder.stat().st_mode & 0o001:
            folder.chmod(0o755)
    folder = tmp_path / "folder"
    folder.mkdir()
    yield folder
    folder.chmod(0o755)


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_a_folder_that_cannot_be_written(locked_folder):
    path = filled(locked_folder / "a.ebmap")
    before = digest(path)
    locked_folder.chmod(0o555)
    assert as_nobody(look, path) == (12, ())
    assert digest(path) == before and os.listdir(locked_folder) == ["a.ebmap"]

    def write():
        MapFile.open(path, write=True)

    assert re.fullmatch(r"PermissionError: .*a\.ebmap\.lock'", as_nobody(write))


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_a_killed_writers_map_in_a_folder_that_cannot_be_written(locked_folder):
    path = begun(locked_folder / "a.ebmap", 2)
    last = killed(path)
    locked_folder.chmod(0o555)
    count, notes = as_nobody(look, path)
    assert count >= last + 1 and not notes
    locked_folder.chmod(0o755)
    (locked_folder / "a.ebmap-shm").unlink()
    locked_folder.chmod(0o555)
    said = as_nobody(look, path)
    assert "its writer did not close it" in said and "copy it and a.ebmap-wal into a folder of yours" in said
    # The remedy:
    locked_folder.chmod(0o755)
    mine = locked_folder / "mine"
    mine.mkdir()
    for name in ("a.ebmap", "a.ebmap-wal"):
        (mine / name).write_bytes((locked_folder / name).read_bytes())
    assert look(mine / "a.ebmap") == (count, ())
    (locked_folder / "a.ebmap-wal").unlink()
    locked_folder.chmod(0o555)
    found, (note,) = as_nobody(look, path)
    assert found <= count and "was not closed, and a.ebmap-wal is not beside it" in note


def test_a_read_only_file(tmp_path):
    path = filled(tmp_path / "a.ebmap")
    path.chmod(0o444)
    with pytest.raises(OSError, match=r"is read-only; allow writing \(chmod u\+w\), or give a copy of it"):
        MapFile.open(path, write=True)
    with MapFile.open(path, write=False) as kept:
        assert_filled(kept)
    path.chmod(0o644)
    MapFile.open(path, write=True).close()


def test_an_earlier_maps_log_is_not_taken_for_a_new_ones(tmp_path):
    path = begun(tmp_path / "a.ebmap")
    killed(path)
    path.unlink()
    with pytest.raises(
        OSError, match=r"a\.ebmap-wal: belongs to an earlier map of this name; put that back, or remove it"
    ):
        MapFile.create(path, FACTS)
    (tmp_path / "a.ebmap-wal").unlink()
    (tmp_path / "a.ebmap-shm").unlink()
    MapFile.create(path, FACTS).close()


def test_a_network_file_system_is_refused(tmp_path, monkeypatch):
    mounts = tmp_path / "mounts"
    mounts.write_text(
        "/dev/vda / ext4 rw 0 0\nserver:/x /mnt/with\\040blank nfs4 rw 0 0\n//nas /mnt cifs rw 0 0\nbad\n"
    )
    assert file_system(Path("/mnt/with blank/a/b.ebmap"), mounts) == "nfs4"
    assert file_system(Path("/mnt/other.ebmap"), mounts) == "cifs"
    assert file_system(Path("/mntother.ebmap"), mounts) == "ext4"
    assert file_system(Path("/x"), tmp_path / "none") == ""
    monkeypatch.setattr("ebjax.io.map_file.lock.file_system", lambda path: "nfs4")
    with pytest.raises(OSError, match=r"network file system \(nfs4\); keep the map on a disk of this machine"):
        MapFile.create(tmp_path / "a.ebmap", FACTS)
    assert os.listdir(tmp_path) == ["mounts"]
