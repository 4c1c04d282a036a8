"""Several devices and several processes that train as one: each keeps all parameters and takes its rows of a batch.

Every process runs the same command with the same config on the same files. Under `jit` arrays are global: a mean over
a batch is the mean over all devices' rows, and XLA adds up what the devices have (GSPMD; facts of a step are the same
as on one device, to rounding). The first process alone writes. A process that ends before the others ends them all:
training goes on from its last checkpoint.
"""

import contextlib
import functools
import os
import sys
import zlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

Tree = TypeVar("Tree")
Made = TypeVar("Made")

AXIS = "data"
LOST = ("gloo", "nccl", "coordination service", "distributed service")
"""Words by which errors of lost connections are known."""


def join(processes: int, process: int, coordinator: str) -> None:
    """Makes this process one of several; must come before the first array. One process alone needs nothing.

    Args:
      processes: how many there are.
      process: which one this is, from 0.
      coordinator: HOST:PORT at which process 0 can be reached by all.

    Raises:
      ValueError: no such process; no coordinator, or nobody there.
    """
    if processes < 1 or not 0 <= process < processes:
        raise ValueError(f"--process is {process} of --processes {processes}; number them from 0")
    if processes == 1:
        return
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdigit():
        raise ValueError(f"--coordinator is {coordinator!r}; give HOST:PORT, the same to all processes")
    try:
        jax.distributed.initialize(coordinator, processes, process, initialization_timeout=120)
    except RuntimeError as fault:
        raise ValueError(f"--coordinator {coordinator}: not all of {processes} processes met there ({fault})") from None


def first() -> bool:
    """Whether this process is the one that writes and prints."""
    return jax.process_index() == 0


@functools.cache
def mesh() -> Mesh:
    """All devices of all processes in a row."""
    return jax.make_mesh((jax.device_count(),), (AXIS,), axis_types=(AxisType.Auto,))


def check_rows(rows: int, key: str) -> None:
    """Raises ValueError, naming the key, where the devices cannot take equally many rows."""
    if rows % jax.device_count():
        raise ValueError(f"{key} is {rows}: needs a multiple of the {jax.device_count()} devices that train")


def share(batch: Tree) -> Tree:
    """Arrays that every process holds whole, laid out over the devices by rows (their first axis)."""
    return _lay(batch, PartitionSpec(AXIS))


def replicate(tree: Tree) -> Tree:
    """Arrays that every process holds whole, on every device whole."""
    return _lay(tree, PartitionSpec())


def _lay(tree, spec):
    if jax.device_count() == 1:
        return jax.tree.map(jax.numpy.asarray, tree)
    sharding = NamedSharding(mesh(), spec)

    def one(leaf):
        host = np.asarray(leaf)
        return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])

    return jax.tree.map(one, tree)


def kept_whole(tree: Tree) -> Tree:
    """Inside `jit`: says that these arrays stay whole on every device, as parameters do."""
    if jax.device_count() == 1:
        return tree
    return jax.lax.with_sharding_constraint(tree, NamedSharding(mesh(), PartitionSpec()))


def map_rows(function: Callable[[Any], Any], rows: Any) -> Any:
    """Inside `jit`: `jax.lax.map(function, rows)`, every device its own rows."""
    if jax.device_count() == 1:
        return jax.lax.map(function, rows)
    spec = PartitionSpec(AXIS)
    local = functools.partial(jax.lax.map, function)
    return jax.shard_map(local, mesh=mesh(), in_specs=(spec,), out_specs=spec, check_vma=False)(rows)


def wait(what: str) -> None:
    """Until all processes are here."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(what)


def in_turn(make: Callable[[], Made]) -> Made:
    """Calls `make` in the first process and only then in the others: files that it leaves are found there."""
    if first():
        made = make()
        wait("made")
        return made
    wait("made")
    return make()


def agree(value: Any, what: str) -> None:
    """Raises ValueError where the processes do not all have the same value, as it is written."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        found = multihost_utils.process_allgather(np.uint32(zlib.crc32(repr(value).encode())))
        if (found != found[0]).any():
            raise ValueError(f"{what} differs between the processes; give all of them the same config and files")


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Tells a lost process by a ConnectionError that says how to go on.

    Raises:
      ConnectionError: another process has ended.
    """
    try:
        yield
    except (ValueError, RuntimeError) as fault:
        if jax.process_count() > 1 and any(word in str(fault).lower() for word in LOST):
            raise ConnectionError(
                "another process of this training has ended; start all of them again with --resume"
            ) from fault
        raise


def leave(code: Any) -> None:
    """Ends this process at once where others are left in the middle of a sum: JAX would wait for them at exit."""
    if code and jax.process_count() > 1:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
