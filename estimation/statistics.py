"""95 % intervals of figures over runs, for every study of the house: each method stands here and nowhere else.

Which one for what: :func:`bootstrap` for any statistic of runs that are drawn independently; :func:`mean` (Student) for
means over few runs; :func:`proportion` for shares; :func:`median` for medians; :func:`half_width` for means over many
errors, where the normal distribution holds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta, binom
from scipy.stats import t as student

PERCENTILES = (2.5, 97.5)
DRAWS = 1000


def bootstrap(
    values: np.ndarray | Sequence[np.ndarray],
    statistic: Callable[..., float] = np.mean,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[float]:
    """Percentile interval of ``statistic(*columns)`` over runs drawn with replacement.

    Parameters
    ----------
    values : (R, ...) one row per run, or several such columns that are drawn together
    """
    columns = values if isinstance(values, list | tuple) else [values]
    runs = len(columns[0])
    indices = np.random.default_rng(seed).integers(0, runs, (draws, runs))
    return percentiles([statistic(*(column[index] for column in columns)) for index in indices])


def percentiles(samples: Sequence[float]) -> list[float]:
    """Both ends of the interval, from samples of a statistic."""
    return [float(q) for q in np.percentile(samples, PERCENTILES)]


def average_and_last(values: np.ndarray) -> dict:
    """Time average and last step of (R, K) values of runs, each with its bootstrap interval."""
    average, last = values.mean(axis=1), values[:, -1]
    return {
        "average": float(average.mean()),
        "average_interval": bootstrap(average),
        "last": float(last.mean()),
        "last_interval": bootstrap(last),
    }


def mean(values) -> dict:
    """Mean and Student's interval; a single value has none."""
    values = np.asarray(values, float)
    half = 0.0
    if len(values) > 1:
        half = float(student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    center = float(values.mean())
    return {"mean": center, "low": center - half, "high": center + half}


def half_width(deviation, count: int):
    """Half of the normal interval of a mean over ``count`` values of a standard deviation."""
    return 1.96 * deviation / np.sqrt(max(count, 1))


def proportion(successes: int, trials: int) -> tuple[float, float]:
    """Interval of Clopper and Pearson."""
    low = 0.0 if successes == 0 else float(beta.ppf(0.025, successes, trials - successes + 1))
    high = 1.0 if successes == trials else float(beta.ppf(0.975, successes + 1, trials - successes))
    return low, high


def share(successes: int, trials: int) -> dict:
    """A share with its interval of Clopper and Pearson; of nothing it may be anything."""
    if not trials:
        return {"value": float("nan"), "low": 0.0, "high": 1.0}
    low, high = proportion(successes, trials)
    return {"value": successes / trials, "low": low, "high": high}


def median(values) -> dict:
    """A median and its interval from order statistics; values that are not finite are left out."""
    values = np.sort(np.asarray([v for v in values if np.isfinite(v)], dtype=float))
    count = len(values)
    if not count:
        return {"value": float("nan"), "low": float("nan"), "high": float("nan")}
    below = int(binom.ppf(0.025, count, 0.5))
    low, high = values[max(below - 1, 0)], values[min(count - max(below, 1), count - 1)]
    return {"value": float(np.median(values)), "low": float(low), "high": float(high)}
