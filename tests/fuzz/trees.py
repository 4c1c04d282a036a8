"""Mutations of JSON and YAML as values: keys removed, renamed, nested; numbers for lists, lists for words; bombs."""

import json
import random
from typing import Any

import yaml

from ebjax.io.json_text import parse_json
from ebjax.io.yaml_text import parse_yaml

VALUES = (
    *(None, True, False, 0, -1, 1.5, 2**31, 2**63, 2**64, 10**400, 1e308, float("nan"), float("inf"), "", "a word"),
    *("1e-3", "1_000", "é\u2028\x85", "x" * 5000, [], {}, [[]], [None], {"": None}, {"data": {}}, [[1, 2], [3]]),
    [0] * 5000,
)
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 10)
)
STRANGE = """x: &x [*x]
x: &x {<<: *x}
<<: [1, 2]
? [1, 2]
? {a: b}
!!binary x: 1
x: 2020-13-45
x: 0o9
x: 1:99:99
x: !!int abc
x: !!float ''
x: !!set [1]
x: !!timestamp abc
x: !!omap 1
x: !!pairs 1
x: *nowhere
x: !!python/object:os.system {}
- x
%TAG ! x
""".splitlines()
"""Lines that YAML's readers stumble over."""


def is_tree(content: bytes) -> bool:
    """Whether content is a mapping or list in JSON or YAML."""
    return isinstance(_parsed(content), dict | list)


def _parsed(content: bytes) -> Any:
    if len(content) > 20_000:
        return None
    try:
        text = content.decode()
        return parse_json(text) if text.lstrip()[:1] in ("{", "[") else parse_yaml(text)
    except (ValueError, yaml.YAMLError):
        return None


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every (container, key or index) of a tree."""
    pairs = list(tree.items() if isinstance(tree, dict) else enumerate(tree)) if isinstance(tree, dict | list) else []
    return [(tree, key) for key, _ in pairs] + [place for _, part in pairs for place in _places(part)]


def change_tree(content: bytes, draw: random.Random) -> bytes:
    """Mutates one place of a JSON or YAML text, and writes it again."""
    as_json = content.lstrip()[:1] in (b"{", b"[")
    if not as_json and draw.random() < 0.25:
        lines = draw.choice((BOMB, *STRANGE)).encode() + b"\n"
        return draw.choice((lines + content, content + b"\n" + lines, lines))
    tree = _parsed(content)
    places = _places(tree)
    if not places:
        return content
    holder, key = draw.choice(places)
    how = draw.randrange(6)
    if how == 0:
        del holder[key]
    elif how == 1 and isinstance(holder, dict):
        other = draw.choice((f"{key}x", str(key).swapcase(), 0, None, "", "x" * 300, f"{key}\n", True))
        holder[other] = holder.pop(key)
    elif how == 2:
        holder[key] = draw.choice(([holder[key]], {str(key): holder[key]}, str(holder[key])))
    elif how == 3 and isinstance(holder[key], list):
        holder[key] = draw.choice((holder[key][:-1], holder[key] * 2, holder[key][::-1], holder[key] + [None]))
    elif how == 4:
        for _ in range(draw.choice((3, 200))):
            holder[key] = [holder[key]]
    else:
        holder[key] = draw.choice(VALUES)
    return _written(tree, as_json)


def _written(tree: Any, as_json: bool) -> bytes:
    try:
        if as_json:
            return json.dumps(tree, indent=1).encode()
        return yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False).encode()
    except (RecursionError, ValueError, yaml.YAMLError):
        return b"{}"
