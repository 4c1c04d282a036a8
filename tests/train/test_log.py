import json
import struct
import sys

import pytest

from ebjax.train.log import Log
from ebjax.train.loop import LoopConfig, check


def read_events(folder):
    """(tag, step, value) of the scalars in TensorBoard's record files, and the steps from which others are purged."""
    from tensorboardX.proto.event_pb2 import Event, SessionLog

    scalars, purged = [], []
    for path in folder.iterdir():
        content, at = path.read_bytes(), 0
        while at < len(content):
            (length,) = struct.unpack_from("<Q", content, at)
            event = Event.FromString(content[at + 12 : at + 12 + length])
            at += 16 + length
            scalars += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
            if event.session_log.status == SessionLog.START:
                purged.append(event.step)
    return scalars, purged


def test_lines_and_events_say_the_same_and_what_came_later_is_taken_away(tmp_path):
    pytest.importorskip("tensorboardX")
    log = Log(tmp_path, 0, events=True)
    for step in (1, 2, 3):
        log.write(step, "step", {"loss": 0.5 * step}, 1.0)
    log = Log(tmp_path, 1, events=True)
    log.write(2, "validation", {"score": 4.0}, 2.0)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], line["kind"]) for line in lines] == [(1, "step"), (2, "validation")]
    scalars, purged = read_events(tmp_path / "events")
    losses = [("step/loss", step, 0.5 * step) for step in (1, 2, 3)]
    assert sorted(scalars) == [*losses, ("validation/score", 2, 4.0)]
    assert purged == [2]


def test_without_tensorboardx_it_says_what_to_install_before_any_work(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(ValueError, match=r"ebjax\[train\]"):
        check(LoopConfig(tensorboard=True))
    check(LoopConfig())


def test_no_events_unless_wanted(tmp_path):
    Log(tmp_path, 0, events=False).write(1, "step", {"loss": 1.0}, 0.0)
    assert not (tmp_path / "events").exists()
