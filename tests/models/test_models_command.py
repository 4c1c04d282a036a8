import os

import numpy as np
import pytest

from ebjax.models import __main__ as command
from ebjax.models.catalogue import MODELS
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import load_weights


class Hostile:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


def test_converts_and_refuses(program, write_torch, tmp_path):
    published = seeded_state("d2net", 4)
    write_torch(tmp_path / "d2_tf.pth", {"model": published})
    done = program("ebjax.models", "convert", "d2_tf.pth", "out/d2net.safetensors", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "d2_tf.pth: d2net, 20 arrays, 7,635,264 numbers" in done.stdout
    _, arrays = load_weights(tmp_path / "out" / "d2net.safetensors")
    kernel = published["dense_feature_extraction.model.21.weight"]
    np.testing.assert_array_equal(arrays["conv4_3.kernel"][1, 2], kernel[:, :, 1, 2].T)
    write_torch(tmp_path / "d2_tf.pth", {"model": published, "extra": Hostile(tmp_path / "trace")})
    done = program("ebjax.models", "convert", "d2_tf.pth", "hostile.safetensors", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "posix.system" in done.stderr
    assert not (tmp_path / "trace").exists() and not (tmp_path / "hostile.safetensors").exists()


def test_check_says_what_is_off_and_exits_1(monkeypatch, capsys, tmp_path):
    from ebjax.models.compare import Deviation

    rows = [("a__x.npz", "map", Deviation(1e-6, 1e-4)), ("a__x.npz", "gap", Deviation(float("inf"), 1e-4))]
    monkeypatch.setattr("ebjax.models.check.check_folder", lambda *_: iter(rows))
    with pytest.raises(SystemExit) as stop:
        command.check(command.CheckConfig(tmp_path))
    assert stop.value.code == 1
    out, err = capsys.readouterr()
    assert "1.00e-06  of 1.00e-04\n" in out and "TOO LARGE" in out and "2 arrays, 1 too far off" in out
    assert "first a__x.npz gap" in err
    rows.pop()
    command.check(command.CheckConfig(tmp_path))


def test_lists_every_network(capsys):
    command.main(["list"])
    out = capsys.readouterr().out
    for name, model in MODELS.items():
        assert all(part in out for part in (name, model.file, model.source, model.licence, f"{model.size_mb:g} MB"))


def test_commands_are_listed_and_others_refused(capsys):
    command.main([])
    assert all(f"python -m ebjax.models {name}" in capsys.readouterr().out for name in ("convert",))
    with pytest.raises(SystemExit) as stop:
        command.main(["frob"])
    assert stop.value.code == 2 and "no command 'frob'" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        command.main(["convert", "a.pth", "b.pth"])
    assert stop.value.code == 2
