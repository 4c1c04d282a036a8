"""Lists the commands of ebjax."""

import ast
import sys
from pathlib import Path


def commands() -> dict[str, str]:
    """Returns every room that can be run, `ebjax.NAME`, with the first line of its command's docstring."""
    found = {}
    for file in sorted(Path(__file__).parent.glob("*/__main__.py")):
        docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        found[f"ebjax.{file.parent.name}"] = docstring.partition("\n")[0]
    return found


def main() -> None:
    """Prints one line a command; an argument is a mistake and gets exit code 2."""
    arguments = [argument for argument in sys.argv[1:] if argument not in ("-h", "--help")]
    if arguments:
        print(f"error: no command {arguments[0]!r} here; `python -m ebjax` lists them", file=sys.stderr)
        sys.exit(2)
    print("Early Bird in JAX. Commands, each with --help:\n")
    for name, line in commands().items():
        print(f"  python -m {name:18} {line}")


if __name__ == "__main__":
    main()
