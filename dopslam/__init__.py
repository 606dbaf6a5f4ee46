"""Radio SLAM end to end: ray-traced multipath → channel estimation → SLAM filters → bounds.

The data flow is one direction: ``trace`` → :class:`~dopslam.records.Paths`, ``synthesize`` → signal, ``estimate`` →
:class:`~dopslam.records.DetectionSeries`, ``slam`` → history, ``evaluate`` → report.
"""

__version__ = "0.1.0"
