"""A worker as its caller has it: an input goes in, a verdict comes out, whatever the reader does."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
WALL_S = 60.0
"""A reader that does not use its processor time is stopped after so long."""
START_S = 120.0
BROKEN = 1
"""Exit status of a child in which the harness itself fails."""
SETTINGS = {
    "JAX_PLATFORMS": "cpu",
    "MALLOC_ARENA_MAX": "2",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
}
"""One thread, and few arenas: else address space grows with threads, not with what a reader asks for."""


class Worker:
    """A server of one group of readers, and the child of it that reads now."""

    def __init__(self, group: str, scratch: Path):
        """Starts it.

        Args:
          group: "host", or "jax" where the readers load JAX.
          scratch: a folder for what readers write, which is gone after a child that dies.
        """
        folders = dict.fromkeys(("TMPDIR", "OPENCV_TEMP_PATH"), str(scratch))
        environment = {**os.environ, **SETTINGS, **folders}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker", group],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, env=environment,
        )  # fmt: skip
        self._rest = b""
        self._child: int | None = None

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        if kind is not None:
            self._process.kill()
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._child or self._process.pid, signal.SIGKILL)
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def read(self, reader: str, path: Path) -> Mapping[str, Any]:
        """Has a path read; a child that hangs is killed, and one that dies is a fault like any other."""
        while self._child is None:
            self._meet(self._answer(START_S))
        request = json.dumps({"reader": reader, "path": str(path)}) + "\n"
        assert self._process.stdin is not None
        self._process.stdin.write(request.encode())
        self._process.stdin.flush()
        start = time.perf_counter()
        while True:
            answer = self._answer(WALL_S)
            if answer is None:
                assert self._child is not None
                os.kill(self._child, signal.SIGKILL)
                fault = ["hang", "", f"nothing after {WALL_S:g} s"]
                self._meet(self._answer(START_S))
                return self._lost(fault, start)
            if "outcome" in answer:
                return answer
            if answer.get("died") == BROKEN:
                raise RuntimeError(f"{reader}: reading fails outside of the reader; FUZZ_STDERR=1 shows why")
            lost = "died" in answer and answer["died"] != 0
            self._meet(answer)
            if lost:
                return self._lost(["crash", "", f"exit status {answer['died']}"], start)
            # A child that had leaked memory ended before it took the request: the next one takes it.

    @staticmethod
    def _lost(fault: list[str], start: float) -> Mapping[str, Any]:
        ms = 1000 * (time.perf_counter() - start)
        return {"outcome": "fault", "faults": [fault], "weak": [], "ms": ms, "bytes": 0}

    def _meet(self, answer: Mapping[str, Any] | None) -> None:
        if answer is None:
            raise RuntimeError("the worker does not start")
        self._child = answer.get("ready")

    def _answer(self, timeout_s: float) -> Mapping[str, Any] | None:
        """The next line of the worker; None where there is none in time."""
        assert self._process.stdout is not None
        while b"\n" not in self._rest:
            if not select.select([self._process.stdout], [], [], timeout_s)[0]:
                return None
            more = os.read(self._process.stdout.fileno(), 1 << 16)
            if not more:
                raise RuntimeError("the worker has ended")
            self._rest += more
        line, _, self._rest = self._rest.partition(b"\n")
        return json.loads(line)
