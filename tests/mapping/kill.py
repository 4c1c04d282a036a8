"""Kills a run at random moments, again and again, and compares what comes out with a run that was not killed.

python -m tests.mapping.kill --times 20
"""

import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import small_run


def processes():
    """Processes that start from one where everything is imported and nothing has run."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["small_run"])
    return context


def started(path):
    context = processes()
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=small_run.drive_and_tell, args=(str(path), there), daemon=True)
    process.start()
    there.close()
    return process, here


def killed(path, rng, most):
    """Kills a run a while after one of its next frames; returns what came out where it was faster, else None."""
    process, here = started(path)
    frames, moment = int(rng.integers(0, most)), float(rng.uniform(0, 0.1))
    try:
        for _ in range(frames + 1):
            said = here.recv()
            if not isinstance(said, int):
                process.join()
                return said
        time.sleep(moment)
    finally:
        process.kill()
        process.join()
    return None


def to_its_end(path):
    """What comes out of a run."""
    process, here = started(path)
    while isinstance(said := here.recv(), int):
        pass
    process.join()
    return said


def main(times, seed):
    rng, folder = np.random.default_rng(seed), Path(tempfile.mkdtemp(prefix="ebjax-kill-"))
    expected, kills, runs = to_its_end(folder / "whole.ebmap"), 0, 0
    while kills < times:
        path, runs = folder / f"{runs}.ebmap", runs + 1
        while kills < times and (found := killed(path, rng, 2 * len(expected[0]) // 4)) is None:
            kills += 1
            print(f"kill {kills}: {small_run.held(path)} keyframes are kept", flush=True)
        if kills == times:
            found = to_its_end(path)
        small_run.assert_same(found, expected)
        print(f"run {runs}: the same trajectory bit for bit, and the same {len(expected[1])} candidates", flush=True)


if __name__ == "__main__":
    arguments = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    main(int(arguments.get("--times", 20)), int(arguments.get("--seed", 0)))
