"""Angles that count the wrong way are found by what single scans make of them."""

from dataclasses import replace

import numpy as np
import pytest

from dopslam.records import SPEED_OF_LIGHT, BaseStations, DetectionSeries, edges_of
from dopslam.slam.snapshot.conventions import CLEAR, check_conventions

from .rooms import room


@pytest.fixture(scope="module")
def measured():
    """Scans of one room each, as one series: the stations differ, so that each scan has its own."""
    rays = [room(seed)[1] for seed in (3, 5, 8)]
    z = np.concatenate([r.z for r in rays])
    units = np.array([1 / SPEED_OF_LIGHT, 1, 1, 1, 1, 1])
    covariance = np.concatenate([r.covariance for r in rays]) * units[:, None] * units
    counts = [len(r.z) for r in rays]
    series = DetectionSeries(
        offsets=edges_of(counts), delay=z[:, 0] / SPEED_OF_LIGHT, aoa=z[:, 1:3], aod=z[:, 3:5], radial_velocity=z[:, 5],
        gain=np.zeros(len(z), complex), covariance=covariance, snr=np.ones(len(z)), noise_variance=np.ones(3),
        threshold=1.0, false_alarm_rate=1.0, search_volume=1e6, anchor=np.repeat(np.arange(3), counts),
    )  # fmt: skip
    return series, BaseStations(np.array([r.anchor[0] for r in rays]), np.zeros(3)), rays[0].height


def test_right_angles_raise_no_doubt(measured):
    found = check_conventions(*measured)
    assert found.best == "as told"
    assert found.doubt is None
    assert len(found.evidence) == 4


@pytest.mark.parametrize("end", ["aoa", "aod"])
def test_a_flipped_azimuth_is_named_whichever_end_it_is(measured, end):
    series, stations, height = measured
    wrong = replace(series, **{end: getattr(series, end) * [-1.0, 1.0]})
    found = check_conventions(wrong, stations, height)
    assert found.best == "AOA azimuth (or AOD azimuth) flipped"
    assert "check how your angles count" in found.doubt
    assert found.evidence[found.best] - found.evidence["as told"] > CLEAR


def test_a_mirrored_world_cannot_be_seen(measured):
    series, stations, height = measured
    mirrored = replace(series, aoa=series.aoa * [-1.0, 1.0], aod=series.aod * [-1.0, 1.0])
    assert check_conventions(mirrored, stations, height).doubt is None
