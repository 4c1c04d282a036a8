import pytest
from small_run import opened

from ebjax.io.map_file.file import MapFile
from ebjax.mapping.maintain import drop_views, forget, repaired


@pytest.mark.slow
def test_views_of_finished_sessions_are_dropped(whole, tmp_path):
    path = tmp_path / "a.ebmap"
    with opened(path) as store:
        whole.keep(store, range(6))
        store.file.end_session(1)
    with opened(path, log="tuesday") as store:
        whole.keep(store, range(3))
    size = path.stat().st_size
    did, kept = drop_views(path)
    assert did.startswith(f"{path}: dropped the colour views of 6 keyframes, ") and did.endswith(" MB less")
    assert kept == f"{path}: kept those of unfinished sessions (2): finish or forget them first"
    assert path.stat().st_size < size
    with MapFile.open(path, write=False) as file:
        assert ["view" in file.arrays(k) for k in range(9)] == [False] * 6 + [True] * 3
        assert file.arrays(2).keys() == whole.arrays[2].keys() - {"view"}
    forget(path, 2)
    assert drop_views(path) == [f"{path}: dropped the colour views of 0 keyframes, 0.0 MB less"]


@pytest.mark.parametrize("number", [7, 0])
def test_a_session_that_is_not_there(whole, tmp_path, number):
    path = tmp_path / "a.ebmap"
    opened(path).close()
    with pytest.raises(ValueError, match=f"{path}: holds no session {number}; it has 1$"):
        forget(path, number)


def test_a_repair_does_not_write_over_a_file(whole, tmp_path):
    path = tmp_path / "building.ebmap"
    opened(path).close()
    assert repaired(path) == [
        f"{tmp_path / 'building.repaired.ebmap'}: saved 1 sessions, 0 keyframes, 0 frames, 0 edges; nothing is lost",
        f"go on with --map {tmp_path / 'building.repaired.ebmap'}",
    ]
    with pytest.raises(FileExistsError):
        repaired(path)
    assert repaired(path, tmp_path / "b.ebmap")[-1] == f"go on with --map {tmp_path / 'b.ebmap'}"
    for none in (tmp_path / "none.ebmap", tmp_path):
        for does in (drop_views, repaired, lambda path: forget(path, 1)):
            with pytest.raises(ValueError, match="name a map"):
                does(none)
