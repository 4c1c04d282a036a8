import resource

import pytest

from ebjax.io.atomic import check_folder, resumed_folder, whole_file, whole_folder


def contents(folder):
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


def test_file_appears_whole_with_its_parents(tmp_path):
    with whole_file(tmp_path / "a" / "b.txt") as file:
        file.write("größe\n")
        assert not (tmp_path / "a" / "b.txt").exists()
    assert (tmp_path / "a" / "b.txt").read_bytes() == "größe\n".encode()
    with whole_file(tmp_path / "a" / "c.bin", "wb") as file:
        file.write(b"\x00\xff")
    assert (tmp_path / "a" / "c.bin").read_bytes() == b"\x00\xff"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    (tmp_path / "b.txt").write_text("old")
    with pytest.raises(error), whole_file(tmp_path / "b.txt") as file:
        file.write("half")
        raise error
    assert contents(tmp_path) == {"b.txt": "old"}


def test_file_over_a_folder_names_it(tmp_path):
    with pytest.raises(OSError, match="name a file"), whole_file(tmp_path):
        pass


def test_new_folder_appears_at_once(tmp_path):
    with whole_folder(tmp_path / "run" / "one") as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "x").write_text("1")
        assert not (tmp_path / "run" / "one").exists()
    assert contents(tmp_path) == {"run/one/deep/x": "1"}


def test_existing_folder_keeps_other_files(tmp_path):
    (tmp_path / "mine").write_text("keep")
    (tmp_path / "x").write_text("old")
    with whole_folder(tmp_path) as folder:
        (folder / "x").write_text("new")
        (folder / "sub").mkdir()
        (folder / "sub" / "y").write_text("2")
    assert contents(tmp_path) == {"mine": "keep", "x": "new", "sub/y": "2"}
    assert not [p for p in tmp_path.iterdir() if "partial" in p.name]


@pytest.mark.parametrize("exists", [False, True])
def test_failed_folder_changes_nothing(tmp_path, exists):
    target = tmp_path / "run"
    if exists:
        target.mkdir()
        (target / "x").write_text("old")
    before = contents(tmp_path)
    with pytest.raises(RuntimeError), whole_folder(target) as folder:
        (folder / "x").write_text("half")
        raise RuntimeError
    assert contents(tmp_path) == before
    assert target.exists() == exists


def test_folder_over_a_file_names_it(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(OSError, match="name a folder"), whole_folder(tmp_path / "f"):
        pass


def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(OSError, match=r"large.*b\.txt"), whole_file(tmp_path / "b.txt") as file:
            file.write("x" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_folder_is_gone_on_with(tmp_path, error):
    with pytest.raises(error), resumed_folder(tmp_path / "a" / "run") as folder, whole_file(folder / "x" / "1") as file:
        file.write("half")
        raise error
    with pytest.raises(error), resumed_folder(tmp_path / "a" / "run") as folder:
        (folder / "x" / "1").write_text("whole")
        (folder / "x" / ".2.12345678.partial").write_text("as a killed process leaves it")
        raise error
    with resumed_folder(tmp_path / "a" / "run") as folder:
        assert contents(tmp_path) == {"a/.run.partial/x/1": "whole"}
        (folder / "x" / "2").write_text("2")
    assert contents(tmp_path) == {"a/run/x/1": "whole", "a/run/x/2": "2"}


def test_a_folder_that_is_full_is_not_gone_on_with(tmp_path):
    (tmp_path / "empty").mkdir()
    with resumed_folder(tmp_path / "empty") as folder:
        (folder / "x").write_text("1")
    for taken in ("empty", "empty/x"):
        with pytest.raises(OSError, match="name another folder"), resumed_folder(tmp_path / taken):
            pass
    assert contents(tmp_path) == {"empty/x": "1"}


@pytest.mark.parametrize("whole", [whole_folder, resumed_folder, whole_file])
def test_what_cannot_be_made_is_told_by_its_name(whole):
    with pytest.raises(OSError, match=r"'/proc/nowhere'"), whole("/proc/nowhere"):
        pass


def test_a_file_in_an_unfinished_folder_is_told_as_it_would_be_called(tmp_path):
    with pytest.raises(OSError, match=r"run/a/b'"), whole_folder(tmp_path / "run") as folder:
        (folder / "a" / "b").read_text()
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("name", ["file", "file/run", "/proc/runs/run"])
def test_a_folder_that_cannot_be_written_is_known_before(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    check_folder(tmp_path / "new" / "run")
    check_folder(tmp_path)
    with pytest.raises(OSError) as stop:
        check_folder(tmp_path / name)
    assert str(stop.value.filename) in str(tmp_path / name)
    assert contents(tmp_path) == {"file": "mine"} and len(list(tmp_path.iterdir())) == 1
