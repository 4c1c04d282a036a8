"""The process that reads damaged inputs: a server that forks a child, and forks another where that one dies.

    python -m tests.fuzz.worker host|jax

A line on standard input is a request {"reader", "path"}; a line on standard output is {"ready": pid}, {"died": status},
or a verdict, see `read_once`. A child has warmed up on whole seeds before it is limited.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2

from .planted import PLANTED
from .readers import READERS, Step

CPU_S = 2.0
MEMORY_BYTES = 1 << 30
"""Beyond what the process has before an input: of resident memory, and, with half as much again, of address space."""
LEAK_BYTES = 300 << 20
PAGE = resource.getpagesize()
ALLOWED = {"ValueError": ValueError, "OSError": OSError}
LONGEST = 1000
IMPORTS = {
    "host": "ebjax.io.logs.open ebjax.logs.describe ebjax.logs.facts ebjax.config ebjax.io.cache rosbags.image yaml",
    "jax": "ebjax.viz.run_errors ebjax.evaluation.nees_tables ebjax.models.checkpoint ebjax.models.weights h5py",
}
SILENT = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning)


class TimedOut(BaseException):
    """An input has used its processor time."""


def _sizes() -> tuple[int, int]:
    """Address space and resident memory, bytes."""
    with open("/proc/self/statm") as file:
        pages = file.read().split()
    return int(pages[0]) * PAGE, int(pages[1]) * PAGE


def _peak() -> int:
    """The most resident memory since `_forget_peak`, bytes."""
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmHWM")) * 1024


def _forget_peak() -> None:
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Processor time and address space for one input."""

    def timed_out(*_: Any) -> None:
        raise TimedOut

    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (_sizes()[0] + MEMORY_BYTES * 3 // 2, hard))
    signal.signal(signal.SIGPROF, timed_out)
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _place(error: BaseException) -> str:
    """The last line of the package that an error came through."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if "/ebjax/" in frame.filename] or frames
    return f"{inside[-1].filename.partition('/ebjax/')[2] or inside[-1].name}:{inside[-1].lineno}" if inside else ""


def fault_of(error: BaseException) -> str | None:
    """Why an error is none that a reader may raise; None where it is one."""
    if not isinstance(error, tuple(ALLOWED.values())):
        return "timeout" if isinstance(error, TimedOut) else type(error).__name__
    message = str(error)
    if len(message.splitlines()) != 1:
        return "message of no line" if not message.strip() else "message of several lines"
    return "message with a repr" if " object at 0x" in message or "Traceback" in message else None


def _weakness(error: BaseException, path: Path) -> str | None:
    """What a message could do better."""
    message = str(error)
    if path.name not in message:
        return "names no file"
    return "long message" if len(message) - len(str(path)) > LONGEST else None


def read_once(steps: Sequence[Step], path: Path) -> dict[str, Any]:
    """Makes the calls of a reader with one input.

    Returns:
      `outcome`: of the first call: result, ValueError, OSError or fault; `faults`: (kind, place, message) of what must
      not be; `weak`: the same of messages that could be better; `ms`; `bytes`: how much resident memory grew at most.
    """
    verdict: dict[str, Any] = {"outcome": "result", "faults": [], "weak": []}
    _forget_peak()
    before, start = _sizes()[1], time.perf_counter()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for category in SILENT:
            warnings.simplefilter("ignore", category)
        for number, step in enumerate(steps):
            try:
                with _limits():
                    step()
            except BaseException as error:
                kind = fault_of(error)
                note = [kind or _weakness(error, path), _place(error), " ".join(str(error).split())[:300]]
                verdict["faults" if kind else "weak"] += [note] * (note[0] is not None)
                if number == 0:
                    verdict["outcome"] = next((name for name in ALLOWED if isinstance(error, ALLOWED[name])), "fault")
    for one in said:
        if not (issubclass(one.category, UserWarning) and "/site-packages/" not in one.filename):
            place = f"{one.filename.rpartition('/ebjax/')[2]}:{one.lineno}"
            verdict["faults"].append([one.category.__name__, place, str(one.message)[:300]])
    grown = max(_peak() - before, 0)
    if grown > MEMORY_BYTES:
        verdict["faults"].append(["memory", "", f"{grown >> 20} MB"])
    return verdict | {"ms": 1000 * (time.perf_counter() - start), "bytes": grown}


def _warm_up(reader: str) -> None:
    """Reads the whole seeds of a reader, without limits."""
    import tempfile

    if reader in PLANTED:
        return
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number, seed in enumerate(READERS[reader].inputs()):
            for step in READERS[reader].steps(seed.write(Path(folder) / str(number))):
                with contextlib.suppress(*ALLOWED.values()):
                    step()


def _child(answers: int) -> None:
    """Answers requests until there are none, or until memory has leaked."""
    cv2.setNumThreads(1)
    warm, base = set[str](), 0
    os.write(answers, (json.dumps({"ready": os.getpid()}) + "\n").encode())
    for line in sys.stdin:
        request = json.loads(line)
        reader, path = request["reader"], Path(request["path"])
        if reader not in warm:
            _warm_up(reader)
            warm.add(reader)
            base = _sizes()[1]
        steps = PLANTED[reader](path) if reader in PLANTED else READERS[reader].steps(path)
        verdict = read_once(steps, path)
        os.write(answers, (json.dumps(verdict) + "\n").encode())
        if _sizes()[1] - base > LEAK_BYTES:
            os._exit(0)
    os._exit(3)


def serve(group: str) -> None:
    """Forks children one after the other, until one says that there is no more to do."""
    for name in IMPORTS[group].split():
        importlib.import_module(name)
    answers, nowhere = os.dup(1), os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 1)
    if "FUZZ_STDERR" not in os.environ:
        os.dup2(nowhere, 2)
    warnings.simplefilter("ignore")  # that forking a process with threads may fail: no thread has begun yet
    while True:
        child = os.fork()
        if child == 0:
            try:
                _child(answers)
            finally:
                traceback.print_exc()
                sys.stderr.flush()
                os._exit(1)
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        if code == 3:
            return
        os.write(answers, (json.dumps({"died": code}) + "\n").encode())


if __name__ == "__main__":
    serve(sys.argv[1])
