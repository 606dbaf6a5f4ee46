"""``dopslam import``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dopslam.cli.common import Settings, overrides

if TYPE_CHECKING:
    from dopslam.config.scenario import Scenario


def import_(
    table: Path,
    *,
    scene: str | None = None,
    out: Path,
    mapping: Annotated[Path | None, Parameter(name="--map")] = None,
    form: Annotated[str, Parameter(name="--format")] = "table",
    track: Path | None = None,
    settings: Settings = None,
) -> None:
    """Turn foreign detections into a dataset file that 'dopslam slam' runs on, or channel measurements into one for
    'dopslam estimate'.

    Parameters
    ----------
    table
        CSV with a header, or a MATLAB file (before v7.3) of equally long vectors; one row per detected path. Channel
        measurements: .npy, .npz, .mat or HDF5.
    mapping
        TOML that says what the columns of a table mean, in which unit and convention. Of channel measurements: what the
        axes mean and what the link is. All keys, with examples: python -m pydoc dopslam.formats.table (or .csi).
    form
        Format of the file: table, csi (channel measurements), or one of your own, module:Class or file.py:Class.
    scene
        Folder with scenario.toml, or the name of a scene that ships: base station, motion model, filter. Not with csi, whose
        mapping says it all.
    out
        Dataset file to make.
    track
        CSV with the true track (time, x, y, …) if it is known; evaluation needs it.
    settings
        Override a scenario key, for instance --set track.speed=0.
    """
    from dataclasses import replace

    import numpy as np
    from rich.console import Console

    from dopslam.config import trackfile
    from dopslam.config.measured import Shown
    from dopslam.config.scenario import load
    from dopslam.datasets import tracks
    from dopslam.errors import DatasetError
    from dopslam.formats.contract import opened as open_foreign
    from dopslam.formats.shown import shown_by
    from dopslam.pipeline import problem as build
    from dopslam.store import file as dataset

    if out.exists():
        raise DatasetError(f"{out}: exists already; remove it or name another file with --out")
    if form == "csi":
        if mapping is None or scene is not None or track is not None:
            raise DatasetError(
                f"{table}: channel measurements need --map, which says it all, without --scene and --track"
            )
        return _channel(table, mapping, out, overrides(settings))
    if scene is None:
        raise DatasetError(f"{table}: give --scene, a folder with scenario.toml or the name of a scene that ships")
    opened = open_foreign(form, table, mapping)
    kind, period = "traced" if opened.snr else "model", opened.period

    def world_of(shown: Shown, *more: str) -> Scenario:
        return load(scene, [f"source.kind={kind}", *flags, *more], replace(shown, period=period))

    flags = overrides(settings)
    flags = [*flags, *_told_by(period, world_of(Shown()), flags)]
    world, truth = world_of(Shown()), None
    if track is not None:
        own = world_of(Shown(), 'dataset.tracks.kind="file"', f"dataset.tracks.file={str(track.resolve())!r}")
        source = tracks.sampled(own, 0)
        truth, _ = source.part(0, int(source.lengths.sum()))
        if "bias" not in trackfile.read_rows(track, "--track"):  # the clock's truth is not known then
            truth = replace(truth, bias=np.full(truth.steps, np.nan))
    found = opened.detections(world, truth)
    shown = shown_by(found, period, opened.doppler)
    world = world_of(shown, f"track.steps={max(found.steps, 1)}")
    found = opened.detections(world, truth)  # searched as wide as they show
    records = {"base_stations": build.base_stations(world), "detections": found}
    if truth is not None:
        records |= {"track": truth, "landmarks": build.model_landmarks(world)}
    dataset.write_records(out, records, world.to_toml(), 0)
    doubt = _doubt(found, records["base_stations"], world.receiver.height)
    turned = None if truth is None else _turned(found, truth, records["base_stations"])
    for remark in (*opened.remarks, *(text for text in (doubt, turned) if text)):
        Console(stderr=True, soft_wrap=True, markup=False).print(f"look: {remark}")
    hint = "" if opened.doppler else " --doppler-std none"
    Console(highlight=False, soft_wrap=True, markup=False).print(
        f"{out}: {len(found.delay)} detections in {found.steps} snapshots; next: dopslam slam {out}{hint}"
    )


def _channel(table: Path, mapping: Path, out: Path, flags: list[str]) -> None:
    from rich.console import Console

    from dopslam.formats import csi
    from dopslam.pipeline import problem as build
    from dopslam.store import file as dataset

    found = csi.read(table, mapping, flags)
    dataset.write_records(out, {"base_stations": build.base_stations(found.scenario)}, found.scenario.to_toml(), 0)
    dataset.write_signal(out, iter(found.snapshots), len(found.snapshots))
    if found.doubt:
        Console(stderr=True, soft_wrap=True, markup=False).print(f"look: {found.doubt}")
    shape = " × ".join(str(length) for length in found.snapshots.shape[1:])
    Console(highlight=False, soft_wrap=True, markup=False).print(
        f"{out}: {len(found.snapshots)} snapshots of {shape} samples; next: dopslam estimate {out}"
    )


def _doubt(found, stations, height: float) -> str | None:
    """Whether the angles seem to count the other way round; silent where single scans have nothing to say."""
    import numpy as np

    from dopslam.slam.snapshot.conventions import check_conventions

    try:
        return check_conventions(found, stations, height).doubt
    except np.linalg.LinAlgError:  # advice only: what is wrong with the covariances a filter will say
        return None


def _turned(found, truth, stations) -> str | None:
    """Whether the departures along the true track speak for another orientation of the base station than the one that is told."""
    import numpy as np

    from dopslam.models.measurement import wrap
    from dopslam.slam.orientation import yaw_of_track

    yaw = yaw_of_track(found, truth.position, stations)
    if yaw is None or not abs(wrap(yaw.value - stations.yaw[0])) > max(3 * yaw.std, np.deg2rad(0.2)):
        return None
    seen, told, std = np.degrees([yaw.value, stations.yaw[0], yaw.std])
    return (
        f"base_station.yaw_deg: along the true track the departures speak for {seen:.2f} ± {std:.2f}, told are {told:.2f}; "
        f"--set base_station.yaw_deg={seen:.2f} if the track is in the base station's frame"
    )


def _told_by(period: float | None, world: Scenario, flags: list[str]) -> list[str]:
    """Settings that the time stamps decide: the period, and with it how far the receiver strays in one."""

    def given(key: str) -> bool:
        return any(text.replace(" ", "").startswith(f"track.{key}=") for text in flags)

    if period is None or given("period"):
        return []
    told = [f"track.period={period!r}"]
    if not given("process_std") and "process_std" not in world.derived.get("track", {}):
        # A walk: its variance is in proportion to the time.
        share = (period / world.track.period) ** 0.5
        told.append(f"track.process_std={[float(std * share) for std in world.track.process_std]}")
    return told
