"""Lists the commands of ebjax, and runs them: `ebjax slam LOG` is `python -m ebjax.slam LOG`."""

import ast
import difflib
import os
import runpy
import sys
from pathlib import Path

import ebjax


def commands() -> dict[str, str]:
    """Returns every room that can be run, `ebjax.NAME`, with the first line of its command's docstring."""
    found = {}
    for file in sorted(Path(__file__).parent.glob("*/__main__.py")):
        docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        found[f"ebjax.{file.parent.name}"] = docstring.partition("\n")[0]
    return found


def main() -> None:
    """Runs `ebjax COMMAND ...`; prints one line a command, or the version; another word gets exit code 2."""
    first = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if f"ebjax.{first}" in commands():
        _run(first)
    elif first == "--version":
        _say([f"ebjax {ebjax.__version__}"])
    elif first in ("-h", "--help"):
        width = max(map(len, commands()))
        lines = [f"  {name.replace('.', ' '):{width}}  {line}" for name, line in commands().items()]
        _say([
            "Closes loops from opposing viewpoints (Early Bird in JAX). Commands, each with --help:",
            *("", *lines, ""),
            "`ebjax slam` is `python -m ebjax.slam`, and so on. `ebjax --version` prints the version.",
        ])  # fmt: skip
    else:
        close = difflib.get_close_matches(first, [name.partition(".")[2] for name in commands()], n=1)
        hint = f"did you mean `ebjax {close[0]}`?" if close else "`ebjax --help` lists them"
        print(f"error: there is no command {first!r}; {hint}", file=sys.stderr)
        sys.exit(2)


def _run(room: str) -> None:
    """Runs the command of a room as `python -m` does."""
    del sys.argv[1]
    # Where a part of one's own may lie.
    sys.path.insert(0, os.getcwd())
    runpy.run_module(f"ebjax.{room}", run_name="__main__", alter_sys=True)


def _say(lines: list[str]) -> None:
    """Prints; a reader that went away (`| head`) is no fault."""
    try:
        print("\n".join(lines), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
