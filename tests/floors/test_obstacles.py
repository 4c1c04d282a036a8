import jax
import jax.numpy as jnp
import numpy as np

from ebjax.floors.obstacles import Boxes, Posts, no_boxes, see_boxes, see_posts, shade_by_boxes, shade_by_posts

ORIGIN = jnp.array([0.0, 0.0, 0.5])
BOX = Boxes(
    *(
        jnp.asarray(n, jnp.float64)
        for n in (
            [[3.0, 0.0]],
            [[0.8, 0.6]],
            [[0.5, 0.3]],
            [0.1],
            [0.9],
            [[[0.3, 0.2, 0.1], [0.1, 0.1, 0.1]]],
            [0.2],
        )
    )
)
POST = Posts(*(jnp.asarray(n, jnp.float64) for n in ([[2.0, 0.1]], [0.2], [0.1], [0.8], [[0.4, 0.4, 0.4]])))


def rays(count=400):
    rng = np.random.default_rng(0)
    directions = np.stack([np.ones(count), rng.uniform(-0.5, 0.5, count), rng.uniform(-0.3, 0.3, count)])
    return [jnp.asarray(d)[None, :] for d in directions]


def seen(see, what):
    far, black = jnp.full((1, 400), jnp.inf), jnp.zeros((1, 400, 3))
    t, colour = jax.jit(see)(what, rays(), ORIGIN, far, black)
    hit = np.isfinite(np.asarray(t))[0]
    points = np.asarray(ORIGIN)[:, None] + np.asarray(t)[0] * np.concatenate(rays())
    return hit, points[:, hit], np.asarray(colour)[0]


def test_rays_meet_boxes_on_their_faces():
    hit, points, colour = seen(see_boxes, BOX)
    dx, dy = points[0] - 3.0, points[1]
    local = np.abs(np.stack([(0.8 * dx + 0.6 * dy) / 0.5, (0.8 * dy - 0.6 * dx) / 0.3, (points[2] - 0.5) / 0.4]))
    np.testing.assert_allclose(local.max(axis=0), 1.0, atol=1e-9)
    assert 20 < hit.sum() < 300 and np.all((colour.max(axis=1) > 0) == hit)


def test_rays_meet_posts_on_their_surface():
    hit, points, _ = seen(see_posts, POST)
    np.testing.assert_allclose(np.hypot(points[0] - 2.0, points[1] - 0.1), 0.2, atol=1e-9)
    assert 20 < hit.sum() < 300 and np.all(points[0] < 2.0)
    assert points[2].min() > 0.1 and points[2].max() < 0.8


def test_what_is_nearer_stays():
    near, black = jnp.full((1, 400), 0.5), jnp.zeros((1, 400, 3))
    for see, what in ((see_boxes, BOX), (see_posts, POST)):
        t, colour = see(what, rays(), ORIGIN, near, black)
        assert jnp.all(t == near) and jnp.all(colour == 0)


def test_floor_is_darker_close_by():
    x, y = jnp.array([[2.0, 2.3, 3.0, 9.0]]), jnp.zeros((1, 4))
    by_box, by_post = shade_by_boxes(BOX, x, y)[0], shade_by_posts(POST, x, y)[0]
    assert by_box[2] < by_box[1] < by_box[3] == 1 and by_post[0] < by_post[1] < by_post[3] == 1
    assert jnp.all(shade_by_boxes(no_boxes(), x, y) == 1)
