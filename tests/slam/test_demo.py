import pytest

from ebjax.bench import programs
from ebjax.front.close import close_loops
from ebjax.front.demo import compile_engine, demo
from ebjax.slam.__main__ import Config


@pytest.fixture
def painted(monkeypatch):
    """Rendering is a list in a folder."""

    def render(config, folder):
        folder.mkdir()
        (folder / "rgb.txt").write_text("")

    monkeypatch.setattr("ebjax.front.demo.render_sequence", render)


def test_what_is_rendered_once_stays(painted, tmp_path, capsys):
    done = []
    folder = demo(tmp_path / "sequence", lambda: done.append("beside"))
    assert folder == tmp_path / "sequence" and done == ["beside"]
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith(f"rendering a synthetic corridor into {folder}; ") and last.startswith("rendered in ")
    assert demo(folder, lambda: done.append("again")) == folder and done == ["beside"]
    assert capsys.readouterr().err == ""


def test_a_fault_beside_the_rendering_is_told(painted, tmp_path):
    def fail():
        raise ValueError("unknown extractor 'surf9'")

    with pytest.raises(ValueError, match="surf9"):
        demo(tmp_path / "sequence", fail)


@pytest.mark.whole
def test_the_drive_finds_its_programs_compiled(rendered):
    compile_engine(Config())
    with programs.counted() as found:
        close_loops(rendered, quiet=True)
    asked = {name.removeprefix("jit(").removesuffix(")") for name in found.asked}
    assert not asked & {"_look", "_describe", "_described", "verify_pair", "lift", "located", "_row_of_cycles"}
