"""Many robots: what is new is calibrated, nothing is lost; who wears sooner is named, a sound fleet is left alone."""

import json
import shutil
import warnings
from dataclasses import replace
from functools import partial

import distributed
import numpy as np
import pyarrow.parquet
import pytest
import scipy.stats
from fleet_workers import doubled
from hypothesis import given, settings
from hypothesis import strategies as st
from slices import some

from tautline.calibration.beforehand import Beforehand, Spread, free_bending
from tautline.calibration.calibrate import calibrate
from tautline.calibration.options import Options
from tautline.errors import TautError
from tautline.fleet import page, prior, sessions
from tautline.fleet.changes import with_changes
from tautline.fleet.findings import findings
from tautline.fleet.population import _UNTOLD as UNTOLD
from tautline.fleet.population import Curves, log_widths, population, population_of_single_value
from tautline.fleet.rows import DATA_SET, DataSet, Row
from tautline.fleet.run import run
from tautline.geometry import project
from tautline.pool import pool
from tautline.splines import Basis
from tools.fleet import cost, robots

PLACES = np.linspace(-5.0, 5.0, 33)
ROBOTS, SESSIONS = 4, 2


def still(fraction, text):
    """No progress."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small fleet, and what was run of it."""
    folder = tmp_path_factory.mktemp("fleet")
    robots.write(folder / "in", ROBOTS, SESSIONS, worn=1, seed=3, seconds=8.0)
    with pool(1, None) as here:
        done = run(folder / "in", folder / "out", here, still)
    return folder, done


@pytest.fixture
def fleet(made, tmp_path):
    """The same, to be changed."""
    shutil.copytree(made[0] / "in", tmp_path / "in")
    shutil.copytree(made[0] / "out", tmp_path / "out")
    return tmp_path


def page_of(folder):
    return (folder / "out" / page.FILE).read_text()


def again(folder):
    with pool(1, None) as here:
        return run(folder / "in", folder / "out", here, still)


# ---- workers that die


@pytest.mark.parametrize("dies", ["", "once", "always"])
def test_a_worker_that_dies_loses_nothing(tmp_path, dies):
    marked = str(tmp_path / "died") if dies == "once" else dies
    work = ((str(number), (number, marked)) for number in range(8))
    with pool(2, None, lambda name: f"{name} died") as workers:
        done = dict(workers(doubled, work))
    expected = {str(number): 2 * number for number in range(8)}
    assert done == expected | ({"3": "3 died"} if dies == "always" else {})


def test_a_task_that_kills_its_workers_is_named_where_nothing_stands_for_it():
    with pytest.raises(TautError, match="3: every worker that had it died"), pool(2, None) as workers:
        list(workers(doubled, ((str(number), (number, "always")) for number in range(5))))


# ---- what is in a folder


def test_sessions_robots_batches_and_dates(tmp_path):
    for name in ("b/2026-02-01 noon", "b/2026-01-01", "a/first/one", "a/first/two", ".hidden/x", "c/nothing"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("b/2026-02-01 noon", "b/2026-01-01", "a/first/one", "a/first/two", ".hidden/x"):
        (tmp_path / name / "motor.csv").write_text("t_s,q_mm\n")
    (tmp_path / "rig.toml").write_text("of all")
    (tmp_path / "b" / "rig.toml").write_text("of b")
    (tmp_path / "b" / "2026-02-01 noon" / "rig.toml").write_text("its own")
    (tmp_path / "robots.csv").write_text("robot,batch,colour\nb,B7,red\n")
    found = sessions.sessions_in(tmp_path)
    assert [(each.id, each.batch, each.date) for each in found] == [
        ("a/first", None, None),
        ("b/2026-01-01", "B7", "2026-01-01"),
        ("b/2026-02-01 noon", "B7", "2026-02-01"),
        ("c/nothing", None, None),
    ]
    (tmp_path / "robots.csv").write_text("robot, batch\nb, B7\n")
    assert [each.batch for each in sessions.sessions_in(tmp_path)] == [None, "B7", "B7", None]
    with pytest.raises(TautError, match=r"holds no motor.csv"):
        found[3].files()
    assert found[0].files() == {"rig.toml": b"of all", "one/motor.csv": b"t_s,q_mm\n", "two/motor.csv": b"t_s,q_mm\n"}
    assert found[1].files()["rig.toml"] == b"of b"
    assert found[2].files()["rig.toml"] == b"its own"
    (tmp_path / "a" / "first" / "one" / "rig.toml").write_text("the recording's")
    assert sessions.sessions_in(tmp_path)[0].files()["rig.toml"] == b"the recording's"


def test_what_is_followed_in_a_video_goes_with_it(tmp_path):
    names = ("motor.csv", "video.mkv", "region.png", "region.toml")
    folder = tmp_path / "a/one"
    folder.mkdir(parents=True)
    for name in (*names, "notes.txt"):
        (folder / name).write_bytes(b"as it was")
    (session,) = sessions.sessions_in(tmp_path)
    assert sorted(session.files()) == [f"one/{name}" for name in sorted(names)]
    (folder / "marker.csv").write_bytes(b"tracked")
    assert sorted(session.files()) == ["one/marker.csv", "one/motor.csv"]


@pytest.mark.parametrize("folder", ["absent", "."])
def test_a_folder_without_sessions_says_how_to_lay_them_out(tmp_path, folder):
    with pytest.raises(TautError, match="ROBOT/SESSION"):
        sessions.sessions_in(tmp_path / folder)


def test_the_hash_is_of_names_contents_and_version():
    files = {"a/motor.csv": b"1", "rig.toml": b"2"}
    same = sessions.digest(dict(reversed(files.items())), "v1")
    assert sessions.digest(files, "v1") == same
    others = [({**files, "rig.toml": b"3"}, "v1"), (files, "v2"), ({"b/motor.csv": b"1", "rig.toml": b"2"}, "v1")]
    assert same not in {sessions.digest(*each) for each in others}


# ---- runs


def test_every_session_is_a_row_of_the_data_set(made):
    folder, done = made
    assert done.new == len(done.rows) == ROBOTS * SESSIONS
    table = pyarrow.parquet.read_table(folder / "out" / DATA_SET).to_pylist()
    assert [(line["robot"], line["session"]) for line in table] == [(row.robot, row.session) for row in done.rows]
    assert all(line["verdict"] in ("good", "doubtful") and line["error"] is None for line in table)
    assert list(DataSet(folder / "out").read().values()) == list(done.rows)


def test_a_copy_of_a_part_that_something_else_made_is_no_part(fleet):
    (part,) = (fleet / "out" / DATA_SET).iterdir()
    before = DataSet(fleet / "out").read()
    shutil.copy(part, part.with_name(f"{part.stem} (1).parquet"))
    assert DataSet(fleet / "out").read() == before


def test_a_file_in_the_data_sets_place_is_one_line(made, tmp_path):
    (tmp_path / DATA_SET).write_text("no folder")
    with pytest.raises(TautError):
        DataSet(tmp_path).append(made[1].rows)


def test_rows_hold_the_truth_within_their_sigma(made):
    _, done = made
    rig = robots.reference_rig()
    off = []
    for row in done.rows:
        number = int(row.robot[1:])
        worn = row.batch == "worn"
        truth = robots.Robot(3, number, worn).instrument(int(row.session), rig).backlash(np.array(row.q))
        inside = (np.array(row.q) > row.measured_low) & (np.array(row.q) < row.measured_high)
        off.append(((np.array(row.width) - truth) / np.array(row.width_sigma))[inside])
    z = np.concatenate(off)
    assert np.sqrt(np.mean(z**2)) < 1.5  # 1 where the sigmas are right; a few tens of independent values


def test_rows_hold_the_path_that_the_camera_saw(made):
    _, done = made
    rig = robots.reference_rig()
    off = []
    for row in done.rows:
        truth = project(rig, robots.Robot(3, int(row.robot[1:]), row.batch == "worn").instrument(0, rig).bend(PLACES))
        inside = np.tile((row.measured_low < PLACES) & (row.measured_high > PLACES), 2)
        off.append(((np.array(row.path) - truth.T.ravel()) / np.array(row.path_sigma))[inside])
    assert 0.7 < np.sqrt(np.mean(np.concatenate(off) ** 2)) < 1.5  # 1 where the sigmas are right


def test_a_second_run_does_only_what_is_new(fleet):
    assert again(fleet).new == 0
    motor = fleet / "in" / "r0001" / "01" / "motor.csv"
    motor.write_text("\n".join(motor.read_text().splitlines()[:-2]) + "\n")
    shutil.copytree(fleet / "in" / "r0000" / "01", fleet / "in" / "r0000" / "02")
    shutil.rmtree(fleet / "in" / "r0003")
    done = again(fleet)
    assert done.new == 2
    assert [row.id for row in done.rows] == [
        f"r000{k}/0{s}" for k, s in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1)]
    ]


def test_recordings_of_two_rigs_are_no_session(fleet):
    session = fleet / "in" / "r0000" / "00"
    parts = [session.with_name("mixed") / name for name in ("one", "two")]
    for part, gain in zip(parts, (1.0, 1.1), strict=True):
        shutil.copytree(session, part)
        rig = robots.reference_rig()
        replace(rig, coarse=replace(rig.coarse, gain=gain * rig.coarse.gain)).save(part / "rig.toml")
    mixed = next(row for row in again(fleet).rows if row.session == "mixed")
    assert mixed.error == "two: its rig.toml differs from the session's: make it another session"


def test_sessions_that_cannot_be_read_are_done_too(fleet):
    (fleet / "in" / "r0000" / "empty").mkdir()
    (fleet / "in" / "r0003" / "new").mkdir()
    for file in (fleet / "in" / "r0000" / "00").iterdir():
        shutil.copy(file, fleet / "in" / "r0003" / "new")
    told = []
    with pool(1, None) as here:
        run(fleet / "in", fleet / "out", here, lambda share, text: told.append((share, text)))
    assert told[-1][0] == 1.0
    assert any(text.startswith("r0000/empty: holds no motor.csv") for _, text in told)


def test_a_run_that_is_stopped_keeps_what_was_done(fleet):
    shutil.rmtree(fleet / "out")

    def workers(function, work, until=ROBOTS * SESSIONS):
        for count, (name, (begun, _)) in enumerate(work):
            if count == until:
                raise KeyboardInterrupt
            yield name, replace(begun, error="nobody looked")

    with pytest.raises(KeyboardInterrupt):
        run(fleet / "in", fleet / "out", partial(workers, until=2), still)
    assert len(DataSet(fleet / "out").read()) == 2
    assert run(fleet / "in", fleet / "out", workers, still).new == ROBOTS * SESSIONS - 2


def test_a_bad_session_is_a_row_and_no_end(fleet, taut):
    (fleet / "in" / "r0002" / "00" / "motor.csv").write_text("t_s,elsewhere\n0,1\n")
    done = taut("fleet", fleet / "in", "--out", fleet / "out", "--jobs", 1, "--json")
    assert done.code == 0
    said = json.loads(done.out)
    assert (said["new"], list(said["errors"]), said["sessions"]) == (1, ["r0002/00"], ROBOTS * SESSIONS)
    assert "r0002/00: 00/motor.csv: " in done.err
    assert "r0002" in (fleet / "out" / "fleet.html").read_text()


def test_a_session_without_a_recording_is_told(fleet, taut):
    (fleet / "in" / "r0001" / "02").mkdir()
    done = taut("fleet", fleet / "in", "--out", fleet / "out", "--jobs", 1, "--json")
    assert list(json.loads(done.out)["errors"]) == ["r0001/02"]
    assert "r0001/02: holds no motor.csv" in done.err and "holds no motor.csv" in page_of(fleet)


def test_the_page_of_a_sound_fleet_names_its_robots(made):
    folder, done = made
    page.write(done.rows, findings(done.rows), folder / "out")
    said = page_of(folder)
    for robot in {row.robot for row in done.rows}:
        assert f'<td class="text" data-label="robot">{robot}</td>' in said


# ---- what the rows say


def row(robot, session, width, sigma=0.002, batch=None):
    curve = tuple(np.broadcast_to(width, PLACES.shape).tolist())
    straight = tuple((12.0 * PLACES).tolist())
    return Row(
        robot, f"{session:02d}", "x", batch, verdict="good", unit="mm", q=tuple(PLACES.tolist()), width=curve,
        width_sigma=(sigma,) * 33, c_deg=straight, c_sigma_deg=(0.1,) * 33, measured_low=-4.0, measured_high=4.0,
    )  # fmt: skip


def fleet_of(rng, count, growth, sessions=6, batches=None, scatter=0.002):
    """Rows whose B (spread by 30 %, in size and in shape) grows by growth[k] a session."""
    rows = []
    for k in range(count):
        shape = 0.5 * np.exp(rng.normal(0.0, 0.3) + 0.1 * np.sin(0.5 * PLACES + rng.uniform(0.0, 6.0)))
        for session in range(sessions):
            size = (1.0 + growth[k] * session) * (1.0 + rng.normal(0.0, scatter))
            rows.append(row(f"r{k:04d}", session, shape * size, batch=None if batches is None else batches[k]))
    return with_changes(rows)


def test_wear_is_the_growth_of_the_mean_width_and_its_sigma_has_the_scatter():
    rng = np.random.default_rng(5)
    truth = rng.uniform(-0.01, 0.03, 200)
    last = [each for each in fleet_of(rng, 200, truth, scatter=0.01) if each.session == "05"]
    # A line through log(1 + g k) is not quite g: less by g / 2 times the mean of k, here at most 0.001.
    off = np.array([each.wear for each in last]) - truth + 2.5 * truth**2
    sigma = np.array([each.wear_sigma for each in last])
    assert np.median(sigma) == pytest.approx(0.01 / np.sqrt(17.5), rel=0.1)  # 17.5: sum of squares of 0..5 about 2.5
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1.0, abs=0.15)  # 3 / sqrt(2 * 200)


def test_a_later_session_is_told_beside_the_first_usable_one():
    failed = Row("a", "00", "x", error="nothing")
    first, later = row("a", 1, 0.5), replace(row("a", 2, 0.55), c_deg=tuple((12.0 * (PLACES - 0.1)).tolist()))
    rows = with_changes([failed, first, later])
    assert rows[0].since is None and rows[1].since is None and rows[2].since == "01"
    assert rows[2].width_change == pytest.approx(0.1)
    assert rows[2].offset_change == pytest.approx(-0.1)  # the tip is where it was at q - 0.1
    assert rows[2].wear == pytest.approx(np.log(1.1))


@pytest.mark.parametrize("named", [True, False])
def test_a_worn_batch_of_a_few_is_found_and_no_other(named):
    rng = np.random.default_rng(11)
    worn = np.zeros(150, dtype=bool)
    worn[rng.permutation(150)[:6]] = True
    growth = np.where(worn, 0.05, 0.006) * rng.lognormal(0.0, 0.2, 150)
    batches = ["C3" if is_worn else f"A{k % 10}" for k, is_worn in enumerate(worn)] if named else None
    found = findings(fleet_of(rng, 150, growth, batches=batches))
    assert {each.name for each in found.worn} == {f"r{k:04d}" for k in np.flatnonzero(worn)}
    assert [each.name for each in found.worn_batches] == (["C3"] if named else [])


@pytest.mark.parametrize("seed", range(3))
def test_in_a_sound_fleet_nobody_is_worn_or_unlike(seed):
    rng = np.random.default_rng(100 + seed)
    found = findings(fleet_of(rng, 60, 0.006 * rng.lognormal(0.0, 0.3, 60)))
    assert found.worn == () and found.worn_batches == () and found.unlike == ()


def test_a_robot_of_another_shape_is_unlike():
    rng = np.random.default_rng(8)
    rows = fleet_of(rng, 60, np.zeros(60), sessions=1)
    strange = replace(rows[7], width=tuple((0.5 + 0.2 * np.sin(4.0 * PLACES)).tolist()))
    found = findings([*rows[:7], strange, *rows[8:]])
    assert [each.name for each in found.unlike] == ["r0007"]


def test_a_robot_without_backlash_makes_no_others_unknown():
    rows = fleet_of(np.random.default_rng(8), 12, np.zeros(12), sessions=1)
    none = replace(rows[7], width=(0.0,) * 33)
    curves = log_widths([*rows[:7], none, *rows[8:]])
    assert np.isfinite(curves.value).all() and np.isfinite(curves.noise).all()
    assert np.isfinite(population(curves).scale).all()


def test_a_session_that_measured_next_to_nothing_has_no_mean(tmp_path):
    rows = fleet_of(np.random.default_rng(8), 2, np.zeros(2), sessions=1)
    rows[1] = replace(rows[1], measured_low=-4.0, measured_high=-3.9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page.write(rows, findings(rows), tmp_path)
    assert "nan mm" not in (tmp_path / page.FILE).read_text()


def test_a_batch_of_one_robot_is_known_no_better_than_the_robot():
    rng = np.random.default_rng(2)
    growth = np.where(np.arange(30) == 7, 0.08, 0.006) * rng.lognormal(0.0, 0.2, 30)
    found = findings(fleet_of(rng, 30, growth, batches=["A"] * 7 + ["B"] + ["A"] * 22))
    (batch,), (robot,) = found.worn_batches, found.worn
    assert batch.name == "B" and batch.sigma == pytest.approx(robot.sigma) and robot.sigma > 0.0


def test_a_fleet_whose_backlash_shrinks_is_said_to_shrink():
    said = findings(fleet_of(np.random.default_rng(2), 6, np.full(6, -0.01))).sentences()
    assert said[1].startswith("B shrinks by 1 % a session")


def test_two_robots_are_no_fleet_and_nothing_is_said():
    found = findings(with_changes([row("a", 0, 0.5), row("b", 0, 0.7)]))
    assert (found.worn, found.unlike, found.drifting) == ((), (), ())


# ---- how B is spread, and what that tells of the next robot


APART = np.abs(PLACES[:, None] - PLACES[None, :]) / 3.0
SCALE = 0.09 * (0.8 + 0.2 * np.exp(-0.5 * APART**2))  # of log B: 30 %, most of it alike everywhere


def drawn(rng, count, sigma, repeats=1):
    """Curves of a known normal distribution, each seen `repeats` times with errors."""
    truth = -1.0 + rng.multivariate_normal(np.zeros(33), SCALE, count)
    robot = np.repeat(np.arange(count), repeats)
    value = truth[robot] + rng.normal(0.0, sigma, (len(robot), 33))
    return Curves(PLACES, value, np.full(value.shape, sigma), tuple(f"r{k}" for k in robot))


@pytest.mark.parametrize("sigma", [0.003, 0.3])
def test_the_spread_is_the_robots_without_the_sessions_errors(sigma):
    found = population(drawn(np.random.default_rng(2), 120, sigma, repeats=2))
    # Of 120 robots the variance is known to sqrt(2 / 120), 13 %; a heavy tail's scale is up to as much below its
    # variance. With the errors in it it would be twice as much where they are 0.3.
    assert np.trace(found.scale) == pytest.approx(np.trace(SCALE), rel=0.25)


def test_a_new_robot_is_as_far_off_as_the_spread_says():
    rng = np.random.default_rng(3)
    found = population(drawn(rng, 150, 0.003))
    others = drawn(rng, 300, 0.003)
    chance = found.chance(others)
    assert np.mean(chance < 0.1) == pytest.approx(0.1, abs=0.08)


def test_places_that_no_session_told_are_no_dimensions_and_go_on_from_those_that_did():
    """B is held beyond the reversals, where it goes on falling: neither is the spread there nor B what it seems."""
    rng = np.random.default_rng(5)
    fall = -0.03 * PLACES
    seen, others = drawn(rng, 120, 0.003), drawn(rng, 300, 0.003)
    told = (PLACES > -3.2) & (PLACES < 4.7)
    ends = np.clip(np.arange(33), *np.flatnonzero(told)[[0, -1]])
    held = replace(seen, value=(seen.value + fall)[:, ends], sigma=np.where(told, seen.sigma, UNTOLD))
    found = population(held)
    known = np.ix_(told, told)
    # As above; a tail of four degrees of freedom that takes 33 dimensions for the 25 would make it three times as much.
    assert np.trace(found.scale[known]) == pytest.approx(np.trace(SCALE[known]), rel=0.25)
    assert np.mean(found.chance(replace(others, value=others.value + fall)) < 0.1) < 0.2


def test_what_a_delay_is_off_by_is_no_spread_between_robots():
    """Errors that go along the whole curve, most of sigma, in a shape that no robot has."""
    rng, sigma, share = np.random.default_rng(6), 0.01, 0.9
    seen, along = drawn(rng, 150, 1e-9), np.resize([1.0, 1.0, -1.0, -1.0], 33)
    along[-1] = 0.0  # no level in it
    together = share * sigma * along
    own = sigma * np.sqrt(1.0 - share**2) * rng.normal(size=(150, 33))
    off = replace(seen, value=seen.value + own + rng.normal(size=(150, 1)) * together, sigma=np.full((150, 33), sigma))
    left = [
        along @ population(curves).scale @ along / (33 * np.sum(together**2))
        for curves in (off, replace(off, together=np.tile(together, (150, 1))))
    ]
    of_robots = along @ SCALE @ along / (33 * np.sum(together**2))
    assert left[1] - of_robots < 0.3 < 0.7 < left[0] - of_robots  # 1 is all of it taken for robots'


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 3.0))
@settings(max_examples=20, deadline=None)
def test_the_prior_s_gradient_is_that_of_its_logarithm(seed, size):
    rng = np.random.default_rng(seed)
    known = Beforehand(Spread(PLACES, np.full(33, -1.0), SCALE + 0.01 * np.eye(33), 12.0))
    basis = Basis(-5.0, 5.0, 20)
    at = size * np.exp(rng.normal(-1.0, 0.3, basis.size))
    way = rng.normal(size=basis.size)
    step = 1e-6 * float(at.min()) / float(np.abs(way).max())
    rise = known.of_width(basis, at + step * way)[2] - known.of_width(basis, at - step * way)[2]
    # The third value is -2 log p, the gradient half of its: rise / (2 step) = 2 gradient . way.
    assert rise / (4 * step) == pytest.approx(float(known.of_width(basis, at)[1] @ way), rel=1e-4, abs=1e-4)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_what_is_known_of_the_path_is_no_bending_and_the_rest_is(seed):
    """A curve through the places that bends least costs nothing, one that is 0 at them all that it bends."""
    rng, basis = np.random.default_rng(seed), Basis(-5.0, 5.0, 100)
    design, (form, rank) = basis.design(PLACES).toarray(), free_bending(basis, tuple(PLACES.tolist()))
    assert np.linalg.matrix_rank(form, tol=1e-9) == rank == basis.size - 33
    values = rng.normal(size=33)
    bordered = np.block([[basis.bending, design.T], [design, np.zeros((33, 33))]])
    least = np.linalg.solve(bordered, np.concatenate([np.zeros(basis.size), values]))[: basis.size]
    assert least @ form @ least < 1e-9 * (least @ basis.bending @ least)
    whole = rng.normal(size=basis.size)
    rest = whole - np.linalg.solve(bordered, np.concatenate([np.zeros(basis.size), design @ whole]))[: basis.size]
    assert whole @ form @ whole == pytest.approx(rest @ basis.bending @ rest, rel=1e-6)


LATE_SIGMA = 1e-4  # of a session's delay, s


def late_by(rng, spread, count, repeats, delay_s=0.03):
    """Sessions' delays: `count` robots' differ by `spread`, s, each has `repeats` sessions that err by LATE_SIGMA."""
    robot = np.repeat(np.arange(count), repeats)
    value = delay_s + rng.normal(0.0, spread, count)[robot] + rng.normal(0.0, LATE_SIGMA, len(robot))
    return Curves(np.zeros(1), value[:, None], np.full((len(robot), 1), LATE_SIGMA), tuple(f"r{k}" for k in robot))


@pytest.mark.parametrize(("spread", "least", "most"), [(0.0, 0.0, 0.6), (0.5, 0.3, 0.7), (3.0, 2.4, 3.6)])
def test_a_delay_is_spread_as_the_robots_are_and_not_as_their_sessions_err(spread, least, most):
    """In sessions' errors. Of 60 robots' excess variance sqrt(2 / 60) = .18 is not told, a spread of .43: none at all
    stays one of about that."""
    rng = np.random.default_rng(8)
    found = [population_of_single_value(late_by(rng, spread * LATE_SIGMA, 60, 3)) for _ in range(6)]
    scale = np.sqrt(np.mean([known.scale[0, 0] for known in found])) / LATE_SIGMA
    assert least < scale < most
    nine_in_ten = scipy.stats.t.ppf(0.95, found[0].freedom)
    others = 0.03 + rng.normal(0.0, spread * LATE_SIGMA, 300)
    covered = [np.abs(others - known.mean[0]) <= nine_in_ten * np.sqrt(known.scale[0, 0]) for known in found]
    assert np.mean(covered) > 0.87


def test_a_camera_of_another_delay_is_no_usual_one_and_hides_none():
    """One robot in 60 that is 5 ms later leaves the others' spread; its own calibration is hardly held by that."""
    seen = late_by(np.random.default_rng(9), 0.0, 60, 3)
    seen.value[:3] += 5e-3
    found = population_of_single_value(seen)
    assert np.sqrt(found.scale[0, 0]) < 0.7 * LATE_SIGMA
    known = Beforehand(Spread(PLACES, np.zeros(33), SCALE, 4.0), (), Spread(found.q, found.mean, found.scale, 4.0))
    pull = abs(known.of_delay(0.035)[1][0])
    assert pull * LATE_SIGMA < 0.2  # less than a fifth of what one session's frames tell


@pytest.fixture(scope="module")
def known_fleet():
    """The distribution that tools' robots come from, by its own draws: no calibration in it."""
    rig, rng, count = robots.reference_rig(), np.random.default_rng(4), 80
    made = [robots.Robot(9, k).instrument(k % 3, rig) for k in range(count)]
    names = tuple(f"r{k}" for k in range(count))

    def learnt(value, sigma, of_next=False):
        seen = value + sigma * rng.normal(size=value.shape)
        found = population(Curves(PLACES, seen, np.full(value.shape, sigma), names), of_next=of_next)
        return Spread(found.q, found.mean, found.scale, found.freedom)

    width = learnt(np.log([each.backlash(PLACES) for each in made]), 0.002, of_next=True)
    path = np.array([project(rig, each.bend(PLACES)) for each in made])
    late = population_of_single_value(late_by(rng, 0.0, 1000, 1, rig.delay_s))
    delay = Spread(late.q, late.mean, late.scale, late.freedom)
    return Beforehand(width, tuple(learnt(path[:, :, k], 0.014) for k in range(2)), delay)


BETWEEN = (PLACES >= -3.0) & (PLACES <= 4.5)  # the reversals


def beside_truth(numbers, seconds, known=None, rig=None, session=2, **kind):
    """B's error and sigma (robots, places) of robots of tools that are not of the fleet."""
    rig = rig or robots.reference_rig()
    off, sigma = [], []
    for number in numbers:
        robot = robots.Robot(9, number, **kind)
        model = calibrate([robot.recording(session, seconds, rig)], rig, Options(beforehand=known)).model
        off.append(np.interp(PLACES, model.q, model.width) - robot.instrument(session, rig).backlash(PLACES))
        sigma.append(np.interp(PLACES, model.q, model.width_sigma))
    return np.array(off), np.array(sigma)


@pytest.mark.parametrize("worn", some([True, False], 1))
def test_five_seconds_with_a_fleet_cover_over_all_of_the_range(known_fleet, worn):
    """The worn have nine sessions of the worse wear, where the fleet's have three."""
    numbers, session = range(500, 504), 9 if worn else 2
    off, sigma = beside_truth(numbers, 5.0, known_fleet, session=session, worn=worn)
    _, alone = beside_truth(numbers, 5.0, session=session, worn=worn)
    # Four robots have some 40 independent places: 90 % of them to 5 %.
    assert np.mean(np.abs(off / sigma) < 1.645) > 0.8
    assert np.sqrt(np.mean(np.square(sigma))) < 0.2 * np.sqrt(np.mean(np.square(alone)))  # beyond the reversals, too


def test_five_seconds_with_a_fleet_are_no_wider_than_twenty_without(known_fleet):
    """Of these six robots .98 times; without the delay 1.05, what is known of B alone leaves them a fifth wider."""
    numbers, path = range(500, 506), replace(known_fleet, path=())
    all_of_it, no_delay, of_width, long = (
        np.median(beside_truth(numbers, *how)[1][:, BETWEEN])
        for how in ((5.0, known_fleet), (5.0, replace(known_fleet, delay=None)), (5.0, path), (20.0, None))
    )
    assert all_of_it < long
    assert no_delay < 0.88 * of_width


@pytest.mark.parametrize("strange", some(["bent", "moved"], 1))
def test_a_path_that_no_robot_of_the_fleet_has_is_covered_as_without_one(known_fleet, strange):
    """A bend of f_remain ten times as narrow as the fleet's, of 0.1 px; a camera that is 2 mm elsewhere. Taken for one
    of the fleet's 75 to 85 % are covered."""
    rig, kind = robots.reference_rig(), {"bent": 0.01} if strange == "bent" else {}
    if strange == "moved":
        rig = replace(rig, hand_eye=replace(rig.hand_eye, translation_mm=(2.0, 0.0, 0.0)))
    found, without = (
        beside_truth(range(300, 303), 5.0, known, rig, **kind) for known in (known_fleet, replace(known_fleet, path=()))
    )
    np.testing.assert_array_equal(found[1], without[1])


def test_a_fleet_s_prior_is_read_by_the_next_calibration(fleet, taut):
    found = taut("fleet", fleet / "in", "--out", fleet / "out", "--jobs", 1, "--json")
    assert found.code == 0
    one = fleet / "in" / "r0000" / "00"
    with_it = taut("calibrate", one, "--prior", fleet / "out", "--out", fleet / "model", "--json")
    without = taut("calibrate", one, "--out", fleet / "alone", "--json")
    sigma = [json.loads(done.out)["backlash"]["sigma"][0] for done in (with_it, without)]
    assert sigma[0] < 0.5 * sigma[1]  # at the end of the range, which no reversal reached
    assert "known beforehand" in " ".join(json.loads(with_it.out)["notes"])


def test_a_prior_of_other_robots_is_refused(fleet, taut):
    rig = robots.reference_rig()
    rows = fleet_of(np.random.default_rng(1), 5, np.zeros(5), sessions=1)
    prior.write(rows, fleet / "out")
    known = prior.read(fleet / "out", rig)
    assert known.width.q[0] == -5.0
    document = json.loads((fleet / "out" / prior.FILE).read_text())
    del document["delay"]  # as it was written before a fleet told its delay
    (fleet / "out" / prior.FILE).write_text(json.dumps({**document, "format": "prior/2"}))
    assert prior.read(fleet / "out", rig) == replace(known, delay=None)
    with pytest.raises(TautError, match="from -5 to 5 mm, this one from -4 to 5 mm: use a fleet of its own make"):
        prior.read(fleet / "out", replace(rig, actuator=replace(rig.actuator, range=(-4.0, 5.0))))
    with pytest.raises(TautError, match="taut fleet FOLDER --out"):
        prior.read(fleet / "nowhere", rig)
    (fleet / "out" / prior.FILE).unlink()
    with pytest.raises(TautError, match="takes 4 calibrated robots of one range"):
        prior.read(fleet / "out", rig)
    (fleet / "out" / prior.FILE).write_text("{}")
    with pytest.raises(TautError, match="damaged"):
        prior.read(fleet / "out", rig)
    with pytest.raises(TautError, match="3 robots of one range are calibrated"):
        prior.write(rows[:3], fleet / "out")
    done = taut("calibrate", "--simulate", "--prior", fleet / "out", "--out", fleet / "model")
    assert done.code == 2 and "taut record" in done.err


@pytest.mark.long
@pytest.mark.parametrize("dies", ["once", "always"])
def test_a_worker_of_a_cluster_that_dies_loses_nothing(tmp_path, dies):
    marked = str(tmp_path / "died") if dies == "once" else dies
    work = ((str(number), (number, marked)) for number in range(8))
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        pool(None, cluster.scheduler_address, lambda name: f"{name} died") as workers,
    ):
        done = dict(workers(doubled, work))
    expected = {str(number): 2 * number for number in range(8)}
    assert done == expected | ({"3": "3 died"} if dies == "always" else {})


@pytest.mark.long
def test_a_fleet_on_a_cluster_says_the_same(made, tmp_path, taut):
    folder, here = made
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        done = taut("fleet", folder / "in", "--out", tmp_path, "--cluster", cluster.scheduler_address, "--json")
    assert json.loads(done.out)["new"] == ROBOTS * SESSIONS
    there = DataSet(tmp_path).read().values()
    assert [replace(row, seconds=None) for row in there] == [replace(row, seconds=None) for row in here.rows]


# ---- what a campaign costs


def test_an_interrupted_campaign_is_told_as_a_part_and_goes_on(made, tmp_path, monkeypatch):
    shutil.copytree(made[0] / "in", tmp_path / "4")
    for robot in range(ROBOTS):
        shutil.rmtree(tmp_path / "4" / f"r{robot:04d}" / "01")
    whole, out = cost.Cost(ROBOTS, 1, ROBOTS, 8.0), tmp_path / "4-by-1"
    run_all = cost.run

    def stopped(folder, result, workers, progress):
        def until(share, what):
            progress(share, what)
            if share > 0.3:
                raise KeyboardInterrupt

        return run_all(folder, result, workers, until)

    monkeypatch.setattr(cost, "run", stopped)
    with pytest.raises(KeyboardInterrupt):
        cost.measure(tmp_path / "4", out, whole)
    assert not cost.Cost.read(out / cost.FILE).whole
    assert "2 of 4 sessions in 1 calls" in cost.told(tmp_path)[0]
    assert not (tmp_path / "cost.svg").exists()
    monkeypatch.setattr(cost, "run", run_all)
    cost.measure(tmp_path / "4", out, whole)
    known = cost.Cost.read(out / cost.FILE)
    assert known.whole and [part.sessions for part in known.parts] == [2, 2]
    assert known.cores_s == pytest.approx(sum(part.cores_s for part in known.parts))
    cost.measure(tmp_path / "4", out, whole)  # nothing is new
    assert cost.Cost.read(out / cost.FILE) == known
    assert "4 sessions in 2 calls" in cost.told(tmp_path)[0] and (tmp_path / "cost.svg").exists()
