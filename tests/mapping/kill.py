"""Kills a run at random moments, again and again, and compares what comes out with a run that was not killed.

python -m tests.mapping.kill --times 20 [--seed 0] [--tilt-deg 1.0] [--wheels 0]

--tilt-deg: the camera is tilted by so much more than is said, so that the run is driven twice, and killed in both.
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


def started(path, **run):
    context = processes()
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=small_run.drive_and_tell, args=(str(path), there), kwargs=run, daemon=True)
    process.start()
    there.close()
    return process, here


def killed(path, rng, most, **run):
    """Kills a run a while after one of its next frames; returns what came out where it was faster, else None."""
    process, here = started(path, **run)
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


def to_its_end(path, **run):
    """What comes out of a run."""
    process, here = started(path, **run)
    while isinstance(said := here.recv(), int):
        pass
    process.join()
    return said


def main(times, seed, **run):
    rng, folder = np.random.default_rng(seed), Path(tempfile.mkdtemp(prefix="ebjax-kill-"))
    expected, kills, runs = to_its_end(folder / "whole.ebmap", **run), 0, 0
    print(
        f"{len(expected[0])} frames, {len(expected[1])} candidates, {(expected[-1] == 'kept').sum()} kept", flush=True
    )
    while kills < times:
        path, found, runs = folder / f"{runs}.ebmap", None, runs + 1
        while kills < times and (found := killed(path, rng, len(expected[0]) // 2, **run)) is None:
            kills += 1
            print(f"kill {kills}: {small_run.held(path)} are kept", flush=True)
        if found is None:
            found = to_its_end(path, **run)
        small_run.assert_same(found, expected)
        print(f"run {runs}: the same candidates and closures, and bit for bit the same trajectory", flush=True)


if __name__ == "__main__":
    arguments = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    main(
        int(arguments.get("--times", 20)),
        int(arguments.get("--seed", 0)),
        tilt_deg=float(arguments.get("--tilt-deg", 0)),
        wheels=arguments.get("--wheels", "1") != "0",
    )
