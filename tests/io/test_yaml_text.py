import pytest
import yaml

from ebjax.io.yaml_text import MOST_VALUES, parse_yaml

LISTS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 10)
)
MERGES = "a0: &a0 {k: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 9)}]}}\n" for k in range(1, 10))


@pytest.mark.parametrize(
    "text",
    [
        "a: [1, 2.5, 1e-3, true, null, word, 'quoted']\nb: {c: {d: []}}\n",
        "a: &x [1, 2]\nb: *x\nc: {<<: {d: 1}, e: 2}\n",
        "a: 2024-05-06\nb: 0x10\nc: 1_000\nd: .inf\n",
        "",
        "- 1\n- - 2\n  - 3\n",
    ],
)
def test_what_people_write_is_read_as_by_pyyaml(text):
    assert parse_yaml(text) == yaml.safe_load(text)


def test_aliases_may_be_written_out_up_to_a_bound():
    short = "a: &a [0]\nb: [" + "*a, " * 1000 + "]\n"
    assert parse_yaml(short)["b"] == [[0]] * 1000
    for text in (LISTS, MERGES):
        with pytest.raises(yaml.YAMLError, match=f"stand for more than {MOST_VALUES} values"):
            parse_yaml(text)
    for text in ("a: &a [*a]", "a: &a {<<: *a}", "&a {b: *a}"):
        with pytest.raises(yaml.YAMLError, match="stand for more than"):
            parse_yaml(text)


@pytest.mark.parametrize("text", ["[" * 5000, "{" * 5000, "- " * 5000, "{a: " * 5000, "a: " + "[" * 200 + "]" * 200])
def test_brackets_have_a_bound(text):
    with pytest.raises(yaml.YAMLError, match="more than 100 brackets in each other") as error:
        parse_yaml(text)
    assert error.value.problem_mark.line == 0
    chain = "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}]\n" for k in range(1, 300))
    with pytest.raises(yaml.YAMLError, match="more than 100 brackets in each other"):
        parse_yaml(chain)


@pytest.mark.parametrize(
    "value, words",
    [
        ("2024-13-45", "'2024-13-45' is no timestamp; put it in quotes"),
        ("!!timestamp noon", "'noon' is no timestamp"),
        ("!!int abc", "'abc' is no int"),
        ("!!float ''", "'' is no float"),
        ("!!bool perhaps", "'perhaps' is no bool"),
        ("1" * 5000, "'1{40}' is no int"),
    ],
)
def test_values_that_are_none(value, words):
    with pytest.raises(yaml.YAMLError, match=words) as error:
        parse_yaml(f"a: 1\nb: {value}\n")
    assert error.value.problem_mark.line == 1
    if "quotes" in words:
        assert parse_yaml(f"b: '{value}'\n") == {"b": value}
