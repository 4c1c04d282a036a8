"""The cache gives back what was put, survives a kill, and never trusts a damaged shard."""

import os
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from ebjax.io.cache import Cache, content_key, digest

SETTINGS = {"view": "abc", "side": 200}


def arrays_of(k):
    rng = np.random.default_rng(k)
    return {
        "map": rng.standard_normal((5, 7)).astype(np.float16),
        "cells": rng.random((5, 7)) < 0.5,
        "count": np.array(k),
        "none": np.zeros((0, 3), np.float32),
    }


def assert_same(found, expected):
    assert found is not None and found.keys() == expected.keys()
    for name in expected:
        assert found[name].dtype == expected[name].dtype
        np.testing.assert_array_equal(found[name], expected[name])


def filled(folder, count=6, **options):
    cache = Cache(folder, "hog", SETTINGS, shard_s=0, **options)
    for k in range(count):
        cache.put(f"image{k}.png {k}", arrays_of(k))
    return cache


def test_arrays_come_back_as_they_were(tmp_path):
    filled(tmp_path)
    again = Cache(tmp_path, "hog", SETTINGS)
    assert len(again) == 6 and not again.damaged
    for k in range(6):
        assert_same(again.get(f"image{k}.png {k}"), arrays_of(k))
    assert again.get("image9.png 9") is None and "image9.png 9" not in again


def test_other_settings_or_models_share_nothing(tmp_path):
    filled(tmp_path)
    for model, settings in (("hog", {**SETTINGS, "side": 201}), ("vgg19", SETTINGS)):
        assert not len(Cache(tmp_path, model, settings))


def test_what_waits_is_there_and_is_written_in_the_end(tmp_path):
    cache = Cache(tmp_path, "hog", SETTINGS, shard_s=1000)
    cache.put("a", arrays_of(1))
    assert_same(cache.get("a"), arrays_of(1))
    assert not list(cache.folder.glob("*.h5"))
    cache.flush()
    cache.flush()
    assert len(list(cache.folder.iterdir())) == 1
    assert_same(Cache(tmp_path, "hog", SETTINGS).get("a"), arrays_of(1))


def test_recall_computes_once(tmp_path):
    cache, calls = Cache(tmp_path, "hog", SETTINGS), []

    def compute():
        calls.append(1)
        return arrays_of(len(calls))

    assert_same(cache.recall("a", compute), arrays_of(1))
    assert_same(cache.recall("a", compute), arrays_of(1))
    assert_same(cache.recall(None, compute), arrays_of(2))


def test_keys_follow_name_and_content(tmp_path):
    files = [tmp_path / "a.png", tmp_path / "b" / "a.png", tmp_path / "c.png"]
    files[1].parent.mkdir()
    for file, content in zip(files, (b"1", b"2", b"1"), strict=True):
        file.write_bytes(content)
    assert len({content_key(file) for file in files}) == 3
    assert content_key(tmp_path / "nowhere.png") is None
    assert digest(np.zeros((2, 3))) != digest(np.zeros((3, 2))) != digest(np.zeros((3, 2), np.float32))
    with pytest.raises(ValueError, match="group in HDF5"):
        Cache(tmp_path, "hog", {}).put("a/b", {})


@pytest.mark.parametrize("share", [0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_shard_is_found_and_rebuilt(tmp_path, share):
    folder = filled(tmp_path).folder
    shards = sorted(folder.glob("*.h5"))
    victim = shards[2]
    with h5py.File(victim) as file:
        lost = list(file)
    content = victim.read_bytes()
    victim.write_bytes(content[: int(share * len(content))])
    again = Cache(tmp_path, "hog", SETTINGS)
    assert again.damaged == [victim] and len(again) == 5 and not victim.exists()
    assert again.get(lost[0]) is None
    assert_same(again.recall(lost[0], lambda: arrays_of(int(lost[0][-1]))), arrays_of(int(lost[0][-1])))
    again.flush()
    whole = Cache(tmp_path, "hog", SETTINGS)
    assert len(whole) == 6 and not whole.damaged and victim.read_bytes() == content


def test_one_wrong_bit_anywhere_is_found(tmp_path):
    folder = filled(tmp_path, 1).folder
    (shard,) = folder.glob("*.h5")
    content = bytearray(shard.read_bytes())
    for position in np.random.default_rng(0).integers(0, len(content), 40):
        content[position] ^= 4
        shard.write_bytes(content)
        assert not len(Cache(tmp_path, "hog", SETTINGS))
        content[position] ^= 4
    shard.write_bytes(content)
    assert len(Cache(tmp_path, "hog", SETTINGS)) == 1


def test_leftovers_of_a_killed_process_are_removed_in_time(tmp_path):
    folder = filled(tmp_path, 1).folder
    old, new = folder / ".x.h5.1.partial", folder / ".y.h5.2.partial"
    for file in (old, new):
        file.write_bytes(b"half")
    os.utime(old, (time.time() - 7200,) * 2)
    assert len(Cache(tmp_path, "hog", SETTINGS)) == 1
    assert not old.exists() and new.exists()


WORKER = """
import sys, numpy as np
from ebjax.io.cache import Cache
cache = Cache(sys.argv[1], "hog", {}, shard_s=0)
for k in range(400):
    if str(k) not in cache:
        cache.put(str(k), {"a": np.full((60, 60), k)})
        print(k, flush=True)
cache.flush()
"""


def test_a_killed_process_goes_on_where_it_was(tmp_path):
    done, kills = [], 0
    for pause in (0.0, 0.013, 0.05, None):
        worker = subprocess.Popen([sys.executable, "-c", WORKER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        assert worker.stdout is not None
        if pause is not None:
            done.append(int(worker.stdout.readline()))
            time.sleep(pause)
            worker.send_signal(signal.SIGKILL)
            kills += worker.wait() == -signal.SIGKILL
        done += [int(line) for line in worker.stdout.read().split()]
        worker.stdout.close()
        worker.wait()
    assert kills >= 2
    assert len(set(done)) == len(done) <= 400, "nothing is computed twice"
    cache = Cache(tmp_path, "hog", {})
    assert len(cache) == 400 and not cache.damaged
    for k in range(400):
        np.testing.assert_array_equal(cache.get(str(k))["a"], np.full((60, 60), k))
