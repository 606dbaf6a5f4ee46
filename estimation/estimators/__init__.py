"""The estimators by name, the only place where names are spelled, and how one's own takes its place among them.

A kind is a name of :data:`ESTIMATORS`, the name of an entry point in the group ``dopslam.estimators``, or
``"module:Class"`` (``"path/to/file.py:Class"`` for a module that is not installed). The class is called with the
:class:`~estimation.SignalModel` and those of the offered options that its signature names; its
``run(signal, noise_variance=None, prior=None)``, of which only ``signal`` must be accepted, returns
:class:`~estimation.Detections` (:meth:`~estimation.Detections.of` makes them from a path table and covariances).
"""

from __future__ import annotations

import difflib
import inspect
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import EstimationError, ModelError
from ..plugins import Table, blamed

if TYPE_CHECKING:
    from ..detections import Detections
    from ..signal.model import SignalModel

ESTIMATORS = Table(
    "estimator",
    "dopslam.estimators",
    {
        "nomp": "estimation.estimators.nomp:Nomp",
        "sage": "estimation.estimators.sage:Sage",
        "esprit": "estimation.estimators.esprit:Esprit",
    },
    ModelError,
)
"""The estimators that there are; none is imported before it is used."""


class Estimator(Protocol):
    """What the pipeline asks of an estimator."""

    def run(self, signal: Any) -> Detections:
        """The paths in one received burst (``model.shape``)."""
        ...


def find(kind: str) -> type:
    """The class of a kind.

    Raises
    ------
    ModelError
        if there is no such name, module or class, or the class has no ``run``.
    """
    found = ESTIMATORS[kind]
    if not callable(getattr(found, "run", None)):
        raise ModelError(
            f"estimator {kind!r}: {found.__name__} has no method run(signal) that returns estimation.Detections"
        )
    return found


def make(kind: str, model: SignalModel, own: dict[str, Any] | None = None, **offered: Any) -> Estimator:
    """An estimator of a link.

    Parameters
    ----------
    kind : as in :func:`find`
    model : the link
    own : options for this estimator; each must be in its signature
    offered : options that are passed on if the signature names them

    Raises
    ------
    ModelError
        for an unknown kind, or an option in ``own`` that the estimator does not have.
    """
    cls = find(kind)
    try:
        parameters = inspect.signature(cls).parameters.values()
    except (TypeError, ValueError):
        parameters = []
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters)
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)][1:]
    for option in own or {}:
        if not open_ended and option not in names:
            near = difflib.get_close_matches(option, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(names) or 'none'}"
            raise ModelError(f"estimator {kind!r}: it has no option {option!r}; {hint}")
    taken = {name: value for name, value in offered.items() if open_ended or name in names}
    with blamed(cls, f"estimator {kind!r} cannot be made", ModelError):
        return cls(model, **(taken | (own or {})))


def estimated(estimator: Estimator, signal: Any) -> Detections:
    """What an estimator finds in a burst, and a clear word if that is not detections.

    Raises
    ------
    EstimationError
        if ``run`` returns anything but :class:`~estimation.Detections`.
    """
    from ..detections import Detections

    with blamed(estimator, f"estimator {type(estimator).__name__}: run(signal)", EstimationError):
        found = estimator.run(signal)
    if not isinstance(found, Detections):
        raise EstimationError(
            f"estimator {type(estimator).__name__}: run(signal) must return estimation.Detections, "
            f"got {type(found).__name__}; estimation.Detections.of(paths, covariance, ...) makes them"
        )
    if np.einsum("nii->ni", found.covariance).min(initial=1.0) <= 0:
        raise EstimationError(
            f"estimator {type(estimator).__name__}: a covariance of its detections has no positive variance"
        )
    return found
