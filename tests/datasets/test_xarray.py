"""A shard opens in xarray with named dimensions, units and frames."""

import numpy as np
import pytest

from dopslam.records import Paths
from dopslam.store import file as dataset


def test_a_shard_opens_in_xarray(made):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    pytest.importorskip("h5netcdf", reason="h5netcdf is not installed")
    path = made / "shard-00000.h5"
    with xarray.open_dataset(path, group="paths", engine="h5netcdf") as paths:
        assert paths["tau"].dims == ("path",) and paths["vertices"].dims == ("vertex", "xyz")
        assert paths["tau"].attrs["units"] == "s" and paths["phi_r"].attrs["frame"] == "world"
        assert np.array_equal(paths["a"].values, dataset.read_record(path, "paths", Paths).a)
    with xarray.open_dataset(path, group="landmarks", engine="h5netcdf") as landmarks:
        assert landmarks.sizes == {"landmark": 6, "xyz": 3}
        assert landmarks["name"].values.tolist()[:2] == ["BS", "VA wall_east"]
