"""The index against an exhaustive search; the same answers whatever came before, whatever its size."""

import jax
import numpy as np
import pytest

from ebjax.places import index as module
from ebjax.places.fixed_words import fixed_words
from ebjax.places.index import PlaceIndex, Projection
from ebjax.places.pairwise import correlate_rows, spectrum
from ebjax.places.place import Place, turned, turned_map

SIZE, CHANNELS, LENGTH = (6, 5), 32, 4096
WORDS = fixed_words("floornet")


def drawn(count, seed=0, spots=None):
    """Places near some spots, from both sides."""
    rng = np.random.default_rng(seed)
    spots = spots or max(count // 4, 1)
    centres = rng.standard_normal((spots, LENGTH)) * 12
    grounds = rng.integers(-100, 101, (spots, *SIZE, CHANNELS)).astype(np.int8)
    places = []
    for k in range(count):
        vector = np.clip(np.round(centres[k % spots] + rng.standard_normal(LENGTH) * 20), -127, 127).astype(np.int8)
        ground = grounds[k % spots]
        if rng.random() < 0.5:
            vector, ground = turned(vector, WORDS), turned_map(ground, WORDS)
        weight = rng.integers(1, 256, SIZE).astype(np.uint8)
        weight[rng.random(SIZE) < 0.1] = 0
        places.append(Place(vector, turned(vector, WORDS), ground * (weight > 0)[..., None], weight))
    return places


def reader(places):
    stored = np.stack([place.map for place in places]), np.stack([place.weight for place in places])
    return lambda rows: (stored[0][rows], stored[1][rows])


def indexed(places):
    made = PlaceIndex(WORDS, reader(places))
    for row, place in enumerate(places):
        assert made.add(place) == row
    return made


def cosines(places, vector):
    rows = np.stack([place.vector for place in places]).astype(np.int64)
    wide = vector.astype(np.int64)
    return rows @ wide / np.sqrt((rows**2).sum(1) * float(wide @ wide))


def exhaustive(places, query, masks, top):
    """(row, opposing, score, shift) of the top of each direction by cosine, ranked by the mean with the correlation."""
    found = []
    for way, mask in enumerate(masks):
        cosine = np.where(mask, cosines(places, query.turned if way else query.vector), -np.inf)
        for row in [row for row in np.argsort(-cosine, kind="stable")[:top] if mask[row]]:
            ours = turned_map(query.map, WORDS) if way else query.map
            weight = query.weight[::-1, ::-1] if way else query.weight
            other = places[row]
            one = spectrum(ours, weight)
            held = jax.tree.map(lambda leaf: leaf[None], spectrum(other.map, other.weight))
            score, shift = (np.asarray(part)[0, 0] for part in correlate_rows(one, one, held, np.zeros((2, 1), int)))
            shift = shift * (-1 if way else 1)
            found.append((row, bool(way), (cosine[row] + float(score)) / 2, *shift))
    return sorted(found, key=lambda one: -one[2])


@pytest.mark.parametrize(("count", "top", "seed"), [(60, 5, 0), (300, 20, 1), (7, 20, 2), (1, 3, 3)])
def test_what_is_found_is_what_an_exhaustive_search_finds(count, top, seed):
    places = drawn(count, seed)
    query, places = places[-1], places[:-1] or places
    rng = np.random.default_rng(seed)
    masks = rng.random((2, len(places))) < 0.7
    found = indexed(places).query(query, *masks, top=top)
    expected = exhaustive(places, query, masks, top)
    assert [*zip(found.j, found.opposing, strict=True)] == [one[:2] for one in expected]
    np.testing.assert_allclose(1 - found.distance, [one[2] for one in expected], atol=1e-6)
    np.testing.assert_array_equal(found.shift, np.reshape([one[3:] for one in expected], (-1, 2)))


def test_a_number_means_the_first_rows():
    places = drawn(40)
    made = indexed(places)
    found = made.query(places[0], 7, 25, top=30)
    masks = np.arange(40) < 7, np.arange(40) < 25
    for ours, theirs in zip(found, made.query(places[0], *masks, top=30), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert (~found.opposing).sum() == 7 and found.opposing.sum() == 25 and (np.diff(found.distance) >= 0).all()
    assert len(made.query(places[0], 0, 0).j) == 0 == len(PlaceIndex().query(places[0], 0, 0).j)


@pytest.mark.parametrize("chunk", [8, 64])
def test_answers_do_not_depend_on_what_was_asked_before(monkeypatch, chunk):
    monkeypatch.setattr(module, "CHUNK", chunk)
    places = drawn(100, 4)
    made, live = PlaceIndex(WORDS, reader(places)), []
    for k, place in enumerate(places):
        live.append(made.query(place, max(k - 5, 0), max(k - 2, 0)))
        made.add(place)
    for k in (99, 50, 9, 3):
        again = indexed(places[: k or 1]).query(places[k], max(k - 5, 0), max(k - 2, 0))
        later = made.query(places[k], max(k - 5, 0), max(k - 2, 0))
        for one, two, three in zip(live[k], again, later, strict=True):
            np.testing.assert_array_equal(one, two)
            np.testing.assert_array_equal(one, three)


def test_no_number_of_places_compiles_anything_new(caplog):
    places = drawn(90, 5)
    made = PlaceIndex(WORDS, reader(places))
    made.add(places[0])
    made.query(places[0], 1, 1)
    with jax.log_compiles():
        for k, place in enumerate(places):
            made.add(place)
            if k % 20 == 0:
                made.query(place, k // 2, k)
    assert not [record.message for record in caplog.records if "Compiling" in record.message]


def test_without_maps_the_cosine_ranks():
    places = [Place(place.vector, place.turned) for place in drawn(30, 6)]
    made = PlaceIndex()
    for place in places:
        made.add(place)
    found = made.query(places[3], 30, 30, top=4)
    expected = np.sort(np.concatenate([np.sort(cosines(places, v))[-4:] for v in places[3][:2]]))[::-1]
    np.testing.assert_allclose(1 - found.distance, expected, atol=1e-12)
    assert found.j[0] == 3 and not found.opposing[0] and not found.shift.any()


@pytest.mark.parametrize("length", [4096, 700])
def test_two_stages_keep_the_exhaustive_first_ten(length):
    rng = np.random.default_rng(7)
    trail = np.cumsum(rng.standard_normal((800, length)), 0)  # neighbours look alike, as on a path
    steps = np.stack([trail[k] - trail[max(k - 12, 0)] for k in range(12, 800)])
    vectors = np.clip(np.round(steps * 8), -127, 127).astype(np.int8)
    made = PlaceIndex()
    for vector in vectors:
        made.add(Place(vector, vector))
    wide = vectors.astype(np.float64) / np.linalg.norm(vectors.astype(float), axis=1, keepdims=True)
    kept = []
    for k in rng.choice(len(vectors), 30, replace=False):
        found = made.query(Place(vectors[k], vectors[k]), len(vectors), 0, top=10)
        kept.append(np.isin(np.argsort(-(wide @ wide[k]))[:10], found.j).mean())
    assert np.mean(kept) > 0.98


def test_projections_keep_inner_products():
    rng = np.random.default_rng(8)
    project, vectors = Projection(LENGTH), rng.integers(-127, 128, (200, LENGTH)).astype(np.int8)
    vectors[1::2] = vectors[::2]  # pairs of the same vector, of which a part is another
    vectors[1::2, : LENGTH // 3] = rng.integers(-127, 128, (100, LENGTH // 3))
    low = np.stack([project(vector) for vector in vectors])
    unit = vectors / np.linalg.norm(vectors.astype(float), axis=1, keepdims=True)
    error = (low[::2] * low[1::2]).sum(1) - (unit[::2] * unit[1::2]).sum(1)
    assert abs(error.mean()) < 0.02 and error.std() < 1.5 / np.sqrt(512)


def test_what_does_not_fit_is_refused():
    places = drawn(3)
    made = indexed(places)
    with pytest.raises(ValueError, match=r"mask of .2,. over an index of 3 places"):
        made.query(places[0], np.ones(2, bool), 3)
    with pytest.raises(ValueError, match="100 numbers beside places of 4096 numbers and a map of 6x5 cells"):
        made.add(Place(places[0].vector[:100], places[0].turned[:100]))
    other = places[0]._replace(map=places[0].map[:4], weight=places[0].weight[:4])
    with pytest.raises(
        ValueError, match=r"map of 4x5 cells beside .* map of 6x5 cells: look at a floor of the same size"
    ):
        made.add(other)
    with pytest.raises(ValueError, match="no map to correlate; make the index without maps_of"):
        PlaceIndex(WORDS, lambda rows: rows).add(Place(places[0].vector, places[0].turned))
    with pytest.raises(ValueError, match="both words and maps_of"):
        PlaceIndex(WORDS)
    assert len(made) == 3 and "3 places" in repr(made)
