"""Walls behind virtual anchors: planes, their uncertainty, their extent, their errors."""

import numpy as np
import pytest

from dopslam.evaluate.walls import plane_jacobian, plane_of, true_walls, wall_errors, wall_figures, wall_list, walls
from dopslam.records import Kind, Landmarks, Track
from dopslam.slam import history as histories

BS = np.array([3.0, -2.0, 10.0])
WALL = np.array([50.0, -2.0, 10.0])  # mirrors the base station at x = 26.5


def made(anchors, steps=5, existence=1.0, spread=0.01):
    """A history whose every step holds the same virtual anchors, seen from a drive along y."""
    table = np.zeros((steps * len(anchors), histories.COLUMNS))
    table[:, :3] = np.tile(anchors, (steps, 1))
    table[:, 3:12] = (spread * np.eye(3)).ravel()
    table[:, 12], table[:, 13], table[:, 14] = existence, 1.0, Kind.VA
    table[:, 15] = np.tile(np.arange(len(anchors)), steps)
    mean = np.column_stack([np.full(steps, 10.0), np.linspace(-8, 8, steps), np.zeros(steps), np.zeros(steps)])
    offsets = len(anchors) * np.arange(steps + 1)
    return histories.history_of(mean, np.tile(0.01 * np.eye(4), (steps, 1, 1)), offsets, table)


def landmarks(*anchors):
    kind = np.array([Kind.BS] + [Kind.VA] * len(anchors), np.int8)
    name = np.array(["BS", *(f"VA {i}" for i in range(len(anchors)))])
    return Landmarks(name, kind, np.array([BS, *anchors]), np.array([0] + [1] * len(anchors)))


def test_the_plane_mirrors_the_base_station_to_its_anchor():
    rng = np.random.default_rng(0)
    anchor = rng.normal(size=(20, 3)) * 30
    normal, offset = plane_of(BS, anchor)
    mirrored = BS + 2 * (offset - normal @ BS)[:, None] * normal
    np.testing.assert_allclose(mirrored, anchor, atol=1e-12)


def test_the_jacobian_against_central_differences():
    rng = np.random.default_rng(1)
    anchor, step = rng.normal(size=3) * 30, 1e-5
    numeric = np.empty((4, 3))
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        ends = [np.append(*plane_of(BS, anchor + s * shift)) for s in (1, -1)]
        numeric[:, axis] = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(plane_jacobian(BS, anchor), numeric, atol=1e-8)


def test_a_wall_spans_the_incidence_points_and_stands_upright():
    found = walls(made([WALL]), BS, 1.5)
    corners = found.corners[0]
    np.testing.assert_allclose(corners[:, 0], 26.5, atol=1e-9)
    assert np.ptp(corners[:, 1]) > 5 and np.ptp(corners[:2, 2]) < 1e-9
    # An anchor off by δ along the normal moves the wall by δ/2.
    np.testing.assert_allclose(found.deviation[0], 0.05, rtol=0.05)


def test_a_wall_seen_once_and_a_floor_are_drawn_too():
    once = walls(made([WALL], steps=1), BS, 1.5)
    assert np.all(np.isfinite(once.corners)) and np.ptp(once.corners[0], axis=0).max() >= 1.0
    floor = walls(made([[3.0, -2.0, -10.0]]), BS, 1.5)
    np.testing.assert_allclose(floor.corners[0][:, 2], 0.0, atol=1e-9)


def test_doubtful_anchors_are_no_walls_and_an_empty_map_has_none():
    assert len(walls(made([WALL], existence=0.3), BS, 1.5)) == 0
    partner, distance, angle = wall_errors(walls(made([WALL], existence=0.3), BS, 1.5), landmarks(WALL), BS)
    assert len(partner) == len(distance) == len(angle) == 0


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_errors_of_walls_are_distance_and_angle_to_the_true_one(shift):
    other = np.array([3.0, 60.0, 10.0])
    found = walls(made([other, WALL + np.array([2 * shift, 0, 0])]), BS, 1.5)
    partner, distance, angle = wall_errors(found, landmarks(WALL, other), BS)
    assert partner.tolist() == [2, 1]
    np.testing.assert_allclose(distance, [0, shift], atol=1e-9)
    np.testing.assert_allclose(angle, 0, atol=1e-7)


def test_an_anchor_in_the_base_station_has_no_wall():
    assert len(walls(made([BS, WALL]), BS, 1.5)) == 1


def test_figures_count_walls_near_true_ones_and_name_what_they_are_off_by():
    other, ghost = np.array([3.0, 60.0, 10.0]), np.array([-70.0, 20.0, 10.0])
    found = walls(made([WALL + np.array([0.4, 0, 0]), ghost]), BS, 1.5)
    figures = wall_figures(found, landmarks(WALL, other), radius=1.0)
    assert (figures["walls_found"], figures["walls_total"], figures["walls_false"]) == (1, 2, 1)
    np.testing.assert_allclose(figures["wall_distance_m"], 0.2, atol=1e-9)
    assert figures["wall_angle_deg"] == pytest.approx(0.0, abs=1e-5)
    none = wall_figures(walls(made([ghost]), BS, 1.5), landmarks(WALL), radius=1.0)
    assert none["wall_distance_m"] is None and none["walls_false"] == 1


def test_a_turned_wall_is_no_wall_found_however_near_it_is():
    """A wall seen in one point lies near any other one that passes there."""
    turned = BS + np.linalg.norm(WALL - BS) * np.array([np.cos(0.5), np.sin(0.5), 0.0])
    found = walls(made([turned, WALL + np.array([0.1, 0, 0])], steps=1), BS, 1.5)
    partner, distance, _ = wall_errors(found, landmarks(WALL), BS)
    assert partner.tolist() == [-1, 1] and distance[1] == pytest.approx(0.05, abs=1e-6)
    figures = wall_figures(walls(made([turned]), BS, 1.5), landmarks(WALL), radius=100.0)
    assert (figures["walls_found"], figures["walls_false"]) == (0, 1)


def test_true_walls_lie_where_the_true_track_sees_them():
    history = made([WALL])
    position = np.column_stack([history.mean[:, :2], np.full(history.steps, 1.5)])
    zero = np.zeros(history.steps)
    track = Track(np.arange(history.steps, dtype=float), position, zero, np.zeros_like(position), zero, np.zeros(4))
    np.testing.assert_allclose(true_walls(track, landmarks(WALL)).corners, walls(history, BS, 1.5).corners, atol=1e-9)


def test_the_band_of_a_wall_holds_95_of_100_draws():
    rng, spread = np.random.default_rng(2), 0.04
    found = walls(made([WALL], spread=spread), BS, 1.5)
    normal, offset = plane_of(BS, WALL + rng.normal(scale=np.sqrt(spread), size=(4000, 3)))
    share = np.mean(np.abs(normal @ found.center[0] - offset) < 1.96 * found.deviation[0])
    assert 0.93 < share < 0.97


def test_walls_are_told_one_by_one_the_widest_first_and_a_wall_of_nothing_has_no_name():
    ghost = WALL + np.array([0, 90.0, 0])
    found = walls(made([ghost, WALL + np.array([0.2, 0, 0])]), BS, 1.5)
    listed = wall_list(found, landmarks(WALL), 1.0)
    assert sorted(str(wall["name"]) for wall in listed) == ["0", "None"]
    (true,) = (wall for wall in listed if wall["name"])
    np.testing.assert_allclose([true["distance_m"], true["angle_deg"]], [0.1, 0.0], atol=1e-9)
    assert listed[0]["width_m"] >= listed[1]["width_m"] and true["std_m"] > 0
    assert "distance_m" not in next(wall for wall in listed if not wall["name"])
