import json
import math

import pytest

from ebjax.io.json_text import NotJson, parse_json, read_json


def test_plain_values():
    text = json.dumps({"a": [1, -2.5, 10**250, True, None, "é"], "b": {"c": {}}})
    assert parse_json(text) == json.loads(text)
    assert parse_json('{"a": 1, "a": 2}', pairs=len) == 2


@pytest.mark.parametrize("depth, deep", [(100, False), (101, True), (2000, True), (100_000, True)])
def test_brackets_have_a_bound(depth, deep):
    text = "[" * depth + "]" * depth
    if not deep:
        assert parse_json(text) == json.loads(text)
        return
    with pytest.raises(NotJson, match=r"line 1: not JSON \(more than 100 brackets in each other"):
        parse_json(text)
    with pytest.raises(NotJson, match="more than 100 brackets"):
        parse_json('{"a":' * depth + "1" + "}" * depth)


@pytest.mark.parametrize("digits, value", [(300, 10**300 - 1), (301, 1e301), (400, math.inf), (5000, math.inf)])
def test_long_whole_numbers_are_floats(digits, value):
    assert parse_json(f"[{'9' * digits}, -{'9' * digits}]") == pytest.approx([value, -value], rel=1e-9)
    assert digits > 300 or parse_json("9" * digits) == value


def test_the_line_is_named(tmp_path):
    (tmp_path / "a.json").write_text('{"a": 1,\n\n oops}')
    with pytest.raises(ValueError, match=r"a\.json line 3: not JSON \(Expecting .*\); correct the file") as error:
        read_json(tmp_path / "a.json")
    assert not isinstance(error.value, NotJson)
