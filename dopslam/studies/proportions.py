"""Intervals of shares and medians over scenes."""

from __future__ import annotations

import numpy as np
from scipy.stats import beta, binom


def share(successes: int, trials: int) -> dict:
    """A share and its 95 % interval (Clopper and Pearson)."""
    if not trials:
        return {"value": float("nan"), "low": 0.0, "high": 1.0}
    low = float(beta.ppf(0.025, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(0.975, successes + 1, trials - successes)) if successes < trials else 1.0
    return {"value": successes / trials, "low": low, "high": high}


def median(values) -> dict:
    """A median and its 95 % interval from order statistics."""
    values = np.sort(np.asarray([v for v in values if np.isfinite(v)], dtype=float))
    count = len(values)
    if not count:
        return {"value": float("nan"), "low": float("nan"), "high": float("nan")}
    below = int(binom.ppf(0.025, count, 0.5))
    low, high = values[max(below - 1, 0)], values[min(count - max(below, 1), count - 1)]
    return {"value": float(np.median(values)), "low": float(low), "high": float(high)}
