"""Other programs' files, in and out: one module per format, found by name.

A format is a class that says whether it ``writes`` and ``reads``, and does it::

    class Mine:
        writes, reads = True, False

        def write(self, parts, out): ...         # parts of a dataset (dopslam.datasets.parts.Part) into the folder `out`
        def read(self, path, mapping): ...       # -> dopslam.formats.contract.Opened

``dopslam export DATA --to my_file.py:Mine`` and ``dopslam import FILE --format my_file.py:Mine`` take it; a package installed
beside adds its own by an entry point of the group ``dopslam.formats``.
"""

from __future__ import annotations

from dopslam.errors import DatasetError
from estimation.plugins import Table

FORMATS = Table(
    "format",
    "dopslam.formats",
    {
        "mat": "dopslam.formats.mat:Mat",
        "deepmimo": "dopslam.formats.deepmimo:DeepMimo",
        "tum": "dopslam.formats.tum:Tum",
        "sigmf": "dopslam.formats.sigmf:SigMf",
        "csv": "dopslam.formats.csv_tables:Csv",
        "geojson": "dopslam.formats.geojson:GeoJson",
        "gltf": "dopslam.formats.mesh:Gltf",
        "ply": "dopslam.formats.mesh:Ply",
        "mcap": "dopslam.formats.mcap:Mcap",
        "rrd": "dopslam.formats.rrd:Rrd",
        "drives": "dopslam.formats.drives:Drives",
        "table": "dopslam.formats.table:ForeignTable",
    },
    DatasetError,
)
"""The only place where the names of formats are spelled."""
