"""From histories and bounds to the summary of a run: records in, plain figures out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dopslam.config.scenario import Scenario
from dopslam.errors import DopslamError
from dopslam.evaluate import community, mapping
from dopslam.evaluate import detections as matching
from dopslam.evaluate.bounds import Bound
from dopslam.evaluate.run import Evaluation, evaluate_run, summarize
from dopslam.evaluate.walls import Walls, wall_figures, wall_list, walls
from dopslam.filters import FILTERS
from dopslam.pipeline import link
from dopslam.pipeline.problem import chosen_filter
from dopslam.records import DetectionSeries, Landmarks, Paths, Track
from dopslam.slam.filter import later
from dopslam.slam.history import History
from estimation.evaluate import Match, associate

WITHOUT = ", no Doppler"


def variant_name(name: str, doppler: bool) -> str:
    """Name of a filter variant in tables and files: the filter's, and whether it left Doppler out though it could."""
    return name if doppler else name + WITHOUT


def split_variant(variant: str) -> tuple[str, bool]:
    """The filter's name and whether it uses Doppler; the inverse of :func:`variant_name`."""
    return variant.removesuffix(WITHOUT), not variant.endswith(WITHOUT)


def largest_order(name: str, landmarks: Landmarks) -> int:
    """Reflections of a virtual anchor that the map of this filter may hold; second reflections are a kind of their own."""
    limit = getattr(FILTERS[name], "largest_order", 1) if name in FILTERS else 1
    return int(landmarks.order.max()) if limit is None else limit


def match_series(scenario: Scenario, track: Track, paths: Paths, detections: DetectionSeries) -> list[Match]:
    """Optimal assignment of the detections of every step to its true paths."""
    model, noise = link.signal_model(scenario), link.noise_variance(scenario)
    return [
        associate(model, matching.snapshot(model, detections, k), link.path_table(scenario, track, paths, k), noise)
        for k in range(paths.steps)
    ]


def judged(
    scenario: Scenario,
    seed: int,
    truth: tuple[Track, Landmarks, Paths | None],
    detections: DetectionSeries | None,
    histories: Mapping[str, History],
    bounds: Mapping[str, Bound],
    failed: dict[str, str] | None = None,
) -> tuple[dict, dict[str, Evaluation]]:
    """Summary of filter variants and the evaluations behind it.

    Parameters
    ----------
    scenario, seed : of the run; how a map is judged stands in ``[evaluation]``
    truth : of the run
    detections : that the filters read; None: what they tell is left out
    histories : by variant name (:func:`variant_name`)
    bounds : by variant name; that of the whole run for a filter that reads it before it answers; none where no true map is
        known
    failed : with it a variant that cannot be judged is added (name → why) and the others are judged
    """
    track, landmarks, paths = truth
    evaluations = {}
    for name, history in histories.items():
        order = largest_order(split_variant(name)[0], landmarks)
        try:
            evaluations[name] = evaluate_run(scenario, track, landmarks, history, bounds.get(name), order)
        except (DopslamError, ValueError, ArithmeticError) as error:
            if failed is None:
                raise
            failed[f"evaluate {name}"] = str(error)
    if not evaluations:
        raise DopslamError(f"no filter's history could be judged: {failed}")
    radius = scenario.evaluation.found_radius
    matches = None if paths is None or detections is None else match_series(scenario, track, paths, detections)
    seen = mapping.steps_seen(matches, paths, landmarks, 1.0 if detections is None else detections.threshold)
    found = {name: walls_of(scenario, histories[name]) for name in evaluations}
    variants = {
        name: {"bound": _own_bound(scenario, name)}
        | summarize(e, landmarks, radius)
        | community.figures(
            track,
            landmarks,
            histories[name],
            scenario.filter.report_existence,
            scenario.evaluation.gospa_cutoff,
            scenario.evaluation.gospa_order,
            largest_order(split_variant(name)[0], landmarks),
        )
        | ({"nis_per_row": histories[name].nis_per_row} if np.isfinite(histories[name].nis_per_row) else {})
        | {"detections_passed_over": histories[name].passed_over}
        | wall_figures(found[name], landmarks, radius)
        | {"walls": wall_list(found[name], landmarks, radius)}
        | mapping.fate(landmarks, histories[name], scenario.filter.report_existence, *seen).figures(landmarks)
        for name, e in evaluations.items()
    }
    main = next((v for v in variants if split_variant(v)[0] == scenario.filter.density), next(iter(variants)))
    summary = {
        "scenario": scenario.name, "seed": seed, "filter": main, "found_within_m": radius,
        **variants[main],
        "detections": _told(detections, matches),
        "variants": variants,
        **({"failed": dict(failed)} if failed else {}),
    }  # fmt: skip
    return summary, evaluations


def walls_of(scenario: Scenario, history: History) -> Walls:
    """The walls of a run's final map, as far as the scenario reports its landmarks."""
    height, least = scenario.receiver.height, scenario.filter.report_existence
    return walls(history, np.array(scenario.base_station.position), height, threshold=least)


def _own_bound(scenario: Scenario, variant: str) -> str:
    """What the bound of a variant's estimates is called."""
    name, _ = split_variant(variant)
    smoothed, lag = later(chosen_filter(scenario, name)) if name in FILTERS else (False, None)
    return "filtering" if not smoothed else "smoothing" if lag is None else f"lag {lag}"


def _told(detections: DetectionSeries | None, matches: list[Match] | None) -> dict:
    if matches is not None:
        return matching.figures(matches)
    return {} if detections is None else {"per_snapshot": len(detections.delay) / detections.steps}
