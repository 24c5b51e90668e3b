import numpy as np

from dualms.field import topology


def ball(n: int, radius: float) -> np.ndarray:
    x = np.indices((n, n, n)) - (n - 1) / 2
    return np.asarray(radius - np.sqrt((x**2).sum(0)), dtype=np.float32)


def test_euler_characteristic_of_ball_torus_and_two_balls() -> None:
    assert topology.euler_characteristic(ball(15, 5) > 0) == 1
    x, y, z = np.indices((21, 21, 9)) - np.array([10, 10, 4])[:, None, None, None]
    torus = (np.hypot(x, y) - 6) ** 2 + z**2 < 6
    assert topology.euler_characteristic(torus) == 0
    two = np.concatenate([ball(15, 5) > 0, ball(15, 5) > 0])
    assert topology.euler_characteristic(two) == 2


def test_following_a_simple_change_reaches_it() -> None:
    inside = np.ones((15, 15, 15), dtype=bool)
    hot = ball(15, 3) > 0
    kept = topology.follow(hot, ball(15, 5), inside)
    assert len(kept) == 0
    assert np.array_equal(hot, ball(15, 5) > 0)


def test_following_neither_joins_splits_nor_removes() -> None:
    inside = np.ones((15, 15, 15), dtype=bool)
    hot = ball(15, 3) > 0
    assert len(topology.follow(hot, np.full(hot.shape, np.float32(-1)), inside)) > 0
    assert hot.sum() == 1, "a ball shrinks to one voxel and stays"
    bar = np.zeros((15, 15, 15), dtype=bool)
    bar[2:13, 6:9, 6:9] = True
    cut = np.where(bar, np.float32(1), np.float32(-1))
    cut[7] = -1
    topology.follow(bar, cut, inside)
    assert topology.component_counts(bar, inside) == (1, 1)


def test_pockets_go_to_the_other_colour_and_skeleton_pieces_stay() -> None:
    inside = np.ones((12, 12, 12), dtype=bool)
    hot = np.zeros(inside.shape, dtype=bool)
    hot[:4] = True
    hot[8, 8, 8] = True
    hot[1, 1, 1] = False
    bones = np.zeros_like(hot), np.zeros_like(hot)
    bones[0][2, :, 2] = True
    bones[1][9, :, 2] = True
    clean, changed = topology.without_pockets(hot, inside, bones)
    assert changed == 2
    assert topology.component_counts(clean, inside) == (1, 1)


def test_a_sealed_wall_keeps_a_film_whole_that_an_open_one_lets_pierce() -> None:
    inside = np.zeros((13, 13, 13), dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    hot = np.zeros_like(inside)
    hot[1:-1, 1:-1, 1:3] = True
    # The cold fluid above the film wants to reach the wall below it.
    values = np.where(hot, np.float32(1), np.float32(-1))
    values[5:8, 5:8, 1:3] = -1
    for sealed, euler in ((False, 0), (True, 1)):
        film = hot.copy()
        topology.follow(film, values, inside, sealed=sealed)
        assert topology.euler_characteristic(film) == euler
        assert topology.component_counts(film, inside) == (1, 1)
