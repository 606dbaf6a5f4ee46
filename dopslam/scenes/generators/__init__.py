"""Random scenes of a kind: a seed gives buildings or furniture, a base station, a panel's direction and a track.

``[scene] generator = "street"`` with a ``seed`` fills whatever a scenario does not say itself: see :mod:`.fill`.
"""

from dopslam.scenes.generators.draft import Generated
from dopslam.scenes.generators.kinds import GENERATORS, generate
from dopslam.scenes.generators.mitsuba import scene_xml

__all__ = ["GENERATORS", "Generated", "generate", "scene_xml"]
