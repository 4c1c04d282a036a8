"""Parts by name: one of ours, or one from outside the package as `my_package.mine:NAME`, whose code is then run.

A part is a descriptor, an extractor, a robust kernel or a reader of logs. One that was made in a session of Python
(a notebook) goes by the name that it has there, `__main__:NAME`. Parts of others are looked up anew each time, so that
one that was defined anew counts at once.
"""

import difflib
import functools
import hashlib
import importlib
import importlib.metadata
import inspect
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

Part = TypeVar("Part")
OWN = "package.module:NAME for one of your own, whose code is then run"
_held: dict[str, Any] = {}
"""Objects that no module has under a name, by one that was made up."""


def is_own(name: str) -> bool:
    """Whether a name is of a part from outside."""
    return ":" in name


def find(what: str, name: str, ours: Mapping[str, str]) -> Any:
    """The object that a name stands for.

    Args:
      what: descriptor, extractor and so on, for messages.
      name: one of `ours`, or `package.module:NAME`.
      ours: name -> "module:attribute".

    Raises:
      ValueError: no such name, module or attribute, or the module cannot be imported.
      ImportError: one of ours needs a package that is not installed.
    """
    if name in ours:
        module, _, attribute = ours[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    if not is_own(name):
        raise ValueError(f"{what} {name!r} is unknown; choose one of {', '.join(ours)}, or {OWN}")
    return _held[name] if name in _held else _attribute(what, name)


def made(what: str, name: str, ours: Mapping[str, str], kind: type[Part], *given: Hashable) -> Part:
    """The part that a name stands for, made where the name is of a function that makes one.

    Args:
      what: see `find`.
      name: see there.
      ours: see there.
      kind: that it must be, a class that `import ebjax` offers.
      given: to the function; what it gave for the same is not made again.

    Raises:
      ValueError, ImportError: as `find`; it is of another kind.
    """
    found = find(what, name, ours)
    part = _made(found, given) if callable(found) else found
    if not isinstance(part, kind):
        raise ValueError(
            f"{what} {name!r} is a {type(part).__name__}; give an ebjax.{kind.__name__}, or a function of (weights, "
            "arithmetic) that returns one"
        )
    return part


@functools.lru_cache(maxsize=64)
def _made(make: Callable[..., Any], given: tuple[Hashable, ...]) -> Any:
    return make(*given)


def _attribute(what: str, name: str) -> Any:
    module_name, _, attribute = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as fault:
        missing = getattr(fault, "name", None) if isinstance(fault, ModuleNotFoundError) else None
        if missing and (module_name == missing or module_name.startswith(f"{missing}.")):
            where = "install it, or put the folder that holds it into PYTHONPATH"
            raise ValueError(f"{what} {name!r}: there is no module {missing}; {where}") from None
        raise ValueError(f"{what} {name!r}: {module_name} cannot be imported ({_said(fault)})") from fault
    found = module
    for part in attribute.split("."):
        if not part or not hasattr(found, part):
            names = [one for one in vars(module) if not one.startswith("_")]
            close = difflib.get_close_matches(attribute, names, n=3) or names[:8]
            raise ValueError(f"{what} {name!r}: {module_name} has no {attribute or 'name'}; it has {', '.join(close)}")
        found = getattr(found, part)
    return found


def _said(fault: BaseException) -> str:
    return f"{type(fault).__name__}: {' '.join(str(fault).split())}"


def name_of(part: Any, ours: Mapping[str, str]) -> str:
    """The name under which `find` gives this very object."""
    known = {lazy: name for name, lazy in ours.items()}
    for module in _modules(part):
        for attribute, value in list(vars(sys.modules[module]).items()):
            if value is part:
                name = f"{module}:{attribute}"
                return known.get(name, name)
    for name, held in _held.items():
        if held is part:
            return name
    module = next(_modules(part), "__main__")
    made_up = f"{module}:{getattr(part, '__qualname__', type(part).__name__)}"
    name, count = made_up, 1
    while name in _held:
        count += 1
        name = f"{made_up}#{count}"
    _held[name] = part
    return name


def version_of(name: str) -> str:
    """Of a part from outside: its package's version, and a digest of its module's source, or in a session its own."""
    part = find("part", name, {})
    module = sys.modules.get(name.partition(":")[0])
    top = name.partition(":")[0].partition(".")[0]
    try:
        version = importlib.metadata.version(top)
    except importlib.metadata.PackageNotFoundError:
        version = str(getattr(sys.modules.get(top), "__version__", ""))
    file = getattr(module, "__file__", None)
    try:
        source = Path(file).read_bytes() if file else "".join(map(inspect.getsource, _functions(part))).encode()
    except (OSError, TypeError):
        source = b""
    digest = f"source {hashlib.sha256(source).hexdigest()[:12]}" if source else "source unknown"
    return f"{version}, {digest}" if version else digest


def _functions(part: Any) -> list[Any]:
    """The part itself, or what it is made of."""
    inner = vars(part).values() if hasattr(part, "__dict__") else ()
    return [part] if inspect.isfunction(part) else [value for value in inner if inspect.isfunction(value)]


def _modules(part: Any) -> Iterator[str]:
    """Where the object may have been defined."""
    names = [getattr(one, "__module__", None) for one in (*_functions(part), part)]
    for name in dict.fromkeys((*names, "__main__")):
        if name in sys.modules:
            yield name
