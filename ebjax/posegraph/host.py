"""NumPy code called from compiled programs.

`jax.pure_callback` hands JAX arrays to its function; making them takes one of XLA's threads, and when the running
programs hold all of these (a machine with one core is enough) it waits for itself forever. Here the function gets the
NumPy arrays as they come.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array

_host_call_p = Primitive("host_call")


def host_call(function: Callable, static: tuple, result: jax.ShapeDtypeStruct, *arrays: Any) -> Array:
    """`function(*static, *arrays)` on the host, an array like `result`.

    Under vmap every array and the result get one more axis in front, of length one where an array is shared. Without
    derivatives.

    Args:
      function: pure, hashable: a function of a module.
      static: its first arguments, hashable.
      result: shape and dtype of what it returns.
      arrays: NumPy arrays when `function` is called.
    """
    return _host_call_p.bind(
        *arrays, function=function, static=static, shape=result.shape, dtype=np.dtype(result.dtype)
    )


@_host_call_p.def_impl
def _run(*arrays, **params):
    return jax.jit(lambda *a: _host_call_p.bind(*a, **params))(*arrays)


@_host_call_p.def_abstract_eval
def _shape(*_, shape, dtype, **__):
    return jax.core.ShapedArray(shape, dtype)


def _batch(arrays, axes, *, shape, **params):
    size = next(a.shape[x] for a, x in zip(arrays, axes, strict=True) if x is not None)
    front = [a[None] if x is None else jnp.moveaxis(a, x, 0) for a, x in zip(arrays, axes, strict=True)]
    return _host_call_p.bind(*front, shape=(size, *shape), **params), 0


def _lower(ctx, *arrays, function, static, **_):
    def call(*values):
        return (function(*static, *map(np.asarray, values)),)

    result, _, _ = mlir.emit_python_callback(
        ctx, call, None, list(arrays), ctx.avals_in, ctx.avals_out, has_side_effect=False, returns_token=False
    )
    return result


batching.primitive_batchers[_host_call_p] = _batch
mlir.register_lowering(_host_call_p, _lower, cacheable=False)
