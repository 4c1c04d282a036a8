"""Reads torch's checkpoints without running them: a pickle is a program, and here it is one that can call nothing.

The opcodes are interpreted by hand. Containers, numbers and text become themselves; a tensor becomes a `Tensor`, a note
of where its numbers lie; the few other things checkpoints hold (NumPy scalars in a training log) become None. Any other
name, `os.system` say, is refused when it is mentioned. Both file formats: zip (torch 1.6 on) and the older stream.
"""

import io
import math
import pickletools
import struct
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import jax.numpy as jnp
import numpy as np

STREAM_MAGIC = 0x1950A86A20F9469CFC6C
STORAGES = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "HalfStorage": np.float16,
    "BFloat16Storage": jnp.bfloat16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}


@dataclass(frozen=True)
class Storage:
    """A block of numbers of the file."""

    key: str
    dtype: np.dtype
    offset: int = 0


@dataclass(frozen=True)
class Tensor:
    """A view of a storage."""

    storage: Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    def view(self, data: bytes) -> np.ndarray:
        """The numbers, from all bytes of the storage.

        Raises:
          ValueError: the view reaches beyond them.
        """
        if any(not isinstance(n, int) or n < 0 for n in (self.offset, *self.shape, *self.strides)):
            raise ValueError("a tensor has a wrong shape")
        base = np.frombuffer(data, self.storage.dtype)[self.storage.offset :]
        span = sum((n - 1) * stride for n, stride in zip(self.shape, self.strides, strict=True)) + 1
        size = math.prod(self.shape)
        if size > len(base) or (size and self.offset + span > len(base)):
            raise ValueError("a tensor reaches beyond its data")
        strides = tuple(stride * base.itemsize for stride in self.strides)
        return np.array(np.lib.stride_tricks.as_strided(base[self.offset :], self.shape, strides), order="C")


@dataclass(frozen=True)
class _Name:
    """What a pickle means by "module.name"; never looked up."""

    text: str


def _rebuild_tensor(storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> Tensor:
    if not isinstance(storage, Storage):
        raise ValueError("a tensor without data")
    return Tensor(storage, offset, tuple(shape), tuple(strides))


CALLS: dict[str, Callable[..., Any]] = {
    "collections.OrderedDict": lambda items=(): OrderedDict(items),
    "torch._utils._rebuild_tensor_v2": _rebuild_tensor,
    "torch._utils._rebuild_tensor": _rebuild_tensor,
    "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
    "torch.Size": lambda sizes=(): tuple(sizes),
    "numpy.core.multiarray.scalar": lambda *_: None,
    "numpy._core.multiarray.scalar": lambda *_: None,
    "numpy.core.multiarray._reconstruct": lambda *_: None,
    "numpy._core.multiarray._reconstruct": lambda *_: None,
    "numpy.dtype": lambda *_: None,
    "_codecs.encode": lambda *_: None,
}
MENTIONS = {*CALLS, "numpy.ndarray", *(f"torch.{name}" for name in STORAGES)}


def _mention(module: Any, name: Any) -> _Name:
    text = f"{module}.{name}"
    if text not in MENTIONS:
        raise ValueError(f"it wants to use {text}, which no weights need; refused")
    return _Name(text)


def _call(name: Any, arguments: Any) -> Any:
    if not isinstance(name, _Name) or name.text not in CALLS:
        raise ValueError("it calls what cannot be called; refused")
    return CALLS[name.text](*arguments)


def _storage(identity: Any) -> Storage:
    kind, name, key, _, _, *view = identity
    if kind != "storage" or name.text.removeprefix("torch.") not in STORAGES:
        raise ValueError("a storage of an unknown kind")
    offset = view[0][1] if view and view[0] is not None else 0
    return Storage(str(key), np.dtype(STORAGES[name.text.removeprefix("torch.")]), offset)


VALUES = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
LITERALS = set(
    "BININT BININT1 BININT2 LONG1 LONG4 BINFLOAT BINUNICODE SHORT_BINUNICODE BINUNICODE8 BINSTRING SHORT_BINSTRING "
    "BINBYTES SHORT_BINBYTES BINBYTES8".split()
)
EMPTY: dict[str, Callable[[], Any]] = {"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple, "EMPTY_SET": set}


def read_pickle(file: io.BufferedIOBase, storages: dict[str, Storage] | None = None) -> Any:
    """Interprets one pickle; the file is left just behind it.

    Args:
      file: its binary content.
      storages: gets every storage the pickle mentions, by key.

    Raises:
      ValueError: it mentions a name or uses an opcode that no checkpoint needs.
      Exception: of whatever kind, where the file is damaged.
    """
    stack: list[Any] = []
    marks: list[int] = []
    memo: dict[int, Any] = {}

    def since_mark() -> list[Any]:
        start = marks.pop()
        items = stack[start:]
        del stack[start:]
        return items

    operations: Any = pickletools.genops(cast("IO[bytes]", file))
    for opcode, argument, _ in operations:
        name = opcode.name
        if name in LITERALS:
            stack.append(argument)
        elif name in VALUES:
            stack.append(VALUES[name])
        elif name in EMPTY:
            stack.append(EMPTY[name]())
        elif name == "MARK":
            marks.append(len(stack))
        elif name in ("BINPUT", "LONG_BINPUT"):
            memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(memo[argument])
        elif name == "GLOBAL":
            stack.append(_mention(*argument.split(" ", 1)))
        elif name == "STACK_GLOBAL":
            attribute, module = stack.pop(), stack.pop()
            stack.append(_mention(module, attribute))
        elif name == "TUPLE":
            stack.append(tuple(since_mark()))
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(name[-1])
            stack[-count:] = [tuple(stack[-count:])]
        elif name == "REDUCE":
            arguments = stack.pop()
            stack.append(_call(stack.pop(), arguments))
        elif name == "BUILD":
            stack.pop()  # attributes of a container: not part of the weights
        elif name == "BINPERSID":
            stack.append(_storage(stack.pop()))
            if storages is not None:
                storages[stack[-1].key] = stack[-1]
        elif name == "APPEND":
            item = stack.pop()
            stack[-1].append(item)
        elif name == "APPENDS":
            items = since_mark()
            stack[-1].extend(items)
        elif name == "ADDITEMS":
            items = since_mark()
            stack[-1].update(items)
        elif name == "SETITEM":
            value, key = stack.pop(), stack.pop()
            stack[-1][key] = value
        elif name == "SETITEMS":
            items = since_mark()
            stack[-1].update(zip(items[::2], items[1::2], strict=True))
        elif name == "STOP":
            return stack.pop()
        elif name not in ("PROTO", "FRAME"):
            raise ValueError(f"it uses the opcode {name}, which no weights need; refused")
    raise EOFError("it ends early")


def read_torch(path: Path) -> tuple[Any, Callable[[Tensor], np.ndarray]]:
    """Reads a checkpoint of either format.

    Returns:
      What was saved, with a `Tensor` for each tensor, and the function that gives the numbers of one.

    Raises:
      Exception: of whatever kind, where the file is damaged or not a checkpoint.
    """
    with open(path, "rb") as file:
        zipped = file.read(2) == b"PK"
    if zipped and not zipfile.is_zipfile(path):
        raise ValueError("a zip file whose end is missing")
    return _read_zip(path) if zipped else _read_stream(path)


def _read_zip(path: Path) -> tuple[Any, Callable[[Tensor], np.ndarray]]:
    archive = zipfile.ZipFile(path)
    inside = {entry.filename.partition("/")[2]: entry for entry in archive.infolist()}
    if "data.pkl" not in inside:
        raise ValueError("a zip file, but not one of torch's (no data.pkl)")
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in inside.values()):
        raise ValueError("its data are compressed, which torch never does")
    if "byteorder" in inside and archive.read(inside["byteorder"]) != b"little":
        raise ValueError("its data are big-endian")
    root = read_pickle(io.BytesIO(archive.read(inside["data.pkl"])))
    return root, lambda tensor: tensor.view(archive.read(inside[f"data/{tensor.storage.key}"]))


def _read_stream(path: Path) -> tuple[Any, Callable[[Tensor], np.ndarray]]:
    """Five pickles (magic number, version, machine, content, order of the storages), then the storages."""
    with open(path, "rb") as file:
        if read_pickle(file) != STREAM_MAGIC:
            raise ValueError("a pickle, but not one of torch's")
        read_pickle(file)
        if not read_pickle(file).get("little_endian", True):
            raise ValueError("its data are big-endian")
        storages: dict[str, Storage] = {}
        root = read_pickle(file, storages)
        places = {}
        end = path.stat().st_size
        for key in read_pickle(file):
            (count,) = struct.unpack("<q", file.read(8))
            start, length = file.tell(), count * storages[key].dtype.itemsize
            if count < 0 or start + length > end:
                raise EOFError("it ends early")
            places[key] = start, length
            file.seek(start + length)

    def numbers(tensor: Tensor) -> np.ndarray:
        start, length = places[tensor.storage.key]
        with open(path, "rb") as file:
            file.seek(start)
            return tensor.view(file.read(length))

    return root, numbers
