"""Two processes on loopback, or two devices, are as good as one; one that is left alone says so."""

import importlib
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ebjax.train import __main__ as command
from ebjax.train import processes

sys.path.insert(0, str(Path(__file__).parent))
toy_training = importlib.import_module("toy_training")
TOY = toy_training.__file__


def losses(out):
    return [
        json.loads(line)["score" if "score" in line else "loss"]
        for line in (out / "log.jsonl").read_text().splitlines()
    ]


@pytest.fixture
def train():
    """Trains the toy in so many processes of so many devices; gives their exit codes and what the first one printed."""

    def start(out, *flags, count=1, devices=1, killed=""):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            coordinator = f"127.0.0.1:{free.getsockname()[1]}"
        flags = [*flags, "--out", str(out), "--processes", str(count), "--coordinator", coordinator]
        xla = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
        environment = {**os.environ, "XLA_FLAGS": xla}
        started = [
            subprocess.Popen(
                [sys.executable, TOY, *flags, "--process", str(process)],
                env={**environment, "TOY_KILL": killed if process else ""},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            for process in range(count)
        ]
        printed = [one.communicate(timeout=120)[0] for one in started]
        return [one.returncode for one in started], printed[0]

    return start


@pytest.mark.slow
def test_two_processes_and_two_devices_train_as_one_and_a_killed_peer_is_told(train, tmp_path):
    toy_training.fit(tmp_path / "one")
    one = losses(tmp_path / "one")
    assert train(tmp_path / "devices", devices=2)[0] == [0]
    assert losses(tmp_path / "devices") == pytest.approx(one, rel=1e-5)

    out = tmp_path / "two"
    codes, printed = train(out, count=2, killed="7")
    assert codes == [2, -9]
    assert "error: another process of this training has ended; start all of them again with --resume" in printed
    assert "Traceback" not in printed
    codes, printed = train(out, "--resume", count=2)
    assert codes == [0, 0], printed
    assert losses(out) == pytest.approx(one, rel=1e-5) and (out / "best.json").exists()


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((2, 2, "h:1"), "--process is 2"),
        ((0, 0, ""), "--processes 0"),
        ((2, 0, ""), "HOST:PORT"),
        ((2, 0, "host:port"), "HOST:PORT"),
    ],
)
def test_what_cannot_be_joined(arguments, words):
    with pytest.raises(ValueError, match=words):
        processes.join(*arguments)


def test_what_cannot_be_shared(monkeypatch, tmp_path):
    monkeypatch.setitem(command.TASKS, "toy", "toy_training")
    with pytest.raises(ValueError, match="--processes is 2: the task toy trains in one process"):
        command.main(command.command("toy")(out=tmp_path, processes=2))
    assert not (tmp_path / "log.jsonl").exists()


def test_alone_nothing_is_laid_out_and_errors_stay():
    processes.join(1, 0, "")
    assert processes.first() and processes.check_rows(7, "floors") is None and processes.in_turn(lambda: 3) == 3
    with pytest.raises(ValueError, match="gloo"), processes.together():
        raise ValueError("gloo is a word")
    processes.leave(2)
