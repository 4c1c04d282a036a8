"""Config files that are damaged or hostile: one line that names file and key."""

from dataclasses import dataclass, field

import pytest

from ebjax.config import load_config


@dataclass(frozen=True)
class Inner:
    low: float = 0.0


@dataclass(frozen=True)
class Config:
    rate: float = 1.0
    count: int = 1
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    "text, words",
    [
        ('"ra\\nte": 1', r"unknown key 'ra\\nte'; did you mean rate\?"),
        ('"": 1', "unknown key ''; known keys"),
        ("inner: {lo: 1}", r"unknown key inner\.lo; did you mean inner\.low\?"),
        (f"{'x' * 500}: 1", r"unknown key 'x{79}\.\.\.; "),
        (f"rate: {'x' * 50000}", r"key rate is 'x{79}\.\.\., not a number"),
        ("rate: [" + "1, " * 5000 + "]", r"key rate is \[1, .*\.\.\., not a number"),
        (f"rate: {'9' * 400}", r"key rate is 9{80}\.\.\., not a number"),
        (f"rate: {'9' * 5000}", " line 1: not YAML .*is no int"),
        ("count: 2024-02-30", " line 1: not YAML .'2024-02-30' is no timestamp; put it in quotes"),
        ("count: 1\nrate: !!float ''", " line 2: not YAML"),
        ("rate: &x [*x]", " line 1: not YAML .its aliases stand for more"),
        ("[" * 5000, " line 1: not YAML .more than 100 brackets"),
        ("rate: 1\n\0", ": not a text file"),
    ],
)
def test_one_line(tmp_path, text, words):
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"config\.yaml:? ?{words}") as error:
        load_config(tmp_path / "config.yaml", Config)
    assert len(str(error.value).splitlines()) == 1 and len(str(error.value)) < 500
