"""Means and differences with their 95 % intervals, over runs and over the steps of one run; the methods are those of
:mod:`estimation.statistics`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimation import statistics

DRAWS = 2000


class Interval(NamedTuple):
    """A figure and its 95 % interval; the interval is NaN where one value alone says nothing about it."""

    value: float
    low: float
    high: float


def over_runs(values) -> Interval:
    """Mean of independent runs, Student's interval: what other runs of the same kind would give on average."""
    values = np.asarray(values, float)
    if len(values) < 2:
        return Interval(float(values.mean()) if len(values) else np.nan, np.nan, np.nan)
    return Interval(*statistics.mean(values).values())


def block_length(steps: int) -> int:
    """Steps that are drawn together: 2 K^(1/3), so that errors which last some steps stay together."""
    return int(np.ceil(2 * steps ** (1 / 3)))


def over_steps(errors, others=None, seed: int = 0) -> Interval:
    """Root mean square over the steps of one run, or its difference to that of another filter on the same steps.

    Steps are not independent: a filter's error lasts. The interval is that of a circular block bootstrap (Politis and
    Romano 1992). It says how much the figure hangs on single stretches of this run, not what another run would give.

    Parameters
    ----------
    errors, others : (K,) errors at the same steps
    seed : of the draws
    """
    squares = np.square(np.asarray(errors, float))
    against = np.zeros_like(squares) if others is None else np.square(np.asarray(others, float))
    steps = len(squares)
    block = block_length(steps)
    value = float(np.sqrt(squares.mean()) - np.sqrt(against.mean()))
    if steps < 2 * block:
        return Interval(value, np.nan, np.nan)
    first = np.random.default_rng(seed).integers(0, steps, (DRAWS, -(-steps // block)))
    chosen = ((first[..., None] + np.arange(block)) % steps).reshape(DRAWS, -1)[:, :steps]
    drawn = np.sqrt(squares[chosen].mean(axis=1)) - np.sqrt(against[chosen].mean(axis=1))
    return Interval(value, *statistics.percentiles(drawn))
