"""The figures of the READMEs: kept in figures.json with the commands that print them, and measured anew on request.

    python -m tests.figures NAME ...

runs the commands of the entries that are named, of all without a name; reads what they print, writes it into
figures.json and puts it into the READMEs. `--list` says which entries there are and what they need. What the commands
print and make stays in `--work`; `--kept` reads it from there, and runs nothing. `tests/test_figures.py` compares the
READMEs with the file.

An entry has

- `commands`: lines for a shell; `{data}` is the folder EBJAX_DATA, `{work}` the one of `--work`;
- `needs`: names in that data, and modules;
- `minutes`: about how long it takes on two cores;
- `machine`: true where figures are times or memory, which another machine would change;
- `prints`: lines that the commands print. `{key}` is a number, `{key.2}` one to be rounded to two places at most,
  `{key*}` the rest of a line, `{_}` a number and `{}` a part of a line or of a cell that does not count. A line without
  keys is where the lines that follow it are sought from. A command's own line, `$ python -m ...` as in the file, stands
  before what it prints;
- `printed`: what stood for the keys;
- `shown`: by README, the rows and sentences that show them.
"""

import argparse
import importlib.util
import json
import os
import re
import subprocess
import sys
from decimal import Decimal
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).with_name("figures.json")
DATA = Path(os.environ.get("EBJAX_DATA", ROOT.parent / "shared" / "data"))
NUMBER, REST, SKIPPED = r"[+-]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[+-]?\d+)?", r"[^\n]*", r"[^|\n]*?"
KEY = re.compile(r"\{(\w*)(\*|\.\d)?\}")

Entry = dict[str, Any]


def recorded() -> list[Entry]:
    """What the file holds."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def keys_of(lines: list[str]) -> list[str]:
    """The names in the braces of some lines."""
    return [name for line in lines for name, _ in KEY.findall(line) if name not in ("", "_")]


def pattern(line: str, values: dict[str, str] | None = None) -> re.Pattern[str]:
    """Finds a line of `prints`, or with values one of `shown`, which may go over the end of a line."""
    blank, parts, at, count = r"[^\S\n]+" if values is None else r"\s+", [], 0, 0
    for key in KEY.finditer(line):
        parts.append(_literal(line[at : key.start()], blank))
        name, rest = key.groups()
        if name in ("", "_"):
            parts.append(NUMBER if name else SKIPPED)
        elif values is None:
            parts.append(f"(?P<{name}>{REST if rest == '*' else NUMBER})")
        else:
            parts.append(f"(?P<_{count}_{name}>{_literal(values[name], blank)})")
            count += 1
        at = key.end()
    return re.compile("".join((*parts, _literal(line[at:], blank))))


def _literal(text: str, blank: str) -> str:
    return blank.join(map(re.escape, re.split(r"\s+", text)))


def read(entry: Entry, text: str) -> dict[str, str]:
    """The values of an entry's keys in what its commands printed.

    Raises:
      ValueError: a line is not there; names it.
    """
    found, start = {}, 0
    without_commands = re.sub(r"^\$ .*$", lambda command: " " * len(command.group()), text, flags=re.MULTILINE)
    for line in entry["prints"]:
        match = pattern(line).search(text if line.startswith("$ ") else without_commands, start)
        if match is None:
            raise ValueError(f"{entry['name']}: its commands print no line {line!r}")
        places = {name: int(rest[1:]) for name, rest in KEY.findall(line) if rest.startswith(".")}
        for key, value in match.groupdict().items():
            found[key] = rounded(value, places[key]) if key in places else " ".join(value.split())
        if not match.groupdict():
            start = match.end()
    return found


def rounded(value: str, places: int) -> str:
    """A number with so many places, or as few as it was printed with."""
    number = Decimal(value.replace(",", ""))
    return f"{number:.{min(places, max(-int(number.as_tuple().exponent), 0))}f}"


def missing(entry: Entry) -> list[str]:
    """What an entry needs and this machine lacks."""
    return [name for name in entry["needs"] if not (DATA / name).exists() and importlib.util.find_spec(name) is None]


def run(entry: Entry, printed: Path, work: Path) -> None:
    """Runs an entry's commands, one after the other; what they print goes into a file.

    Raises:
      ValueError: a command ended with an error.
    """
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    variables = os.environ | {"PATH": path, "EBJAX_DATA": str(DATA)}
    work.mkdir(parents=True, exist_ok=True)
    with printed.open("w", encoding="utf-8") as out:
        for command in entry["commands"]:
            out.write(f"$ {command}\n")
            out.flush()
            line = command.replace("{data}", str(DATA)).replace("{work}", str(work))
            done = subprocess.run(line, shell=True, cwd=ROOT, stdout=out, env=variables, check=False)
            if done.returncode:
                raise ValueError(f"{entry['name']}: exit code {done.returncode} of {line}")


def put(entry: Entry, text: str, page: str, new: dict[str, str]) -> str:
    """The text of a README with an entry's new figures in place of the old ones.

    Raises:
      ValueError: a row or sentence is not there; names it.
    """
    for line in entry["shown"][page]:
        old = pattern(line, entry["printed"])
        match = old.search(text)
        if match is None:
            raise ValueError(f"{page}: does not show {line!r} with the figures of {entry['name']}")
        parts, at = [], match.start()
        for group in match.groupdict():
            parts += [text[at : match.start(group)], new[re.sub(r"^_\d+_", "", group)]]
            at = match.end(group)
        text = "".join((text[: match.start()], *parts, text[at:]))
    return text


def renew(entry: Entry, work: Path, *, kept: bool) -> str:
    """Measures one entry, writes file and READMEs as they are by then, and says what changed.

    Raises:
      ValueError: a command, or a line in what it printed or in a README, fails.
      OSError: with `kept`, nothing was printed before.
    """
    printed = work / f"{entry['name']}.txt"
    if not kept:
        run(entry, printed, work)
    entries = recorded()
    entry = next(other for other in entries if other["name"] == entry["name"])
    new, old = read(entry, printed.read_text(encoding="utf-8")), entry["printed"]
    pages = {page: put(entry, (ROOT / page).read_text(encoding="utf-8"), page, new) for page in entry["shown"]}
    for page, text in pages.items():
        (ROOT / page).write_text(text, encoding="utf-8")
    entry["printed"] = new
    write(entries)
    return ", ".join(f"{key} {old.get(key)} -> {new[key]}" for key in new if old.get(key) != new[key]) or "as before"


def write(entries: list[Entry]) -> None:
    """Writes the file."""
    FILE.write_text(json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main(argv: list[str] | None = None) -> int:
    """Runs what is asked for; 1 where an entry failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.figures", description="Measures the READMEs' figures anew.")
    entries = recorded()
    parser.add_argument("names", nargs="*", help="of entries; none: all")
    parser.add_argument("--list", action="store_true", help="say which entries there are and what they need")
    parser.add_argument("--kept", action="store_true", help="read what an earlier run printed; run nothing")
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "figures", help="folder for what commands make")
    options = parser.parse_args(argv)
    if unknown := set(options.names) - {entry["name"] for entry in entries}:
        parser.error(f"no entry {', '.join(sorted(unknown))}; --list says which there are")
    chosen = [entry for entry in entries if not options.names or entry["name"] in options.names]
    failed = False
    for entry in chosen:
        lacks = ", ".join(missing(entry))
        if options.list:
            kind, absent = ", times of one machine" if entry["machine"] else "", f"; lacks {lacks}" if lacks else ""
            print(f"{entry['name']}: {entry['minutes']} min{kind}{absent}")
        elif lacks and not options.kept:
            print(f"{entry['name']}: left out, there is no {lacks}")
        else:
            try:
                told = renew(entry, options.work.resolve(), kept=options.kept)
                print(f"{entry['name']}: {told}", flush=True)
            except (ValueError, OSError) as fault:
                failed = True
                print(f"failed: {fault}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
