"""Studies: reproducible for any number of workers, consistent filters, and controls that must fail."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dopslam.cli import main
from dopslam.evaluate.metrics import nees, state_errors
from dopslam.models.scans import Scans
from dopslam.pipeline.problem import told
from dopslam.simulate.world import section_v, simulate
from dopslam.slam.history import COLUMNS, history_of
from dopslam.slam.pmb import ek_pmb
from dopslam.slam.pmb.ek_pmb import Diagnostics
from dopslam.slam.pmb.filters import Joint, Marginal
from dopslam.studies.montecarlo import Study, correct_association_weight, run_once, run_study, summarize

RUNS = 60
mc = pytest.mark.mc


@mc
def test_same_numbers_for_any_number_of_workers():
    study = Study(section_v(), Joint(iterations=2))
    results = [summarize(run_study(study, 4, seed=3, jobs=jobs), study) for jobs in (1, 2)]
    for result in results:
        result.pop("microseconds_per_step")
    assert results[0] == results[1]


@mc
def test_joint_filter_is_efficient_and_consistent():
    """Sixty runs: NEES near 4, RMSE at the bound, and not below it beyond Monte Carlo error."""
    study = Study(section_v(), Joint(iterations=2))
    result = summarize(run_study(study, RUNS, seed=7), study)
    low, high = result["nees_interval"]
    assert low < 4.9 and 3.6 < high < 6.0
    for name in ("position", "heading", "clock"):
        low, high = result["rmse_over_bound_interval"][name]
        assert high > 1.0 and low < 1.15
    assert result["diverged"] == 0
    assert result["gospa_va_m"]["last"] < 2.5 and result["gospa_sp_m"]["last"] < 1.8
    assert 0.9 < result["nis_per_row"] < 1.1


@mc
def test_marginal_density_is_overconfident():
    """Negative control and the paper's own loss: NEES far above 4."""
    study = Study(section_v(), Marginal(iterations=2))
    result = summarize(run_study(study, 20, seed=7), study)
    assert result["nees_mean"] > 15
    assert result["rmse_over_bound"]["position"] > 1.25


def changed(scans: Scans, control: str) -> Scans:
    if control == "R times 2":
        return replace(scans, covariance=2 * scans.covariance)
    if control == "R halved":
        return replace(scans, covariance=0.5 * scans.covariance)
    flipped = scans.z.copy()
    flipped[:, 5] *= -1
    return replace(scans, z=flipped)


@mc
@pytest.mark.parametrize(
    ("control", "low", "high"),
    [("R times 2", 0.0, 0.85), ("R halved", 1.25, 3.0), ("flipped Doppler", 1.2, np.inf)],
)
def test_wrong_assumptions_leave_the_band(control, low, high):
    """NIS per row, or the NEES for the flipped sign (whose measurements are gated away)."""
    world = section_v()
    nis, values = [], []
    for run in range(15):
        states, scans = simulate(world, 7, run)
        history, diagnostics = ek_pmb.run(
            changed(scans, control), (world.prior_mean, world.prior_covariance), world.motion, world.bs
        )
        nis.append(diagnostics.nis.sum() / diagnostics.nis_rows.sum())
        values.append(nees(state_errors(history.mean, states), history.covariance).mean() / 4)
    figure = np.mean(values) if control == "flipped Doppler" else np.mean(nis)
    assert low < figure < high


@mc
def test_a_wrong_speed_breaks_the_known_speed_filter_only():
    """A 2 % error in an assumed-known speed, side by side with speed and turn rate in the state."""
    from dopslam.simulate.world import unknown_motion

    truth = section_v()
    wrong = replace(truth.motion, speed=1.02 * truth.motion.speed)
    six = unknown_motion(truth)
    mean = six.prior_mean * [1, 1, 1, 1, 1.02, 1]
    known = Study(truth, Joint(iterations=2), replace(told(truth), motion=wrong))
    unknown = Study(truth, Joint(iterations=2), replace(told(six), mean=mean))
    errors = []
    for study in (known, unknown):
        results = [run_once(study, 9, run) for run in range(20)]
        errors.append(np.sqrt(np.mean([r.squared["position"] for r in results])))
    assert errors[0] > 1.5 * errors[1]


@mc
def test_heavy_clutter_and_many_misses_do_not_break_it():
    world = section_v()
    hard = replace(world, clutter_count=20.0, noise=replace(world.noise, detection_probability=0.7))
    from dopslam.models.detection import ConstantDetection

    study = Study(hard, Joint(iterations=2), replace(told(hard), detection=ConstantDetection(0.7)))
    result = summarize(run_study(study, 12, seed=1), study)
    assert result["diverged"] == 0


def test_weight_of_the_correct_association():
    """Three scans told by hand: a birth, its detection beside clutter, and a wrong association."""
    scans = Scans(
        z=np.zeros((5, 6)),
        covariance=np.tile(np.eye(6), (5, 1, 1)),
        offsets=np.array([0, 2, 4, 5]),
        clutter_count=1.0,
        search_volume=1.0,
        doppler_span=1.0,
        label=np.array([0, 2, 2, -1, 2]),
    )
    diagnostics = Diagnostics(
        nis=np.zeros(3),
        nis_rows=np.zeros(3, dtype=int),
        weights=(np.array([1.0]), np.array([0.7, 0.3]), np.array([0.6, 0.4])),
        associations=(np.array([[-1, -2]]), np.array([[1, -2], [-2, 1]]), np.array([[-2], [1]])),
        existence=(np.zeros(2), np.zeros(2), np.zeros(1)),
    )
    table = np.zeros((2, COLUMNS))
    table[:, 12], table[:, 14] = 0.9, 1  # one track, existing in the first two steps
    history = history_of(np.zeros((3, 4)), np.zeros((3, 4, 4)), np.array([0, 1, 2, 2]), table)
    np.testing.assert_allclose(correct_association_weight(scans, diagnostics, history), [1.0, 0.7, 0.4])


def test_bound_table_from_the_command_line(tmp_path, capsys):
    target = tmp_path / "bound.csv"
    main(["bound", "ring_road", "--doppler-std", "none", "--visibility", "50", "--csv", str(target)])
    lines = target.read_text().splitlines()
    assert lines[0].startswith("step,peb_m,heb_rad,ceb_m,leb_VA0_m") and len(lines) == 41
    assert lines[1].split(",")[0] == "1" and lines[1].endswith(",,")  # two scatter points not seen yet
    assert "p_D = 1" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--doppler-std", "-1"], ["--visibility", "far"], ["--set", "filter.gat=3"]])
def test_bad_options_are_one_line(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["bound", "ring_road", *arguments])
    assert stop.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@mc
def test_montecarlo_from_the_command_line(tmp_path):
    target = tmp_path / "out.json"
    arguments = ["--runs", "2", "--jobs", "1", "--filter", "smoother", "--json", str(target)]
    main(["montecarlo", "ring_road", *arguments])
    result = json.loads(target.read_text())
    assert set(result["rmse_over_bound"]) == {"position", "heading", "clock"}
    for key in (
        "nees_mean",
        "gospa_va_m",
        "gospa_sp_m",
        "correct_da_weight",
        "diverged",
        "microseconds_per_step",
    ):
        assert key in result
    assert len(result["per_step"]["rmse_position"]) == 40
