"""Scenes from what people have: floor plans, maps and models, turned into shapes with materials.

A reader takes a file and options and returns shapes; :data:`READERS` finds it by the file's ending. Plans and maps are
drawn from above and raised to heights; models are taken as they are.
"""

from dopslam.scenes.plans.read import READERS, read_plan

__all__ = ["READERS", "read_plan"]
