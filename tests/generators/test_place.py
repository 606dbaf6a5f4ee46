"""Where a base station and a drive are put in a scene that says nothing of either: on hilly ground at a height of its own."""

import numpy as np

from dopslam.scenes.generators.place import OUTDOOR, level_places, place, terrain


def hill() -> tuple[np.ndarray, np.ndarray]:
    """A terrace 20 m above a plain with a slope between, as one object, and two buildings on the terrace as others."""

    def quad(x0, x1, y0, y1, z0, z1):
        a, b, c, d = [x0, y0, z0], [x1, y0, z1], [x1, y1, z1], [x0, y1, z0]
        return [[a, b, c], [a, c, d]]

    def block(x0, x1, y0, y1, z, top):
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        walls = []
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            walls += [[[ax, ay, z], [bx, by, z], [bx, by, top]], [[ax, ay, z], [bx, by, top], [ax, ay, top]]]
        return walls + quad(x0, x1, y0, y1, top, top)

    ground = []
    for y in range(-200, 200, 20):  # mesh cells
        ground += quad(-200, -20, y, y + 20, 0, 0) + quad(-20, 20, y, y + 20, 0, 20)
        for x in range(20, 200, 20):
            ground += quad(x, x + 20, y, y + 20, 20, 20)
    north, south = block(40, 160, 20, 60, 20, 40), block(40, 160, -60, -20, 20, 40)
    triangles = np.array([*ground, *north, *south], float)
    return triangles, np.repeat([0, 1, 2], [len(ground), len(north), len(south)])


def test_a_drive_on_a_terrace_stands_on_it_and_not_inside_of_the_hill():
    triangles, owner = hill()
    floor = terrain(triangles, owner)
    assert (
        len(floor) < np.sum(owner == 0) and np.ptp(floor[..., 2]) == 20
    )  # the slope is no ground, roofs are not either
    levels, standing = set(), 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        level, spots = level_places(floor, rng)
        levels.add(level)
        assert np.all(spots[:, 0] > 20 if level == 20 else spots[:, 0] < -20)
        placed = place(triangles, OUTDOOR, level, lambda points: np.zeros(len(points), bool), rng, spots)
        if level == 20 and placed is not None:
            standing += 1
            assert placed.receiver_height == 21.5 and placed.station[2] == 28.0 and placed.start[0] > 20
    assert levels == {0.0, 20.0} and standing
