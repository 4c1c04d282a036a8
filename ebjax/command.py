"""What every command shares: flags over a YAML file over defaults, one line on bad input, progress, JAX's settings.

A command is a frozen dataclass with documented fields and a function of it: `run(main, Config)`. Exit codes: 0, 2 for
bad input (one line on stderr; `EBJAX_DEBUG=1` shows the traceback), 130 for ctrl-C.
"""

import contextlib
import dataclasses
import functools
import io
import itertools
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import tyro

from ebjax.config import dump_config, load_config

__all__ = ["dump_config", "parse", "progress", "run", "setup_jax"]

Config = TypeVar("Config")
Item = TypeVar("Item")


class Command(NamedTuple):
    """What is run, its options, and whether it needs JAX."""

    main: Callable[[Any], None]
    config: type
    needs_jax: bool = True


def run(
    main: Callable[[Any], None],
    config_class: type[Any],
    argv: Sequence[str] | None = None,
    *,
    needs_jax: bool = True,
) -> None:
    """Parses the command line and calls `main(config)`.

    Args:
      main: the command. Its ValueError or OSError becomes the one line `error: ...` on stderr and exit code 2.
      config_class: frozen dataclass, nested ones allowed; field docstrings are the help, `tyro.conf.Positional` fields
        the arguments. `--config FILE.yaml` is added.
      argv: the arguments; None means the process's own.
      needs_jax: False spares a command without JAX the second that importing it takes.

    Raises:
      SystemExit: 2 on bad input, 130 on ctrl-C, 0 after `--help`.
    """
    try:
        config = parse(config_class, sys.argv[1:] if argv is None else argv, prog=_program(main))
        if needs_jax:
            setup_jax()
        main(config)
        sys.stdout.flush()
    except BrokenPipeError:
        _nobody_reads()
        sys.exit(0)
    except SystemExit:  # after --help
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            _nobody_reads()
        raise
    except (ValueError, OSError) as error:
        if os.environ.get("EBJAX_DEBUG") == "1":
            raise
        print(f"error: {_one_line(error)}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def run_one_of(commands: Mapping[str, Command], does: str, argv: Sequence[str]) -> None:
    """Runs the command that the first argument names; without one, or for --help, says which there are.

    Args:
      commands: by name.
      does: what they do together, a sentence.
      argv: the arguments.

    Raises:
      SystemExit: as `run`; 2 for a name that no command has.
    """
    if argv and argv[0] in commands:
        one = commands[argv[0]]
        return run(one.main, one.config, argv[1:], needs_jax=one.needs_jax)
    if argv and argv[0] not in ("-h", "--help"):
        print(f"error: no command {argv[0]!r}; there are {', '.join(commands)}", file=sys.stderr)
        sys.exit(2)
    print(f"{does} Commands, each with --help and --config FILE:\n")
    for name, one in commands.items():
        print(f"  {_program(one.main)} {name:9} {(one.config.__doc__ or '').partition(chr(10))[0]}")


def parse(config_class: type[Config], argv: Sequence[str], *, prog: str | None = None) -> Config:
    """Resolves defaults < the YAML file of `--config` < flags.

    Raises:
      ValueError: an unknown flag, a missing argument, a wrong value; in the YAML file, named with its key.
      SystemExit: 0, after printing `--help`.
    """
    config_file = Annotated[str | None, tyro.conf.arg(help="YAML file of differences from the defaults; flags win.")]
    with_file = dataclasses.make_dataclass(
        config_class.__name__,
        [("config", config_file, dataclasses.field(default=None))],
        bases=(config_class,),
        frozen=True,
        kw_only=True,
    )
    with_file.__doc__ = config_class.__doc__
    path = _config_path(argv)
    default: dict[str, Any] = {}
    if path is not None:
        loaded = load_config(path, config_class)
        default = {"default": with_file(**_fields(loaded), config=path)}
    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            parsed = tyro.cli(
                with_file, args=list(argv), prog=prog, config=(tyro.conf.PositionalMetavarFromFieldName,), **default
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        raise ValueError(f"{_flatten(messages.getvalue())} (--help lists the options)") from None
    values = _fields(parsed)
    values.pop("config")
    return config_class(**values)


def setup_jax() -> None:
    """Switches on float64 and keeps compiled programs in the user's cache folder, so that the second run starts fast.

    The folder is $JAX_COMPILATION_CACHE_DIR, or ebjax in $XDG_CACHE_HOME or ~/.cache; one that cannot be written is
    left out silently. A program that cannot be read from it is removed, and written anew.
    """
    import jax

    if not isinstance(warnings.showwarning, functools.partial):
        warnings.filterwarnings("always", message=_UNREADABLE.pattern)
        warnings.showwarning = functools.partial(_mend_or_show, warnings.showwarning)

    jax.config.update("jax_enable_x64", True)
    # Two hundred small programs take longer to compile than to read.
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if getattr(jax.config, "jax_compilation_cache_dir", None) is not None:  # the user's own choice
        return
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ebjax"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))


_UNREADABLE = re.compile("Error reading persistent compilation cache entry for '([^']+)'")


def _mend_or_show(show: Callable[..., None], message: Warning | str, *where: Any, **more: Any) -> None:
    """Shows a warning, unless it says that a program cannot be read from the cache and that could be removed.

    JAX writes an entry in place, so that a process killed meanwhile leaves a part of it, and JAX never writes over an
    entry that is there. It warns before it compiles the program and writes it. The warning names the program, not the
    entry, so all entries of that name go.
    """
    import jax

    found = _UNREADABLE.match(str(message))
    entries = (
        Path(getattr(jax.config, "jax_compilation_cache_dir", None) or "").glob(f"{found[1]}-*-cache") if found else ()
    )
    removed = 0
    with contextlib.suppress(OSError):
        for entry in entries:
            entry.unlink(missing_ok=True)
            removed += 1
    if not removed:
        show(message, *where, **more)


def progress(iterable: Iterable[Item], total: int | None = None, label: str = "") -> Iterator[Item]:
    """Iterates with a progress bar on stderr; silent when that is not a terminal.

    Args:
      iterable: what to go through.
      total: how many items; None asks the iterable for its length.
      label: what is being done.
    """
    if not sys.stderr.isatty():
        yield from iterable
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(iterable, description=label, total=total, console=Console(stderr=True), transient=True)


def _nobody_reads() -> None:
    """The reader of our output went away (`| head`); nothing is left to tell it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fields(config: Any) -> dict[str, Any]:
    return {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}


def _config_path(argv: Sequence[str]) -> str | None:
    path = None
    for argument, following in itertools.zip_longest(argv, argv[1:]):
        if argument == "--config":
            path = following
        elif argument.startswith("--config="):
            path = argument.removeprefix("--config=")
    return path


def _program(main: Callable[[Any], None]) -> str:
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    name = spec.name if spec is not None and spec.name.startswith("ebjax.") else main.__module__
    return f"python -m {name.removesuffix('.__main__')}"


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror[0].lower()}{error.strerror[1:]}"
    return " ".join(str(error).split()) or type(error).__name__


def _flatten(box: str) -> str:
    """Turns tyro's framed message into one sentence: what stands above its rule, and the flags that may be meant."""
    parts: list[list[str]] = [[]]
    for line in box.splitlines():
        if _RULE.fullmatch(line):
            parts.append([])
        elif (text := line.strip("│").rstrip()) and not text.startswith("       "):
            parts[-1].append(text.strip())
    # Without a frame nothing is told apart.
    said, *more = parts[1:] or parts
    named = [text for part in more if part and "you meant" in part[0] for text in part if text[0] == "-"]
    meant = [text.split()[0].rstrip(",") for text in named]
    return " ".join(said) + (f"; perhaps you meant {' or '.join(meant)}" if meant else "")


_RULE = re.compile(r"[╭╰].*|[│\s]*[─-]{9,}[│\s]*")
"""A line of tyro's frame; where it cannot draw one, the title stands above the first rule."""
